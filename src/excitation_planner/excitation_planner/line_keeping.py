"""Steering along the line on which the vehicle stood, closed loop, while it gets up to speed."""

import math
from dataclasses import dataclass

import numpy as np

from excitation_planner.way_back.pursuit import Chassis
from tricycle_bridge.protocol.units import ANGLE_UNIT
from tricycle_core.poses import Pose, seen_from

DECAY_TIME = 0.5
"""Time in which a deviation falls by a factor of e [s] ..."""

SHORTEST_DECAY = 0.7
"""... and the way that this takes at least [m]."""

SMOOTHING_TIME = 0.1
"""Time in which the steering takes up a correction [s]."""

SHARPEST = 0.1
"""Largest curvature of a correction, and of an offset [1/m]."""

RESPONSE_TIME = 0.2
"""Time in which the vehicle takes up a curvature and its yaw rate is measured [s]."""


@dataclass
class LineKeeping:
    """Steers along a straight line, closed loop; it does not control the speed.

    By its yaw rate a vehicle shows at once how much more it turns than it is steered, as by an
    error of the steering's zero or a side slope: long before that has led it aside.

    Attributes
    ----------
    start : (float, float, float)
        Pose of `base_link` at rest [m, m, rad]: the line goes through it, along its heading.
    end : float
        Time from the start of the maneuver until which it steers [s].
    chassis : Chassis
        Steering geometry and tyre radius of the vehicle.
    curvature : float
        Commanded curvature of the path of the unsteered axle's middle [1/m].
    offset : float
        Curvature that the vehicle has besides, as learned on the way [1/m].
    """

    start: Pose
    end: float
    chassis: Chassis
    curvature: float = 0.0
    offset: float = 0.0
    _time: float = 0.0  # of the last step
    _taken_up: float = 0.0  # of the commanded curvature

    def steer(self, pose: Pose, speed: float, yaw_rate: float, time: float) -> float:
        """Return by how much the steering motor turns for now [rad], as the protocol can say it.

        It is from where the commands hold it, which is straight on.

        Parameters
        ----------
        pose : (float, float, float)
            Present pose of `base_link` [m, m, rad].
        speed : float
            Present speed [m/s].
        yaw_rate : float
            Present yaw rate, left positive [rad/s].
        time : float
            Time since the start of the maneuver [s].
        """
        x, y, heading = self.chassis.axle(*pose)
        ((_, aside),) = seen_from(np.array([[x, y]]), *self.chassis.axle(*self.start)).tolist()
        turned = math.remainder(heading - self.start[2], math.tau)
        decay = max(SHORTEST_DECAY, DECAY_TIME * speed)
        step = max(time - self._time, 0.0)  # a clock may step back
        self._time = time
        self._taken_up += min(step / RESPONSE_TIME, 1.0) * (self.curvature - self._taken_up)
        unexplained = yaw_rate - speed * (self._taken_up + self.offset)
        self.offset = _limited(self.offset + min(step / decay, 1.0) * unexplained)
        # critically damped along the way
        wanted = _limited(-aside / decay**2 - 2.0 * turned / decay - self.offset)
        self.curvature += min(step / SMOOTHING_TIME, 1.0) * (wanted - self.curvature)
        more = self.chassis.motor_angle(self.curvature) - self.chassis.motor_angle(0.0)
        return round(more / ANGLE_UNIT) * ANGLE_UNIT


def _limited(curvature: float) -> float:
    return min(max(curvature, -SHARPEST), SHARPEST)
