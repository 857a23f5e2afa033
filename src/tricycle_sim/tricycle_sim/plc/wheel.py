"""Whether the wheel turns as the motor's torque says (`wheel.c` in C; section 5.8).

A broken hall wire shows no pulses, a broken direction wire shows them the wrong way round; the
speed controller then pushes ever harder. The mass is known within a range, the slope is not, but
it stays the same for a second or so. The check keeps the interval of slopes with which torque and
pulses fit together; when none is left, or when the speed is not what every slope of the interval
gives, they do not.
"""

from __future__ import annotations

from tricycle_bridge.protocol.boards import (
    AGAINST_GEAR,
    DOUBT_PULSES,
    NO_PULSE_SPEED,
    NO_PULSE_TIME,
    PULSE_MARGIN,
    RESISTANCE,
    RESTING_TIME,
    TORQUE_LAG,
)
from tricycle_core.timing import TICK

_REST_TIME = 0.3  # s without pulses after which the speed between two pulses is not known
_SPEED_ERROR = 0.05  # m/s of a measured speed
_SLACK = 0.05  # m/s^2 by which the slope may change
_WINDOW = 0.4  # s over which the slope is estimated from speeds


class WheelCheck:
    """The check of torque against hall pulses, tick by tick, in the direction of the gear.

    Parameters
    ----------
    pulse : float
        Travel per hall pulse [m].
    radius : float
        Radius of the tyre [m].
    mass_low, mass_high : float
        Lightest and heaviest vehicle at the tread, wheels' inertia included [kg].
    """

    def __init__(self, pulse: float, radius: float, mass_low: float, mass_high: float) -> None:
        self._pulse = pulse
        self._light = mass_low * radius
        self._heavy = mass_high * radius
        self._wanted = 0.0  # m by the set-point, since the last pulse
        self._waiting = 0.0  # s in which one should have come since then
        self._rested = 0.0  # s since the motor pushed
        self.restart()

    @property
    def rests(self) -> bool:
        """Whether a wheel that seems to rest does: without its sensor it always seems to."""
        return self._wanted < DOUBT_PULSES * self._pulse or self._rested >= RESTING_TIME

    def rest(self, pulses: int) -> None:
        """Begin at rest: the motor is off, or the brake is on.

        Parameters
        ----------
        pulses : int
            Number of pulses since the last tick.
        """
        self._rested += TICK
        if pulses:
            self._wanted = self._waiting = 0.0
        self.restart()

    def restart(self) -> None:
        """Begin at rest."""
        self._torque = 0.0  # N m, behind its demand
        self._low, self._high = -RESISTANCE, RESISTANCE  # m/s^2, interval of slopes
        self._speed_error = 0.0  # m/s, of the speed below: the brake held the wheel
        self._last = 0  # pulses of the last tick that had some
        self._silence = _REST_TIME  # s since then
        self._window_time = self._window_gain = self._window_speed = 0.0
        self._anchor(0.0)

    def _anchor(self, speed: float) -> None:
        """Begin anew at a known speed."""
        self._speed = speed
        self._time = 0.0
        self._count = 0
        # without a slope, of the heaviest and the lightest vehicle: gain of speed, travel
        self._slow_gain = self._slow_travel = self._fast_gain = self._fast_travel = 0.0

    def fails(self, torque: float, pulses: int, speed: float, setpoint: float) -> bool:
        """Return whether torque and pulses contradict each other.

        Parameters
        ----------
        torque : float
            Torque of the motor in the last tick [N m].
        pulses : int
            Number of pulses since the last tick.
        speed : float
            Measured speed [m/s].
        setpoint : float
            Speed set-point [m/s]; all four positive in the direction of the gear.
        """
        self._torque += (torque - self._torque) * TICK / (TICK + TORQUE_LAG)
        pushes = self._torque > 0.0
        slow = self._torque / (self._heavy if pushes else self._light)
        fast = self._torque / (self._light if pushes else self._heavy)
        self._time += TICK
        self._slow_gain += slow * TICK
        self._fast_gain += fast * TICK
        self._slow_travel += (self._speed + self._slow_gain) * TICK
        self._fast_travel += (self._speed + self._fast_gain) * TICK
        self._window_time += TICK
        self._window_gain += slow * TICK
        self._count += pulses
        self._silence += TICK
        self._rested = 0.0
        self._wanted += TICK * setpoint
        if setpoint >= NO_PULSE_SPEED:
            self._waiting += TICK

        half_square = 0.5 * self._time**2
        margin = PULSE_MARGIN * self._pulse + self._speed_error * self._time
        travel = self._count * self._pulse
        self._high = min(self._high, (travel + margin - self._slow_travel) / half_square)
        self._low = max(self._low, (travel - margin - self._fast_travel) / half_square)
        implausible = (
            self._low > self._high + _SLACK
            or speed < -AGAINST_GEAR
            or (self._silence > NO_PULSE_TIME and setpoint >= NO_PULSE_SPEED)
        )
        if self._waiting > NO_PULSE_TIME:
            implausible = True
            self._waiting = 0.0  # after CLEAR the wheel may turn again
        if pulses:
            if self._silence < _REST_TIME and pulses * self._last > 0:
                implausible |= self._take_speed(speed)
            self._last = pulses
            self._silence = self._wanted = self._waiting = 0.0
        return implausible

    def _take_speed(self, speed: float) -> bool:
        """Compare a speed between two pulses with the slowest that fits, and go on from it."""
        slowest = self._speed + self._slow_gain + (self._low - 0.3) * self._time - 0.01
        implausible = speed < slowest - 0.2 - 0.1 * abs(speed)
        speed = max(speed, slowest)
        if self._window_time >= _WINDOW:
            gain = self._window_gain / self._window_time
            slope = (speed - self._window_speed) / self._window_time - gain
            error = 0.12 + 0.12 * abs(gain)
            self._low = min(max(slope - error, -RESISTANCE), RESISTANCE)
            self._high = min(max(slope + error, -RESISTANCE), RESISTANCE)
            self._window_time = self._window_gain = 0.0
            self._window_speed = speed
        self._speed_error = _SPEED_ERROR
        self._anchor(speed)
        return implausible
