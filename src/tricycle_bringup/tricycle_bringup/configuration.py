"""Parameters of the nodes, from the packaged YAML files and the vehicle file."""

import dataclasses
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from tricycle_bridge.commands.kinematics import TurningGeometry
from tricycle_bridge.protocol.boards import (
    MOTOR_NO_LOAD_SPEED,
    MOTOR_SLOPE,
    SPEED_GAIN,
    hall_pulse,
)
from tricycle_bridge.protocol.limits import (
    MAX_POWER,
    MAX_REGENERATIVE_TORQUE,
    MAX_STEERING_ANGLE,
    MAX_TORQUE,
)
from tricycle_bridge.settings import BridgeSettings
from tricycle_core.errors import LinkError, VehicleError
from tricycle_sim.vehicle import Vehicle, load_vehicle
from tricycle_sim.vehicle.kinematics import road_angles

SIMULATION_CONFIG = str(files("tricycle_bringup") / "config" / "simulation.yaml")
VEHICLE_CONFIG = str(files("tricycle_bringup") / "config" / "vehicle.yaml")

IDENTIFYING = ("wheelbase", "tyre_radius", "hall_pulse", "motor_angles", "road_angles")
"""Parameters of the bridge by which another vehicle is noticed."""

TURNING_POINTS = 11  # of the steering, between which the bridge interpolates

# what a board uses at most of a stronger motor
_MOST = {
    "motor_torque": MAX_TORQUE,
    "regenerative_torque": MAX_REGENERATIVE_TORQUE,
    "motor_power": MAX_POWER,
}

# what is compiled into the firmware; emulated boards follow the vehicle file
_COMPILED = {
    "motor_no_load_speed": MOTOR_NO_LOAD_SPEED,
    "motor_slope": MOTOR_SLOPE,
    "speed_gain_proportional": SPEED_GAIN,
    "speed_gain_integral": SPEED_GAIN,
}


def bridge_parameters(vehicle_file: str) -> dict[str, Any]:
    """Return the ROS parameters of the bridge that follow from the vehicle.

    Parameters
    ----------
    vehicle_file : str
        Vehicle YAML; empty for the packaged tricycle.

    Raises
    ------
    VehicleError
        If it is not a valid vehicle file, or of a vehicle that the boards cannot drive.
    """
    vehicle = load_vehicle(Path(vehicle_file) if vehicle_file else None)
    bridge_settings(vehicle)
    return _settings(vehicle) | _geometry(vehicle)


def driver_parameters(vehicle_file: str) -> dict[str, Any]:
    """Return the ROS parameters of the maneuver driver that follow from the vehicle.

    Parameters
    ----------
    vehicle_file : str
        Vehicle YAML; empty for the packaged tricycle.

    Raises
    ------
    VehicleError
        If it is not a valid vehicle file.
    """
    vehicle = load_vehicle(Path(vehicle_file) if vehicle_file else None)
    unsteered = [vehicle.of(wheel).x for wheel in vehicle.wheels if not wheel.steered]
    return _geometry(vehicle) | {
        "tyre_radius": vehicle.driven_radius,
        "unsteered_axle": float(np.mean(unsteered)),
    }


def check_bridge(vehicle: Vehicle, parameters: Mapping[str, Any]) -> None:
    """Refuse a bridge that was started for another vehicle.

    Its limits may be lower than the vehicle's; wheels and steering are the vehicle's. What depends
    on an unknown parameter may differ: a drive is there to find it.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle that is to be driven.
    parameters : mapping
        Parameters of the running bridge, with those in `IDENTIFYING`.

    Raises
    ------
    VehicleError
        If they differ; the message names the parameters, with both values.
    """
    expected = _identifying(vehicle)
    ends = (
        _identifying(vehicle.replace(**{n: e})) for n, two in vehicle.unknown.items() for e in two
    )
    uncertain = {name for other in ends for name in other if other[name] != expected[name]}
    differing = [
        f"{name} {_short(parameters[name])} instead of {_short(value)}"
        for name, value in expected.items()
        if name not in uncertain and not _alike(parameters[name], value)
    ]
    if differing:
        raise VehicleError(
            f"tricycle_bridge was started for another vehicle than {vehicle.name}: "
            f"{', '.join(differing)}; start it with this vehicle's file (vehicle_file)"
        )


