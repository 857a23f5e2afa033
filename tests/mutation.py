"""Mutation tests of codec, limits and watchdog: do the tests notice when the code is changed?

    python tests/mutation.py [part of a file's name]
    python tests/mutation.py firmware           # the C code alone

One operator or number after the other is changed in the files below, and their tests are run until
one fails. What survives is printed with its line, and the exit status is 1 unless it is in
`EQUIVALENT`: changes that make no difference, each with the reason. Python is changed in its syntax
tree. C is changed in its text, token by token, and compiled as the library of the host.
"""

import ast
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from typing import Any, TypeVar

os.environ["NUMBA_DISABLE_JIT"] = "1"  # a changed kernel is not compiled

import numba
import numpy
import pytest

__all__ = ["numba", "numpy"]  # imported once, before the forks

ROOT = Path(__file__).parents[1]
TIMEOUT = 120.0  # s; a mutant that hangs is noticed
CPU_LIMIT = 60  # s; the same for one in C
PYTEST_OPTIONS = ("-x", "-q", "-p", "no:cacheprovider", "-m", "not slow",
                  "-W", "ignore::pytest.PytestAssertRewriteWarning")  # fmt: skip
T = TypeVar("T")


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
        (
            "tests/tricycle_sim/plc/test_operations.py",
            "tests/tricycle_sim/plc/test_setup.py",
            "tests/tricycle_sim/plc/test_plc.py",
            "tests/tricycle_sim/plc/test_protocol_document.py",
        ),
        (
            "clamp",
            "in_order",
            "to_i16",
            "to_u16",
            "_accept_command",
            "_check_watchdog",
            "_arm",
            "_clear",
            "_operate",
            "_set_up",
            "_supply_wrong",
            "_limited",
            "_is_stale",
            "_answer",
        ),
    ),
    Target(
        "tricycle_sim.plc.steer",
        (
            "tests/tricycle_sim/plc/test_steer.py",
            "tests/tricycle_sim/plc/test_setup.py",
            "tests/tricycle_sim/plc/test_protocol_document.py",
        ),
        ("_take_command", "_find_fault", "_control", "_allowed", "_begin_tick", "_servo_on"),
    ),
    Target(
        "tricycle_sim.plc.drive",
        (
            "tests/tricycle_sim/plc/test_drive.py",
            "tests/tricycle_sim/plc/test_setup.py",
            "tests/tricycle_sim/plc/test_protocol_document.py",
        ),
        (
            "_take_command",
            "_find_fault",
            "_control",
            "_allowed",
            "_begin_at_speed",
            "_follow_command",
            "_stop",
            "_ready",
            "_stopped",
            "_wheel_fails",
        ),
    ),
)


@dataclass(frozen=True)
class FirmwareTarget:
    """A file of the firmware, the boards to compile, and the tests that must notice its changes."""

    file: str
    boards: tuple[str, ...]
    tests: tuple[str, ...]
    functions: tuple[str, ...] = ()  # all where empty

    @property
    def module(self) -> str:
        return f"firmware/{self.file}"

    @property
    def path(self) -> Path:
        return ROOT / "firmware" / self.file


_STEER, _DRIVE, _PLC, _OPERATIONS, _SETUP, _CODEC, _DOCUMENT = (
    f"tests/tricycle_sim/plc/test_{name}.py"
    for name in ("steer", "drive", "plc", "operations", "setup", "firmware", "protocol_document")
)
_FULL_LINE = f"{_CODEC}::test_a_full_line_drops_whole_frames_and_counts_them"
_BOTH = ("steer", "drive")
_ALIVE = "test_the_alive_output_toggles_while_the_board_acts"
FIRMWARE_TARGETS = (
    FirmwareTarget(
        "frame.c",
        ("steer",),
        (
            f"{_CODEC}::test_every_segment_is_judged_alike",
            f"{_CODEC}::test_random_frames_are_byte_identical",
            f"{_CODEC}::test_damaged_streams_are_judged_alike",
        ),
    ),
    FirmwareTarget(
        "plc.c",
        _BOTH,
        (_PLC, _OPERATIONS, _SETUP, _FULL_LINE, f"{_CODEC}::{_ALIVE}", _DOCUMENT),
    ),
    FirmwareTarget("plc.h", _BOTH, (_STEER, _DRIVE), ("clamp", "slew")),
    FirmwareTarget(
        "steer.c",
        _BOTH,
        (_STEER, _SETUP, f"{_CODEC}::test_the_servo_pulse_is_exact_for_every_setpoint"),
    ),
    # motor.c and wheel.c estimate: their tests compare within tolerances
    FirmwareTarget(
        "drive.c",
        _BOTH,
        (_DRIVE, _SETUP, _CODEC),
        (
            "at_rest",
            "board_accepts",
            "drive_push",
            "drive_pwm",
            "drive_throttle",
            "board_find_fault",
            "board_stopped",
            "board_ready",
            "board_armed",
            "board_disarmed",
            "board_take_command",
            "target_of",
            "begin_at_speed",
            "follow",
            "stop",
            "board_control",
            "board_send_state",
            "board_send_limits",
        ),
    ),
)

