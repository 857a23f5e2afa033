"""`tricycle monitor` beside real nodes of a running simulation."""

import json
import os
import pty
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tricycle_bringup.configuration import SIMULATION_CONFIG, bridge_parameters
from tricycle_cli.operation.processes import NodeProcesses

pytestmark = [pytest.mark.ros, pytest.mark.slow]

TRICYCLE = str(Path(sys.executable).with_name("tricycle"))
DEADLINE = 60.0  # s


@pytest.fixture
def simulation(ros_environment, tmp_path):
    ports = {"steer_port": str(tmp_path / "steer"), "drive_port": str(tmp_path / "drive")}
    with NodeProcesses(ros_environment, tmp_path / "log") as nodes:
        nodes.start("tricycle_sim", config=SIMULATION_CONFIG, parameters=ports)
        nodes.start(
            "tricycle_bridge",
            config=SIMULATION_CONFIG,
            parameters={**ports, **bridge_parameters("")},
        )
        nodes.start("maneuver_driver", config=SIMULATION_CONFIG, parameters={})
        yield


def test_it_hears_links_maneuver_and_speeds(simulation, ros_environment):
    wanted = {f"tricycle_bridge: {part}" for part in ("vehicle", "steer PLC", "drive PLC")}
    deadline = time.monotonic() + DEADLINE
    told = {}
    while not (
        wanted <= set(told.get("diagnostics", ()))
        and all(told[part] for part in ("measured", "maneuver", "odom"))
    ):
        assert time.monotonic() < deadline, told
        line = [TRICYCLE, "monitor", "--json"]
        done = subprocess.run(line, env=ros_environment, capture_output=True, text=True)
        if done.returncode == 0:
            told = json.loads(done.stdout)
        else:  # nobody was up yet
            assert "nothing heard in 5 s" in done.stderr
    assert told["maneuver"]["state"] == "waiting"
    assert told["commanded"] is None  # nobody commands
    assert abs(told["odom"]["speed"]) < 0.1


def test_the_screen_is_drawn_and_ctrl_c_ends_it(simulation, ros_environment):
    master, slave = pty.openpty()
    process = subprocess.Popen(
        [TRICYCLE, "monitor"],
        env=ros_environment | {"TERM": "xterm", "COLUMNS": "110", "LINES": "40"},
        stdin=slave, stdout=slave, stderr=slave,
    )  # fmt: skip
    os.close(slave)
    drawn, deadline = b"", time.monotonic() + DEADLINE
    while not all(part in drawn for part in (b"waiting", b"drive PLC", b"rear wheel rad/s")):
        assert time.monotonic() < deadline, drawn[-3000:]
        drawn += os.read(master, 65536)
    process.send_signal(signal.SIGINT)
    deadline = time.monotonic() + DEADLINE
    while process.poll() is None:
        assert time.monotonic() < deadline, "Ctrl-C was not heard"
        try:
            drawn += os.read(master, 65536)
        except OSError:  # the terminal was closed at the other end
            break
    assert process.wait(10) == 0
    assert b"Traceback" not in drawn
    os.close(master)
