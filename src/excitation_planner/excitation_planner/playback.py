"""Playback of a maneuver's commands, open loop: the state machine of the driver, without ROS.

Time is an argument everywhere; the node that owns a `Playback` passes its ROS clock.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from tricycle_core.quantities import FloatArray

STANDSTILL_SPEED = 0.05
"""Speed above which a maneuver does not start [m/s]."""

PATHS_KEPT = 8
"""Paths that are kept until the commands with the same stamp arrive."""


class PlaybackState(Enum):
    """What the driver is doing; the values are those of `maneuver/state`."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    ABORTED = "aborted"


@dataclass(frozen=True)
class Schedule:
    """Commands to play, each held until the next one; the last row is the end.

    Attributes
    ----------
    time : ndarray of float, shape (c,)
        Time from the start of the maneuver, starting at 0 [s].
    steering_motor_angle : ndarray of float, shape (c,)
        Left positive [rad].
    wheel_rate : ndarray of float, shape (c,)
        Of the rear wheel, forward positive [rad/s].

    Raises
    ------
    ValueError
        If the rows are not finite, do not start at 0, or their times do not increase.
    """

    time: FloatArray
    steering_motor_angle: FloatArray
    wheel_rate: FloatArray

    def __post_init__(self) -> None:
        if self.time.size < 2 or self.time[0] != 0.0 or not np.all(np.diff(self.time) > 0.0):
            raise ValueError("times must start at 0 s and increase; at least two rows")
        rows = np.isfinite(self.steering_motor_angle) & np.isfinite(self.wheel_rate)
        if not rows.all():
            raise ValueError(f"row {int(np.argmin(rows))} holds a number that is not finite")

    @property
    def duration(self) -> float:
        """End of the maneuver in s."""
        return float(self.time[-1])


@dataclass(frozen=True)
class PlanarState:
    """Planar pose and speed of `base_link` in `odom`.

    Attributes
    ----------
    x, y : float
        Position [m].
    yaw : float
        Left positive [rad].
    speed : float
        Absolute value [m/s].
    """

    x: float
    y: float
    yaw: float
    speed: float


@dataclass(frozen=True)
class JointCommand:
    """What is commanded of the two joints.

    Attributes
    ----------
    steering_motor_angle : float
        Left positive [rad].
    wheel_rate : float
        Of the rear wheel, forward positive [rad/s].
    """

    steering_motor_angle: float
    wheel_rate: float


