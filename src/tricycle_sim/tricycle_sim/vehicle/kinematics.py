"""How a vehicle turns at walking pace, from the places and the angles of its wheels."""

import math
from typing import NamedTuple

import numpy as np

from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.vehicle.constants import Vehicle
from tricycle_sim.vehicle.kernel import functions_for
from tricycle_sim.vehicle.parts import steering_constants, structure_of
from tricycle_sim.vehicle.registry import PARTS, law_name


class SteeredWheel(NamedTuple):
    """A steered wheel on the road.

    Attributes
    ----------
    x, y : float
        Place, ahead of the middle of the unsteered axle and left of it [m].
    angle : float
        Angle on the road [rad], left positive.
    """

    x: float
    y: float
    angle: float

    def pace(self, turn: float) -> float:
        """Return its speed over that of the unsteered axle.

        Parameters
        ----------
        turn : float
            Curvature of the unsteered axle's way [rad/m].
        """
        return math.hypot(self.x * turn, 1.0 - self.y * turn)


def steered_wheels(vehicle: Vehicle, motor_angle: float) -> dict[str, SteeredWheel]:
    """Return the steered wheels at a steering motor angle, by name.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its steering linkage.
    motor_angle : float
        Angle of the steering motor [rad].
    """
    table, angles = np.empty((1, 8)), np.empty((2, 1))
    servo = np.array([motor_angle, 0.0])
    constants = steering_constants(vehicle, TICK)  # without set-points there is no step
    functions_for(vehicle).steer(servo, np.empty(0), constants, 1, table, angles)
    axles = table.reshape(-1, 4).tolist()  # of each side: the direction of the axle, its rate
    unsteered = [vehicle.of(wheel) for wheel in vehicle.wheels if not wheel.steered]
    x, y = (float(np.mean([getattr(own, k) for own in unsteered])) for k in "xy")
    sides = structure_of(vehicle).sides
    return {
        wheel.name: SteeredWheel(
            vehicle.of(wheel).x - x,
            vehicle.of(wheel).y - y,
            math.atan2(-axles[side][0], axles[side][1]),
        )
        for wheel, side in zip(vehicle.wheels, sides, strict=False)
        if wheel.steered
    }


def king_pin_angles(vehicle: Vehicle) -> dict[str, tuple[float, float]]:
    """Return the steered wheels' angles about their king-pins with the motor at 0, by name.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its steering linkage.

    Returns
    -------
    dict of str to (float, float)
        Angle [rad], left positive, and its slope by the motor's angle.
    """
    constants = steering_constants(vehicle, TICK)
    *angles, left_slope, right_slope = functions_for(vehicle).wheel_angles(0.0, constants)
    slopes = left_slope, right_slope
    sides = structure_of(vehicle).sides
    return {
        wheel.name: (angles[side], slopes[side])
        for wheel, side in zip(vehicle.wheels, sides, strict=False)
        if wheel.steered
    }


def curvature(wheels: list[SteeredWheel]) -> float:
    """Return the curvature of the unsteered axle's way [rad/m], left positive.

    Wheels that do not agree on one turn slide a little; their side forces, in proportion to their
    slip angles, then have no moment about the middle of the unsteered axle.

    Parameters
    ----------
    wheels : list of SteeredWheel
        Steered wheels of one vehicle at one angle of its motor.
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
    """Return the road angles [rad] of the single front wheel that would turn the vehicle alike.

    The motor then turns as that of a vehicle that is driven at its unsteered axle.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its steering linkage.
    motor_angles : ndarray of float
        Angles of the steering motor [rad].
    """
    share = PARTS["drive"][law_name("drive", vehicle.wheels, vehicle.parts)].rows["torque_share"]
    found = []
    for motor_angle in motor_angles:
        wheels = steered_wheels(vehicle, motor_angle)
        turn = curvature(list(wheels.values()))
        # speed of the motor over that of the unsteered axle; an axle's mean is its middle's
        pace = sum(
            share(vehicle.of(w)) * (wheels[w.name].pace(turn) if w.steered else 1.0)
            for w in vehicle.wheels
            if w.driven
        )
        found.append(math.atan(vehicle.wheelbase * turn / pace))
    return np.array(found)