def _identifying(vehicle: Vehicle) -> dict[str, Any]:
    parameters = _settings(vehicle) | _geometry(vehicle)
    return {name: parameters[name] for name in IDENTIFYING}


def _alike(found: Any, expected: Any) -> bool:
    # the bridge's own defaults are rounded, and coefficients of a polynomial may vanish
    return np.shape(found) == np.shape(expected) and np.allclose(
        found, expected, rtol=1e-3, atol=1e-6
    )


def _short(value: Any) -> str:
    return np.array2string(np.asarray(value), precision=4, separator=", ", max_line_width=1000)


def _geometry(vehicle: Vehicle) -> dict[str, Any]:
    """Return the fields of `TurningGeometry` as ROS parameters."""
    return {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in dataclasses.asdict(turning_geometry(vehicle)).items()
    }


def bridge_settings(vehicle: Vehicle) -> BridgeSettings:
    """Return the bridge's settings for a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle that the bridge drives.

    Raises
    ------
    VehicleError
        If the boards cannot be set up for a constant, or the motor holds no speed.
    """
    if not vehicle.has_speed_loop:
        raise VehicleError(
            f"{vehicle.name}: the boards cannot drive it: they hold a speed, and parts.motor: "
            f"{vehicle.parts['motor']} has no speed loop; hub_motor has one"
        )
    try:
        return BridgeSettings(**_settings(vehicle))
    except LinkError as error:
        raise VehicleError(f"{vehicle.name}: the boards cannot drive it: {error}") from error


def turning_geometry(vehicle: Vehicle) -> TurningGeometry:
    """Return the relation of steering angle and curvature that the bridge uses for a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its steering linkage.
    """
    reach = _steering_reach(vehicle)
    motor_angles = np.linspace(-reach, reach, TURNING_POINTS)
    return TurningGeometry(
        vehicle.wheelbase,
        tuple(motor_angles.tolist()),
        tuple(road_angles(vehicle, motor_angles).tolist()),
    )


def beyond_the_boards(vehicle: Vehicle) -> tuple[str, ...]:
    """Return what the boards' firmware does not use of a vehicle, one line each.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle that the boards drive.
    """
    beyond = [
        f"{name}: {vehicle.values[name]:g} {vehicle.unit(name)}, of which the boards use {most:g}"
        for name, most in _MOST.items()
        if vehicle.values.get(name, 0.0) > most
    ]
    beyond += [
        f"{name}: {vehicle.values[name]:g} {vehicle.unit(name)}; the firmware has {compiled:g}"
        for name, compiled in _COMPILED.items()
        if vehicle.values.get(name, compiled) != compiled
    ]
    return tuple(beyond)


def _settings(vehicle: Vehicle) -> dict[str, float]:
    """Return the fields of `BridgeSettings` that follow from the vehicle."""
    return {
        "tyre_radius": vehicle.driven_radius,
        "hall_pulse": hall_pulse(vehicle.driven_radius),
        "max_steering_angle": _steering_reach(vehicle),
        "max_steering_rate": vehicle.steering_slew,
        "max_acceleration": vehicle.acceleration,
        **{
            name: min(vehicle.values[name], most)
            for name, most in _MOST.items()
            if name in vehicle.values
        },
        "mass": _mass_at_the_tread(vehicle),
        "drive_supply_low": vehicle.drive_supply_low,
        "drive_supply_high": vehicle.drive_supply_high,
        "steer_supply_low": vehicle.steer_supply_low,
        "steer_supply_high": vehicle.steer_supply_high,
    }


def _steering_reach(vehicle: Vehicle) -> float:
    return min(vehicle.steering_reach, MAX_STEERING_ANGLE)


def _mass_at_the_tread(vehicle: Vehicle) -> float:
    """Mass that the motor accelerates [kg]: the wheels' inertia counts at the tread."""
    wheels = (vehicle.of(wheel) for wheel in vehicle.wheels)
    return float(vehicle.mass + sum(own.wheel_inertia / own.tyre_radius**2 for own in wheels))
