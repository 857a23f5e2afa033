"""The parts of a vehicle: which laws it has, and where the constants of each stand.

A law is a function that is compiled into the equations, and the constants that it reads. A new one
is an entry of `tyre.LAWS`, `actuators.MOTORS`, `BRAKES`, `SERVOS` or `steering.LINKAGES`.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from tricycle_core.errors import VehicleError
from tricycle_core.quantities import FloatArray
from tricycle_sim.vehicle import actuators, steering, tyre
from tricycle_sim.vehicle.constants import Vehicle, upward
from tricycle_sim.vehicle.layout import CONSTANTS, Formulas, blocks

PARTS: Mapping[str, Mapping[str, tuple[Any, Any]]] = {
    "tyre": tyre.LAWS,
    "motor": actuators.MOTORS,
    "brake": actuators.BRAKES,
    "servo": actuators.SERVOS,
    "linkage": steering.LINKAGES,
}
"""Function and constants of every law, by part and name; the first law is the default."""


class Laws(NamedTuple):
    """Functions of the laws that a vehicle has.

    Attributes
    ----------
    tyre, motor, brake, servo, linkage : compiled function
        Of the part.
    """

    tyre: Any
    motor: Any
    brake: Any
    servo: Any
    linkage: Any


BODY: Formulas = {
    "gravity_z": lambda v: v.gravity * upward(v)[2],  # towards the road
    "inverse_mass": lambda v: 1.0 / v.mass,
    "drag_per_mass": lambda v: v.air_drag / v.mass,
    "ixx": lambda v: v.roll_inertia,
    "iyy": lambda v: v.pitch_inertia,
    "izz": lambda v: v.yaw_inertia,
    "inverse_ixx": lambda v: 1.0 / v.roll_inertia,
    "inverse_iyy": lambda v: 1.0 / v.pitch_inertia,
    "inverse_izz": lambda v: 1.0 / v.yaw_inertia,
    "front_x": lambda v: v.com_to_front_axle,
    "rear_x": lambda v: -v.com_to_rear_axle,
    "left_y": lambda v: v.left_wheel_y,
    "right_y": lambda v: v.right_wheel_y,
    "rear_y": lambda v: v.rear_wheel_y,
    "wheel_z": lambda v: v.tyre_radius - v.com_height,
    "spin_inertia_front": lambda v: v.front_wheel_inertia,
    "spin_inertia_rear": lambda v: v.rear_wheel_inertia,
    "inverse_spin_inertia_front": lambda v: 1.0 / v.front_wheel_inertia,
    "inverse_spin_inertia_rear": lambda v: 1.0 / v.rear_wheel_inertia,
    "king_pin_x": lambda v: -np.sin(v.caster_angle),
    "king_pin_z": lambda v: np.cos(v.caster_angle),
    "rollover_cosine": lambda v: np.cos(v.rollover_angle),
    "gravity_x": lambda v: v.gravity * upward(v)[0],  # along the road, against its axes
    "gravity_y": lambda v: v.gravity * upward(v)[1],
}
"""Constants of body, wheels and king-pins, which every vehicle has."""

BLOCK, ROWS = blocks(
    CONSTANTS,
    {
        "body": [BODY],
        "tyre": [tyre.CONSTANTS],
        "tyre_law": [constants for _, constants in tyre.LAWS.values()],
        "motor": [constants for _, constants in actuators.MOTORS.values()],
        "brake": [constants for _, constants in actuators.BRAKES.values()],
    },
)
"""First row of each block of constants in a group; number of rows of a group."""


def law_names(vehicle: Vehicle) -> tuple[str, ...]:
    """Return the names of the vehicle's laws, in the order of `Laws`.

    Parameters
    ----------
    vehicle : Vehicle
        Names laws in `parts`; a part that it does not name has the first law.

    Raises
    ------
    VehicleError
        If there is no such part or law.
    """
    for part, name in vehicle.parts.items():
        if part not in PARTS:
            raise VehicleError(f"parts.{part}: must be one of {', '.join(PARTS)}")
        if name not in PARTS[part]:
            raise VehicleError(f"parts.{part}: {name!r} must be one of {', '.join(PARTS[part])}")
    return tuple(vehicle.parts.get(part, next(iter(PARTS[part]))) for part in Laws._fields)


def group_constants(vehicle: Vehicle, values: Any) -> dict[int, Any]:
    """Return the constants of a group by row.

    Parameters
    ----------
    vehicle : Vehicle
        Names the laws.
    values : object
        With the constants of a `Vehicle` as attributes; numbers, or arrays for some of them.
    """
    names = dict(zip(Laws._fields, law_names(vehicle), strict=True))
    by_block = {
        "body": BODY,
        "tyre": tyre.CONSTANTS,
        "tyre_law": tyre.LAWS[names["tyre"]][1],
        "motor": actuators.MOTORS[names["motor"]][1],
        "brake": actuators.BRAKES[names["brake"]][1],
    }
    return {
        row: formula(values)
        for block, formulas in by_block.items()
        for row, formula in enumerate(formulas.values(), start=getattr(BLOCK, block))
    }


def steering_constants(vehicle: Vehicle, half_step: float) -> FloatArray:
    """Return the constants of servo, linkage and caster.

    Parameters
    ----------
    vehicle : Vehicle
        Of which they are.
    half_step : float
        Length of the servo's steps [s].

    Returns
    -------
    ndarray of float, shape (steering.SIZE,)
        See `steering.BLOCK`.
    """
    names = dict(zip(Laws._fields, law_names(vehicle), strict=True))
    constants = np.zeros(steering.SIZE)
    servo = actuators.SERVOS[names["servo"]][1]
    for at, step_formula in enumerate(servo.values(), start=steering.BLOCK.servo):
        constants[at] = step_formula(vehicle, half_step)
    for start, formulas in (
        (steering.BLOCK.linkage, steering.LINKAGES[names["linkage"]][1]),
        (steering.BLOCK.geometry, steering.GEOMETRY),
    ):
        for at, formula in enumerate(formulas.values(), start=start):
            constants[at] = formula(vehicle)
    return constants
