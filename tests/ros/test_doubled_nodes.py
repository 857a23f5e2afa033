"""Two nodes of one name: what they would command and answer cannot be told apart."""

import time

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState

from excitation_planner.maneuver_driver_node import ManeuverDriver
from excitation_planner.playback import PlaybackState
from tricycle_cli.operation.operator_node import Operator
from tricycle_core.errors import NodeError
from tricycle_core.nodes import LATCHED

pytestmark = pytest.mark.ros

PATIENCE = 30.0  # s; only a failing test waits that long
TWICE = "/maneuver_driver runs 2 times: end all but one"


@pytest.fixture
def driver(ros_environment):
    rclpy.init()
    node = ManeuverDriver()
    yield node
    node.destroy_node()
    rclpy.shutdown()


@pytest.fixture
def namesake(driver):
    """A node of the driver's name that could command too."""
    node = rclpy.create_node("maneuver_driver")
    node.create_publisher(JointState, "joint_commands", 10)
    yield node
    node.destroy_node()


def wait(executor, condition, what):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        executor.spin_once(timeout_sec=0.1)


def test_a_driver_with_a_namesake_does_not_start_and_ends_its_run(driver, namesake):
    said = {}
    namesake.create_subscription(
        DiagnosticArray,
        "maneuver/preflight",
        lambda message: said.update({s.name: s.message for s in message.status}),
        LATCHED,
    )
    executor = SingleThreadedExecutor()
    executor.add_node(driver)
    executor.add_node(namesake)
    wait(executor, lambda: said.get("commanders", "").startswith(TWICE), "the pre-flight")
    playback = driver._playback
    playback.state = PlaybackState.RETURNING  # as if the other one came during a run
    wait(executor, lambda: playback.state is PlaybackState.ABORTED, "the abort")
    assert playback.reason.startswith(TWICE)
    executor.shutdown()


def test_an_operator_refuses_doubled_nodes(driver, namesake, ros_environment):
    domain = int(ros_environment["ROS_DOMAIN_ID"])
    with Operator(domain=domain, check=lambda: None, simulated=False) as operator:
        names = operator._node.get_node_names
        operator._wait(lambda: names().count("maneuver_driver") == 2, "both drivers")
        with pytest.raises(NodeError, match="maneuver_driver runs 2 times: end all but one"):
            operator._refuse_doubled()
