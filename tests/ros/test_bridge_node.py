"""The bridge as a process on ptys: real rclpy, real pyserial, emulated PLCs."""

import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import BatteryState, JointState
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

from tricycle_bridge.protocol.messages import Board, Fault, PlcState
from tricycle_cli.operation.operator_node import ServiceCaller
from tricycle_core.nodes import LATCHED

pytestmark = pytest.mark.ros

PATIENCE = 20.0  # s; only a failing test waits that long


class Operator:
    """A commander and an operator in one node."""

    def __init__(self, node) -> None:
        self.node = node
        self.executor = SingleThreadedExecutor(context=node.context)
        self.executor.add_node(node)
        self.commands = node.create_publisher(JointState, "joint_commands", 10)
        self.twists = node.create_publisher(TwistStamped, "cmd_vel", 10)
        self.readings: list[JointState] = []
        self.batteries: list[BatteryState] = []
        self.diagnostics: dict[str, object] = {}
        node.create_subscription(JointState, "joint_states", self.readings.append, 100)
        node.create_subscription(BatteryState, "battery_state", self.batteries.append, 10)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)
        self.states: list[dict[str, str]] = []  # of vehicle/state
        self.levels: list[bytes] = []
        self.armed: list[Bool] = []
        node.create_subscription(Bool, "vehicle/armed", self.armed.append, LATCHED)
        node.create_subscription(DiagnosticStatus, "vehicle/state", self._on_state, LATCHED)
        self.services = ServiceCaller(node, self.wait)
        self.target: tuple[float, float] | None = None  # rad, m/s; None: silent
        self.twist: tuple[float, float] | None = None  # m/s, rad/s
        node.create_timer(0.01, self._stream)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        self.diagnostics.update({status.name: status for status in array.status})

    def _on_state(self, status: DiagnosticStatus) -> None:
        self.states.append({pair.key: pair.value for pair in status.values})
        self.levels.append(status.level)

    def _stream(self) -> None:
        now = self.node.get_clock().now().to_msg()
        if self.target is not None:
            angle, speed = self.target
            message = JointState(
                name=["steering_motor_joint", "rear_wheel_joint"],
                position=[angle, 0.0],
                velocity=[0.0, speed / 0.335],
            )
            message.header.stamp = now
            message.header.frame_id = "/test_observer"
            self.commands.publish(message)
        if self.twist is not None:
            stamped = self.twists.msg_type is TwistStamped
            message = TwistStamped() if stamped else Twist()
            twist = message
            if stamped:
                message.header.stamp = now
                twist = message.twist
            twist.linear.x, twist.angular.z = self.twist
            self.twists.publish(message)

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, f"waited in vain for {what}: {self.said()}"
            self.executor.spin_once(timeout_sec=0.02)

    def said(self) -> dict[str, str]:
        return {name: status.message for name, status in self.diagnostics.items()}

    def wait_for(self, part: str, text: str) -> None:
        self.diagnostics.clear()  # what was said before does not count
        self.wait(lambda: text in self.said().get(f"tricycle_bridge: {part}", ""), text)

    def call(self, service: str, kind: type, request):
        return self.services.call(f"tricycle_bridge/{service}", kind, request)

    def arm(self, wanted: bool = True):
        return self.call("arm", SetBool, SetBool.Request(data=wanted))

    def arm_at_standstill(self) -> None:
        self.target = (0.0, 0.0)
        self.wait_for("vehicle", "waiting for the operator")
        answer = self.arm()
        assert (answer.success, answer.message) == (True, "armed")

    def drive(self, plc_pair, angle: float, speed: float) -> None:
        """Arm and drive at a speed; anew where a busy machine made this commander pause."""
        while plc_pair.speed < speed - 0.01:
            self.arm_at_standstill()
            self.target = (angle, speed)
            self.wait(
                lambda: plc_pair.speed > speed - 0.01 or plc_pair.drive.state is PlcState.SAFE,
                "speed",
            )
            if plc_pair.speed < speed - 0.01:
                assert (plc_pair.steer.faults | plc_pair.drive.faults) & Fault.CMD_TIMEOUT

    def change_state(self, transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return self.call("change_state", ChangeState, request).success


@pytest.fixture
def operator(ros_node) -> Iterator[Operator]:
    operator = Operator(ros_node)
    yield operator
    operator.executor.shutdown()


@pytest.fixture
def start_bridge(ros_environment) -> Iterator[Callable[..., subprocess.Popen]]:
    running: list[subprocess.Popen] = []

    def start(*remapped: str, **parameters: object) -> subprocess.Popen:
        arguments = [f"{name}:={value}" for name, value in {"boot_wait": 0.0, **parameters}.items()]
        command = [sys.executable, "-m", "tricycle_bridge.bridge_node", "--ros-args"]
        for argument in arguments:
            command += ["-p", argument]
        for rule in remapped:
            command += ["-r", rule]
        bridge = subprocess.Popen(
            command,
            env=ros_environment,
            stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            text=True,
        )
        running.append(bridge)
        return bridge

    yield start
    for bridge in running:
        if bridge.poll() is None:
            bridge.terminate()
        bridge.communicate(timeout=PATIENCE)


@pytest.fixture
def bridge(start_bridge, plc_pair) -> subprocess.Popen:
    return start_bridge(steer_port=plc_pair.steer_path, drive_port=plc_pair.drive_path)


def _at_rest(pair) -> bool:
    return pair.speed == 0.0


def test_a_drive_from_arming_to_joint_states(bridge, operator, plc_pair):
    operator.drive(plc_pair, 0.3, 1.0)
    assert plc_pair.steering_angle == pytest.approx(0.3, abs=1e-3)
    operator.wait(lambda: operator.readings[-1].velocity[1] > 2.9, "joint states")
    reading = operator.readings[-1]
    assert list(reading.name) == ["steering_motor_joint", "rear_wheel_joint"]
    assert reading.position[0] == pytest.approx(0.3, abs=1e-3)
    now = operator.node.get_clock().now().nanoseconds * 1e-9
    stamp = reading.header.stamp.sec + reading.header.stamp.nanosec * 1e-9
    assert 0.0 <= now - stamp < 0.5
    operator.wait(lambda: bool(operator.batteries), "battery state")
    assert operator.batteries[-1].voltage == pytest.approx(48.0)


def test_a_silent_commander_stops_the_vehicle(bridge, operator, plc_pair):
    operator.drive(plc_pair, 0.0, 0.5)
    operator.target = None
    operator.wait(lambda: _at_rest(plc_pair), "standstill")
    assert plc_pair.drive.faults & Fault.CMD_TIMEOUT
    operator.wait_for("vehicle", "waiting for the operator; stopped: ")
    operator.target = (0.0, 0.5)
    operator.wait_for("vehicle", "commanded speed is 0.50 m/s")
    assert plc_pair.drive.state is PlcState.SAFE  # never by itself
    operator.arm_at_standstill()


def test_refusals_say_why(bridge, operator, plc_pair):
    operator.wait_for("vehicle", "waiting for the operator")
    plc_pair.estop_pressed = True
    operator.wait_for("vehicle", "hardware e-stop pressed")
    assert "hardware e-stop pressed" in operator.arm().message


def test_an_armed_vehicle_waits_at_rest_for_its_commander(bridge, operator, plc_pair):
    operator.wait_for("vehicle", "waiting for the operator")
    assert operator.arm().message == "armed"
    operator.wait(lambda: operator.states and operator.states[-1]["armed"] == "true", "armed")
    until = time.monotonic() + 0.5  # longer than the boards wait for commands
    while time.monotonic() < until:
        operator.executor.spin_once(timeout_sec=0.05)
    assert plc_pair.drive.state is PlcState.ARMED
    operator.target = (0.1, 0.5)
    operator.wait(lambda: plc_pair.speed > 0.49, "speed")
    operator.wait(lambda: operator.states[-1]["commander"] == "/test_observer", "the commander")
    operator.target = (0.1, 0.0)
    operator.wait(lambda: _at_rest(plc_pair), "standstill")


def test_the_state_of_the_vehicle_is_said_at_once_and_twice_per_second(bridge, operator, plc_pair):
    operator.wait(lambda: len(operator.states) >= 3, "vehicle/state")
    operator.arm_at_standstill()
    operator.wait(lambda: operator.states[-1]["armed"] == "true", "armed")
    operator.wait(lambda: operator.armed[-1].data, "armed, as a value")
    operator.arm(False)
    operator.wait(lambda: operator.states[-1]["armed"] == "false", "not armed")
    operator.wait(lambda: not operator.armed[-1].data, "not armed, as a value")
    assert "disarmed by the operator" in operator.states[-1]["reason"]
    before, start = len(operator.states), time.monotonic()
    operator.wait(lambda: len(operator.states) >= before + 4, "vehicle/state")
    assert time.monotonic() - start < 4 * 0.5 + 0.5
    bridge.terminate()
    operator.wait(lambda: operator.states[-1]["reason"] == "the bridge has ended", "its end")
    bridge.communicate(timeout=PATIENCE)


def test_a_second_commander_is_refused_until_the_vehicle_is_released(bridge, operator, plc_pair):
    operator.drive(plc_pair, 0.0, 0.5)
    operator.twist = (0.2, 0.0)
    refusal = "cmd_vel is refused: joint_commands of /test_observer commands the vehicle"
    operator.wait_for("vehicle", refusal)
    assert plc_pair.speed > 0.4
    operator.wait(lambda: operator.levels[-1] == DiagnosticStatus.ERROR, "the conflict")
    answer = operator.call("release", Trigger, Trigger.Request())
    assert (answer.success, answer.message[:31]) == (False, "not released: the vehicle moves")
    operator.target = (0.0, 0.0)
    operator.twist = (0.0, 0.0)
    operator.wait(lambda: plc_pair.speed == 0.0, "standstill")
    assert operator.call("release", Trigger, Trigger.Request()).success
    operator.target = None
    operator.wait(lambda: operator.states[-1]["commander"] == "cmd_vel", "the other one")
    operator.twist = (0.2, 0.0)
    operator.wait(lambda: plc_pair.speed > 0.19, "speed")


def test_commands_that_cannot_be_driven_stop_the_vehicle_and_are_named(bridge, operator, plc_pair):
    said: list[str] = []
    latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    operator.node.create_subscription(Log, "/rosout", lambda log: said.append(log.msg), latched)
    operator.drive(plc_pair, 0.0, 0.5)
    operator.target = (0.0, 1e300)
    operator.wait(lambda: _at_rest(plc_pair), "standstill")
    assert plc_pair.drive.state is PlcState.ARMED
    refusal = "joint_commands of /test_observer is refused: speed 1e+300 m/s: at most 4.8 m/s"
    operator.wait(lambda: any(refusal in line for line in said), "the refusal")


def test_odometry_that_contradicts_the_wheel_stops_the_vehicle(bridge, operator, plc_pair):
    publisher = operator.node.create_publisher(Odometry, "odom", 10)
    message = Odometry()
    operator.node.create_timer(0.02, lambda: publisher.publish(message))
    operator.drive(plc_pair, 0.0, 0.5)
    message.twist.twist.linear.x = 1.1
    operator.wait(lambda: "odom 1.10 m/s: hall sensor" in operator.states[-1]["reason"], "the stop")
    operator.wait(lambda: _at_rest(plc_pair), "standstill")


def test_emergency_stop_and_disarm_services(bridge, operator, plc_pair):
    operator.arm_at_standstill()
    answer = operator.call("emergency_stop", Trigger, Trigger.Request())
    assert answer.success
    for board in (Board.STEER, Board.DRIVE):
        operator.wait(lambda b=board: plc_pair.plc(b).state is PlcState.ESTOP, "ESTOP")
    operator.arm_at_standstill()  # clears, then arms
    assert operator.arm(False).success
    operator.wait(lambda: plc_pair.drive.state is PlcState.SAFE, "SAFE")


@pytest.mark.parametrize("board", [Board.STEER, Board.DRIVE])
def test_losing_one_board_stops_the_other(bridge, operator, plc_pair, board):
    operator.drive(plc_pair, 0.1, 0.5)
    plc_pair.unplug(board)
    other = plc_pair.drive if board is Board.STEER else plc_pair.steer
    operator.wait(lambda: other.state is not PlcState.ARMED, "the other board to stop")
    assert not other.faults & Fault.CMD_TIMEOUT  # told to, not timed out
    operator.wait_for(f"{board.name.lower()} PLC", "does not exist")
    plc_pair.plug(board)
    operator.target = (0.0, 0.0)
    operator.wait_for("vehicle", "waiting for the operator")
    assert plc_pair.plc(board).state is PlcState.SAFE
    operator.arm_at_standstill()


def test_swapped_ports_are_named_and_never_armed(start_bridge, operator, plc_pair):
    start_bridge(steer_port=plc_pair.drive_path, drive_port=plc_pair.steer_path)
    operator.target = (0.0, 0.0)
    operator.wait_for("steer PLC", "ports swapped: the drive PLC answers")
    operator.wait_for("drive PLC", "ports swapped: the steer PLC answers")
    answer = operator.arm()
    assert not answer.success
    assert "ports swapped" in answer.message


def test_missing_ports_are_a_diagnostic_and_are_retried(start_bridge, operator, plc_pair):
    plc_pair.unplug(Board.DRIVE)
    start_bridge(steer_port=plc_pair.steer_path, drive_port=plc_pair.drive_path)
    operator.wait_for("drive PLC", "does not exist")
    assert "does not exist" in operator.arm().message
    plc_pair.plug(Board.DRIVE)
    operator.wait_for("drive PLC", "SAFE")


def test_commands_that_are_nan_or_too_old_move_nothing(bridge, operator, plc_pair):
    operator.arm_at_standstill()
    operator.target = (math.nan, 0.0)
    operator.wait_for("vehicle", "armed")
    assert plc_pair.steer.state is PlcState.ARMED  # it is to stand still, as it does
    operator.target = None
    old = JointState(
        name=["steering_motor_joint", "rear_wheel_joint"], position=[0.5, 0.0], velocity=[0.0, 1.0]
    )
    operator.commands.publish(old)  # no stamp
    vehicle = "tricycle_bridge: vehicle"

    def too_old() -> int:
        values = operator.diagnostics[vehicle].values if vehicle in operator.diagnostics else []
        return int(next((v.value for v in values if v.key == "commands too old"), "0"))

    operator.wait(lambda: too_old() == 1, "the old command to be counted")
    assert plc_pair.steering_angle == 0.0


def test_commands_at_1_khz_overload_nothing(bridge, operator, plc_pair):
    sent, drive = [], "tricycle_bridge: drive PLC"  # (s, frames)

    def count(array: DiagnosticArray) -> None:
        stamp = array.header.stamp.sec + array.header.stamp.nanosec * 1e-9
        values = {v.key: v.value for s in array.status if s.name == drive for v in s.values}
        sent.append((stamp, int(values["frames sent"])))

    operator.node.create_subscription(DiagnosticArray, "/diagnostics", count, 100)
    message = JointState(
        name=["steering_motor_joint", "rear_wheel_joint"],
        position=[0.7461, 0.0],
        velocity=[0.0, 14.0],
    )
    message.header.frame_id = "/test_observer"
    # a busy machine may hold a process up for 0.1 s: boards disarm, or find commands stale
    for _ in range(3):
        operator.arm_at_standstill()
        operator.target = None
        stale = plc_pair.drive.counters.stale
        sent.clear()
        start = time.monotonic()
        for k in range(2500):
            message.header.stamp = operator.node.get_clock().now().to_msg()
            operator.commands.publish(message)
            left = start + 1e-3 * (k + 1) - time.monotonic()
            operator.executor.spin_once(timeout_sec=max(left, 0.0))
        if plc_pair.drive.state is PlcState.ARMED and plc_pair.drive.counters.stale == stale:
            break
        operator.arm(False)
    assert plc_pair.drive.state is PlcState.ARMED
    assert plc_pair.drive.counters.stale == stale
    (first, before), *_, (last, after) = sent
    # 105 commands per second at most, and some pings and requests
    assert after - before < 110 * (last - first) + 5
    assert 0.5 < plc_pair.speed <= 4.8
    assert plc_pair.steering_angle == pytest.approx(0.7461, abs=1e-4)


def test_publishers_without_a_name_are_counted_on_a_remapped_topic_too(
    start_bridge, operator, plc_pair
):
    paths = {"steer_port": plc_pair.steer_path, "drive_port": plc_pair.drive_path}
    start_bridge("cmd_vel:=teleop/cmd_vel", **paths)
    operator.node.destroy_publisher(operator.twists)
    operator.twists, _ = (
        operator.node.create_publisher(TwistStamped, "teleop/cmd_vel", 10) for _ in range(2)
    )
    operator.twist = (0.0, 0.0)
    operator.wait_for("vehicle", "2 publishers of cmd_vel that do not say who sends")


@pytest.mark.parametrize("stamped", [True, False])
def test_cmd_vel_drives(start_bridge, operator, plc_pair, stamped):
    start_bridge(
        steer_port=plc_pair.steer_path,
        drive_port=plc_pair.drive_path,
        cmd_vel_stamped=str(stamped).lower(),
    )
    if not stamped:
        operator.node.destroy_publisher(operator.twists)
        operator.twists = operator.node.create_publisher(Twist, "cmd_vel", 10)
    operator.wait_for("vehicle", "waiting for the operator")
    assert operator.arm().success
    operator.twist = (0.5, 0.1)
    operator.wait(lambda: plc_pair.speed > 0.49, "speed")
    # inner wheel theta, outer theta (0.8 - 0.2 theta / 45 deg), turned about a 20 deg king-pin
    theta = plc_pair.steering_angle
    wheel = theta * (1.0 + 0.8 - 0.2 * theta / math.radians(45)) / 2
    radius = 1.443 / (math.cos(0.349) * math.tan(wheel))
    assert radius == pytest.approx(0.5 / 0.1, rel=1e-3)
    operator.twist = (0.5, 3.0)
    operator.wait(lambda: _at_rest(plc_pair), "standstill")
    assert plc_pair.steering_angle == pytest.approx(theta, abs=1e-3)


@pytest.mark.parametrize("topic", ["joint_commands", "cmd_vel"])
def test_a_commander_that_cannot_be_heard_is_warned_of(bridge, operator, topic):
    said: list[str] = []
    latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    operator.node.create_subscription(Log, "/rosout", lambda log: said.append(log.msg), latched)
    operator.wait_for("vehicle", "waiting for the operator")  # it runs, and is heard
    kind = {"joint_commands": JointState, "cmd_vel": TwistStamped}[topic]
    operator.node.create_publisher(kind, topic, qos_profile_sensor_data)
    warning = f"New publisher discovered on topic '{topic}', offering incompatible QoS"
    operator.wait(lambda: any(warning in line for line in said), "the warning")


def test_what_is_safe_can_be_set_while_it_runs_and_the_rest_says_why_not(
    bridge, operator, plc_pair
):
    def set_parameter(name: str, value: object):
        parameter = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[parameter])
        return operator.call("set_parameters", SetParameters, request).results[0]

    operator.arm_at_standstill()
    assert set_parameter("max_acceleration", 0.5).successful
    operator.readings.clear()
    operator.target = (0.0, 1.0)

    def wheel() -> list[tuple[float, float]]:
        """Time of measurement (s) and speed (m/s) while the wheel accelerates."""
        both = [r for r in operator.readings if len(r.name) == 2]
        times = [r.header.stamp.sec + r.header.stamp.nanosec * 1e-9 for r in both]
        speeds = [0.335 * r.velocity[1] for r in both]
        return [(t, v) for t, v in zip(times, speeds, strict=True) if 0.1 < v < 0.4]

    operator.wait(lambda: plc_pair.speed > 0.45, "speed")
    (start, slow), *_, (end, fast) = wheel()
    assert (fast - slow) / (end - start) == pytest.approx(0.5, rel=0.1)  # not 1.0, the default
    assert not set_parameter("max_acceleration", 3.0).successful  # beyond the PLC's
    refused = set_parameter("max_acceleration", 1.5)
    assert "is above 1, for which the boards are set up" in refused.reason
    refused = set_parameter("steer_port", "/dev/other")
    assert (refused.successful, refused.reason) == (
        False,
        "steer_port is read when the bridge is configured: clean it up first",
    )
    refused = set_parameter("command_rate", 100.00005)  # which rclpy takes for 100
    assert refused.reason == "command_rate = 100 is outside 20..100"
    assert not set_parameter("autostart", False).successful  # read-only


