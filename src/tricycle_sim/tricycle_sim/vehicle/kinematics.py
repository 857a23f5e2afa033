"""How a vehicle turns at walking pace, from the places and the angles of its wheels."""

import math
from typing import NamedTuple

import numpy as np

from tricycle_core.quantities import FloatArray
from tricycle_sim.vehicle.constants import Vehicle
from tricycle_sim.vehicle.kernel import functions_for
from tricycle_sim.vehicle.parts import steering_constants, structure_of


class SteeredWheel(NamedTuple):
    """A steered wheel on the road.

    Attributes
    ----------
    x, y : float
        Place, ahead of the middle of the unsteered axle and left of it [m].
    angle : float
        On the road [rad], left positive.
    """

    x: float
    y: float
    angle: float


def steered_wheels(vehicle: Vehicle, motor_angle: float) -> list[SteeredWheel]:
    """Return the steered wheels at an angle of the steering motor.

    Parameters
    ----------
    vehicle : Vehicle
        With its law of steering.
    motor_angle : float
        Of the steering motor [rad].
    """
    table, angles = np.empty((1, 8)), np.empty((2, 1))
    servo = np.array([motor_angle, 0.0])
    constants = steering_constants(vehicle, 1.0)  # without set-points there is no step
    functions_for(vehicle).steer(servo, np.empty(0), constants, 1, table, angles)
    # a row holds the direction of each wheel's axle, three numbers, and its rate
    axles = table.reshape(-1, 4).tolist()
    still = [vehicle.of(wheel) for wheel in vehicle.wheels if not wheel.steered]
    x = sum(own.x for own in still) / len(still)
    y = sum(own.y for own in still) / len(still)
    found = []
    for wheel, side in zip(vehicle.wheels, structure_of(vehicle).sides, strict=False):
        if side >= 0:
            own, axle = vehicle.of(wheel), axles[side]
            found.append(SteeredWheel(own.x - x, own.y - y, math.atan2(-axle[0], axle[1])))
    return found


def curvature(wheels: list[SteeredWheel]) -> float:
    """Return the curvature of the unsteered axle's way [rad/m], left positive.

    Wheels that do not agree on one turn slide a little; their side forces, in proportion to their
    slip angles, then have no moment about the middle of the unsteered axle.

    Parameters
    ----------
    wheels : list of SteeredWheel
        Of one vehicle at one angle of its motor.
    """

    def moment(turn: float) -> float:
        return sum(
            (w.x * math.cos(w.angle) + w.y * math.sin(w.angle))
            * (w.angle - math.atan2(w.x * turn, 1.0 - w.y * turn))
            for w in wheels
        )

    # the centre of the turn is not between the wheels
    high = min(1.0 / max(abs(w.y), 1e-3 * abs(w.x)) for w in wheels)
    low = -high
    while high - low > 1e-9:
        middle = 0.5 * (low + high)
        if moment(middle) > 0.0:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def road_angles(vehicle: Vehicle, motor_angles: FloatArray) -> FloatArray:
    """Return the angles on the road [rad] of the one front wheel that would turn the vehicle so.

    Parameters
    ----------
    vehicle : Vehicle
        With its law of steering.
    motor_angles : ndarray of float
        Of the steering motor [rad].
    """
    length = vehicle.wheelbase
    curvatures = [curvature(steered_wheels(vehicle, angle)) for angle in motor_angles]
    return np.arctan(length * np.array(curvatures))
