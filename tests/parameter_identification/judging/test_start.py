"""What judging a drive imports: a command that takes a second must not import for three."""

import subprocess
import sys

HEAVY = ("scipy", "numba", "sklearn", "matplotlib", "pandas", "rosbags.rosbag2")


def test_judging_imports_no_heavy_library():
    code = "import sys, tricycle_cli.commands.judge; print(*sys.modules)"
    command = [sys.executable, "-c", code]
    found = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert [name for name in HEAVY if name in found] == []
