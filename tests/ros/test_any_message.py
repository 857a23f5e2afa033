"""No message ends a node: empty, NaN, huge, of wrong lengths, with impossible stamps."""

import itertools
import math
import time
from array import array

import pytest
import rclpy
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from nav_msgs.msg import Odometry, Path
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from rosidl_parser.definition import (
    AbstractGenericString,
    AbstractSequence,
    Array,
    BasicType,
    NamespacedType,
)
from sensor_msgs.msg import Imu, JointState
from trajectory_msgs.msg import JointTrajectory

from excitation_planner.maneuver_driver_node import ManeuverDriver
from excitation_planner.planner_node import ExcitationPlanner
from parameter_identification.identification_monitor_node import IdentificationMonitor
from trajectory_recorder.bag.reader import BagReader
from trajectory_recorder.bag.topics import message_class
from trajectory_recorder.recorder_node import TrajectoryRecorder
from tricycle_bridge.bridge_node import BridgeNode
from tricycle_cli.operation.monitor_node import Monitor
from tricycle_cli.operation.operator_node import Operator
from tricycle_core.joints import JOINTS
from tricycle_core.nodes import LATCHED, ignore_impossible_times
from tricycle_core.readiness import Readiness

pytestmark = pytest.mark.ros

PATIENCE = 20.0  # s; only a failing test waits that long
FAR = (1 << 31) - 1, (1 << 32) - 1
STAMPS = [(0, 0), (-(1 << 31), 0), (-1, 999_999_999), FAR]
NUMBERS = [0.0, math.nan, math.inf, -math.inf, 1e300, -1e300]
INTEGERS = {
    "octet": (bytes([0]), bytes([255])),
    "boolean": (False, True),
    **{f"int{n}": (-(1 << n - 1), (1 << n - 1) - 1) for n in (8, 16, 32, 64)},
    **{f"uint{n}": (0, (1 << n) - 1) for n in (8, 16, 32, 64)},
}


def value(kind, number, length, stamp):
    """A value of a field's type, as nasty as told."""
    if isinstance(kind, BasicType):
        if kind.typename in ("double", "float"):
            return number
        return INTEGERS[kind.typename][length % 2]
    if isinstance(kind, AbstractGenericString):
        return "ä\n" * length
    if isinstance(kind, AbstractSequence):
        return [value(kind.value_type, number, length, stamp) for _ in range(length)]
    if isinstance(kind, Array):
        return [value(kind.value_type, number, length, stamp) for _ in range(kind.size)]
    assert isinstance(kind, NamespacedType)
    return message("/".join((*kind.namespaces, kind.name)), number, length, stamp)


def message(kind, number, length, stamp):
    """A message of a type of which everything is as nasty as told."""
    kind = message_class(kind) if isinstance(kind, str) else kind
    if kind in (Time, Duration):
        return kind(sec=stamp[0], nanosec=stamp[1])
    names = kind.get_fields_and_field_types()
    values = (value(slot, number, length, stamp) for slot in kind.SLOT_TYPES)
    return kind(**dict(zip(names, values, strict=True)))


def nasty(kind):
    """All of these messages, and some that are nearly right."""
    for number, length, stamp in itertools.product(NUMBERS, (0, 1, 3), STAMPS):
        yield message(kind, number, length, stamp)
    if kind is JointTrajectory:
        for names in (list(JOINTS), [*JOINTS, JOINTS[0]]):
            for number, rows in itertools.product(NUMBERS, (1, 3)):
                found = message(kind, number, rows, FAR)
                found.joint_names = names
                for second, point in enumerate(found.points):
                    point.time_from_start = Duration(sec=second)
                    point.positions = point.velocities = array("d", [number] * 2)
                yield found
    if kind is JointState:
        for length in range(3):
            yield kind(name=list(JOINTS), position=[math.nan] * length)
    if kind is Odometry:
        yield Odometry()
    if kind is DiagnosticStatus:
        for pairs in (Readiness(armed=True).values(), {"armed": "yes"}, {"state": "running"}):
            yield kind(values=[KeyValue(key=k, value=v) for k, v in pairs.items()])


class Hearing:
    """Counts what a node has taken of its subscriptions."""

    def __init__(self, node):
        self.taken = 0
        for subscription in node.subscriptions:
            subscription.callback = self._counted(subscription.callback)

    def _counted(self, callback):
        def heard(message):
            self.taken += 1
            callback(message)

        return heard


