"""Poses of the localisation, and whether a vehicle can have moved so."""

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from excitation_planner.preflight import Check
from tricycle_bridge.protocol.limits import MAX_SPEED
from tricycle_core.diagnostics import Level
from tricycle_core.poses import Pose

FASTEST = 2.0 * MAX_SPEED
"""Speed beyond which a message is wrong, whatever the vehicle does [m/s]."""

FASTEST_TURN = 10.0
"""The same for the yaw rate [rad/s]."""

JUMP = 0.3
"""Distance between a pose and its prediction by the velocity that noise cannot explain [m]."""

TURN_JUMP = 0.2
"""The same for the heading [rad]."""

SHARE = 0.1
"""Additional distance, as a share of the way or turn meanwhile: error of a measured velocity."""

WINDOW = 1.0
"""Time over which poses are compared with the velocity [s]."""

FROZEN = 0.5
"""Time for which the pose of a driven vehicle may be the same to the last digit [s]."""

MOVED = 0.3
"""Distance between poses that shows that the vehicle moves [m] ..."""

DRIVEN_ON = 1.0
"""... the way that it is commanded to go by then at the latest [m] ..."""

STARTED = 3.0
"""... and the time that it has for it [s]: a board notices that no pulse comes within 2.5 s."""

SCATTER = 0.05
"""Standard deviation of the position at rest that deserves a warning [m]."""


@dataclass(frozen=True)
class PlanarState:
    """Planar pose and motion of `base_link` in `odom`; not finite where the message is not.

    Attributes
    ----------
    x, y : float
        Position [m].
    yaw : float
        Heading, left positive [rad].
    speed : float
        Absolute value [m/s].
    slip : float
        Direction of the motion relative to the heading, left positive [rad].
    yaw_rate : float
        Yaw rate, left positive [rad/s].
    frame : str
        Frame in which the pose is given.
    body : str
        Frame whose pose it is; empty: unknown.
    """

    x: float
    y: float
    yaw: float
    speed: float
    slip: float = 0.0
    yaw_rate: float = 0.0
    frame: str = ""
    body: str = ""

    @property
    def finite(self) -> bool:
        """Whether pose and speed are numbers."""
        return all(map(math.isfinite, (self.x, self.y, self.yaw, self.speed)))

    @property
    def turns_known(self) -> bool:
        """Whether turn rate and direction of the motion are numbers."""
        return math.isfinite(self.yaw_rate) and math.isfinite(self.slip)

    @property
    def implausible(self) -> str:
        """Why no vehicle moves so; empty if one may."""
        if self.speed > FASTEST:
            return f"odom says {self.speed:.4g} m/s, faster than any vehicle ({FASTEST:g} m/s)"
        if abs(self.yaw_rate) > FASTEST_TURN:
            return (
                f"odom says a turn rate of {self.yaw_rate:.4g} rad/s, faster than any vehicle "
                f"({FASTEST_TURN:g} rad/s)"
            )
        return ""

    def after(self, time: float) -> Pose:
        """Return the pose x, y [m], heading [rad] a short time later, at constant motion.

        Parameters
        ----------
        time : float
            Time by which it is later [s].
        """
        turn, way = self.yaw_rate * time, self.speed * time
        course = self.yaw + self.slip + 0.5 * turn
        return self.x + way * math.cos(course), self.y + way * math.sin(course), self.yaw + turn


@dataclass(frozen=True)
class _Track:
    """A pose, and where the velocities measured since the first one lead."""

    stamp: float
    state: PlanarState
    x: float = 0.0
    y: float = 0.0
    turn: float = 0.0
    way: float = 0.0
    turned: float = 0.0  # absolute


@dataclass
class PoseWatch:
    """Compares each pose with those before it and the velocities between them.

    Attributes
    ----------
    frozen : str
        For how long the wheels have been driven and the pose stayed the same; empty: it has not.
    """

    frozen: str = ""
    _tracks: deque[_Track] = field(default_factory=deque)
    _pose: tuple[float, float, float] | None = None
    _stamp: float = -math.inf
    _changed_at: float = -math.inf
    _verdict: str = ""

    def contradiction(self, state: PlanarState, stamp: float, *, driven: bool) -> str:
        """Take a pose; return why no vehicle can have moved there, or an empty string.

        A pose with the stamp of the newest one is ignored, and the answer repeated. One with an
        older stamp is compared with those before it.

        Parameters
        ----------
        state : PlanarState
            Pose with finite numbers.
        stamp : float
            Time of the measurement [s].
        driven : bool
            Whether the wheels are commanded to turn.
        """
        if self._pose is None or stamp != self._stamp:
            self.frozen = self._look_for_change(state, stamp, driven=driven)
            self._verdict = self._judge(state, stamp) or self.frozen
            self._stamp = stamp
        return self._verdict

    def _look_for_change(self, state: PlanarState, stamp: float, *, driven: bool) -> str:
        before, self._pose = self._pose, (state.x, state.y, state.yaw)
        self._changed_at = min(self._changed_at, stamp)
        if not driven or self._pose != before:
            self._changed_at = stamp
        if (still := stamp - self._changed_at) <= FROZEN:
            return ""
        return f"the pose has been the same for {still:.2f} s, but the wheels are driven"

    def _judge(self, state: PlanarState, stamp: float) -> str:
        if not state.turns_known:
            self._tracks.clear()  # without a direction no pose can be predicted
            return ""
        while self._tracks and self._tracks[-1].stamp >= stamp:
            self._tracks.pop()  # of a clock that was ahead: poses until then would be ignored
        if not self._tracks:
            self._tracks.append(_Track(stamp, state))
            return ""
        last = self._tracks[-1]
        new = _moved(last, state, stamp)
        while len(self._tracks) > 1 and self._tracks[1].stamp <= stamp - WINDOW:
            self._tracks.popleft()
        self._tracks.append(new)
        return _difference(last, new) or _difference(self._tracks[0], new)


