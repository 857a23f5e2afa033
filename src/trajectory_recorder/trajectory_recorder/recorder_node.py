"""trajectory_recorder: writes serialised messages to rosbag2 directories, as they come.

Subscriptions live as long as the node does, so that a bag begins with the latched messages of
before and loses nothing to discovery. They take raw bytes and are drained in one callback, which
costs a fraction of one callback per message.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import Trigger

from trajectory_recorder.bag.topics import OfferedQos, Topic, message_class
from trajectory_recorder.bag.writer import Compression
from trajectory_recorder.receipt_clock import ReceiptClock
from trajectory_recorder.recording import LACKS, BagSettings, Recording
from trajectory_recorder.topic_patterns import matches
from trajectory_recorder.topic_source import TopicSource
from tricycle_core import __version__
from tricycle_core.diagnostics import Level
from tricycle_core.errors import BagError, message_of
from tricycle_core.nodes import (
    NotTheExecutors,
    declare,
    overridable,
    run_node,
    take_waiting,
)
from tricycle_core.stamps import nanoseconds_of

DISCOVERY_PERIOD = 0.1  # s
FLUSH_PERIOD = 0.5  # s; a killed recorder loses what came since the last flush
DIAGNOSTICS_PERIOD = 1.0  # s
DRAIN = 1000  # messages taken in one callback, so that services are answered in a flood
UNNUMBERED = 2**64 - 1  # number of a message where the middleware has none
CLOCK_DEPTH = 10_000  # ticks that wait for the next message
TOPICS = [
    *("maneuver/*", "identification/*", "vehicle/*", "odom", "imu"),
    *("joint_states", "joint_commands", "battery_state", "/diagnostics", "cmd_vel"),
    *("/tf", "/tf_static", "robot_description"),
]


class TrajectoryRecorder(Node):
    """Records the topics that match its patterns, from `~/start` to `~/stop`."""

    def __init__(self) -> None:
        super().__init__("trajectory_recorder")
        topics = declare(self, "topics", TOPICS, "names to record; * and ? match anything")
        self._patterns = [self._absolute("topics", pattern) for pattern in topics]
        without = declare(
            self, "exclude", [""], "names not to record, of those that topics matches"
        )
        self._excluded = [self._absolute("exclude", pattern) for pattern in without if pattern]
        declare(self, "output", "", "directory of the next bag", read_only=False)
        compression = declare(self, "compression", "zstd", "of chunks: zstd, lz4, none")
        split_size = declare(self, "split_size", 0.0, "MB of a file, 0: no limit", (0, 1e6))
        split_duration = declare(self, "split_duration", 0.0, "s of a file, 0: no limit", (0, 1e6))
        reserve = declare(self, "disk_reserve", 100.0, "MB left free on the disk", (0, 1e6))
        self._depth = declare(
            self, "queue_depth", 10_000, "messages waiting per topic", (1, 1_000_000)
        )
        backlog = declare(
            self, "snapshot_size", 0.0, "MB of messages kept for ~/snapshot, 0: none", (0, 1e5)
        )
        pairs = declare(self, "metadata", [""], "key=value pairs for the bag's metadata record")
        record = declare(self, "record", False, "start recording to `output` at once")
        self._exit_on_failure = declare(
            self, "exit_on_failure", False, "end the process when the disk ends the recording"
        )

        self._receipts = ReceiptClock()
        self._ticks: Subscription | None = None
        # whether there is a time: a simulated clock has ticked
        self._timed = not self.get_parameter("use_sim_time").value
        if not self._timed:
            self._ticks = self.create_subscription(
                ClockMessage,
                "/clock",
                lambda _: None,
                QoSProfile(depth=CLOCK_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT),
                callback_group=NotTheExecutors(),
            )
        self.recording = Recording(
            BagSettings(
                compression=_compression(compression),
                split_size=round(split_size * 1e6),
                split_duration=split_duration,
                disk_reserve=reserve * 1e6,
                backlog=round(backlog * 1e6),
                metadata={"software_version": __version__, **_metadata(pairs)},
            ),
            self._on_failure,
        )
        self._subscriptions_of: dict[str, Subscription] = {}
        self._undefined: set[str] = set()  # topics without a definition that were warned of
        self._numbered = True  # whether the middleware numbers messages, as far as is known
        self._seen: dict[str, set[bytes]] = {}  # topic -> ids of the publishers it had last
        self._diagnostics = self.create_publisher(
            DiagnosticArray, "/diagnostics", **overridable(10)
        )
        self.create_service(Trigger, "~/start", partial(self._serve, self.start_with_room))
        self.create_service(Trigger, "~/stop", partial(self._serve, self.stop))
        self.create_service(Trigger, "~/pause", partial(self._serve, self.pause))
        self.create_service(Trigger, "~/resume", partial(self._serve, self.resume))
        self.create_service(Trigger, "~/split", partial(self._serve, self.split))
        self.create_service(Trigger, "~/snapshot", partial(self._serve, self.snapshot))
        wall = Clock(clock_type=ClockType.STEADY_TIME)  # a stopped /clock stops no flush
        self.create_timer(DISCOVERY_PERIOD, self._discover, clock=wall)
        self.create_timer(FLUSH_PERIOD, self._flush, clock=wall)
        self.create_timer(DIAGNOSTICS_PERIOD, self._report, clock=wall)
        self._discover()
        if record:
            self.start()

    def _absolute(self, parameter: str, pattern: str) -> str:
        if set(pattern).isdisjoint("*?["):
            try:
                return str(self.resolve_topic_name(pattern))  # follows remappings
            except RuntimeError as error:  # rclpy's, which names neither
                reason = str(error).removeprefix("failed to resolve name: ").partition(", at ")[0]
                raise BagError(f"{parameter}: {pattern!r}: {reason}") from error
        return pattern if pattern[0] == "/" else self.get_namespace().rstrip("/") + "/" + pattern

    def start(self) -> Path:
        """Begin a bag at `output`, with the latched messages of before.

        Raises
        ------
        BagError
            If a bag is being recorded, none is named, or it exists.
        """
        self._drain_all()  # what waits is newer than the latched messages taken so far
        output = self.get_parameter("output").value
        return self.recording.start(output, self._stamp(time.time_ns()))

    def start_with_room(self) -> Path:
        """Begin a bag, unless it would end at once: who asks for it can make room.

        Raises
        ------
        BagError
            As `start`, or if less than the reserve of the disk is free.
        """
        self.recording.check_room(self.get_parameter("output").value)
        return self.start()

    def stop(self) -> str:
        """Take what has arrived and close the bag; say where it is, and what it lacks.

        Raises
        ------
        BagError
            If nothing is being recorded.
        """
        self._drain_all()
        lost, answer = self.recording.lost, str(self.recording.stop())
        for name in self.recording.refused:  # the next bag may take what did not fit into this one
            self._seen.pop(name, None)
        if lost:
            answer += LACKS + lost
            self.get_logger().warning(answer)
        return answer

    def pause(self) -> str:
        """Take what has arrived, and record no more until `resume`."""
        self._drain_all()
        self.recording.pause()
        return "paused"

    def resume(self) -> str:
        """Record again, what arrives from now on."""
        self._drain_all()
        self.recording.resume()
        return "recording"

    def split(self) -> str:
        """Begin the next file of the bag."""
        self._drain_all()
        self.recording.split(self._stamp(time.time_ns()) or 0)  # before any, nothing is written
        return "split"

    def snapshot(self) -> Path:
        """Write what was received last to a bag at `output`."""
        self._drain_all()
        return self.recording.snapshot(self.get_parameter("output").value)

    def destroy_node(self) -> None:
        """Close the bag, then the node; end the process with status 1 if the bag lacks its end."""
        failed = False
        with suppress(BagError):
            try:
                self.stop()
            except OSError as error:
                failed = True
                self.get_logger().error(f"the bag is not complete: {message_of(error)}")
        super().destroy_node()
        if failed:
            raise SystemExit(1)

    def _serve(
        self, action: Callable[[], Path | str], _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        try:
            response.message = str(action())
            response.success = True
        except (BagError, OSError) as error:
            response.message = message_of(error)
            self.get_logger().error(response.message)
        return response

    def _discover(self) -> None:
        for name, _ in self.get_topic_names_and_types():
            if not matches(name, self._patterns) or matches(name, self._excluded):
                continue
            publishers = self.get_publishers_info_by_topic(name)
            gids = {bytes(publisher.endpoint_gid) for publisher in publishers}
            seen = self._seen.get(name, set())
            if gids - seen or (gids != seen and gids and name in self.recording.refused):
                self._subscribe(name, publishers)
            elif gids != seen and name in self._subscriptions_of:
                source = self.recording.topics[name]
                self._drain(source, self._subscriptions_of[name], self._depth)
                source.left(len(gids))
            self._seen[name] = gids

    def _subscribe(self, name: str, publishers: list[TopicEndpointInfo]) -> None:
        """Subscribe as strictly as all publishers of a topic allow."""
        types = sorted({publisher.topic_type for publisher in publishers})
        if len(types) > 1:
            self._refuse(name, f"has the types {', '.join(types)}")
            return
        try:
            message = message_class(types[0])
            topic = _topic(name, types[0], publishers)
            if self.recording.forget_other_type(topic):
                self.destroy_subscription(self._subscriptions_of.pop(name))
        except BagError as error:
            self._refuse(name, str(error))
            return
        self.recording.refused.pop(name, None)
        if not topic.definition and name not in self._undefined:
            self._undefined.add(name)
            self.get_logger().warning(
                f"{name} is recorded without the definition of its type {types[0]}, for which no "
                ".msg file of plain fields was found: readers need the type installed"
            )
        reliable = all(qos.reliability == "reliable" for qos in topic.qos)
        profile = QoSProfile(
            depth=self._depth,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL
            if topic.latched
            else DurabilityPolicy.VOLATILE,
        )
        source = self.recording.offer(topic)
        old = self._subscriptions_of.get(name)
        if old is not None:
            if old.qos_profile == profile:
                return  # one publisher more or less, offering the same
            self._drain(source, old, self._depth)
            self.destroy_subscription(old)
        self._subscriptions_of[name] = self.create_subscription(
            message, name, partial(self._on_message, source), profile, raw=True
        )

    def _refuse(self, name: str, why: str) -> None:
        if self.recording.refused.get(name) != why:
            self.recording.refused[name] = why
            self.get_logger().warning(f"{name} is not recorded: {why}")

    def _on_message(self, source: TopicSource, data: bytes, info: dict[str, int]) -> None:
        self._take(source, data, info)
        self._drain(source, self._subscriptions_of[source.topic.name])

    def _drain_all(self) -> None:
        """Take all that has arrived, which a recorder that was held up may have much of."""
        for name, subscription in self._subscriptions_of.items():
            self._drain(self.recording.topics[name], subscription, self._depth)
        self._stamp(time.time_ns())

    def _flush(self) -> None:
        if not self._timed:
            self._stamp(time.time_ns())
        self.recording.flush()

    def _drain(self, source: TopicSource, subscription: Subscription, most: int = DRAIN) -> None:
        for data, info in take_waiting(subscription, most):
            self._take(source, data, info)

    def _take(self, source: TopicSource, data: bytes, info: dict[str, int]) -> None:
        stamp = self._stamp(info["received_timestamp"])
        sequence = info["publication_sequence_number"]
        if sequence == UNNUMBERED and self._numbered:
            self._numbered = False
            self.get_logger().warning(
                "lost messages are not counted: the middleware (RMW_IMPLEMENTATION) numbers none"
            )
        source.received(data, sequence)
        if stamp is not None:
            self.recording.write(source, data, stamp)

    def _stamp(self, received: int) -> int | None:
        """Return ROS time of receipt, ns; None before the first tick of a simulated clock.

        With the first tick the latched messages of before it are written. Where the middleware has
        no time of arrival (0), it is that of handling.
        """
        received = received or time.time_ns()
        if self._ticks is None:
            return received
        with self._ticks.handle:
            while self._receipts.newest <= received:
                taken = self._ticks.handle.take_message(self._ticks.msg_type, False)
                if taken is None:
                    break
                message, info = taken
                if message.clock.sec >= 0:
                    arrived = info["received_timestamp"] or time.time_ns()
                    self._receipts.tick(arrived, nanoseconds_of(message.clock))
        stamp = self._receipts.at(received)
        if not self._timed and stamp is not None:
            self._timed = True
            self.recording.write_latched(stamp)
        return stamp

    def _on_failure(self, failure: str) -> None:
        self.get_logger().error(failure)
        self._report()
        if self._exit_on_failure:
            raise SystemExit(1)

    def _report(self) -> None:
        found = self.recording.status(self._patterns)
        if not self._timed and found.level is Level.OK:
            message = "waits for the first /clock: nothing is recorded before it"
            found = replace(found, level=Level.WARN, message=message)
        status = DiagnosticStatus(
            level=bytes([found.level]),
            name=f"{self.get_name()}: bag",
            message=found.message,
            values=[KeyValue(key=key, value=str(value)) for key, value in found.values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)


def _compression(name: str) -> Compression:
    try:
        return Compression[name.upper()]
    except KeyError:
        known = ", ".join(kind.name.lower() for kind in Compression)
        raise BagError(f"compression: {name!r} must be one of {known}") from None


def _metadata(pairs: Sequence[str]) -> dict[str, str]:
    found = {}
    for pair in filter(None, pairs):
        key, equals, value = pair.partition("=")
        if not (key and equals):
            raise BagError(f"metadata: {pair!r} must be key=value")
        found[key] = value
    return found


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
    except BagError:
        return Topic(name, type_name, type_hash=str(publishers[0].topic_type_hash), qos=qos)


def main() -> None:
    """Run the node."""
    run_node(TrajectoryRecorder)
