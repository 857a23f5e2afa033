"""The bridge while the computer's clock is set."""

import time

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState

from tricycle_bridge.bridge_node import BridgeNode
from tricycle_bridge.protocol.messages import PlcState
from tricycle_core.nodes import time_message

pytestmark = pytest.mark.ros

PATIENCE = 20.0  # s; only a failing test waits that long


class Computer:
    """The bridge and a commander on one clock that can be set."""

    def __init__(self, bridge, executor, pair):
        self.bridge = bridge
        self.pair = pair
        self.logged = []
        self._executor = executor
        self._commander = rclpy.create_node("commander")
        self._publisher = self._commander.create_publisher(JointState, "joint_commands", 10)
        self._readings = []
        self._commander.create_subscription(JointState, "joint_states", self._readings.append, 10)
        self._commander.create_timer(0.01, self._command)
        executor.add_node(self._commander)
        self.speed = 0.0
        self.late = 0.0  # s of the commander's stamps

    def _command(self):
        message = JointState(name=["steering_motor_joint", "rear_wheel_joint"])
        message.header.stamp = time_message(self.bridge._ros_now() - self.late)
        message.position, message.velocity = [0.0, 0.0], [0.0, self.speed / 0.335]
        self._publisher.publish(message)

    def spin(self, condition, what):
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, f"waited in vain for {what}"
            self._executor.spin_once(timeout_sec=0.02)

    def spin_for(self, seconds):
        until = time.monotonic() + seconds
        self.spin(lambda: time.monotonic() > until, "the time")

    def drive(self):
        self.spin(lambda: self.bridge._bridge.refusal(time.monotonic()) is None, "both boards")
        self.bridge._bridge.arm(time.monotonic(), lambda _outcome: None)
        self.spin(lambda: self.bridge._bridge.armed, "armed")
        self.speed = 0.5
        self.spin(lambda: self.pair.speed > 0.49, "speed")

    def age_of_readings(self):
        """Age of the newest joint states on the clock that can be set [s]."""
        self._readings.clear()
        self.spin(lambda: self._readings, "joint states")
        stamp = self._readings[-1].header.stamp
        return self.bridge._ros_now() - (stamp.sec + stamp.nanosec * 1e-9)


@pytest.fixture
def set_by():
    """By how much the computer's clock was set [s]."""
    return [0.0]


@pytest.fixture
def computer(ros_environment, plc_pair, monkeypatch, set_by):
    right = BridgeNode._ros_now
    monkeypatch.setattr(BridgeNode, "_ros_now", lambda node: right(node) + set_by[0])
    ports = {"steer_port": plc_pair.steer_path, "drive_port": plc_pair.drive_path, "boot_wait": 0.0}
    rclpy.init(args=["--ros-args", *(a for n, v in ports.items() for a in ("-p", f"{n}:={v}"))])
    bridge, executor = BridgeNode(), SingleThreadedExecutor()
    executor.add_node(bridge)
    computer = Computer(bridge, executor, plc_pair)
    yield computer
    executor.shutdown()
    bridge.destroy_node()
    rclpy.shutdown()


@pytest.mark.parametrize("step", [3600.0, -3600.0])
def test_setting_the_clock_neither_stops_the_vehicle_nor_its_commands(computer, set_by, step):
    computer.drive()
    set_by[0] = step
    computer.spin_for(1.0)  # longer than the boards wait for commands
    assert computer.bridge._bridge.armed
    assert computer.pair.drive.state is PlcState.ARMED
    assert computer.pair.speed == pytest.approx(0.5, abs=0.01)
    assert abs(computer.age_of_readings()) < 1.0  # stamps follow the clock
    computer.speed = 0.2
    computer.spin(lambda: computer.pair.speed < 0.21, "the new speed")


def test_a_commander_whose_clock_is_behind_is_refused(computer):
    computer.drive()
    computer.late = 0.2
    computer.spin(lambda: computer.pair.drive.state is not PlcState.ARMED, "the watchdog")
    assert computer.bridge._bridge.commands.counters.stale > 0
