"""The commands of a maneuver, as the driver plays them."""

from dataclasses import dataclass

import numpy as np

from tricycle_bridge.protocol.limits import MAX_STEERING_ANGLE
from tricycle_core.errors import PlanError
from tricycle_core.quantities import FloatArray
from tricycle_sim.commands import LONGEST

MAX_ROWS = 360_000
"""Largest number of commands, and of points of a path: an hour at 100 Hz."""

MAX_WHEEL_RATE = 100.0
"""Largest rate of the rear wheel [rad/s]; the PLC's limit is a speed, and far below."""


@dataclass(frozen=True)
class Schedule:
    """Commands to play, each held until the next one; the last row is the end.

    Attributes
    ----------
    time : ndarray of float, shape (c,)
        Time from the start of the maneuver, starting at 0 [s].
    steering_motor_angle : ndarray of float, shape (c,)
        Steering motor angle, left positive [rad].
    wheel_rate : ndarray of float, shape (c,)
        Rate of the rear wheel, forward positive [rad/s].

    Raises
    ------
    PlanError
        If there are too few or too many rows, one holds a number that is not finite or is beyond
        its limit, or the times do not start at 0 and increase; the message names the row.
    """

    time: FloatArray
    steering_motor_angle: FloatArray
    wheel_rate: FloatArray

    def __post_init__(self) -> None:
        rows = self.time.size
        if not 2 <= rows <= MAX_ROWS:
            raise PlanError(f"{rows} rows; needs 2 to {MAX_ROWS}, the last one is the end")
        for name, column, limit, unit in (
            ("time", self.time, LONGEST, "s"),
            ("steering motor angle", self.steering_motor_angle, MAX_STEERING_ANGLE + 1e-9, "rad"),
            ("wheel rate", self.wheel_rate, MAX_WHEEL_RATE, "rad/s"),
        ):
            if column.shape != (rows,):
                raise PlanError(f"{name}: needs one number for each of the {rows} rows")
            wrong = ~(np.abs(column) <= limit)  # so that NaN is wrong too
            if wrong.any():
                row = int(np.argmax(wrong))
                raise PlanError(
                    f"row {row}: {name} {column[row]:g}: needs a number within "
                    f"{limit:g} {unit} of 0"
                )
        if self.time[0] != 0.0:
            raise PlanError(f"row 0: time {self.time[0]:g} s: the first row is due at 0 s")
        steps = np.diff(self.time)
        if not (steps > 0.0).all():
            row = int(np.argmin(steps > 0.0)) + 1
            raise PlanError(
                f"row {row}: time {self.time[row]:g} s does not come after {self.time[row - 1]:g} s"
            )

    @property
    def duration(self) -> float:
        """End of the maneuver in s."""
        return float(self.time[-1])
