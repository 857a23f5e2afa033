"""bag_replayer: publishes a bag's messages by their stamps, with `/clock`.

Names are remapped as those of any node (``-r /odom:=/recorded/odom``).
"""

import math
from collections.abc import Callable
from functools import partial
from threading import Thread

from rcl_interfaces.msg import SetParametersResult
from rclpy._rclpy_pybind11 import RCLError
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import Trigger

from trajectory_recorder.bag.location import bag_path
from trajectory_recorder.bag.reader import BagReader, RecordedMessage
from trajectory_recorder.bag.topics import OfferedQos, message_class
from trajectory_recorder.player import Player
from trajectory_recorder.topic_patterns import chosen
from tricycle_core.errors import BagError, message_of
from tricycle_core.nodes import declare, run_node

ACKNOWLEDGE = Duration(seconds=0.05)  # to wait at a time for reliable subscribers
DEPTH = 100  # messages, where the middleware did not tell the recorded publisher's


class BagReplayer(Node):
    """Plays a bag; ends when it ends."""

    def __init__(self) -> None:
        super().__init__("bag_replayer")
        path = declare(self, "bag", "", "rosbag2 directory, .mcap or .db3 file, or URL")
        topics = declare(self, "topics", ["*"], "names to play; * and ? match anything")
        without = declare(self, "exclude", [""], "names not to play, of those that topics matches")
        rate = declare(self, "rate", 1.0, "recorded s per s; 0: as fast as it is taken", (0, 1000))
        start = declare(
            self,
            "start",
            0.0,
            "recorded s to skip; set while it plays, it jumps there",
            (0, 1e9),
            read_only=False,
        )
        duration = declare(self, "duration", 0.0, "recorded s to play; 0: to the end", (0, 1e9))
        loop = declare(self, "loop", False, "begin again at the end")
        paused = declare(self, "paused", False, "wait for ~/resume or ~/step")
        clock = declare(self, "clock", True, "publish /clock, unless the bag holds it")
        if not path:
            raise BagError("the parameter bag is empty: set it to the bag to play")
        self._bag = BagReader(bag_path(path))
        if reason := self._beyond(start):
            raise BagError(reason)
        self._as_fast_as_taken = rate == 0
        self._to: dict[str, Publisher] = {}
        for name in chosen(self._bag.topics, topics, [name for name in without if name]):
            self._create(name)
        if not self._to:
            raise BagError(f"{path} holds nothing to play on {', '.join(topics)}")
        self._clock_publisher = (
            self.create_publisher(ClockMessage, "/clock", 10)
            if clock and "/clock" not in self._to
            else None
        )
        self._played = 0
        self._player = Player(
            self._bag,
            self._to,
            rate=rate,
            start=start,
            duration=duration or math.inf,
            loop=loop,
            paused=paused,
        )
        self.create_service(Trigger, "~/pause", partial(self._serve, self._player.pause))
        self.create_service(Trigger, "~/resume", partial(self._serve, self._player.resume))
        self.create_service(Trigger, "~/step", partial(self._serve, self._player.step))
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._seek)
        self._failure = ""  # what ended it before the end
        self._thread = Thread(target=self._play, name="player")
        self._thread.start()
        self.create_timer(0.05, self._end, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def destroy_node(self) -> None:
        """End playing, then the node."""
        self._player.stop()
        self._thread.join()
        self._bag.close()
        super().destroy_node()

    def _create(self, name: str) -> None:
        topic = self._bag.topics[name]
        if topic.encoding != "cdr":
            self.get_logger().warning(f"{name} is not played: its messages are not CDR")
            return
        try:
            kind = message_class(topic.type)
        except BagError as error:
            self.get_logger().warning(f"{name} is not played: {error}")
            return
        self._to[name] = self.create_publisher(
            kind, name, _profile(topic.qos, lossless=self._as_fast_as_taken)
        )

    def _beyond(self, start: float) -> str:
        first, last = self._bag.span or (0, 0)
        lasts = (last - first) * 1e-9
        return f"start = {start:g} s, but the bag lasts {lasts:.3f} s" if start > lasts else ""

    def _check_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name == "start":
                reason = self._beyond(parameter.value)
                if not self._thread.is_alive():
                    reason = "the bag has ended"
                if reason:
                    return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _seek(self, parameters: list[Parameter]) -> None:
        for parameter in parameters:
            if parameter.name == "start":
                self._player.seek(parameter.value)

    def _play(self) -> None:
        try:
            self._player.run(self._publish, self._tick)
        except (BagError, OSError) as error:
            self._failure = message_of(error)
        except BaseException as error:  # a mistake of ours, or a bag that makes no sense
            self._failure = f"ended by an error: {message_of(error)}"
            raise

    def _publish(self, message: RecordedMessage) -> None:
        while True:
            try:
                self._to[message.topic].publish(message.data)
            except RCLError:  # the queue is full, and stayed so for the time publishing may block
                if self._player.stopped:
                    return
            else:
                self._played += 1
                return

    def _tick(self, stamp: int) -> None:
        if self._clock_publisher is not None:
            self._clock_publisher.publish(ClockMessage(clock=Time(nanoseconds=stamp).to_msg()))

    def _end(self) -> None:
        """End the process when the bag has ended and reliable subscribers have it."""
        if self._thread.is_alive():
            return
        if not all(publisher.wait_for_all_acked(ACKNOWLEDGE) for publisher in self._to.values()):
            return
        if self._failure:
            self.get_logger().error(self._failure)
            raise SystemExit(2)
        self.get_logger().info(f"played {self._played} messages")
        raise SystemExit(0)

    def _serve(
        self,
        action: Callable[[], bool | None],
        _: Trigger.Request,
        response: Trigger.Response,
    ) -> Trigger.Response:
        response.success = action() is not False
        response.message = "" if response.success else "not paused: call ~/pause first"
        return response


def _profile(offered: tuple[OfferedQos, ...], *, lossless: bool) -> QoSProfile:
    """Quality of service that serves whoever the recorded publishers served.

    Lossless: reliable, and publishing waits for subscribers that keep all.
    """
    reliable = lossless or all(qos.reliability != "best_effort" for qos in offered)
    latched = bool(offered) and all(qos.latched for qos in offered)
    keep_all = lossless or any(qos.history == "keep_all" for qos in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if keep_all else HistoryPolicy.KEEP_LAST,
        depth=max((qos.depth for qos in offered), default=0) or (1 if latched else DEPTH),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def main() -> None:
    """Run the node."""
    run_node(BagReplayer)
