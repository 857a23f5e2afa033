"""The colcon workspace builds from a clean copy and its nodes start from `install/`."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from launch_recorder import project_scripts

from tricycle_core import __version__

pytestmark = [pytest.mark.ros, pytest.mark.slow]

ROOT = Path(__file__).parents[2]


# colcon installs the packages, not the distribution of the root pyproject.toml
NO_ROOT_DISTRIBUTION = """
from importlib import metadata

find = metadata.Distribution.from_name


def from_name(name):
    if name == "tricycle-excitation":
        raise metadata.PackageNotFoundError(name)
    return find(name)


metadata.Distribution.from_name = from_name
"""


def _files(folder: Path) -> set[Path]:
    found = {path.relative_to(folder) for path in folder.rglob("*") if path.is_file()}
    return {path for path in found if path.suffix != ".pyc"}


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
    executables = {
        script: install / package / "lib" / package / script
        for script, entry in project_scripts().items()
        for package in [entry.partition(".")[0]]
    }
    assert [path for path in executables.values() if not os.access(path, os.X_OK)] == []
    packages = [str(path) for path in install.glob("*/lib/python3*/site-packages") if path.is_dir()]
    assert len(packages) == len(list((ROOT / "src").iterdir()))
    for folder in packages:
        name = Path(folder).relative_to(install).parts[0]
        assert _files(Path(folder) / name) == _files(tmp_path / "src" / name / name)
    hidden = tmp_path / "hidden"
    hidden.mkdir()
    (hidden / "sitecustomize.py").write_text(NO_ROOT_DISTRIBUTION)
    sourced = os.environ.get("PYTHONPATH")
    path = os.pathsep.join(filter(None, [str(hidden), *packages, sourced]))
    # not compiled: that takes most of the time, and says nothing of the installation
    env = {**ros_environment, "PYTHONPATH": path, "NUMBA_DISABLE_JIT": "1"}
    asked = subprocess.run(
        [executables["tricycle"], "--version"], env=env, capture_output=True, text=True, check=True
    )
    assert asked.stdout.strip() == __version__
    ports = {name: tmp_path / name for name in ("steer_port", "drive_port")}
    links = ports.values()
    _run(executables["tricycle_sim"], ports, env, lambda: all(path.is_symlink() for path in links))
    assert not any(path.is_symlink() for path in links)
    bag = tmp_path / "bag"
    _run(executables["trajectory_recorder"], {"record": True, "output": bag}, env, bag.exists)
    assert (bag / "metadata.yaml").exists()


def _run(executable, parameters, env, condition):
    """Start a node, and end it when the condition holds."""
    words = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    node = subprocess.Popen(
        [executable, "--ros-args", *words], env=env, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 200  # a first start compiles the model
    while not condition() and node.poll() is None:
        if time.monotonic() > deadline:
            node.kill()
        time.sleep(0.05)
    node.send_signal(signal.SIGINT)
    _, errors = node.communicate(timeout=30)
    assert node.returncode == 0, errors
