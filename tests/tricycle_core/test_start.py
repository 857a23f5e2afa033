"""Start of the executables."""

import importlib.metadata
import importlib.util
import os
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]


def test_a_node_that_is_interrupted_while_it_imports_says_nothing(tmp_path):
    (tmp_path / "slow_node.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)")
    path = os.pathsep.join(filter(None, (str(tmp_path), os.environ.get("PYTHONPATH"))))
    done = subprocess.run(
        [sys.executable, "-c", "from tricycle_core.start import start; start('slow_node')"],
        env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == -signal.SIGINT
    assert (done.stdout, done.stderr) == ("", "")


def test_every_executable_starts_a_node_of_its_package(monkeypatch):
    for name, target in PROJECT["scripts"].items():
        if name != "tricycle":
            started = []
            module = target.partition(":")[0]
            monkeypatch.setattr(f"{module}.start", started.append)
            importlib.metadata.EntryPoint(name, target, "console_scripts").load()()
            (node,) = started
            assert node.startswith(module.partition(".")[0])
            assert node.endswith("_node")
            assert importlib.util.find_spec(node) is not None