class ProgressWatch:
    """Compares the poses of a driven vehicle with the way that it is commanded to go.

    Attributes
    ----------
    standing : str
        How far it was commanded to go on since its pose has last moved; empty: it moves.
    """

    def __init__(self) -> None:
        self.standing = ""
        self._pose: tuple[float, float] | None = None
        self._way = 0.0  # commanded when the pose was there
        self._since = 0.0  # when it was commanded to be gone

    def stands(self, state: PlanarState, way: float, now: float) -> str:
        """Take a pose; return why the vehicle, or its localisation, stands still, or nothing.

        Parameters
        ----------
        state : PlanarState
            Pose with finite numbers.
        way : float
            Way commanded so far, forwards less backwards [m].
        now : float
            Present time [s].
        """
        x, y = self._pose or (math.inf, math.inf)
        moved = math.hypot(state.x - x, state.y - y)
        if moved > MOVED:
            self._pose, self._way = (state.x, state.y), way
        on = abs(way - self._way)
        if on <= MOVED:
            self._since = now
        self.standing = ""
        if on > DRIVEN_ON:
            self.standing = (
                f"commanded to go {on:.1f} m on, but its pose has moved by {moved:.2f} m: is the "
                "vehicle driven at all, and does the localisation follow it?"
            )
        return self.standing if now - self._since > STARTED else ""


class RestingPoses:
    """Poses of the last `WINDOW` of a vehicle at rest: how often they come, how they scatter."""

    def __init__(self) -> None:
        self._poses: deque[tuple[float, float, float, float]] = deque()

    def take(self, state: PlanarState, stamp: float) -> None:
        """Take a pose.

        Parameters
        ----------
        state : PlanarState
            Pose with finite numbers.
        stamp : float
            Time of the measurement [s].
        """
        poses = self._poses
        if poses and stamp <= poses[-1][0]:  # a clock that was set back
            poses.clear()
        poses.append((stamp, state.x, state.y, state.yaw))
        while poses[0][0] < stamp - WINDOW:
            poses.popleft()

    def mean(self) -> Pose | None:
        """Return the mean pose x, y [m] and yaw [rad]; None without any."""
        if not self._poses:
            return None
        _, x, y, yaw = np.array(self._poses).T
        return float(x.mean()), float(y.mean()), float(np.unwrap(yaw).mean())

    def check(self, age: float) -> Check:
        """Return how the localisation is.

        Parameters
        ----------
        age : float
            Age of the newest pose [s].
        """
        stamps, x, y, yaw = np.array(self._poses).reshape(-1, 4).T
        if stamps.size < 2:
            return Check("localisation", f"one pose, {age:.2f} s old", Level.WARN)
        rate = (stamps.size - 1) / (stamps[-1] - stamps[0])
        position = math.hypot(np.std(x), np.std(y))
        heading = np.std(np.unwrap(yaw))
        return Check(
            "localisation",
            f"{rate:.0f} Hz, {max(age, 0.0):.2f} s old, scatters by {position * 1e3:.0f} mm and "
            f"{math.degrees(heading):.1f} deg",
            Level.WARN if position > SCATTER else Level.OK,
        )


def _moved(last: _Track, state: PlanarState, stamp: float) -> _Track:
    """Dead reckoning by the velocities at both ends."""
    dt = stamp - last.stamp
    half = [
        (0.5 * dt * s.speed, s.yaw + s.slip, 0.5 * dt * s.yaw_rate) for s in (last.state, state)
    ]
    turn = half[0][2] + half[1][2]
    return _Track(
        stamp,
        state,
        last.x + sum(way * math.cos(course) for way, course, _ in half),
        last.y + sum(way * math.sin(course) for way, course, _ in half),
        last.turn + turn,
        last.way + half[0][0] + half[1][0],
        last.turned + abs(turn),
    )


def _difference(old: _Track, new: _Track) -> str:
    a, b = old.state, new.state
    off = math.hypot(b.x - a.x - (new.x - old.x), b.y - a.y - (new.y - old.y))
    if off > JUMP + SHARE * (new.way - old.way):
        return (
            f"the pose is {off:.2f} m from where the vehicle's velocity led in "
            f"{new.stamp - old.stamp:.2f} s"
        )
    turn = abs(math.remainder(b.yaw - a.yaw - (new.turn - old.turn), math.tau))
    if turn > TURN_JUMP + SHARE * (new.turned - old.turned):
        return (
            f"the heading is {math.degrees(turn):.0f} deg from where the vehicle's turn rate led "
            f"in {new.stamp - old.stamp:.2f} s"
        )
    return ""
