"""The newest messages of the vehicle: its pose, whether it obeys, whether it may run."""

import math
from dataclasses import dataclass

from excitation_planner.localisation import PlanarState
from tricycle_bridge.protocol.boards import TRACKING_ERROR
from tricycle_core.frames import BASE_LINK, of_frame
from tricycle_core.readiness import PERIOD, TOPIC, Readiness

STANDSTILL_SPEED = 0.05
"""Speed above which a maneuver does not start, and below which the vehicle rests [m/s]."""

CLOCK_TOLERANCE = 0.1
"""Time by which a pose may be stamped ahead, or the clock may step back [s]."""

ARRIVED = 0.05
"""Deviation of the steering motor from its command within which it has arrived [rad]."""

MUST_STAND = "it must stand still"
"""Why a start is refused that comes too soon."""


@dataclass
class VehicleWatch:
    """Holds the newest messages of the vehicle, and what is wrong with them.

    Reasons are texts for a person, empty where nothing is wrong.

    Attributes
    ----------
    odom_timeout : float
        Age of the newest pose beyond which it is lost [s].
    state_timeout : float
        Age of the newest message of `vehicle/state` beyond which no maneuver runs [s].
    commander : str
        Name of this driver as a commander of the vehicle; empty: it is not checked whom the vehicle
        obeys.
    clock_tolerance : float
        Time by which a pose may be stamped ahead [s].
    hold_timeout : float
        Age of the newest message of the hold-to-run button beyond which it counts as released [s];
        0: there is no button.
    observed : PlanarState or None
        Newest pose and speed.
    stamp : float
        Time of that measurement [s].
    """

    odom_timeout: float
    state_timeout: float = 2 * PERIOD
    commander: str = ""
    clock_tolerance: float = CLOCK_TOLERANCE
    hold_timeout: float = 0.0
    observed: PlanarState | None = None
    stamp: float = -math.inf
    _received_at: float = -math.inf
    _readiness: Readiness | None = None
    _heard_at: float = -math.inf
    _pressed: bool = False
    _pressed_at: float = -math.inf
    _angle: float = math.nan
    _angle_at: float = -math.inf

    def observe(self, state: PlanarState, stamp: float, now: float) -> None:
        """Take the newest pose and speed.

        Parameters
        ----------
        state : PlanarState
            Pose and speed of the vehicle.
        stamp : float
            Time of the measurement, by the clock of its sender [s].
        now : float
            Time of receipt [s].
        """
        self.observed, self.stamp, self._received_at = state, stamp, now

    def hear(self, readiness: Readiness, now: float) -> None:
        """Take what the vehicle says about itself.

        Parameters
        ----------
        readiness : Readiness
            Content of the newest message of `vehicle/state`.
        now : float
            Time of receipt [s].
        """
        self._readiness, self._heard_at = readiness, now

    def hold(self, pressed: bool, now: float) -> None:
        """Take whether the hold-to-run button is pressed.

        Parameters
        ----------
        pressed : bool
            Newest word of it.
        now : float
            Time of receipt [s].
        """
        self._pressed, self._pressed_at = pressed, now

    def steer(self, angle: float, now: float) -> None:
        """Take a measured angle of the steering motor.

        Parameters
        ----------
        angle : float
            Left positive [rad].
        now : float
            Time of receipt [s].
        """
        self._angle, self._angle_at = angle, now

    def forget(self) -> None:
        """Forget what was heard of the vehicle and its button: its age is not known any more."""
        self.observed = self._readiness = None
        self._pressed, self._angle = False, math.nan

    @property
    def speed(self) -> float:
        """Newest speed [m/s]; NaN without one."""
        return self.observed.speed if self.observed else math.nan

    @property
    def disarmed(self) -> bool:
        """Whether the vehicle has said that it is not armed."""
        return self._readiness is not None and not self._readiness.armed

    def rests(self, now: float) -> bool:
        """Return whether the vehicle is known to stand still.

        Parameters
        ----------
        now : float
            Present time [s].
        """
        return not self.pose_lost(now) and self.speed < STANDSTILL_SPEED

    def not_ready(self, now: float) -> str:
        """Return why the vehicle does not obey; empty if it does.

        Parameters
        ----------
        now : float
            Present time [s].
        """
        if self._readiness is None:
            return f"nothing heard on {TOPIC}; is tricycle_bridge running?"
        if not self._readiness.armed:
            return f"the vehicle is not armed: {self._readiness.reason or 'no reason is given'}"
        if now - self._heard_at > self.state_timeout:
            return f"nothing heard on {TOPIC} for {now - self._heard_at:.2f} s"
        if self.commander and self._readiness.commander not in ("", self.commander):
            return (
                f"the vehicle obeys another commander, {self._readiness.commander}: end it, or "
                "release the vehicle (tricycle_bridge/release)"
            )
        if self._readiness.refused:
            return f"tricycle_bridge refuses the commands: {self._readiness.refused}"
        return ""

    def released(self, now: float) -> str:
        """Return why the hold-to-run button does not count as pressed; empty if it does.

        Parameters
        ----------
        now : float
            Present time [s].
        """
        if not self.hold_timeout:
            return ""
        if not self._pressed:
            return "maneuver/hold is not pressed"
        if now - self._pressed_at > self.hold_timeout:
            return f"nothing heard on maneuver/hold for {now - self._pressed_at:.2f} s"
        return ""

    def pose_lost(self, now: float) -> str:
        """Return why the pose is not known; empty if it is.

        Parameters
        ----------
        now : float
            Present time [s].
        """
        if self.observed is None:
            return "no pose on odom"
        silence, age = now - self._received_at, now - self.stamp
        if silence > self.odom_timeout:
            return f"no pose on odom for {silence:.2f} s"
        if not self.observed.finite:
            return "the pose on odom is not finite, or its orientation is not a unit quaternion"
        if self.observed.implausible:
            return self.observed.implausible
        if not of_frame(self.observed.body, BASE_LINK):
            return f"odom has the pose of {self.observed.body}: that of {BASE_LINK} is needed"
        if age < -self.clock_tolerance:
            return f"odom is stamped {-age:.2f} s ahead of the clock: synchronise the clocks"
        if age > self.odom_timeout:
            return f"no pose on odom for {age:.2f} s, by its stamp"
        return ""

    def turning(self, angle: float, now: float, *, late: bool = False) -> str:
        """Return how far the wheels still are from an angle; empty where they have arrived.

        It is empty, too, where their angle is not measured.

        Parameters
        ----------
        angle : float
            Commanded angle of the steering motor [rad].
        now : float
            Present time [s].
        late : bool
            Whether there was time enough; then the steer board's own tolerance is allowed.
        """
        off = abs(angle - self._angle)
        allowed = TRACKING_ERROR if late else ARRIVED
        if not off > allowed or now - self._angle_at > self.odom_timeout:
            return ""
        return f"the steering motor is at {self._angle:.2f} rad, the plan begins at {angle:.2f} rad"

    def undirected(self) -> str:
        """Return why the vehicle cannot be steered by its pose; empty if it can."""
        if self.observed is None or self.observed.turns_known:
            return ""
        return "odom has no turn rate, without which the vehicle is not steered by its pose"

    def moves(self) -> str:
        """Return how fast the vehicle moves, or that nobody knows; empty where it stands."""
        if self.speed <= STANDSTILL_SPEED:
            return ""
        if math.isnan(self.speed):
            return f"no speed on odom; {MUST_STAND}"
        return f"the vehicle moves at {self.speed:.2f} m/s; {MUST_STAND}"
