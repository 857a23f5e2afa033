"""The bridge's own clock beside the computer's, which may be set while the vehicle moves."""

from __future__ import annotations

import time
from collections.abc import Callable

STEP = 0.002
"""Change of the difference of the two clocks from which it is told [s]."""

FOLLOWED = 0.2e-3
"""The same from which stamps follow it [s]; also how well the difference must be known for that."""

_READINGS = 3  # of which the best counts: between two readings of clocks the computer may pause


class HostClock:
    """Relates the bridge's steady clock to the ROS clock; only stamps depend on the latter.

    The computer's time service slews both clocks alike, so that their difference changes only when
    one is set.

    Parameters
    ----------
    ros, steady : callable
        Return the present time on the ROS clock and on the steady one [s].
    """

    def __init__(
        self, ros: Callable[[], float], steady: Callable[[], float] = time.monotonic
    ) -> None:
        self._ros = ros
        self._steady = steady
        self._offset, self._error = self._measure()

    def find_step(self) -> float | None:
        """Follow the ROS clock and return by how much it was set [s] since the last call.

        Returns
        -------
        step : float or None
            None if it was set by less than `STEP`, or if the computer pauses so much that the
            difference is not known: the next call finds the step then.
        """
        offset, error = self._measure()
        step = offset - self._offset
        if error > FOLLOWED or abs(step) < FOLLOWED + error:
            return None
        surely = abs(step) - self._error
        self._offset, self._error = offset, error
        return step if surely >= STEP else None

    def to_ros(self, steady: float) -> float:
        """Return the ROS time of a time on the steady clock [s]."""
        return steady + self._offset

    def _measure(self) -> tuple[float, float]:
        """Difference of the clocks and the largest error of it [s]."""
        readings = ((self._steady(), self._ros(), self._steady()) for _ in range(_READINGS))
        before, ros, after = min(readings, key=lambda reading: reading[2] - reading[0])
        return ros - 0.5 * (before + after), 0.5 * (after - before)
