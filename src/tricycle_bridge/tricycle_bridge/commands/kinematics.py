"""Steering geometry for `cmd_vel`: turn rate and angle of the steering motor."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from tricycle_core.errors import LinkError


@dataclass(frozen=True)
class TurningGeometry:
    """Relation of steering angle and curvature without tyre slip; the node has these parameters.

    The defaults are those of the packaged tricycle. Between two angles it interpolates linearly.

    Attributes
    ----------
    wheelbase : float
        Distance of the axles [m].
    motor_angles : sequence of float
        Angles of the steering motor [rad], rising.
    road_angles : sequence of float
        Angle on the road of the one front wheel that would turn the vehicle as each of them does
        [rad], left positive, rising.

    Raises
    ------
    LinkError
        The lists do not belong together or do not rise.
    """

    wheelbase: float = 1.443
    motor_angles: Sequence[float] = (
        *(-0.7461, -0.5969, -0.4477, -0.2985, -0.1492, 0.0),
        *(0.1492, 0.2985, 0.4477, 0.5969, 0.7461),
    )
    road_angles: Sequence[float] = (
        *(-0.5705, -0.4664, -0.3571, -0.2429, -0.1239, 0.0),
        *(0.1239, 0.2429, 0.3571, 0.4664, 0.5705),
    )

    def __post_init__(self) -> None:
        if len(self.motor_angles) != len(self.road_angles) or len(self.road_angles) < 2:
            raise LinkError(
                f"motor_angles has {len(self.motor_angles)} numbers, road_angles "
                f"{len(self.road_angles)}: must be equally many, at least 2"
            )
        for name in ("motor_angles", "road_angles"):
            angles = getattr(self, name)
            if not all(-math.pi / 2 < angle < math.pi / 2 for angle in angles):
                raise LinkError(f"{name}: must be between -pi/2 and pi/2")
            if not all(low < high for low, high in pairwise(angles)):
                raise LinkError(f"{name}: each number must be above the one before")

    def turn_rate(self, speed: float, angle: float) -> float:
        """Return the turn rate [rad/s] that an angle of the steering motor gives.

        Parameters
        ----------
        speed : float
            Speed [m/s], forward positive.
        angle : float
            Angle of the steering motor [rad], left positive.

        Examples
        --------
        >>> round(TurningGeometry().turn_rate(1.0, 0.677), 2)
        0.4
        """
        road = _interpolate(angle, self.motor_angles, self.road_angles)
        return speed * math.tan(road) / self.wheelbase

    def motor_angle(self, speed: float, turn_rate: float) -> float:
        """Return the angle of the steering motor [rad] that gives a turn rate.

        Parameters
        ----------
        speed : float
            Speed [m/s], forward positive; not 0.
        turn_rate : float
            Yaw rate [rad/s], left positive; one that the steering cannot give counts as the largest
            that it can.

        Examples
        --------
        >>> round(TurningGeometry().motor_angle(1.0, 0.4), 2)
        0.68
        """
        road = math.atan(self.wheelbase * turn_rate / speed)
        return _interpolate(road, self.road_angles, self.motor_angles)


def _interpolate(x: float, xs: Sequence[float], ys: Sequence[float]) -> float:
    """Return y at x between the points; beyond them the value at the end."""
    x = min(max(x, xs[0]), xs[-1])
    k = min(bisect_right(xs, x), len(xs) - 1)
    share = (x - xs[k - 1]) / (xs[k] - xs[k - 1])
    return ys[k - 1] + share * (ys[k] - ys[k - 1])
