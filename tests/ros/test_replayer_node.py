"""The replayer as a process."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import Trigger

from trajectory_recorder.bag.topics import OfferedQos, Topic, jazzy
from trajectory_recorder.bag.writer import BagWriter
from tricycle_cli.operation.operator_node import ServiceCaller
from tricycle_cli.operation.processes import executable
from tricycle_core.nodes import LATCHED

pytestmark = pytest.mark.ros
TYPE = "std_msgs/msg/String"
EVERY_ONE = QoSProfile(depth=100)  # reliable: the replayer waits for it before it ends


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    with BagWriter(tmp_path / "bag") as writer:
        latched = (OfferedQos(history="unknown", depth=0, durability="transient_local"),)
        sensor = (OfferedQos(history="unknown", depth=0, reliability="best_effort"),)
        plan = writer.add_topic(Topic.of_type("/plan", TYPE, qos=latched))
        odom = writer.add_topic(Topic.of_type("/odom", TYPE))
        writer.add_topic(Topic.of_type("/imu", TYPE, qos=sensor))
        writer.add_topic(Topic("/foreign", "no_such_msgs/msg/Thing"))
        writer.add_topic(Topic("/json", TYPE, encoding="json"))
        for i in range(100):
            data = jazzy().serialize_cdr(jazzy().types[TYPE](data=str(i)), TYPE)
            writer.write(odom if i else plan, 1000 * 10**9 + i * 10**7, bytes(data))
    return tmp_path / "bag"


FAILING_READ = """
import os, threading
pread = os.pread
def failing(*where):
    if threading.current_thread().name == "player":
        raise {error}
    return pread(*where)
