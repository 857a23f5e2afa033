"""The bridge's own clock beside the computer's, which may be set while the vehicle moves."""

from __future__ import annotations

STEP = 0.02
"""Change of the difference of the two clocks from which it is a step [s]."""


class HostClock:
    """Relates the bridge's steady clock to the ROS clock; only stamps depend on the latter.

    Parameters
    ----------
    ros : float
        Present ROS time [s].
    steady : float
        Present time on the steady clock [s].
    """

    def __init__(self, ros: float, steady: float) -> None:
        self._offset = ros - steady

    def find_step(self, ros: float, steady: float) -> float | None:
        """Return by how much the ROS clock was set [s] since the last call, None if it was not.

        Parameters
        ----------
        ros : float
            Present ROS time [s].
        steady : float
            Present time on the steady clock [s].
        """
        step = ros - steady - self._offset
        if abs(step) < STEP:
            return None
        self._offset += step
        return step

    def to_ros(self, steady: float) -> float:
        """Return the ROS time of a time on the steady clock [s]."""
        return steady + self._offset