def test_lifecycle_deactivate_stops_and_cleanup_closes(start_bridge, operator, plc_pair):
    start_bridge(steer_port=plc_pair.steer_path, drive_port=plc_pair.drive_path, autostart="false")
    assert operator.change_state(Transition.TRANSITION_CONFIGURE)
    operator.target = (0.0, 0.0)
    operator.wait_for("vehicle", "the bridge is not active")
    assert operator.change_state(Transition.TRANSITION_ACTIVATE)
    operator.drive(plc_pair, 0.0, 0.5)
    assert not operator.change_state(Transition.TRANSITION_ACTIVATE)  # it is
    assert operator.change_state(Transition.TRANSITION_DEACTIVATE)
    operator.wait(lambda: _at_rest(plc_pair), "standstill")
    assert not plc_pair.drive.faults & Fault.CMD_TIMEOUT
    assert operator.change_state(Transition.TRANSITION_CLEANUP)
    assert operator.change_state(Transition.TRANSITION_CONFIGURE)
    operator.wait_for("drive PLC", "SAFE")


def test_killing_the_bridge_at_speed_stops_the_vehicle(bridge, operator, plc_pair):
    operator.drive(plc_pair, 0.0, 1.0)
    bridge.send_signal(signal.SIGKILL)
    operator.wait(lambda: plc_pair.drive.state is PlcState.SAFE, "SAFE")
    assert _at_rest(plc_pair)
    assert plc_pair.drive.faults == Fault.CMD_TIMEOUT


