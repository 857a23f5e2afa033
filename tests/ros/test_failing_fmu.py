"""FMUs that cannot be or that fail, under the launch file's nodes and `tricycle drive`."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from bicycle_fmu import IS_NAN, REFUSES, needs_compiler, write_bicycle_fmu
from launch_recorder import launched_nodes

from excitation_planner.maneuver import Circle
from excitation_planner.plan import save_plan
from excitation_planner.planning import PlanRequest, plan_at
from trajectory_recorder.bag.reader import BagReader
from tricycle_bringup.configuration import SIMULATION_CONFIG
from tricycle_cli.operation.operator_node import Operator
from tricycle_cli.operation.processes import NodeProcesses
from tricycle_core.errors import NodeError
from tricycle_sim.vehicle import load_vehicle

pytest.importorskip("fmpy")
pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    needs_compiler,
]
PATIENCE = 60.0  # s
TRICYCLE = Path(sys.executable).with_name("tricycle")


@pytest.fixture(scope="module")
def plan():
    request = PlanRequest(load_vehicle(), Circle(duration=6.0), "cornering_stiffness", samples=50)
    return plan_at(request, np.array([2.5, 1.0]))


def launched(env, folder, mapping):
    """The nodes that the launch file starts, started; and what it does where a node ends."""
    ports = {f"{name}_port": str(folder / name) for name in ("steer", "drive")}
    more = {
        "tricycle_sim": ports,
        "tricycle_bridge": {**ports, "autostart": True},  # the launch file does it by its events
    }
    nodes, on_exit = NodeProcesses(env, folder / "log"), {}
    for node in launched_nodes(
        "simulation.launch.py", plant=f"fmu:{mapping}", real_time_factor="5", bag=""
    ):
        name = node["executable"]
        parameters = node["parameters"] | more.get(name, {})
        nodes.start(name, config=SIMULATION_CONFIG, parameters=parameters)
        on_exit[name] = node.get("on_exit")
    return nodes, on_exit


@pytest.mark.parametrize(
    ("fails", "line"),
    [
        (IS_NAN, r"tricycle_sim ended with status 1: .*bicycle\.fmu: x is nan at \d+\.\d+ s"),
        (REFUSES, r"tricycle_sim ended with status 1: .*bicycle\.fmu: fails at \d+\.\d+ s"),
    ],
)
def test_one_that_fails_on_the_way_ends_the_launch_and_the_bag_is_closed(
    ros_environment, plan, tmp_path, fails, line
):
    mapping = write_bicycle_fmu(tmp_path, fails=fails, fails_from=1.0)
    nodes, on_exit = launched(ros_environment, tmp_path, mapping)
    domain = int(ros_environment["ROS_DOMAIN_ID"])
    with nodes, Operator(domain=domain, check=nodes.check) as operator:
        with pytest.raises(NodeError, match=line) as ended:
            operator.drive(plan, tmp_path / "bag", progress=lambda *_: None)
        assert "\n" not in str(ended.value)
        (then,) = on_exit["tricycle_sim"]
        with pytest.raises(RuntimeError, match=r"^tricycle_sim has ended$"):
            then.keywords["function"](SimpleNamespace(is_shutdown=False))
        then.keywords["function"](SimpleNamespace(is_shutdown=True))
    log = (tmp_path / "log" / "tricycle_sim.log").read_text()
    assert "Traceback" not in log
    with BagReader(tmp_path / "bag") as bag:
        assert bag.metadata["plan_id"] == plan.id
        assert sum(1 for _ in bag.messages({"/odom"})) > 50


MISTAKES = {
    "no FMU": ({"mapping": {"fmu": "bicycle.yaml"}}, "bicycle.yaml: is not an FMU"),
    "missing variable": (
        {"mapping": {"outputs": {"x": "ex", "y": "y", "heading": "heading"}}},
        "outputs: no variable 'ex'",
    ),
    "wrong unit": (
        {"mapping": {"inputs": {"steering": "steering", "speed": "steering"}}},
        "inputs.speed: unit: steering is in deg, needs m/s or km/h",
    ),
}


def test_one_that_cannot_be_ends_the_simulation_of_the_launch_with_one_line(
    ros_environment, tmp_path
):
    running = {}
    for number, (mistake, (changes, _)) in enumerate(MISTAKES.items()):
        folder = tmp_path / str(number)
        folder.mkdir()
        mapping = write_bicycle_fmu(folder, **changes)
        (node,) = (
            node
            for node in launched_nodes("simulation.launch.py", plant=f"fmu:{mapping}")
            if node["executable"] == "tricycle_sim"
        )
        command = [Path(sys.executable).with_name("tricycle_sim"), "--ros-args"]
        for name in ("plant", "plc", "vehicle_file"):
            command += ["-p", f"{name}:={node['parameters'][name]!r}"]
        command += [a for n in ("steer", "drive") for a in ("-p", f"{n}_port:={folder / n}")]
        running[mistake] = subprocess.Popen(
            command, env=ros_environment, stderr=subprocess.PIPE, text=True
        )
    for mistake, process in running.items():
        _, errors = process.communicate(timeout=PATIENCE)
        assert process.returncode != 0, mistake
        told = [line for line in errors.splitlines() if "bicycle" in line]
        assert len(told) == 1, errors
        assert MISTAKES[mistake][1] in told[0]
        assert "Traceback" not in errors


def test_a_start_that_fails_behind_one_leaves_nothing_unpacked(ros_environment, tmp_path):
    mapping, unpacked = write_bicycle_fmu(tmp_path), tmp_path / "unpacked"
    unpacked.mkdir()
    command = [Path(sys.executable).with_name("tricycle_sim"), "--ros-args"]
    for name, value in (("plant", f"fmu:{mapping}"), ("drive_port", "/proc/nowhere/drive")):
        command += ["-p", f"{name}:={value}"]
    done = subprocess.run(
        [*command, "-p", f"steer_port:={tmp_path / 'steer'}"],
        env=ros_environment | {"TMPDIR": str(unpacked)}, capture_output=True, text=True,
        timeout=PATIENCE, check=False,
    )  # fmt: skip
    assert done.returncode != 0
    assert "/proc/nowhere" in done.stderr
    assert not list(unpacked.glob("fmu-*"))
    assert not (tmp_path / "steer").exists()


def test_one_that_cannot_be_ends_the_drive_with_one_line_and_leaves_no_bag(
    ros_environment, plan, tmp_path
):
    changes, line = MISTAKES["wrong unit"]
    mapping = write_bicycle_fmu(tmp_path, **changes)
    save_plan(plan, tmp_path / "plan.json")
    done = subprocess.run(
        [TRICYCLE, "drive", "plan.json", "--plant", f"fmu:{mapping}", "--bag", "bag"],
        cwd=tmp_path, env=ros_environment, capture_output=True, text=True, timeout=PATIENCE,
        check=False,
    )  # fmt: skip
    assert done.returncode == 2
    (told,) = (text for text in done.stderr.splitlines() if text.startswith("tricycle: "))
    assert line in told
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "bag").exists()
