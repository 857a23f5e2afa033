"""The bridge in this process: when one of its threads dies, and what it takes for an IMU."""

import time

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import Imu, JointState

from tricycle_bridge.bridge_node import BridgeNode
from tricycle_bridge.diagnosis import diagnose

pytestmark = pytest.mark.ros

PATIENCE = 20.0  # s; only a failing test waits that long


@pytest.fixture
def bridge(ros_environment, plc_pair):
    ports = {"steer_port": plc_pair.steer_path, "drive_port": plc_pair.drive_path, "boot_wait": 0.0}
    rclpy.init(args=["--ros-args", *(a for n, v in ports.items() for a in ("-p", f"{n}:={v}"))])
    node = BridgeNode()
    yield node
    node.destroy_node()
    rclpy.shutdown()


def _spin(node):
    """Command standstill until the executor raises."""
    publisher = node.create_publisher(JointState, "joint_commands", 10)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            publisher.publish(JointState())
            executor.spin_once(timeout_sec=0.02)
    finally:
        executor.shutdown()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize(
    ("method", "thread"), [("_follow_clock", "serial ports"), ("_command", "commands")]
)
def test_the_executor_raises_when_a_thread_died(bridge, monkeypatch, method, thread):
    def fail(*_args, **_kwargs):
        raise ValueError("a fault of the bridge")

    with monkeypatch.context() as patch:
        patch.setattr(BridgeNode, method, fail)  # which only this thread calls
        with pytest.raises(RuntimeError, match=f"the thread of the {thread} died"):
            _spin(bridge)


def test_an_imu_without_an_accelerometer_is_none(bridge):
    def told():
        values = diagnose(bridge._bridge, bridge._now())[0].values
        return values["first pulses against imu"]

    message = Imu()
    message.linear_acceleration_covariance[0] = -1.0  # REP-145
    bridge._on_imu(message)
    assert told() == "not watched: no acceleration on imu"
    message.linear_acceleration_covariance[0] = 0.0
    bridge._on_imu(message)
    assert told() == "watched"
