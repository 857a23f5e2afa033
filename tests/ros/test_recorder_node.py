"""The recorder as a process: what is published is in the bag, whatever happens to the process."""

import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.srv import SetParameters
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from trajectory_recorder import recorder_node
from trajectory_recorder.bag.reader import BagReader
from trajectory_recorder.bag.topics import OfferedQos, Topic, deserialize
from trajectory_recorder.recorder_node import TrajectoryRecorder
from tricycle_cli.operation.operator_node import ServiceCaller
from tricycle_cli.operation.processes import executable
from tricycle_core.nodes import LATCHED

pytestmark = pytest.mark.ros


class Recorder:
    """A recorder process and its services."""

    def __init__(self, node: Node, env: dict[str, str], **parameters: object) -> None:
        command = [executable("trajectory_recorder"), "--ros-args"]
        for name, value in parameters.items():
            command += ["-p", f"{name}:={value}"]
        self.process = subprocess.Popen(command, env=env, stderr=subprocess.PIPE, text=True)
        self.node = node
        self.executor = SingleThreadedExecutor(context=node.context)
        self.executor.add_node(node)
        self.services = ServiceCaller(node, lambda condition, _: self.wait(condition))
        self.status: dict[str, str] = {}
        self.level = b""
        self.message = ""
        self.now = 0  # s, by the recorder's clock
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.now = message.header.stamp.sec
        for status in message.status:
            if status.name == "trajectory_recorder: bag":
                self.status = {pair.key: pair.value for pair in status.values}
                self.level, self.message = status.level, status.message

    def wait(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + 20
        while not condition():
            assert time.monotonic() < deadline, "timed out"
            assert self.process.poll() is None, self.process.stderr and self.process.stderr.read()
            self.executor.spin_once(timeout_sec=0.02)

    def call(self, service: str, kind: type, request: Any) -> Any:
        return self.services.call(f"trajectory_recorder/{service}", kind, request)

    def trigger(self, service: str) -> tuple[bool, str]:
        answer = self.call(service, Trigger, Trigger.Request())
        return answer.success, answer.message

    def set_output(self, path: Path) -> None:
        parameter = Parameter("output", value=str(path)).to_parameter_msg()
        answer = self.call(
            "set_parameters", SetParameters, SetParameters.Request(parameters=[parameter])
        )
        assert answer.results[0].successful

    def end(self, number: signal.Signals = signal.SIGINT) -> int:
        self.process.send_signal(number)
        return self.process.wait(10)


@pytest.fixture
def recorder(ros_node: Node, ros_environment: dict[str, str]) -> Iterator[Callable[..., Recorder]]:
    started: list[Recorder] = []

    def start(**parameters: object) -> Recorder:
        started.append(Recorder(ros_node, ros_environment, **parameters))
        return started[-1]

    yield start
    for one in started:
        one.executor.shutdown()
        one.process.kill()
        one.process.wait()
        assert one.process.stderr is not None
        one.process.stderr.close()


def texts(path: Path, topic: str) -> list[str]:
    with BagReader(path) as bag:
        return [deserialize("std_msgs/msg/String", m.data).data for m in bag.messages([topic])]


def test_bags_one_after_the_other(recorder, ros_node: Node, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    latched = ros_node.create_publisher(String, "maneuver/path", LATCHED)
    latched.publish(String(data="stale"))
    latched.publish(String(data="before the recorder"))
    sensor = ros_node.create_publisher(String, "imu", qos_profile_sensor_data)
    state = ros_node.create_publisher(DiagnosticStatus, "maneuver/state", LATCHED)
    r = recorder(disk_reserve=0.0)
    r.wait(lambda: "/imu" in r.status.get("topics", "") and "/maneuver/state" in r.status["topics"])
    assert r.trigger("stop") == (False, "not recording")
    assert "output is empty" in r.trigger("start")[1]

    for name in ("first", "second"):
        r.set_output(tmp_path / name)
        assert r.trigger("start") == (True, str(tmp_path / name))
        assert "already recording" in r.trigger("start")[1]
        state.publish(DiagnosticStatus(values=[KeyValue(key="plan_id", value=name)]))
        for i in range(200):
            sensor.publish(String(data=f"{name} {i}"))
            r.executor.spin_once(timeout_sec=0)
        r.wait(lambda: int(r.status.get("messages", 0)) > 200)
        assert r.trigger("stop") == (True, str(tmp_path / name))

    r.set_output(tmp_path / "first")
    assert r.trigger("start") == (
        False, f"{tmp_path / 'first'} exists: a bag is not overwritten, choose another name",
    )  # fmt: skip
    for name in ("first", "second"):
        assert texts(tmp_path / name, "/maneuver/path") == ["before the recorder"]
        assert texts(tmp_path / name, "/imu") == [f"{name} {i}" for i in range(200)]
        with BagReader(tmp_path / name) as bag:
            assert bag.metadata["plan_id"] == name
            assert bag.metadata["software_version"]
            (qos,) = bag.topics["/imu"].qos
            assert (qos.reliability, qos.durability) == ("best_effort", "volatile")
            assert bag.topics["/imu"].type_hash.startswith("RIHS01_")
            stamps = [m.stamp for m in bag.messages(["/imu"])]
            assert abs(stamps[0] * 1e-9 - time.time()) < 60
            assert stamps == sorted(stamps)
    assert r.end() == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_an_ended_recorder_leaves_a_readable_bag(  # type: ignore[no-untyped-def]
    recorder, ros_node: Node, tmp_path: Path, number: signal.Signals
) -> None:
    publisher = ros_node.create_publisher(String, "odom", 1000)
    r = recorder(record=True, output=tmp_path / "bag", topics="[odom]", disk_reserve=0.0)

    def publish_until_recorded() -> bool:  # either side may know the other before it is known
        publisher.publish(String(data="first"))
        return int(r.status.get("messages", 0)) > 0

    r.wait(publish_until_recorded)
    for i in range(300):
        publisher.publish(String(data=str(i)))
    r.wait(lambda: texts_or_none(tmp_path / "bag")[-1:] == ["299"])
    if number is not signal.SIGKILL:  # what waits in memory is written at the end
        for i in range(300, 310):
            publisher.publish(String(data=str(i)))
        assert publisher.wait_for_all_acked(Duration(seconds=10))
    r.end(number)
    with BagReader(tmp_path / "bag") as bag:
        assert bag.complete
    recorded = [text for text in texts(tmp_path / "bag", "/odom") if text != "first"]
    assert recorded == [str(i) for i in range(300 if number is signal.SIGKILL else 310)]


def texts_or_none(path: Path) -> list[str]:
    try:
        return texts(path, "/odom")
    except ValueError:
        return []


def test_a_bag_begins_with_the_latched_message_that_waits_and_not_the_one_before(
    ros_environment: dict[str, str], tmp_path: Path
) -> None:
    rclpy.init(args=["--ros-args", "-p", f"output:={tmp_path / 'bag'}"])
    try:
        node = TrajectoryRecorder()
        latched = node.create_publisher(String, "maneuver/path", LATCHED)
        latched.publish(String(data="old"))
        deadline = time.monotonic() + 20
        while not (source := node.recording.topics.get("/maneuver/path")) or not source.latched:
            assert time.monotonic() < deadline
            rclpy.spin_once(node, timeout_sec=0.02)
        latched.publish(String(data="new"))
        assert latched.wait_for_all_acked(Duration(seconds=20))
        node.start()
        node.destroy_node()
    finally:
        rclpy.shutdown()
    assert texts(tmp_path / "bag", "/maneuver/path") == ["new"]


def test_a_stop_takes_all_that_waits(ros_environment: dict[str, str], tmp_path: Path) -> None:
    rclpy.init(args=["--ros-args", "-p", f"output:={tmp_path / 'bag'}", "-p", "topics:=[much]"])
    try:
        node = TrajectoryRecorder()
        much = node.create_publisher(String, "much", 3000)
        deadline = time.monotonic() + 20
        while not much.get_subscription_count():
            assert time.monotonic() < deadline
            rclpy.spin_once(node, timeout_sec=0.02)
        node.start()
        for number in range(2500):
            much.publish(String(data=str(number)))
        assert much.wait_for_all_acked(Duration(seconds=20))
        assert node.stop() == str(tmp_path / "bag")
        node.destroy_node()
    finally:
        rclpy.shutdown()
    assert texts(tmp_path / "bag", "/much") == [str(number) for number in range(2500)]


def test_a_topic_that_comes_late_and_goes_and_comes_back(  # type: ignore[no-untyped-def]
    recorder, ros_node: Node, tmp_path: Path
) -> None:
    r = recorder(record=True, output=tmp_path / "bag", disk_reserve=0.0, topics="[late]")
    r.wait(lambda: r.status.get("missing", "").split() == ["/late"])

    latched = ros_node.create_publisher(String, "late", LATCHED)
    latched.publish(String(data="latched before the recorder saw the topic"))
    r.wait(lambda: r.status["messages"] == "1")
    latched.publish(String(data="after"))
    r.wait(lambda: r.status["messages"] == "2")
    ros_node.destroy_publisher(latched)

    weaker = ros_node.create_publisher(String, "late", qos_profile_sensor_data)

    def heard() -> bool:
        weaker.publish(String(data="best effort"))
        return int(r.status["messages"]) > 2  # only who has found the publisher hears it

    r.wait(heard)
    assert r.end() == 0
    recorded = texts(tmp_path / "bag", "/late")
    assert recorded[:2] == ["latched before the recorder saw the topic", "after"]
    assert set(recorded[2:]) == {"best effort"}


@pytest.fixture
def other_node(ros_environment: dict[str, str]) -> Iterator[Node]:
    """A node that may give topics of `ros_node` another type."""
    context = rclpy.Context()
    context.init()
    yield rclpy.create_node("other", context=context)
    context.shutdown()


def test_what_subscribes_with_a_wrong_type_hinders_no_recording(  # type: ignore[no-untyped-def]
    recorder, ros_node: Node, other_node: Node, tmp_path: Path
) -> None:
    other_node.create_subscription(Bool, "odom", lambda _: None, 10)
    publisher = ros_node.create_publisher(String, "odom", LATCHED)
    publisher.publish(String(data="recorded"))
    r = recorder(record=True, output=tmp_path / "bag", topics="[odom]", disk_reserve=0.0)
    r.wait(lambda: "recorded" in texts_or_none(tmp_path / "bag"))


def test_a_topic_may_change_its_type_between_bags(  # type: ignore[no-untyped-def]
    recorder, ros_node: Node, other_node: Node, tmp_path: Path
) -> None:
    first = other_node.create_publisher(Bool, "odom", LATCHED)
    r = recorder(record=True, output=tmp_path / "first", topics="[odom]", disk_reserve=0.0)
    r.wait(lambda: r.status.get("topics") == "/odom")
    other_node.destroy_publisher(first)
    publisher = ros_node.create_publisher(String, "odom", LATCHED)
    publisher.publish(String(data="recorded"))
    wrong = "has the type std_msgs/msg/String, and std_msgs/msg/Bool in this bag"
    r.wait(lambda: r.status.get("/odom") == wrong)
    assert r.trigger("stop")[0]
    r.wait(lambda: "/odom" not in r.status)
    r.set_output(tmp_path / "second")
    r.wait(lambda: r.status.get("topics") == "/odom")
    assert r.trigger("start")[0]
    r.wait(lambda: "recorded" in texts_or_none(tmp_path / "second"))


def test_a_disk_that_fills_up_stops_the_recording_and_leaves_a_readable_bag(  # type: ignore[no-untyped-def]
    recorder, ros_node: Node, tmp_path: Path
) -> None:
    """A file size limit set on the running process stands for the full disk."""
    publisher = ros_node.create_publisher(String, "odom", 10)
    r = recorder(
        record=True, output=tmp_path / "bag", topics="[odom]", compression="none", disk_reserve=0.0
    )
    r.wait(lambda: publisher.get_subscription_count() == 1)
    resource.prlimit(r.process.pid, resource.RLIMIT_FSIZE, (100_000, resource.RLIM_INFINITY))

    def publish_until_it_stops() -> bool:
        publisher.publish(String(data="x" * 1000))
        return bool(r.level == DiagnosticStatus.ERROR)

    r.wait(publish_until_it_stops)
    assert "File too large" in r.message
    success, message = r.trigger("stop")
    assert not success
    assert "File too large" in message
    with BagReader(tmp_path / "bag") as bag:
        assert not bag.complete
        assert "File too large" in bag.metadata["failure"]
    found = texts(tmp_path / "bag", "/odom")
    assert found
    assert set(found) == {"x" * 1000}


def test_on_simulated_time_a_message_has_the_tick_it_was_received_at(  # type: ignore[no-untyped-def]
    recorder, ros_node: Node, tmp_path: Path
) -> None:
    clock = ros_node.create_publisher(Clock, "/clock", 1000)
    publisher = ros_node.create_publisher(String, "odom", LATCHED)  # so that none is lost
    r = recorder(record=True, output=tmp_path / "bag", topics="[odom]", use_sim_time=True)
    r.wait(lambda: publisher.get_subscription_count() == 1 and clock.get_subscription_count() == 2)

    def heard() -> bool:
        clock.publish(Clock(clock=Time(sec=1)))
        return r.now == 1  # best effort: only who has found the publisher hears it

    r.wait(heard)
    for tick in (2, 3, 4):
        clock.publish(Clock(clock=Time(sec=tick)))
        publisher.publish(String(data=str(tick)))
        r.wait(lambda: r.status.get("messages") == str(tick - 1))  # noqa: B023
    assert r.end() == 0
    with BagReader(tmp_path / "bag") as bag:
        stamps = [message.stamp for message in bag.messages(["/odom"])]
    assert stamps == [2_000_000_000, 3_000_000_000, 4_000_000_000]


def test_before_the_first_tick_only_latched_messages_are_kept(  # type: ignore[no-untyped-def]
    recorder, ros_node: Node, tmp_path: Path
) -> None:
    clock = ros_node.create_publisher(Clock, "/clock", 1000)
    latched = ros_node.create_publisher(String, "maneuver/path", LATCHED)
    latched.publish(String(data="plan"))
    publisher = ros_node.create_publisher(String, "odom", 10)
    topics = "[odom,maneuver/path]"
    r = recorder(record=True, output=tmp_path / "bag", topics=topics, use_sim_time=True)
    r.wait(lambda: publisher.get_subscription_count() == 1 and clock.get_subscription_count() == 2)
    publisher.publish(String(data="without a time"))
    r.wait(lambda: "waits for the first /clock" in r.message)
    assert (r.level, r.status["messages"]) == (DiagnosticStatus.WARN, "0")

    def heard() -> bool:
        clock.publish(Clock(clock=Time(sec=7)))
        return r.status.get("messages") == "1"

    r.wait(heard)
    assert r.end() == 0
    with BagReader(tmp_path / "bag") as bag:
        assert [(m.topic, m.stamp) for m in bag.messages()] == [("/maneuver/path", 7_000_000_000)]


def test_a_bag_that_is_removed_stops_the_recording_with_a_diagnostic(  # type: ignore[no-untyped-def]
    recorder, ros_node: Node, tmp_path: Path
) -> None:
    r = recorder(record=True, output=tmp_path / "bag")
    r.wait(lambda: r.status.get("bag") == str(tmp_path / "bag"))
    shutil.rmtree(tmp_path / "bag")
    r.wait(lambda: r.level == DiagnosticStatus.ERROR)
    assert "No such file or directory" in r.message
    assert r.end() == 0


def test_a_nearly_full_disk_stops_the_recording_with_a_diagnostic(  # type: ignore[no-untyped-def]
    recorder, ros_node: Node, tmp_path: Path
) -> None:
    r = recorder(record=True, output=tmp_path / "bag", disk_reserve=1e6)
    r.wait(lambda: r.level == DiagnosticStatus.ERROR)
    assert "disk_reserve is 1000000 MB" in r.message
    assert "disk_reserve" in r.trigger("stop")[1]


def test_a_nearly_full_disk_refuses_a_start(recorder, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    r = recorder(output=tmp_path / "bag", disk_reserve=1e6)
    success, message = r.trigger("start")
    assert not success
    assert "disk_reserve is 1000000 MB" in message
    assert not (tmp_path / "bag").exists()


def test_a_recording_that_cannot_go_on_ends_the_node_where_that_is_wanted(  # type: ignore[no-untyped-def]
    recorder, tmp_path: Path
) -> None:
    r = recorder(record=True, output=tmp_path / "bag", disk_reserve=1e6, exit_on_failure=True)
    assert r.process.wait(10) == 1


def test_a_mistake_ends_the_node_with_one_line(recorder, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "bag").mkdir()
    r = recorder(record=True, output=tmp_path / "bag")
    assert r.process.wait(10) == 2
    assert r.process.stderr is not None
    (line,) = r.process.stderr.read().splitlines()
    assert "exists: a bag is not overwritten" in line


def test_pause_split_and_snapshot(recorder, ros_node: Node, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    publisher = ros_node.create_publisher(String, "odom", 10)
    ignored = ros_node.create_publisher(String, "imu", 10)
    r = recorder(disk_reserve=0.0, snapshot_size=1.0, exclude="[/imu]")
    r.wait(lambda: "/odom" in r.status.get("topics", ""))
    assert ignored.get_subscription_count() == 0

    def publish(text: str) -> None:
        publisher.publish(String(data=text))
        assert publisher.wait_for_all_acked(Duration(seconds=10))

    assert r.trigger("pause") == (False, "not recording")
    publish("just happened")
    r.set_output(tmp_path / "snapshot")
    assert r.trigger("snapshot") == (True, str(tmp_path / "snapshot"))
    assert texts(tmp_path / "snapshot", "/odom") == ["just happened"]
    r.set_output(tmp_path / "bag")
    assert r.trigger("start")[0]
    publish("recorded")
    assert r.trigger("pause")[0]
    publish("left out")
    assert r.trigger("resume")[0]
    assert r.trigger("split")[0]
    publish("in the second file")
    assert r.trigger("stop")[0]
    assert texts(tmp_path / "bag", "/odom") == ["recorded", "in the second file"]
    assert len(list((tmp_path / "bag").glob("*.mcap"))) == 2


class Said:
    """Stands in for a logger."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def warning(self, text: str) -> None:
        self.lines.append(text)

    error = warning


@pytest.fixture
def said() -> Said:
    return Said()


@pytest.fixture
def node(
    ros_environment: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: Said
) -> Iterator[TrajectoryRecorder]:
    """A recorder in this process, which is not spun."""
    rclpy.init(args=["--ros-args", "-p", f"output:={tmp_path / 'bag'}", "-p", "disk_reserve:=0.0"])
    try:
        node = TrajectoryRecorder()
        monkeypatch.setattr(node, "get_logger", lambda: said)
        yield node
        node.destroy_node()
    finally:
        rclpy.shutdown()


def test_without_times_and_numbers_of_the_middleware_stamps_are_those_of_handling(
    node: TrajectoryRecorder, said: Said, tmp_path: Path
) -> None:
    begin = time.time_ns()
    node.start()
    source = node.recording.offer(Topic("/odom", "std_msgs/msg/String", qos=(OfferedQos(),)))
    unknown = {"received_timestamp": 0, "publication_sequence_number": 2**64 - 1}
    for data in (b"1", b"2"):
        node._take(source, data, unknown)
    assert node.stop() == str(tmp_path / "bag")  # no loss is made up
    with BagReader(tmp_path / "bag") as bag:
        assert all(begin <= m.stamp <= time.time_ns() for m in bag.messages(["/odom"]))
        assert bag.topics["/odom"].count == 2
    assert [line for line in said.lines if "lost messages are not counted" in line] == said.lines
    assert len(said.lines) == 1


def test_a_last_write_that_fails_ends_the_process_with_status_1(
    node: TrajectoryRecorder, said: Said, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail() -> str:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(node, "stop", fail)
        patch.setattr(Node, "destroy_node", lambda _: None)
        with pytest.raises(SystemExit) as ending:
            node.destroy_node()
    assert ending.value.code == 1
    assert said.lines == ["the bag is not complete: No space left on device"]


def test_every_topic_without_a_definition_is_warned_of_once(
    node: TrajectoryRecorder, said: Said, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        recorder_node, "_topic", lambda name, kind, _: Topic(name, kind, qos=(OfferedQos(),))
    )
    for name in ("odom", "imu"):
        node.create_publisher(String, name, 10)
        publishers = node.get_publishers_info_by_topic(name)
        for _ in range(2):
            node._subscribe(f"/{name}", publishers)
    assert [line.partition(" ")[0] for line in said.lines] == ["/odom", "/imu"]


def test_losses_are_counted_again_when_a_publisher_has_left(node: TrajectoryRecorder) -> None:
    first, second = (node.create_publisher(String, "odom", 10) for _ in range(2))

    def wait(number: int) -> None:
        deadline = time.monotonic() + 20
        while len(node.get_publishers_info_by_topic("/odom")) != number:
            assert time.monotonic() < deadline
            rclpy.spin_once(node, timeout_sec=0.02)
        node._discover()

    wait(2)
    source = node.recording.topics["/odom"]
    source.received(b"", 900)
    node.destroy_publisher(first)
    wait(1)
    for sequence in (3, 9):
        source.received(b"", sequence)
    assert source.lost == 5
    node.destroy_publisher(second)


@pytest.mark.parametrize(
    ("parameter", "line"),
    [
        ("metadata:=[vehicle]", "metadata: 'vehicle' must be key=value"),
        ("compression:=gzip", "compression: 'gzip' must be one of none, lz4, zstd"),
    ],
)
def test_a_setting_that_cannot_be_is_told(
    ros_environment: dict[str, str], parameter: str, line: str
) -> None:
    command = [executable("trajectory_recorder"), "--ros-args", "-p", parameter]
    done = subprocess.run(command, env=ros_environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert done.stderr.rstrip().endswith(f"[trajectory_recorder]: {line}")
