"""Whether the wheel turns when the vehicle starts: an IMU feels a start that a stuck sensor hides.

At a start, torque without pulses may be a heavy vehicle uphill or a light one downhill whose hall
sensor is stuck. What the IMU measures at rest is gravity; what it measures beyond that after the
brake is released is the vehicle's acceleration, whatever its mass and the slope.

Times are seconds on the bridge's clock.
"""

from __future__ import annotations

import math

from tricycle_bridge.protocol.messages import DriveState
from tricycle_bridge.protocol.units import BRAKE_UNIT

PULSES = 3
"""Pulses that a travel must have shown ..."""

TRAVEL = 0.04
"""... but never less than this travel [m]."""

REST = 0.5
"""Time at rest, brake full, after which gravity is known [s]."""

GAP = 0.15
"""Largest time between two measurements [s]."""

_LAG = 0.2  # s, of gravity behind its measurements, of which what was before the rest is none


class StartWatch:
    """Compares the wheel's first pulses with the travel that the IMU has felt.

    Parameters
    ----------
    pulse : float
        Travel per hall pulse [m].

    Attributes
    ----------
    problem : str or None
        How they disagree, for a person; None while they agree or are not both known.
    """

    def __init__(self, pulse: float) -> None:
        self.problem: str | None = None
        self._allowed = max(TRAVEL, PULSES * pulse)
        self._heard_at = -math.inf
        self._gravity = 0.0  # m/s^2, forward
        self._rest = 0.0  # s, brake full and no pulses
        self._starts = False  # the brake is released, no pulse came yet
        self._count: int | None = None
        self._speed = self._travel = 0.0  # m/s and m since the brake was released

    def watching(self, now: float) -> bool:
        """Whether an IMU measures, often enough.

        Parameters
        ----------
        now : float
            Present time [s].
        """
        return 0.0 <= now - self._heard_at <= GAP

    def add_force(self, force: float, now: float) -> None:
        """Take a specific force of the IMU; one that is not finite is ignored.

        Parameters
        ----------
        force : float
            Specific force, forward positive [m/s^2].
        now : float
            Time of arrival [s].
        """
        if not math.isfinite(force) or now == self._heard_at:
            return
        elapsed, self._heard_at = now - self._heard_at, now
        if not 0.0 < elapsed <= GAP:
            self._rest, self._starts, self._gravity = 0.0, False, force
        elif self._starts:
            self._speed += (force - self._gravity) * elapsed
            self._travel += self._speed * elapsed
        else:
            self._rest += elapsed
            self._gravity += (force - self._gravity) * min(elapsed / min(self._rest, _LAG), 1.0)

    def look(self, state: DriveState | None) -> None:
        """Check the drive PLC's state; sets `problem`.

        Parameters
        ----------
        state : DriveState or None
            Telemetry of the drive PLC; None if it is not fresh.
        """
        if state is None or state.hall_count != self._count:
            self._count = None if state is None else state.hall_count
            self._rest, self._starts, self.problem = 0.0, False, None
        elif state.brake * BRAKE_UNIT >= 1.0:
            self._starts, self.problem = False, None
        elif not self._starts:
            self._starts = self._rest >= REST
            self._rest = self._speed = self._travel = 0.0
        elif abs(self._travel) > self._allowed:
            self.problem = (
                f"the imu has felt {self._travel:+.2f} m since the brake was released, "
                "the wheel no pulse: hall sensor stuck?"
            )
