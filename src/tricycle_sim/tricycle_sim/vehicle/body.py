"""The body and the road under it, and where on the body each wheel is."""

from typing import Any

import numpy as np

from tricycle_sim.vehicle.laws import Constant, any_number, between, not_negative, positive
from tricycle_sim.vehicle.layout import Formulas

BODY_CONSTANTS = (
    positive("gravity", "m/s^2"),
    positive("mass", "kg"),
    positive("roll_inertia", "kg m^2"),
    positive("pitch_inertia", "kg m^2"),
    positive("yaw_inertia", "kg m^2"),
    not_negative("air_drag", "N s^2/m^2"),  # force against u per u |u|
    between("rollover_angle", "rad", 0.2, 1.3),  # tilt at which a run is ended
)
WHEEL_CONSTANTS = (
    any_number("x", "m", per_wheel=True),
    any_number("y", "m", per_wheel=True),
    positive("com_height", "m"),  # with unloaded tyres
    positive("tyre_radius", "m", per_wheel=True),  # unloaded
    positive("wheel_inertia", "kg m^2", per_wheel=True),  # about the axle, each
)
ROAD_CONSTANTS = (
    between("road_grade", "rad", -0.5, 0.5, default=0.0),  # of the x axis above the horizontal
    between("road_bank", "rad", -0.5, 0.5, default=0.0),  # of the y axis above the horizontal
)
"""Constants of the road, a plane; its frame is that of all trajectories."""

SHORTHANDS = {
    "com_to_front_axle": positive("com_to_front_axle", "m"),
    "com_to_rear_axle": positive("com_to_rear_axle", "m"),
    "left_wheel_y": positive("left_wheel_y", "m"),
    "right_wheel_y": Constant("right_wheel_y", "m", low=-np.inf, high=0.0),
}
"""Spellings of `Wheel.spellings` whose bounds are others than those of the constant they hold."""


def upward(values: Any) -> tuple[Any, Any, Any]:
    """Return the upward vertical in the road's frame, a unit vector.

    Parameters
    ----------
    values : object
        Object with the attributes `road_grade` and `road_bank`, numbers or arrays.
    """
    x, y = np.sin(values.road_grade), np.sin(values.road_bank)
    return x, y, np.sqrt(1.0 - x * x - y * y)


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
    "king_pin_x": lambda v: -np.sin(v.caster_angle),
    "king_pin_z": lambda v: np.cos(v.caster_angle),
    "rollover_cosine": lambda v: np.cos(v.rollover_angle),
    "gravity_x": lambda v: v.gravity * upward(v)[0],  # along the road, against its axes
    "gravity_y": lambda v: v.gravity * upward(v)[1],
}
"""Constants of the body and of the king-pins, which every vehicle has."""

PLACE: Formulas = {
    "x": lambda w: w.x,
    "y": lambda w: w.y,
    "z": lambda w: w.tyre_radius - w.com_height,
    "inertia": lambda w: w.wheel_inertia,
    "inverse_inertia": lambda w: 1.0 / w.wheel_inertia,
}
"""Constants of a wheel, whatever its tyre."""