os.pread = failing
from trajectory_recorder.replayer_node import main
main()
"""
"""Program of the replayer, in which reading fails once the bag is open."""


class Replayer:
    def __init__(self, node: Node, env: dict[str, str], *arguments: str, program: str = "") -> None:
        start = [sys.executable, "-c", program] if program else [executable("bag_replayer")]
        command = [*start, "--ros-args", *arguments]
        self.process = subprocess.Popen(command, env=env, stderr=subprocess.PIPE, text=True)
        self.node = node
        self.executor = SingleThreadedExecutor(context=node.context)
        self.executor.add_node(node)
        self.services = ServiceCaller(node, lambda condition, _: self.wait(condition))

    def wait(self, condition: Callable[[], bool], seconds: float = 20.0) -> None:
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, "timed out"
            self.executor.spin_once(timeout_sec=0.02)

    def call(self, name: str) -> Any:
        return self.services.call(f"bag_replayer/{name}", Trigger, Trigger.Request())

    def errors(self) -> str:
        assert self.process.stderr is not None
        return self.process.stderr.read()


@pytest.fixture
def replayer(ros_node: Node, ros_environment: dict[str, str]) -> Iterator[Callable[..., Replayer]]:
    started: list[Replayer] = []

    def start(*arguments: str, program: str = "") -> Replayer:
        started.append(Replayer(ros_node, ros_environment, *arguments, program=program))
        return started[-1]

    yield start
    for one in started:
        one.executor.shutdown()
        one.process.kill()
        one.process.wait()
        assert one.process.stderr is not None
        one.process.stderr.close()


def test_play_pause_step_clock_and_end(  # type: ignore[no-untyped-def]
    replayer, ros_node: Node, bag: Path
) -> None:
    heard: list[str] = []
    plans: list[str] = []
    clock: list[float] = []
    ros_node.create_subscription(String, "moved", lambda m: heard.append(m.data), EVERY_ONE)
    ros_node.create_subscription(
        Clock, "/clock", lambda m: clock.append(m.clock.sec + m.clock.nanosec * 1e-9), 100
    )
    r = replayer("-p", f"bag:={bag}", "-p", "paused:=true", "-r", "/odom:=/moved")
    r.wait(lambda: ros_node.count_publishers("/moved") == ros_node.count_publishers("/imu") == 1)
    (sensor,) = ros_node.get_publishers_info_by_topic("/imu")
    assert sensor.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert not heard
    assert r.call("step").success  # the plan
    assert r.call("step").success
    r.wait(lambda: heard == ["1"])
    ros_node.create_subscription(String, "plan", lambda m: plans.append(m.data), LATCHED)
    r.wait(lambda: plans == ["0"])
    assert r.call("resume").success
    assert not r.call("step").success
    r.wait(lambda: r.process.poll() is not None)
    r.wait(lambda: heard[-1] == "99")
    assert heard == [str(i) for i in range(1, 100)]
    assert r.process.returncode == 0
    errors = r.errors()
    assert "/foreign is not played" in errors
    assert "/json is not played: its messages are not CDR" in errors
    assert clock == sorted(clock)
    assert 1000.0 <= clock[0] <= clock[-1] <= 1000.99


def test_start_set_while_held_jumps(replayer, ros_node: Node, bag: Path) -> None:  # type: ignore[no-untyped-def]
    heard: list[str] = []
    ros_node.create_subscription(String, "odom", lambda m: heard.append(m.data), EVERY_ONE)
    r = replayer("-p", f"bag:={bag}", "-p", "paused:=true")
    r.wait(lambda: ros_node.count_publishers("/odom") == 1)

    def jump(seconds: float) -> Any:
        request = SetParameters.Request(
            parameters=[Parameter("start", value=seconds).to_parameter_msg()]
        )
        response = r.services.call("bag_replayer/set_parameters", SetParameters, request)
        return response.results[0]

    refused = jump(1.5)
    assert not refused.successful
    assert "the bag lasts 0.990 s" in refused.reason
    for seconds in (0.5, 0.2):
        assert jump(seconds).successful
        assert r.call("step").success
        r.wait(partial(heard.__contains__, f"{100 * seconds:.0f}"))
    assert r.call("resume").success
    r.wait(lambda: r.process.poll() is not None)
    r.wait(lambda: heard[-1] == "99")
    assert heard == ["50", *(str(i) for i in range(20, 100))]


def test_loop_until_interrupted(replayer, ros_node: Node, bag: Path) -> None:  # type: ignore[no-untyped-def]
    heard: list[str] = []
    ros_node.create_subscription(
        String, "odom", lambda m: heard.append(m.data), qos_profile_sensor_data
    )
    r = replayer(
        "-p", f"bag:={bag}", "-p", "loop:=true", "-p", "rate:=20.0", "-p", "topics:=[/od*]"
    )
    r.wait(lambda: heard.count("50") >= 3)
    r.process.send_signal(signal.SIGINT)
    assert r.process.wait(10) == 0
    assert ros_node.count_publishers("/plan") == 0


def test_rate_0_waits_for_who_keeps_all(  # type: ignore[no-untyped-def]
    replayer, ros_node: Node, tmp_path: Path
) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        topic = writer.add_topic(Topic.of_type("/odom", TYPE))
        for i in range(5500):
            data = jazzy().serialize_cdr(jazzy().types[TYPE](data=str(i)), TYPE)
            writer.write(topic, i * 10**9, bytes(data))
    heard: list[str] = []
    keep_all = QoSProfile(history=HistoryPolicy.KEEP_ALL)  # up to 5000 in Fast DDS
    subscription = ros_node.create_subscription(
        String, "odom", lambda m: heard.append(m.data), keep_all
    )
    r = replayer("-p", f"bag:={tmp_path / 'bag'}", "-p", "rate:=0.0", "-p", "paused:=true")
    r.wait(lambda: ros_node.count_publishers("/odom") == 1)
    assert r.call("resume").success

    def heard_all() -> bool:
        # slowly, so that the queue fills, but without the executor: with thousands of messages
        # in the queue each of its waits takes Fast DDS up to 8 ms
        with subscription.handle:
            while taken := subscription.handle.take_message(String, False):
                heard.append(taken[0].data)
                time.sleep(0.0002)
        return len(heard) == 5500

    r.wait(heard_all, 60.0)
    assert heard == [str(i) for i in range(5500)]
    r.wait(lambda: r.process.poll() == 0)


def test_simulated_time_never_goes_back(replayer, ros_node: Node, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """However far the recorder was behind: it writes the waiting messages topic by topic."""
    with BagWriter(tmp_path / "bag") as writer:
        ids = [writer.add_topic(Topic.of_type(name, TYPE)) for name in ("/odom", "/imu")]
        data = bytes(jazzy().serialize_cdr(jazzy().types[TYPE](data=""), TYPE))
        for second in range(2):
            for topic in ids:
                for i in range(100):
                    writer.write(topic, (100 + second) * 10**9 + i * 10**7, data)
    jumps: list[int] = []
    heard: list[float] = []  # s, when
    ros_node.set_parameters([Parameter("use_sim_time", value=True)])
    threshold = JumpThreshold(
        min_forward=Duration(nanoseconds=1),
        min_backward=Duration(nanoseconds=-1),
        on_clock_change=False,
    )
    handle = ros_node.get_clock().create_jump_callback(
        threshold,
        post_callback=lambda jump: (
            jumps.append(jump.delta.nanoseconds),
            heard.append(time.monotonic()),
        ),
    )
    r = replayer("-p", f"bag:={tmp_path / 'bag'}", "-p", "paused:=true")
    r.wait(lambda: ros_node.count_publishers("/clock") == 1)
    r.wait(lambda: ros_node.count_publishers("/odom") == 1)
    assert r.call("resume").success
    r.wait(lambda: r.process.poll() is not None)
    assert heard[-1] - heard[0] < 1.5 * 1.99
    handle.unregister()
    assert len(jumps) > 100
    assert min(jumps) > 0


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ((), "the parameter bag is empty"),
        (("-p", "bag:=nowhere"), "nowhere: no such bag"),
        (("-p", "bag:={bag}", "-p", "start:=2.0"), "start = 2 s, but the bag lasts 0.990 s"),
        (("-p", "bag:={bag}", "-p", "topics:=[/nothing]"), "no topic of the bag is /nothing"),
    ],
)
def test_mistakes_are_one_line(  # type: ignore[no-untyped-def]
    replayer, bag: Path, arguments: tuple[str, ...], reason: str
) -> None:
    r = replayer(*(argument.format(bag=bag) for argument in arguments))
    assert r.process.wait(10) == 2
    (line,) = r.errors().splitlines()
    assert reason in line


@pytest.mark.parametrize(
    ("error", "told"),
    [
        ("OSError(5, 'Input/output error')", ": Input/output error"),
        ("KeyError('a mistake of ours')", "ended by an error: 'a mistake of ours'"),
    ],
)
def test_a_bag_that_cannot_be_read_on_is_no_success(  # type: ignore[no-untyped-def]
    replayer, bag: Path, error: str, told: str
) -> None:
    r = replayer("-p", f"bag:={bag}", program=FAILING_READ.format(error=error))
    assert r.process.wait(20) == 2
    errors = r.errors()
    assert told in errors
    assert ": played" not in errors
