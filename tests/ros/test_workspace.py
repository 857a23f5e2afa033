"""The colcon workspace builds from a clean copy and its nodes start from `install/`."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.ros, pytest.mark.slow]

ROOT = Path(__file__).parents[2]


def test_a_clean_copy_builds_and_a_node_starts_from_it(ros_environment, tmp_path):
    for part in ("src", "ros_ws"):
        shutil.copytree(
            ROOT / part,
            tmp_path / part,
            symlinks=True,
            ignore=shutil.ignore_patterns("build", "install", "log", "__pycache__", "*.egg-info"),
        )
    venv = str(Path(sys.executable).parents[1])
    built = subprocess.run(
        [tmp_path / "ros_ws" / "colcon-build", "--event-handlers", "console_direct-"],
        env={**os.environ, "VENV": venv},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert built.returncode == 0, built.stderr
    install = tmp_path / "ros_ws" / "install"
    share = install / "tricycle_bringup" / "share" / "tricycle_bringup"
    assert {path.name for path in (share / "launch").iterdir()} == {
        *("simulation.launch.py", "vehicle.launch.py", "replay.launch.py"),
    }
    node = install / "tricycle_sim" / "lib" / "tricycle_sim" / "tricycle_sim"
    packages = [str(path) for path in install.glob("*/lib/python3*/site-packages") if path.is_dir()]
    # a wrong parameter ends the node at once: its packages were found, and in the workspace
    ran = subprocess.run(
        [node, "--ros-args", "-p", "vehicle_file:=nowhere.yaml"],
        env={**ros_environment, "PYTHONPATH": os.pathsep.join(packages)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert ran.returncode == 2, ran.stderr
    assert "nowhere.yaml" in ran.stderr
