"""Commands import what they need when they run: help and mistakes are answered at once."""

import json
import subprocess
import sys

import pytest

from tricycle_cli.main import COMMANDS

SLOW = {
    *("scipy", "sklearn", "numba", "matplotlib", "plotly", "rclpy", "rosbags", "rich"),
    *("pandas", "jinja2"),
}
# what the families' names (importlib.metadata imports email) and documents need
LATER = {"email", "msgspec"}
SCRIPT = """
import json, sys
from tricycle_cli.main import main
try:
    status = main(sys.argv[1:])
except SystemExit as stop:
    status = stop.code
print(json.dumps([status, sorted({name.partition(".")[0] for name in sys.modules})]))
"""


def imported(*arguments):
    """Exit status of `tricycle`, and the packages that are imported in its process then."""
    line = [sys.executable, "-c", SCRIPT, *map(str, arguments)]
    done = subprocess.run(line, capture_output=True, text=True, check=True)
    status, names = json.loads(done.stdout.splitlines()[-1])
    return status, set(names)


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["plan", "show", "--help"]])
def test_help_imports_nothing_slow(arguments):
    status, names = imported(*arguments)
    assert status == 0
    assert names & SLOW == set()


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command_imports_nothing_slow(command):
    status, names = imported(command, "--help")
    assert status == 0
    assert names & SLOW == set()


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments", [["fly"], ["plan", "--bad"], ["judge"], ["plc", "taste", "x"]]
)
def test_a_wrong_argument_imports_nothing_slow(arguments):
    status, names = imported(*arguments)
    assert status == 2
    assert names & SLOW == set()


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_a_wrong_argument_of_a_command_looks_for_no_family_and_reads_no_document(command):
    status, names = imported(command, "--bad")
    assert status == 2
    assert names & (SLOW | LATER) == set()


@pytest.mark.slow
@pytest.mark.parametrize("options", [[], ["--json"]])
def test_a_bag_is_judged_without_what_only_planning_and_plotting_need(
    record_drive, tmp_path, options
):
    record_drive(tmp_path / "bag")
    status, names = imported("judge", tmp_path / "bag", *options)
    assert status == 0
    assert names & {"scipy", "sklearn", "numba", "matplotlib", "plotly", "rclpy"} == set()
