"""Playback of a bag against the wall clock: order, rate, pause, step, seek, loop; without ROS."""

import math
import time
from collections.abc import Callable, Collection
from itertools import takewhile
from threading import TIMEOUT_MAX, Condition

from trajectory_recorder.bag.latched import since
from trajectory_recorder.bag.reader import BagReader, RecordedMessage

CLOCK_PERIOD = 10_000_000  # ns of recorded time between ticks of the clock


class Player:
    """Plays messages in the order of their stamps, spaced as they were received.

    Parameters
    ----------
    bag : BagReader
        Bag to play, open.
    topics : collection of str
        Names of the topics to play.
    rate : float
        Recorded seconds per second; 0 plays as fast as ``publish`` returns.
    start : float
        Recorded time to skip from the bag's begin [s], but the newest messages of latched topics.
    duration : float
        Recorded time to play [s].
    loop : bool
        Whether to begin again at the end.
    paused : bool
        Whether to begin paused.

    Raises
    ------
    ValueError
        If rate, start or duration are negative.
    """

    def __init__(
        self,
        bag: BagReader,
        topics: Collection[str],
        *,
        rate: float = 1.0,
        start: float = 0.0,
        duration: float = math.inf,
        loop: bool = False,
        paused: bool = False,
    ) -> None:
        if min(rate, start, duration) < 0:
            raise ValueError(
                f"rate {rate}, start {start} s and duration {duration} s must not be negative"
            )
        self._bag = bag
        self._topics = topics
        self._rate = rate
        self._start = round(start * 1e9)
        self._duration = duration * 1e9
        self._loop = loop
        self._paused = paused
        self._steps = 0  # messages to play although paused
        self._sought = False
        self._stopped = False
        self._changed = Condition()
        self._origin: tuple[float, int] | None = None  # wall s and recorded ns that coincide

    def run(self, publish: Callable[[RecordedMessage], None], tick: Callable[[int], None]) -> None:
        """Play until the end, or until `stop`.

        Parameters
        ----------
        publish : callable
            Called for each message when it is due.
        tick : callable
            Called with recorded time [ns], every CLOCK_PERIOD of it.
        """
        while True:
            begun = time.monotonic()
            self._play_once(publish, tick)
            if self._stopped or not (self._loop or self._sought):
                return
            # a pass of one message, or of none, lasts no time
            left = begun + CLOCK_PERIOD * 1e-9 / (self._rate or 1.0) - time.monotonic()
            with self._changed:
                self._changed.wait_for(
                    lambda: self._stopped or self._sought, min(max(left, 0.0), TIMEOUT_MAX)
                )

    def pause(self) -> None:
        """Hold before the next message."""
        with self._changed:
            self._paused = True
            self._changed.notify()

    def resume(self) -> None:
        """Go on."""
        with self._changed:
            self._paused = False
            self._origin = None
            self._changed.notify()

    def step(self) -> bool:
        """Play one message; False if not paused."""
        with self._changed:
            if self._paused:
                self._steps += 1
                self._changed.notify()
            return self._paused

    def seek(self, start: float) -> None:
        """Go on from another place, forward or back, with the newest messages of latched topics.

        Parameters
        ----------
        start : float
            Recorded time to skip from the bag's begin [s]; `duration` counts from there.
        """
        with self._changed:
            self._start = round(start * 1e9)
            self._sought = True
            self._changed.notify()

    def stop(self) -> None:
        """End `run`."""
        with self._changed:
            self._stopped = True
            self._changed.notify()

    @property
    def stopped(self) -> bool:
        """Whether `stop` was called."""
        return self._stopped

    def _play_once(
        self, publish: Callable[[RecordedMessage], None], tick: Callable[[int], None]
    ) -> None:
        with self._changed:
            self._origin = None
            self._sought = False
            start = self._start
        first, _ = self._bag.span or (0, 0)
        begin, next_tick = first + start, None
        messages = takewhile(
            lambda _: not (self._stopped or self._sought),
            self._bag.messages_by_stamp(self._topics),
        )
        for message in since(begin, messages, self._bag.topics):
            if self._stopped or self._sought:
                return
            stamp = message.stamp
            if stamp < begin:
                publish(message)
                continue
            if stamp - begin > self._duration:
                return
            if next_tick is None:
                next_tick = stamp
            if self._rate == 0:
                next_tick = max(next_tick, stamp - CLOCK_PERIOD + 1)  # no ticks between messages
            while next_tick <= stamp and self._wait(next_tick):
                tick(next_tick)
                next_tick += CLOCK_PERIOD
            if not self._wait(stamp):
                return
            publish(message)
            with self._changed:
                self._steps = max(self._steps - 1, 0)

    def _wait(self, stamp: int) -> bool:
        """Wait until a recorded time is due; False when stopped or sent elsewhere."""
        with self._changed:
            while not (self._stopped or self._sought):
                if self._paused and not self._steps:
                    self._origin = None
                    self._changed.wait()
                    continue
                if self._paused or self._rate == 0:
                    return True
                now = time.monotonic()
                if self._origin is None:
                    self._origin = (now, stamp)
                wall, recorded = self._origin
                left = wall + (stamp - recorded) * 1e-9 / self._rate - now
                if left <= 0:
                    return True
                self._changed.wait(min(left, TIMEOUT_MAX))
            return False