def test_sigterm_ends_the_bridge_quietly_and_the_drive_stops(bridge, operator, plc_pair):
    operator.drive(plc_pair, 0.0, 0.5)
    bridge.terminate()
    operator.wait(lambda: plc_pair.drive.state is PlcState.SAFE, "SAFE")
    assert not plc_pair.drive.faults & Fault.CMD_TIMEOUT  # told to, not timed out
    _, stderr = bridge.communicate(timeout=PATIENCE)
    assert bridge.returncode == 0
    assert "Traceback" not in stderr


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"command_rate": 500.0}, "command_rate"),
        ({"baud": "fast"}, "baud"),
        ({"steer_port": "/dev/same", "drive_port": "/dev/../dev/same"}, "both /dev/same"),
        ({"bring_up_record": "/nowhere.json"}, "`tricycle plc check` writes it"),
    ],
)
def test_a_users_mistake_is_one_line_and_status_2(start_bridge, parameters, said):
    bridge = start_bridge(**parameters)
    _, stderr = bridge.communicate(timeout=PATIENCE)
    assert bridge.returncode == 2
    assert said in stderr
    assert len(stderr.strip().splitlines()) == 1


def test_arm_on_activate_arms_once(start_bridge, operator, plc_pair):
    start_bridge(
        steer_port=plc_pair.steer_path, drive_port=plc_pair.drive_path, arm_on_activate="true"
    )
    operator.target = (0.0, 0.0)
    # this process, with the commander and the boards, may pause: a board then stops at once
    operator.wait(
        lambda: plc_pair.drive.state is PlcState.ARMED or plc_pair.drive.faults & Fault.CMD_TIMEOUT,
        "ARMED",
    )
    plc_pair.reset(Board.DRIVE)
    operator.wait_for("vehicle", "waiting for the operator")
    operator.wait(lambda: plc_pair.drive.state is PlcState.SAFE, "SAFE")
    operator.wait_for("vehicle", "waiting for the operator")