def subscribed(node):
    return {
        subscription.topic_name: (subscription.msg_type, subscription.qos_profile)
        for subscription in node.subscriptions
    }


def deliver(node, spin):
    """Send every nasty message to every subscription of a node, one after the other."""
    hearing = Hearing(node)
    sender = rclpy.create_node("sender")
    sent = 0
    for topic, (kind, wanted) in subscribed(node).items():
        profile = QoSProfile(
            depth=1, durability=wanted.durability, reliability=ReliabilityPolicy.RELIABLE
        )
        publisher = sender.create_publisher(kind, topic, profile)
        deadline = time.monotonic() + PATIENCE
        while not publisher.get_subscription_count():
            assert time.monotonic() < deadline, topic
            spin(0.01)
        for count, content in enumerate(nasty(kind)):
            before, deadline = hearing.taken, time.monotonic() + PATIENCE
            while hearing.taken == before:  # the first may come before it is known here
                assert time.monotonic() < deadline, (topic, count)
                publisher.publish(content)
                spin(0.1)
            sent += 1
        sender.destroy_publisher(publisher)
    sender.destroy_node()
    return sent


@pytest.fixture
def on_simulated_time(ros_environment, tmp_path, monkeypatch):
    """ROS in this process as a node's executable starts it."""
    monkeypatch.chdir(tmp_path)
    rclpy.init(args=["--ros-args", "-p", "use_sim_time:=true", "-p", "output:=bag"])
    yield
    rclpy.shutdown()


@pytest.fixture
def spun(on_simulated_time):
    """Constructs a node; returns it and what spins it."""
    made = []

    def construct(factory):
        node = factory()
        ignore_impossible_times(node)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        made.append((executor, node))
        return node, lambda timeout: executor.spin_once(timeout_sec=timeout)

    yield construct
    for executor, node in made:
        executor.shutdown()
        node.destroy_node()


@pytest.mark.parametrize(
    "factory", [BridgeNode, ManeuverDriver, ExcitationPlanner, IdentificationMonitor]
)
def test_a_node_outlives_every_message(spun, factory):
    node, spin = spun(factory)
    assert deliver(node, spin) >= 72


@pytest.mark.parametrize("factory", [Monitor, Operator])
def test_what_the_command_line_listens_with_outlives_every_message(
    on_simulated_time, ros_environment, factory
):
    options = {"domain": int(ros_environment["ROS_DOMAIN_ID"])}
    if factory is Operator:
        options["check"] = lambda: None
    with factory(**options) as listener:
        executor = listener._executor
        assert deliver(listener._node, lambda t: executor.spin_once(timeout_sec=t)) >= 72


def test_the_recorder_records_every_message(spun, tmp_path):
    recorder, spin = spun(TrajectoryRecorder)
    sender = rclpy.create_node("sender")
    kinds = {
        "odom": Odometry,
        "imu": Imu,
        "joint_commands": JointState,
        "maneuver/path": Path,
        "maneuver/commands": JointTrajectory,
        "vehicle/state": DiagnosticStatus,
        "/diagnostics": DiagnosticArray,
    }
    publishers = {
        topic: sender.create_publisher(kind, topic, LATCHED if "/" in topic else 100)
        for topic, kind in kinds.items()
    }
    clock = sender.create_publisher(Clock, "/clock", 10)
    deadline = time.monotonic() + PATIENCE
    while not all(p.get_subscription_count() for p in (*publishers.values(), clock)):
        assert time.monotonic() < deadline
        spin(0.05)
    recorder.start()
    for contents in itertools.zip_longest(nasty(Clock), *map(nasty, kinds.values())):
        for publisher, content in zip((clock, *publishers.values()), contents, strict=True):
            if content is not None:
                publisher.publish(content)
        for publisher in publishers.values():
            publisher.wait_for_all_acked()
        spin(0.0)
    recorder.stop()
    sender.destroy_node()
    with BagReader(tmp_path / "bag") as bag:
        assert bag.complete
        counts = {name.lstrip("/"): topic.count for name, topic in bag.topics.items()}
    assert {topic for topic in kinds if not counts.get(topic.lstrip("/"))} == set()
    assert counts["odom"] == len(list(nasty(Odometry)))  # not latched: none replaces another
