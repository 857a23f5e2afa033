"""Vehicles of every structure, made up for tests: wheels, laws, and constants.

Each is what a vehicle file says beside its constants; constants that are not here are those of
`tricycle.yaml`.
"""

from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.constants import Vehicle, constant_entries
from tricycle_sim.vehicle.wheels import Wheel

MAGIC = {
    "shape_longitudinal": 1.6,
    "curvature_longitudinal": 0.3,
    "shape_lateral": 1.3,
    "curvature_lateral": -0.8,
    "friction_load_slope": 0.1,
}

PLACES = ("com_to_", "left_", "right_", "rear_", "front_")
"""How the constants of the tricycle begin that are those of one of its wheels or axles."""

STEERED = {"steered": True}
DRIVEN = {"driven": True, "braked": True}


def _pair(axle, **role):
    return [{"name": f"{axle}_{side}", "axle": axle, **role} for side in ("left", "right")]


def _places(axle, x, left, right):
    sides = {"left": left, "right": right}
    return {f"{axle}_{side}.x": x for side in sides} | {
        f"{axle}_{side}.y": y for side, y in sides.items()
    }


DELTA = {
    "wheels": [
        {"name": "front", "axle": "front", **STEERED},
        *_pair("rear", **DRIVEN),
    ],
    "parts": {"steering": "parallel", "drive": "differential", "tyre": "fiala"},
    "constants": {
        "front.x": 0.8,
        "front.y": 0.01,
        **_places("rear", -0.4, 0.35, -0.33),
        "front.wheel_inertia": 0.2,
        "rear.wheel_inertia": 0.4,
        "front.cornering_stiffness": 1700.0,
        "steering_gain": 0.9,
        "com_height": 0.4,
    },
}

CAR = {
    "wheels": [*_pair("front", **STEERED), *_pair("rear", **DRIVEN)],
    "parts": {
        "steering": "ackermann",
        "drive": "differential",
        "front.tyre": "magic_formula",
        "rear.tyre": "fiala",
    },
    "constants": {
        **_places("front", 0.9, 0.4, -0.38),
        **_places("rear", -0.7, 0.45, -0.41),
        "front.wheel_inertia": 0.2,
        "rear.wheel_inertia": 0.4,
        "front.tyre_radius": 0.3,
        "rear.tyre_radius": 0.36,
        "front.vertical_stiffness": 45000.0,
        "rear.cornering_stiffness": 1500.0,
        "front.friction_coefficient": 0.9,
        "caster_angle": 0.1,
        **{f"front.{name}": value for name, value in MAGIC.items()},
    },
}

ALL_WHEELS = {
    "wheels": [*_pair("front", **STEERED, **DRIVEN), *_pair("rear", **DRIVEN)],
    "parts": {"steering": "parallel", "drive": "all", "tyre": "magic_formula"},
    "constants": {
        **_places("front", 0.6, 0.4, -0.4),
        **_places("rear", -0.7, 0.4, -0.4),
        "wheel_inertia": 0.3,
        "drive_front_share": 0.4,
        "caster_angle": 0.0,
        **MAGIC,
    },
}

REAR_STEERED = {
    "wheels": [*_pair("front", **DRIVEN), *_pair("rear", **STEERED)],
    "parts": {"steering": "ackermann", "drive": "differential", "tyre": "softened"},
    "constants": {
        "front.tyre_saturation": 0.6,
        "rear.tyre_saturation": 1.8,
        "front.tyre_rounding": 0.7,
        "rear.tyre_rounding": 0.2,
        "front.slip_by_speed": 0.8,
        "rear.slip_by_speed": 0.3,
        **_places("front", 0.5, 0.4, -0.4),
        **_places("rear", -0.8, 0.3, -0.32),
        "wheel_inertia": 0.3,
        "steering_offset": 0.02,
    },
}

PLAIN = {
    "wheels": [*_pair("front", **STEERED), *_pair("rear", **DRIVEN)],
    "parts": {"steering": "parallel"},
    "constants": {
        **_places("front", 0.7, 0.4, -0.4),
        **_places("rear", -0.8, 0.4, -0.4),
        "wheel_inertia": 0.3,
        "caster_angle": 0.0,
        "camber_stiffness": 0.0,
        "self_aligning_stiffness": 0.0,
        "rolling_coefficient_1": 0.0,
        "rolling_coefficient_2": 0.0,
        "front.cornering_stiffness": 1200.0,
        "rear.cornering_stiffness": 1500.0,
        "friction_coefficient": 50.0,
        "lateral_carcass_damping": 0.0,
    },
}
"""As close to the linear bicycle as the model comes: nothing but slip, far below the limit."""

STRUCTURES = {
    "delta": DELTA,
    "car": CAR,
    "all_wheels": ALL_WHEELS,
    "rear_steered": REAR_STEERED,
}

WITHOUT_SPEED_LOOP = {
    "direct_torque": {
        **DELTA,
        "parts": {**DELTA["parts"], "motor": "direct_torque", "servo": "geared"},
        "constants": {
            **DELTA["constants"],
            "setpoint_torque": 12.0,
            "servo_delay": 0.034,
            "servo_backlash": 0.02,
        },
    },
    "throttle_curve": {
        **REAR_STEERED,
        "parts": {**REAR_STEERED["parts"], "motor": "throttle_curve"},
        "constants": {
            **REAR_STEERED["constants"],
            "throttle_full_setpoint": 4.0,
            "throttle_torque_25": 0.0,
            "throttle_torque_50": 6.0,
            "throttle_torque_75": 18.0,
            "throttle_torque_100": 30.0,
        },
    },
}


def vehicle_of(structure, unknown=None, **constants):
    """A vehicle of a structure; what it does not say is as with the paper's tricycle."""
    wheels = tuple(Wheel(**wheel) for wheel in structure["wheels"])
    parts = structure["parts"]
    shared = {
        name: value
        for name, value in load_vehicle().values.items()
        if name in constant_entries(wheels, parts) and not name.startswith(PLACES)
    }
    values = shared | structure["constants"] | constants
    return Vehicle(name="made up", values=values, unknown=unknown or {}, parts=parts, wheels=wheels)
