"""Every parameter of the launch files and their YAML is one that its node declares."""

import subprocess
import sys
import threading
from pathlib import Path
from pkgutil import resolve_name

import pytest
import rclpy
from launch_recorder import LAUNCH_FILES, NODES, launched_nodes
from rclpy.parameter import Parameter

pytestmark = pytest.mark.ros

BUILT_IN = ("use_sim_time", "start_type_description_service", "qos_overrides.")


@pytest.fixture
def declared(ros_environment, tmp_path, monkeypatch):
    """Parameters of each node by executable, from the node itself: name -> descriptor."""
    monkeypatch.chdir(tmp_path)
    rclpy.init()

    def describe(executable):
        node = resolve_name(NODES[executable])()
        try:
            return {d.name: d for d in node.describe_parameters(list(node._parameters))}
        finally:
            node.destroy_node()

    yield describe
    rclpy.shutdown()


@pytest.mark.parametrize("executable", [name for name in NODES if name != "bag_replayer"])
def test_every_parameter_is_described(declared, executable):
    for name, descriptor in declared(executable).items():
        assert descriptor.description or name.startswith(BUILT_IN), name


@pytest.mark.parametrize("file", LAUNCH_FILES)
def test_launch_files_set_only_parameters_that_exist(declared, file):
    for node in launched_nodes(file):
        if node["executable"] == "bag_replayer":
            continue  # it wants a bag to exist: test_replayer_node
        descriptors = declared(node["executable"])
        for name, value in node["parameters"].items():
            assert name in descriptors, f"{node['executable']}: {name}"
            assert descriptors[name].type == Parameter(name, value=value).type_.value, name


@pytest.mark.parametrize(
    ("name", "parameter"),
    [
        ("excitation_planner", "criterion (c)"),
        ("tricycle_bridge", "steer_port (/dev/tricycle_steer) * before configure"),
        ("tricycle_sim", "true_seed (-1"),
    ],
)
def test_help_of_a_node_tells_its_parameters_and_starts_nothing(name, parameter):
    executable = Path(sys.executable).with_name(name)
    done = subprocess.run([executable, "--help"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0
    assert done.stderr == ""
    assert done.stdout.startswith(f"usage: {name} ")
    assert "parameters (default; range)" in done.stdout
    assert parameter in done.stdout


def started(*arguments, seconds=20.0):
    """What a node says, and its status; it is ended once it says that it runs."""
    executable = Path(sys.executable).with_name("excitation_planner")
    with subprocess.Popen(
        [executable, *arguments], stderr=subprocess.STDOUT, stdout=subprocess.PIPE, text=True
    ) as process:
        guard = threading.Timer(seconds, process.kill)
        guard.start()
        said = []
        for line in process.stdout:
            said.append(line)
            if "runs, version" in line:
                process.terminate()
        guard.cancel()
    return "".join(said), process.returncode


@pytest.mark.parametrize(
    ("arguments", "unknown"),
    [(["circle"], "circle"), (["-p", "target:=yaw_inertia"], "-p")],  # rcl takes a:=b for a remap
)
def test_arguments_that_are_none_of_ros_are_refused(ros_environment, arguments, unknown):
    said, status = started(*arguments)
    assert status == 2
    line = said.splitlines()[-1]
    assert f"unknown arguments: {unknown}; parameters are set by --ros-args -p" in line


@pytest.mark.parametrize(
    ("parameter", "line"),
    [
        ("noise_std:=1", "noise_std: needs a number with a point, as 2.0, not 1"),
        ("seed:=1.5", "seed: needs a whole number, not 1.5"),
        ("ranges:=radius", "ranges: needs a list of texts, as [a, b], not radius"),
        ("noise_std:=-1.0", "noise_std = -1.0 must be from 0.0 to 10000.0"),
    ],
)
def test_a_value_that_a_parameter_does_not_take_is_told(ros_environment, parameter, line):
    said, status = started("--ros-args", "-p", parameter)
    assert status == 2
    (fatal,) = (text for text in said.splitlines() if "FATAL" in text)
    assert fatal.endswith(f"[excitation_planner]: {line}")


def test_parameters_that_are_none_of_the_node_are_warned_of(ros_environment, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said, status = started(
        *("--ros-args", "-p", "targt:=yaw_inertia", "-p", "criterion:=h", "-p", "target:=mass")
    )
    assert status == 0
    assert "targt is not a parameter of this node: did you mean target?" in said
    assert "criterion is no" not in said
    assert "no plan can be made: unknown target 'mass'" in said
    said, status = started("--ros-args", "-p", "area_file:=nowhere.yaml")
    assert "no plan can be made: nowhere.yaml: No such file or directory" in said