@dataclass
class Playback:
    """Plays one schedule after the other.

    Attributes
    ----------
    max_deviation : float
        Distance from the path beyond which the run is aborted [m].
    odom_timeout : float
        Age of the newest pose beyond which the run is aborted [s].
    state : PlaybackState
        What it is doing.
    reason : str
        Why it was aborted; empty otherwise.
    start_time : float or None
        When row 0 was played [s].
    elapsed : float
        Time since then, at the newest tick of the run [s].
    """

    max_deviation: float
    odom_timeout: float
    state: PlaybackState = PlaybackState.WAITING
    reason: str = ""
    start_time: float | None = None
    elapsed: float = 0.0
    _schedule: Schedule | None = None
    _stamp: int = 0  # of the schedule
    _paths: deque[tuple[int, FloatArray]] = field(default_factory=lambda: deque(maxlen=PATHS_KEPT))
    _path: FloatArray | None = None  # (m, 2) from the pose at the start, of the maneuver running
    _observed: PlanarState | None = None
    _observed_at: float = -math.inf
    _anchor: PlanarState | None = None
    _held: JointCommand = field(default_factory=lambda: JointCommand(0.0, 0.0))

    def load(self, schedule: Schedule, stamp: int = 0) -> None:
        """Take a new schedule; while one is being played it is refused.

        Parameters
        ----------
        schedule : Schedule
            To be played next.
        stamp : int
            Of its message [ns].

        Raises
        ------
        ValueError
            If a maneuver is running.
        """
        if self.state is PlaybackState.RUNNING:
            raise ValueError("a maneuver is running; abort it before sending new commands")
        self._schedule, self._stamp = schedule, stamp
        self._held = JointCommand(0.0, 0.0)
        self._set(PlaybackState.WAITING, "")
        self.start_time, self.elapsed = None, 0.0

    def load_path(self, points: FloatArray, stamp: int = 0) -> None:
        """Take the path of the schedule with the same stamp, for the deviation limit.

        Parameters
        ----------
        points : ndarray of float, shape (m, 2)
            Relative to the start pose [m].
        stamp : int
            Of its message [ns]; path and schedule may come in either order.
        """
        self._paths.append((stamp, points))

    def observe(self, state: PlanarState, now: float) -> None:
        """Take the newest pose and speed.

        Parameters
        ----------
        state : PlanarState
            Of the vehicle.
        now : float
            Time of the measurement [s].
        """
        self._observed, self._observed_at = state, now

    def start(self, now: float) -> None:
        """Start the maneuver; row 0 is played at the next tick.

        Raises
        ------
        ValueError
            The reason why the maneuver cannot start.
        """
        if self._schedule is None:
            raise ValueError("no commands yet; publish a plan on maneuver/commands")
        if self.state is PlaybackState.RUNNING:
            raise ValueError("already running")
        if self._observed is None or now - self._observed_at > self.odom_timeout:
            raise ValueError("no pose on odom; the maneuver starts only where it can be watched")
        if abs(self._observed.speed) > STANDSTILL_SPEED:
            raise ValueError(
                f"the vehicle moves at {self._observed.speed:.2f} m/s; it must stand still"
            )
        paths = [points for stamp, points in self._paths if stamp == self._stamp]
        if self._paths and not paths:
            raise ValueError(
                "the path on maneuver/path is that of other commands; publish both with one stamp"
            )
        self._path = paths[-1] if paths else None
        self._anchor = self._observed
        self.start_time, self.elapsed = None, 0.0
        self._set(PlaybackState.RUNNING, "")

    def abort(self, reason: str) -> None:
        """Stop a running maneuver; standstill is commanded.

        Raises
        ------
        ValueError
            If none is running.
        """
        if self.state is not PlaybackState.RUNNING:
            raise ValueError("no maneuver is running")
        self._held = JointCommand(self._held.steering_motor_angle, 0.0)
        self._set(PlaybackState.ABORTED, reason)

    def tick(self, now: float) -> JointCommand:
        """Return the command for now; standstill unless a maneuver is running."""
        if self.state is not PlaybackState.RUNNING or self._schedule is None:
            return self._held
        if self.start_time is None:
            self.start_time = now
        reason = self._unsafe(now)
        if reason:
            self.abort(reason)
            return self._held
        self.elapsed = now - self.start_time
        if self.elapsed >= self._schedule.duration - 1e-6:
            self._held = JointCommand(float(self._schedule.steering_motor_angle[-1]), 0.0)
            self._set(PlaybackState.DONE, "")
            return self._held
        # 1 µs: a tick that is due at a row's time plays that row whatever the rounding
        row = int(np.searchsorted(self._schedule.time, self.elapsed + 1e-6, side="right")) - 1
        self._held = JointCommand(
            float(self._schedule.steering_motor_angle[row]), float(self._schedule.wheel_rate[row])
        )
        return self._held

    @property
    def duration(self) -> float:
        """Length of the loaded maneuver in s; 0 without one."""
        return self._schedule.duration if self._schedule else 0.0

    def _set(self, state: PlaybackState, reason: str) -> None:
        self.state, self.reason = state, reason

    def _unsafe(self, now: float) -> str:
        if now - self._observed_at > self.odom_timeout:
            return f"no pose on odom for {now - self._observed_at:.2f} s"
        if self._path is None or self._observed is None or self._anchor is None:
            return ""
        dx, dy = self._observed.x - self._anchor.x, self._observed.y - self._anchor.y
        c, s = math.cos(self._anchor.yaw), math.sin(self._anchor.yaw)
        here = np.array([c * dx + s * dy, -s * dx + c * dy])
        deviation = float(np.sqrt(((self._path - here) ** 2).sum(axis=1).min()))
        if deviation > self.max_deviation:
            return f"{deviation:.2f} m off the path (limit {self.max_deviation:g} m)"
        return ""
