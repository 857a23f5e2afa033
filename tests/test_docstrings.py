"""Public docstrings are numpydoc: every parameter, each with its type and what it is."""

import ast
from pathlib import Path

import pytest
from numpydoc.docscrape import NumpyDocString

SRC = Path(__file__).parents[1] / "src"
MODULES = sorted(p.relative_to(SRC) for p in SRC.glob("*/*/**/*.py"))
SECTIONS = ("Parameters", "Attributes", "Returns", "Yields", "Raises")
FRAGMENTS = ("Of ", "That ", "Which ", "Whose ", "Those ", "With ", "Its ")
"""Beginnings of a description that does not name the thing, as in "Of the starts."."""


def public(tree):
    """(where, node, parameters) of public classes, functions and methods."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield node.name, node, parameters(node)
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            init = [n for n in node.body if isinstance(n, ast.FunctionDef) and n.name == "__init__"]
            yield node.name, node, [p for n in init for p in parameters(n)]
            for method in node.body:
                if (
                    isinstance(method, ast.FunctionDef)
                    and not method.name.startswith("_")
                    and "overload" not in map(ast.unparse, method.decorator_list)
                ):
                    found = parameters(method)
                    # one parameter may be told by the summary
                    yield f"{node.name}.{method.name}", method, found if len(found) > 1 else []


def parameters(function):
    arguments = function.args
    every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    return [a.arg for a in every if a.arg not in ("self", "cls") and not a.arg.startswith("_")]


def faults(module):
    for where, node, wanted in public(ast.parse((SRC / module).read_text())):
        docstring = NumpyDocString(ast.get_docstring(node) or "")
        entries = {
            section: [(p.name, p.type, p.desc) for p in docstring[section]] for section in SECTIONS
        }
        named = {n.strip() for name, _, _ in entries["Parameters"] for n in name.split(",")}
        named |= {n.strip() for name, _, _ in entries["Attributes"] for n in name.split(",")}
        if missing := [name for name in wanted if name not in named]:
            yield f"{where}: Parameters lacks {', '.join(missing)}"
        for section, rows in entries.items():
            for name, kind, text in rows:
                if not text:
                    yield f"{where}: {section}: {name or kind}: has no description under its type"
                if " ".join(text).startswith(FRAGMENTS):
                    yield f"{where}: {section}: {name or kind}: does not say what it is: {text[0]}"
                if section in ("Parameters", "Attributes") and not kind:
                    yield f"{where}: {section}: {name}: has no type"


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_public_docstrings_say_type_and_meaning_of_every_parameter(module):
    assert list(faults(module)) == []
