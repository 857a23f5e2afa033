"""Mutation tests of the codec and the limits: do the tests notice when the code is changed?

    python tests/mutation.py [part of a file's name]

One operator or number after the other is changed in the files below, and their tests are run until
one fails. What survives is printed with its line, and the exit status is 1 unless it is in
`EQUIVALENT`: changes that make no difference, each with the reason.
"""

import ast
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path

os.environ["NUMBA_DISABLE_JIT"] = "1"  # a changed kernel is not compiled

import numpy
import pytest

__all__ = ["numpy"]  # imported once, before the forks

ROOT = Path(__file__).parents[1]
TIMEOUT = 120.0  # s; a mutant that hangs is noticed


@dataclass(frozen=True)
class Target:
    """A module, the functions to change in it (all where empty), and the tests that must notice."""

    module: str
    tests: tuple[str, ...]
    functions: tuple[str, ...] = ()

    @property
    def path(self) -> Path:
        package = self.module.partition(".")[0]
        return ROOT / "src" / package / f"{self.module.replace('.', '/')}.py"


TARGETS = (
    Target(
        "tricycle_bridge.protocol.framing",
        (
            "tests/tricycle_bridge/protocol/test_messages.py",
            "tests/tricycle_bridge/protocol/test_framing.py",
        ),
    ),
    Target(
        "tricycle_bridge.protocol.messages",
        (
            "tests/tricycle_bridge/protocol/test_messages.py",
            "tests/tricycle_bridge/protocol/test_framing.py",
        ),
        # its numbers are held by the test of the firmware's header
        ("low", "high", "size", "layout", "payload", "from_payload", "of", "guarded", "echo_of"),
    ),
    Target("tricycle_sim.setpoints", ("tests/tricycle_sim/test_setpoints.py",)),
    Target(
        "tricycle_sim.plc.plc",
        ("tests/tricycle_sim/plc/test_plc.py",),
        ("_limit", "_take_command", "_accept_command", "_check_watchdog", "_arm"),
    ),
)

# (module, changed line without its indentation): why it is no change
EQUIVALENT: dict[tuple[str, str], str] = {
    ("tricycle_sim.setpoints", "if abs(target - setpoint) <= reach:"): "both branches agree there",
    (
        "tricycle_sim.setpoints",
        "return setpoint + reach if target > setpoint else setpoint - reach",
    ): "they are not equal there",
    (
        "tricycle_sim.setpoints",
        "if behind > rate * TICK * (1.0 + 1e-6):",
    ): "no lag is that margin to the last bit",
}

OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Add, ast.LShift: ast.RShift,
    ast.RShift: ast.LShift, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.And: ast.Or,
    ast.Or: ast.And, ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult, ast.Div: ast.Mult,
}  # fmt: skip


class Mutator(ast.NodeTransformer):
    """Makes the change number `wanted`; counts changes where it is negative."""

    def __init__(self, functions: tuple[str, ...], wanted: int = -1) -> None:
        self.functions, self.wanted = functions, wanted
        self.count, self.line = 0, 0
        self._inside = not functions

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        before, self._inside = self._inside, self._inside or node.name in self.functions
        node.args.defaults = [self.visit(default) for default in node.args.defaults]
        node.body = [self.visit(statement) for statement in node.body]
        self._inside = before
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        node.value = node.value and self.visit(node.value)
        return node

    def _chosen(self, node: ast.expr) -> bool:
        self.count += self._inside
        if not self._inside or self.count - 1 != self.wanted:
            return False
        self.line = node.lineno
        return True

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        self.generic_visit(node)
        for k, operator in enumerate(node.ops):
            if self._chosen(node):
                node.ops[k] = OPERATORS[type(operator)]()
        return node

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        if type(node.op) in OPERATORS and self._chosen(node):
            node.op = OPERATORS[type(node.op)]()
        return node

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        self.generic_visit(node)
        if self._chosen(node):
            node.op = OPERATORS[type(node.op)]()
        return node

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        self.generic_visit(node)
        return node.operand if self._chosen(node) else node

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        if isinstance(node.value, bool):
            return (
                ast.copy_location(ast.Constant(not node.value), node)
                if self._chosen(node)
                else node
            )
        if isinstance(node.value, int | float) and self._chosen(node):
            return ast.copy_location(ast.Constant(node.value + 1), node)
        return node


class Mutant(MetaPathFinder, Loader):
    """Gives the changed module to whoever imports it."""

    def __init__(self, target: Target, tree: ast.Module) -> None:
        self.target, self.tree = target, tree

    def find_spec(self, fullname, path=None, target=None):
        if fullname == self.target.module:
            return ModuleSpec(fullname, self, origin=str(self.target.path))
        return None

    def create_module(self, spec):
        return None

    def exec_module(self, module):
        module.__file__ = str(self.target.path)
        exec(compile(self.tree, self.target.path, "exec"), module.__dict__)


def mutants(target: Target) -> Iterator[tuple[int, ast.Module]]:
    """Line and module of each change."""
    source = target.path.read_text()
    counter = Mutator(target.functions)
    counter.visit(ast.parse(source))
    for wanted in range(counter.count):
        mutator = Mutator(target.functions, wanted)
        tree = ast.fix_missing_locations(mutator.visit(ast.parse(source)))
        yield mutator.line, tree


def noticed(target: Target, tree: ast.Module) -> bool:
    """Whether a test fails, in a process of its own."""
    child = os.fork()
    if child == 0:
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        sys.meta_path.insert(0, Mutant(target, tree))
        options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:tricycle", "-m", "not slow"]
        try:
            status = int(pytest.main([*options, *target.tests]))
        except BaseException:
            status = 1
        os._exit(status)
    deadline = time.monotonic() + TIMEOUT
    while time.monotonic() < deadline:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status != 0
        time.sleep(0.01)
    os.kill(child, 9)
    os.waitpid(child, 0)
    return True


def main() -> int:
    """Try every change; print what survives and the totals."""
    os.chdir(ROOT)
    survivors = 0
    for target in TARGETS:
        if not any(part in target.module for part in sys.argv[1:] or [""]):
            continue
        lines = target.path.read_text().splitlines()
        whole = ast.parse(target.path.read_text())
        if noticed(target, whole):
            raise SystemExit(f"{target.module}: its tests fail without any change")
        killed = equivalent = total = 0
        for line, tree in mutants(target):
            total += 1
            if noticed(target, tree):
                killed += 1
            elif (target.module, lines[line - 1].strip()) in EQUIVALENT:
                equivalent += 1
            else:
                survivors += 1
                print(
                    f"  survived: {target.path.name}:{line}: {lines[line - 1].strip()}", flush=True
                )
        print(f"{target.module}: {killed} of {total} noticed, {equivalent} equivalent", flush=True)
    return int(survivors > 0)


if __name__ == "__main__":
    sys.exit(main())
