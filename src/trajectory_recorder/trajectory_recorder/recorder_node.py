"""trajectory_recorder: writes serialised messages to rosbag2 directories, as they come.

Subscriptions live as long as the node does, so that a bag begins with the latched messages of
before and loses nothing to discovery. They take raw bytes and are drained in one callback, which
costs a fraction of one callback per message.
"""

import shutil
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.time import Time
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import Trigger

from trajectory_recorder.bag.topics import OfferedQos, Topic, message_class
from trajectory_recorder.bag.writer import BagWriter, Compression
from trajectory_recorder.receipt_clock import ReceiptClock
from tricycle_core import __version__
from tricycle_core.errors import BagError
from tricycle_core.nodes import NotTheExecutors, declare, overridable, run_node

DISCOVERY_PERIOD = 0.1  # s
FLUSH_PERIOD = 0.5  # s; a killed recorder loses what came since the last flush
DIAGNOSTICS_PERIOD = 1.0  # s
DRAIN = 1000  # messages taken in one callback, so that services are answered in a flood
CLOCK_DEPTH = 10_000  # ticks that wait for the next message
TOPICS = [
    *("maneuver/*", "odom", "imu", "joint_states", "joint_commands", "battery_state"),
    "/diagnostics",
]
# values of diagnostics that are copied to the bag's metadata record
METADATA = ("plan_id", "vehicle*", "firmware*")
DIAGNOSTIC_TYPES: dict[str, Callable[[Any], Any]] = {  # to a list of DiagnosticStatus
    "diagnostic_msgs/msg/DiagnosticStatus": lambda m: [m],
    "diagnostic_msgs/msg/DiagnosticArray": lambda m: m.status,
}


class _Source:
    """A subscribed topic: how it is offered, its latched messages, what was lost."""

    def __init__(self, topic: Topic) -> None:
        self.latched: deque[bytes] = deque()
        self.subscription: Subscription = None
        self.id = 0  # in the bag being written
        self.sequence = 0  # last one received
        self.lost = 0
        self.offered(topic)

    def offered(self, topic: Topic) -> None:
        """Take note of how the topic is offered now."""
        self.topic = topic
        self.sequence = 0
        # The middleware does not tell how many messages a publisher latches; nearly all latch one.
        self.latched = deque(self.latched, maxlen=len(topic.qos) if topic.latched else 0)

    def count_lost(self, sequence: int) -> None:
        """Count what is missing before this sequence number; numbers are per publisher."""
        if len(self.topic.qos) == 1 and 0 < self.sequence < sequence:
            self.lost += sequence - self.sequence - 1
        self.sequence = sequence


