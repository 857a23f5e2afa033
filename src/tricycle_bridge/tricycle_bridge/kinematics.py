"""Steering geometry for `cmd_vel`: turn rate and angle of the steering motor."""

from __future__ import annotations

import math

# The inner wheel turns by the motor's angle theta, the outer by theta (0.8 - 0.2 |theta| / 45 deg):
# their mean is theta (0.9 - 0.1 |theta| / 45 deg).
_MEAN_RATIO = 0.9
_MEAN_RATIO_DROP = 0.1 / (math.pi / 4)  # 1/rad


def steering_motor_angle(
    speed: float, turn_rate: float, *, wheelbase: float, caster_angle: float
) -> float:
    """Return the angle of the steering motor that gives a turn rate without tyre slip.

    Parameters
    ----------
    speed : float
        Speed [m/s], forward positive; not 0.
    turn_rate : float
        Yaw rate [rad/s], left positive.
    wheelbase : float
        Wheelbase [m].
    caster_angle : float
        Angle between king-pin and vertical [rad].

    Returns
    -------
    angle : float
        Angle [rad], left positive; infinite where no angle gives the turn rate.

    Examples
    --------
    >>> round(steering_motor_angle(1.0, 0.4, wheelbase=1.443, caster_angle=math.radians(20)), 3)
    0.677
    """
    road = math.atan(wheelbase * turn_rate / speed)  # angle of the wheels' track on the road
    wheel = abs(math.atan(math.tan(road) / math.cos(caster_angle)))  # about the king-pin
    # wheel = theta (0.9 - 0.127 theta): the smaller root
    discriminant = _MEAN_RATIO**2 - 4.0 * _MEAN_RATIO_DROP * wheel
    if discriminant < 0.0:
        return math.copysign(math.inf, road)
    theta = (_MEAN_RATIO - math.sqrt(discriminant)) / (2.0 * _MEAN_RATIO_DROP)
    return math.copysign(theta, road)


def turn_rate(speed: float, angle: float, *, wheelbase: float, caster_angle: float) -> float:
    """Return the turn rate [rad/s] that an angle of the steering motor gives without tyre slip.

    Parameters
    ----------
    speed : float
        Speed [m/s], forward positive.
    angle : float
        Angle of the steering motor [rad], left positive.
    wheelbase : float
        Wheelbase [m].
    caster_angle : float
        Angle between king-pin and vertical [rad].

    Examples
    --------
    >>> round(turn_rate(1.0, 0.677, wheelbase=1.443, caster_angle=math.radians(20)), 3)
    0.4
    """
    wheel = angle * (_MEAN_RATIO - _MEAN_RATIO_DROP * abs(angle))
    return speed * math.tan(wheel) * math.cos(caster_angle) / wheelbase