# (module, line without its indentation; of C the changed line): why it is no change
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
    ("firmware/plc.h", "return value <= low ? low : value > high ? high : value;"): "low is low",
    ("firmware/plc.h", "return value < low ? low : value >= high ? high : value;"): "high is high",
    (
        "firmware/steer.c",
        "board->rate_limit = rate <= fastest ? rate : fastest;",
    ): "both are the same there",
    (
        "firmware/steer.c",
        "int32_t more = setpoint * (16L * SERVO_SPAN) + (setpoint <= 0 ? -full : full) / 2;",
    ): "half a unit is rounded off at 0, whatever its sign",
    (
        "firmware/steer.c",
        "int32_t more = setpoint * (16L * SERVO_SPAN) + (setpoint < 1 ? -full : full) / 2;",
    ): "half a unit is rounded off at 0, whatever its sign",
    (
        "firmware/steer.c",
        "(int16_t)((board->setpoint + (board->setpoint <= 0 ? -5 : 5)) / 10),",
    ): "half a unit is rounded off at 0, whatever its sign",
    (
        "firmware/steer.c",
        "(int16_t)((board->setpoint + (board->setpoint < 1 ? -5 : 5)) / 10),",
    ): "half a unit is rounded off at 0, whatever its sign",
    (
        "firmware/drive.c",
        "(int16_t)((board->setpoint + (board->setpoint <= 0 ? -50 : 50)) / 100),",
    ): "half a unit is rounded off at 0, whatever its sign",
    (
        "firmware/drive.c",
        "(int16_t)((board->setpoint + (board->setpoint < 1 ? -50 : 50)) / 100),",
    ): "half a unit is rounded off at 0, whatever its sign",
    (
        "firmware/drive.c",
        "board->acceleration_limit = acceleration <= most ? acceleration : most;",
    ): "both are the same there",
    (
        "firmware/drive.c",
        "board->commanded_brake = command.brake <= MAX_BRAKE ? command.brake : MAX_BRAKE;",
    ): "both are MAX_BRAKE there",
    ("firmware/drive.c", "board->motor.integral = 1;"): "0.1 um",
    (
        "firmware/drive.c",
        "int32_t more = board->torque <= 0 ? -MAX_TORQUE / 2 : MAX_TORQUE / 2;",
    ): "half a unit is rounded off at 0, whatever its sign",
    (
        "firmware/drive.c",
        "int32_t more = board->torque < 1 ? -MAX_TORQUE / 2 : MAX_TORQUE / 2;",
    ): "half a unit is rounded off at 0, whatever its sign",
    (
        "firmware/plc.c",
        "return !plc->commanded || age >= 255 ? 255 : (uint8_t)age;",
    ): "both are 255 there",
    (
        "firmware/plc.c",
        "struct pong pong = { 1, now, now };",
    ): "the token is written over it",
    ("firmware/frame.c", "static const uint32_t table[17] = {"): "the last is not used",
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


# what a token of C becomes; binary operators stand between spaces in this code, pointers do not
C_TOKENS = {
    r"(?<= )<=(?= )": "<", r"(?<= )<(?= )": "<=", r"(?<= )>=(?= )": ">", r"(?<= )>(?= )": ">=",
    "==": "!=", "!=": "==", "&&": "||", r"\|\|": "&&", r"(?<= )<<(?= )": ">>",
    r"(?<= )>>(?= )": "<<", r"(?<= )\+(?= )": "-", r"(?<= )-(?= )": "+", r"(?<= )\*(?= )": "+",
    r"(?<= )/(?= )": "*", r"(?<= )&(?= )": "|", r"(?<= )\|(?= )": "&", r"(?<= )\^(?= )": "|",
    r"\+=": "-=", "-=": "+=", r"\|=": "&=", "&=": "|=", r"\^=": "|=", r"\+\+": "--", "--": "++",
    r"!(?!=)": "", "~": "", r"(?<=[ (])-(?=\w)": "", r"\btrue\b": "false", r"\bfalse\b": "true",
}  # fmt: skip
C_NUMBER = re.compile(r"(?<![\w.])(0x[0-9A-Fa-f]+|\d+)(U?L?)\b")
C_HIDDEN = re.compile(
    r'/\*.*?\*/|"[^"\n]*"|^#(?:\\\n|[^\n])*|\bcase .*?:', re.DOTALL | re.MULTILINE
)
C_FUNCTION = re.compile(r"^\w[^;\n]*?(\w+)\([^;{]*\)\n\{\n(.*?)^\}", re.DOTALL | re.MULTILINE)


def firmware_mutants(target: FirmwareTarget) -> Iterator[tuple[int, str]]:
    """Line and text of the file for each change."""
    source = target.path.read_text()
    visible = C_HIDDEN.sub(lambda hidden: re.sub(r"[^\n]", "\0", hidden[0]), source)
    changes = []
    for function in C_FUNCTION.finditer(visible):
        if target.functions and function[1] not in target.functions:
            continue
        start, end = function.span(2)
        changes += [
            (number.span(1), str(int(number[1], 0) + 1))
            for number in C_NUMBER.finditer(visible, start, end)
        ]
        for token, becomes in C_TOKENS.items():
            found = re.compile(token).finditer(visible, start, end)
            changes += [(match.span(), becomes) for match in found]
    for (start, end), becomes in sorted(changes):
        yield source.count("\n", 0, start) + 1, source[:start] + becomes + source[end:]


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
    """Whether a test fails with a changed module."""
    return fails(target.tests, lambda: sys.meta_path.insert(0, Mutant(target, tree)))


