"""Every parameter of the launch files and their YAML is one that its node declares."""

import subprocess
import sys
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
        ("tricycle_bridge", "steer_port (/dev/tricycle_steer)"),
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
