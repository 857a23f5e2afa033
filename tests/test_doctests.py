"""The examples in docstrings give what they show."""

import doctest
import importlib
from pathlib import Path

import pytest

SRC = Path(__file__).parents[1] / "src"
WITH_EXAMPLES = sorted(
    ".".join(path.relative_to(SRC).with_suffix("").parts[1:]).removesuffix(".__init__")
    for path in SRC.glob("*/*/**/*.py")
    if ">>> " in path.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_examples_of_docstrings(module, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = doctest.DocTestFinder(exclude_empty=True).find(importlib.import_module(module))
    examples = [case for case in found if case.examples]
    assert examples, "`>>>` stands where doctest does not look"
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    shown = []
    for case in examples:
        runner.run(case, out=shown.append)
    assert not runner.failures, "".join(shown)