class FirmwareMutation:
    """A plugin of pytest: it collects the tests once and runs them for every change, in forks."""

    def __init__(self, target: FirmwareTarget) -> None:
        self.target = target
        self.survivors = 0

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session):
        items = list(session.items)

        def is_noticed(_target, text):
            with tempfile.TemporaryDirectory() as folder:
                libraries = self.compile(text, Path(folder))
                failed = libraries is None or self.first_failure(items, libraries)
            if isinstance(failed, int) and failed > 0:
                items.insert(0, items.pop(failed - 1))  # likely to notice the next change, too
            return failed != 0

        text = self.target.path.read_text()
        changes = firmware_mutants(self.target)
        self.survivors = survivors_of(self.target, text, changes, is_noticed)
        return True

    def compile(self, text: str, folder: Path) -> Path | None:
        """Libraries with a changed file; None where it does not compile without a warning."""
        firmware, build = folder / "firmware", folder / "build"
        shutil.copytree(self.target.path.parent, firmware)
        (firmware / self.target.file).write_text(text)
        wanted = [f"{build}/lib{board}.so" for board in self.target.boards]
        make = ["make", "-s", "-C", firmware, f"BUILD={build}", "OPTIMISE=-O0", *wanted]
        done = subprocess.run(make, capture_output=True, check=False)
        return build if done.returncode == 0 else None

    def first_failure(self, items: list[pytest.Item], libraries: Path) -> int:
        """Number of the first test that fails, from 1; 0: none; -1: it crashed or hangs."""
        result, write = os.pipe()
        child = os.fork()
        if child == 0:
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, 1)
            os.dup2(null, 2)
            resource.setrlimit(resource.RLIMIT_CPU, (CPU_LIMIT, CPU_LIMIT))
            os.environ["FIRMWARE_LIBRARIES"] = str(libraries)
            failed, session = 0, items[0].session
            for k, (item, following) in enumerate(zip(items, [*items[1:], None], strict=True)):
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
                if session.testsfailed:
                    failed = k + 1
                    break
            os.write(write, failed.to_bytes(2, "little"))
            os._exit(0)
        os.close(write)
        with os.fdopen(result, "rb") as pipe:
            answer = pipe.read()
        os.waitpid(child, 0)
        return int.from_bytes(answer, "little") if answer else -1


def firmware_survivors(target: FirmwareTarget) -> int:
    """Try every change of a file of the firmware; print what survives and the totals."""
    mutation = FirmwareMutation(target)
    options = [
        "-p",
        "no:faulthandler",
        "-qq",
        "--no-header",
        "--no-summary",
        "--capture=no",
        "-k",
        "firmware",
    ]
    pytest.main([*PYTEST_OPTIONS, *options, *target.tests], plugins=[mutation])
    return mutation.survivors


def fails(tests: tuple[str, ...], prepare: Callable[[], None]) -> bool:
    """Whether a test fails, in a process of its own."""
    child = os.fork()
    if child == 0:
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        prepare()
        os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # starts sooner
        try:
            status = int(pytest.main([*PYTEST_OPTIONS, *tests]))
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


def survivors_of(
    target: Target | FirmwareTarget,
    unchanged: T,
    changes: Iterator[tuple[int, T]],
    is_noticed: Callable[[Any, T], bool],
) -> int:
    """Try every change of a target; print what survives and the totals."""
    lines = target.path.read_text().splitlines()
    if is_noticed(target, unchanged):
        raise SystemExit(f"{target.module}: its tests fail without any change")
    killed = equivalent = survivors = 0
    for line, changed in changes:
        of_c = isinstance(changed, str)
        text = (changed.splitlines() if of_c else lines)[line - 1].strip()
        if is_noticed(target, changed):
            killed += 1
        elif (target.module, text) in EQUIVALENT:
            equivalent += 1
        else:
            survivors += 1
            print(f"  survived: {target.path.name}:{line}: {text}", flush=True)
    total = killed + equivalent + survivors
    print(f"{target.module}: {killed} of {total} noticed, {equivalent} equivalent", flush=True)
    return survivors


def main() -> int:
    """Try every change; return 1 where one survives."""
    os.chdir(ROOT)
    survivors = 0
    for target in TARGETS:
        if any(part in target.module for part in sys.argv[1:] or [""]):
            whole = ast.parse(target.path.read_text())
            survivors += survivors_of(target, whole, mutants(target), noticed)
    for of_c in FIRMWARE_TARGETS:
        if any(part in of_c.module for part in sys.argv[1:] or [""]):
            survivors += firmware_survivors(of_c)
    return int(survivors > 0)


if __name__ == "__main__":
    sys.exit(main())
