"""Whether the wheel's speed agrees with odometry: the drive PLC alone cannot see lost pulses.

Times are seconds on the bridge's clock.
"""

from __future__ import annotations

import math

FRESH = 0.2
"""Largest age of a speed that is compared [s]."""

DIFFERENCE = 0.3
"""Difference that is allowed at any speed [m/s] ..."""

SHARE = 0.15
"""... and as a share of the larger speed besides."""

PATIENCE = 0.2
"""Time for which a larger difference is allowed [s]."""

LOST = 1.0
"""Silence of odometry after which a difference is forgotten [s]."""


class OdometryWatch:
    """Compares the speed of the wheel with that of odometry.

    Attributes
    ----------
    problem : str or None
        How they disagree, for a person; None while they agree or are not both known.
    """

    def __init__(self) -> None:
        self.problem: str | None = None
        self._speed = math.nan  # m/s, of odometry
        self._heard_at = -math.inf
        self._differing_since: float | None = None

    def watching(self, now: float) -> bool:
        """Whether odometry is known."""
        return 0.0 <= now - self._heard_at <= FRESH

    def add_odometry(self, speed: float, now: float) -> None:
        """Take a speed of odometry; one that is not finite counts as none.

        Parameters
        ----------
        speed : float
            Speed [m/s], forward positive.
        now : float
            Time of arrival [s].
        """
        if math.isfinite(speed):
            self._speed, self._heard_at = speed, now

    def compare(self, wheel_speed: float | None, now: float) -> None:
        """Compare the wheel's speed with that of odometry; sets `problem`.

        Parameters
        ----------
        wheel_speed : float or None
            Speed at the rear wheel's tread [m/s], forward positive; None if it is not known.
        now : float
            Present time [s].
        """
        lost = not 0.0 <= now - self._heard_at <= LOST
        if not lost and not self.watching(now):
            return  # the next message may differ still
        if wheel_speed is None or lost or self._agrees(wheel_speed):
            self._differing_since = self.problem = None
            return
        if self._differing_since is None or now < self._differing_since:
            self._differing_since = now
        if now - self._differing_since >= PATIENCE:
            self.problem = (
                f"the wheel says {wheel_speed:.2f} m/s, odom {self._speed:.2f} m/s: "
                "hall sensor miscounts?"
            )

    def _agrees(self, wheel_speed: float) -> bool:
        allowed = DIFFERENCE + SHARE * max(abs(wheel_speed), abs(self._speed))
        return abs(wheel_speed - self._speed) <= allowed