class TrajectoryRecorder(Node):
    """Records the topics that match its patterns, from `~/start` to `~/stop`."""

    def __init__(self) -> None:
        super().__init__("trajectory_recorder")
        topics = declare(self, "topics", TOPICS, "names to record; * and ? match anything")
        self._patterns = [self._absolute(pattern) for pattern in topics]
        declare(self, "output", "", "directory of the next bag", read_only=False)
        self._compression = Compression(
            declare(self, "compression", "zstd", "of chunks: zstd, lz4, none").replace("none", "")
        )
        self._split_size = declare(self, "split_size", 0.0, "MB of a file, 0: no limit", (0, 1e6))
        self._split_duration = declare(
            self, "split_duration", 0.0, "s of a file, 0: no limit", (0, 1e6)
        )
        self._reserve = declare(self, "disk_reserve", 100.0, "MB left free on the disk", (0, 1e6))
        self._depth = declare(
            self, "queue_depth", 10_000, "messages waiting per topic", (1, 1_000_000)
        )
        pairs = declare(self, "metadata", [""], "key=value pairs for the bag's metadata record")
        self._metadata = dict(pair.split("=", 1) for pair in pairs if pair)
        record = declare(self, "record", False, "start recording to `output` at once")
        self._exit_on_failure = declare(
            self, "exit_on_failure", False, "end the process when the disk ends the recording"
        )

        self._receipts = ReceiptClock()
        self._ticks: Subscription | None = None
        if self.get_parameter("use_sim_time").value:
            self._ticks = self.create_subscription(
                ClockMessage,
                "/clock",
                lambda _: None,
                QoSProfile(depth=CLOCK_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT),
                callback_group=NotTheExecutors(),
            )
        self._sources: dict[str, _Source] = {}
        self._seen: dict[str, set[bytes]] = {}  # topic -> ids of those it had last
        self._refused: dict[str, str] = {}  # topic -> why it is not recorded
        self._bag: BagWriter | None = None
        self._failure = ""  # why the last recording ended by itself
        self._reported = (time.monotonic(), 0, 0)  # s, messages, bytes
        self._disk_free = 0  # bytes
        self._diagnostics = self.create_publisher(
            DiagnosticArray, "/diagnostics", **overridable(10)
        )
        self.create_service(Trigger, "~/start", partial(self._serve, self.start))
        self.create_service(Trigger, "~/stop", partial(self._serve, self.stop))
        wall = Clock(clock_type=ClockType.STEADY_TIME)  # a stopped /clock stops no flush
        self.create_timer(DISCOVERY_PERIOD, self._discover, clock=wall)
        self.create_timer(FLUSH_PERIOD, self._flush, clock=wall)
        self.create_timer(DIAGNOSTICS_PERIOD, self._report, clock=wall)
        self._discover()
        if record:
            self.start()

    def _absolute(self, pattern: str) -> str:
        if set(pattern).isdisjoint("*?["):
            return str(self.resolve_topic_name(pattern))  # follows remappings
        return pattern if pattern[0] == "/" else self.get_namespace().rstrip("/") + "/" + pattern

    def start(self) -> Path:
        """Begin a bag at `output`, with the latched messages of before.

        Raises
        ------
        BagError
            If a bag is being recorded, none is named, or it exists.
        """
        if self._bag is not None:
            raise BagError(f"already recording {self._bag.path}: stop it first")
        output = self.get_parameter("output").value
        if not output:
            raise BagError("the parameter output is empty: set it to the directory of the bag")
        self._drain_all()  # what waits is newer than the latched messages taken so far
        self._bag = BagWriter(
            Path(output).absolute(),
            compression=self._compression,
            split_size=round(self._split_size * 1e6),
            split_duration=self._split_duration,
            metadata={"software_version": __version__, **self._metadata},
        )
        self._failure = ""
        self._reported = (time.monotonic(), 0, 0)
        self._disk_free = shutil.disk_usage(self._bag.path).free
        now = self.get_clock().now().nanoseconds
        for source in self._sources.values():
            source.id = self._bag.add_topic(source.topic)
            source.lost = 0
            for data in source.latched:
                self._write(source, data, now)
        return self._bag.path

    def stop(self) -> Path:
        """Take what has arrived and close the bag.

        Raises
        ------
        BagError
            If nothing is being recorded.
        """
        self._drain_all()
        if self._bag is None:
            raise BagError(self._failure or "not recording")
        bag, self._bag = self._bag, None
        bag.close()
        return bag.path

    def destroy_node(self) -> None:
        """Close the bag, then the node."""
        with suppress(BagError):
            try:
                self.stop()
            except OSError as error:
                self.get_logger().error(f"the bag is not complete: {error}")
        super().destroy_node()

    def _serve(
        self, action: Callable[[], Path], _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        try:
            response.message = str(action())
            response.success = True
        except (BagError, OSError) as error:
            response.message = str(error)
            self.get_logger().error(response.message)
        return response

    def _discover(self) -> None:
        for name, types in self.get_topic_names_and_types():
            if not any(fnmatchcase(name, pattern) for pattern in self._patterns):
                continue
            publishers = self.get_publishers_info_by_topic(name)
            gids = {bytes(publisher.endpoint_gid) for publisher in publishers}
            if gids - self._seen.get(name, set()):
                self._subscribe(name, types, publishers)
            self._seen[name] = gids

    def _subscribe(self, name: str, types: list[str], publishers: list[TopicEndpointInfo]) -> None:
        """Subscribe as strictly as all publishers of a topic allow."""
        if len(types) != 1:
            self._refuse(name, f"has the types {', '.join(types)}")
            return
        try:
            message = message_class(types[0])
        except BagError as error:
            self._refuse(name, str(error))
            return
        topic = _topic(name, types[0], publishers)
        reliable = all(qos.reliability == "reliable" for qos in topic.qos)
        profile = QoSProfile(
            depth=self._depth,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL
            if topic.latched
            else DurabilityPolicy.VOLATILE,
        )
        source = self._sources.get(name)
        if source is None:
            source = self._sources[name] = _Source(topic)
            if self._bag is not None:
                source.id = self._bag.add_topic(topic)
        else:
            source.offered(topic)
            if source.subscription.qos_profile == profile:
                return  # one publisher more or less, offering the same
            self._drain(source)
            self.destroy_subscription(source.subscription)
        source.subscription = self.create_subscription(
            message, name, partial(self._on_message, source), profile, raw=True
        )

    def _refuse(self, name: str, why: str) -> None:
        if self._refused.get(name) != why:
            self._refused[name] = why
            self.get_logger().warning(f"{name} is not recorded: {why}")

    def _on_message(self, source: _Source, data: bytes, info: dict[str, int]) -> None:
        self._take(source, data, info)
        self._drain(source)

    def _drain_all(self) -> None:
        for source in self._sources.values():
            self._drain(source)

    def _drain(self, source: _Source) -> None:
        subscription = source.subscription
        with subscription.handle:
            for _ in range(DRAIN):
                taken = subscription.handle.take_message(subscription.msg_type, True)
                if taken is None:
                    return
                self._take(source, *taken)

    def _take(self, source: _Source, data: bytes, info: dict[str, int]) -> None:
        source.latched.append(data)
        source.count_lost(info["publication_sequence_number"])
        self._write(source, data, self._stamp(info["received_timestamp"]))

    def _stamp(self, received: int) -> int:
        """Return ROS time of receipt, ns."""
        if self._ticks is None:
            return received
        with self._ticks.handle:
            while self._receipts.newest <= received:
                taken = self._ticks.handle.take_message(self._ticks.msg_type, False)
                if taken is None:
                    break
                message, info = taken
                time = Time.from_msg(message.clock).nanoseconds
                self._receipts.tick(info["received_timestamp"], time)
        return self._receipts.at(received)

    def _write(self, source: _Source, data: bytes, stamp: int) -> None:
        if self._bag is None:
            return
        try:
            self._bag.write(source.id, stamp, data)
        except OSError as error:
            self._fail(f"{self._bag.path}: {error.strerror or error}")
            return
        statuses = DIAGNOSTIC_TYPES.get(source.topic.type)
        if statuses is not None:
            message = deserialize_message(data, source.subscription.msg_type)
            for pair in (pair for status in statuses(message) for pair in status.values):
                if any(fnmatchcase(pair.key, pattern) for pattern in METADATA):
                    self._bag.metadata[pair.key] = pair.value

    def _flush(self) -> None:
        if self._bag is None:
            return
        try:
            self._disk_free = shutil.disk_usage(self._bag.path).free
            if self._disk_free >= self._reserve * 1e6:
                self._bag.flush()
                return
            left = f"{self._disk_free / 1e6:.0f} MB of disk left"
            reason = f"{left}, disk_reserve is {self._reserve:.0f} MB"
        except OSError as error:
            reason = f"{self._bag.path}: {error.strerror or error}"
        self._fail(reason)

    def _fail(self, reason: str) -> None:
        """End the recording; the bag holds what the disk took."""
        bag, self._bag = self._bag, None
        self._failure = f"recording stopped: {reason}"
        self.get_logger().error(self._failure)
        if bag is not None:
            with suppress(OSError):
                bag.close()
        self._report()
        if self._exit_on_failure:
            raise SystemExit(1)

    def _report(self) -> None:
        status = DiagnosticStatus(
            level=DiagnosticStatus.OK,
            name=f"{self.get_name()}: bag",
            message="recording" if self._bag else "not recording",
        )
        values: dict[str, object] = {}
        lost = sum(source.lost for source in self._sources.values())
        if self._bag is not None:
            before, messages, size = self._reported
            now = time.monotonic()
            self._reported = (now, self._bag.messages, self._bag.size)
            values = {
                "bag": self._bag.path,
                "messages": self._bag.messages,
                "bytes": self._bag.size,
                "messages_per_second": round((self._bag.messages - messages) / (now - before), 1),
                "bytes_per_second": round((self._bag.size - size) / (now - before)),
                "disk_free": self._disk_free,
            }
        values["lost"] = lost
        values["topics"] = " ".join(sorted(self._sources))
        missing = [p for p in self._patterns if not self._matches(p)]
        if missing:
            values["missing"] = " ".join(missing)
        for name, why in self._refused.items():
            values[name] = why
        if self._failure:
            status.level, status.message = DiagnosticStatus.ERROR, self._failure
        elif lost:
            status.level, status.message = DiagnosticStatus.WARN, f"{lost} messages lost"
        elif self._refused:
            status.level, status.message = DiagnosticStatus.WARN, "topics are not recorded"
        status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def _matches(self, pattern: str) -> bool:
        return any(fnmatchcase(name, pattern) for name in self._sources)


def _topic(name: str, type_name: str, publishers: list[TopicEndpointInfo]) -> Topic:
    """Topic as its publishers offer it."""
    qos = tuple(
        OfferedQos(
            history=p.qos_profile.history.short_key,
            depth=p.qos_profile.depth,
            reliability=p.qos_profile.reliability.short_key,
            durability=p.qos_profile.durability.short_key,
            deadline=p.qos_profile.deadline.nanoseconds,
            lifespan=p.qos_profile.lifespan.nanoseconds,
            liveliness=p.qos_profile.liveliness.short_key,
            lease=p.qos_profile.liveliness_lease_duration.nanoseconds,
        )
        for p in publishers
    )
    try:
        return Topic.of_type(name, type_name, qos=qos)
    except BagError:  # recorded all the same, without its definition
        return Topic(name, type_name, type_hash=str(publishers[0].topic_type_hash), qos=qos)


def main() -> None:
    """Run the node."""
    run_node(TrajectoryRecorder)
