"""Where the nodes' parameters come from: the packaged YAML files and the vehicle file."""

import dataclasses
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from tricycle_bridge.kinematics import TurningGeometry
from tricycle_bridge.protocol.boards import hall_pulse
from tricycle_bridge.protocol.limits import MAX_STEERING_ANGLE
from tricycle_bridge.settings import BridgeSettings
from tricycle_core.errors import LinkError, VehicleError
from tricycle_sim.vehicle import Vehicle, load_vehicle
from tricycle_sim.vehicle.kinematics import road_angles

SIMULATION_CONFIG = str(files("tricycle_bringup") / "config" / "simulation.yaml")
VEHICLE_CONFIG = str(files("tricycle_bringup") / "config" / "vehicle.yaml")

TURNING_POINTS = 11  # of the steering, between which the bridge interpolates


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
    return _settings(vehicle) | {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in dataclasses.asdict(turning_geometry(vehicle)).items()
    }


def bridge_settings(vehicle: Vehicle) -> BridgeSettings:
    """Return the bridge's settings for a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
        That it drives.

    Raises
    ------
    VehicleError
        If a constant is beyond what the boards can be set up for.
    """
    try:
        return BridgeSettings(**_settings(vehicle))
    except LinkError as error:
        raise VehicleError(f"{vehicle.name}: the boards cannot drive it: {error}") from error


def turning_geometry(vehicle: Vehicle) -> TurningGeometry:
    """Return how the bridge turns a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
        With its steering.
    """
    reach = _steering_reach(vehicle)
    motor_angles = np.linspace(-reach, reach, TURNING_POINTS)
    return TurningGeometry(
        vehicle.wheelbase,
        tuple(motor_angles.tolist()),
        tuple(road_angles(vehicle, motor_angles).tolist()),
    )


def _settings(vehicle: Vehicle) -> dict[str, float]:
    """Those of `BridgeSettings` that follow from the vehicle."""
    return {
        "tyre_radius": vehicle.tyre_radius,
        "hall_pulse": hall_pulse(vehicle.tyre_radius),
        "max_steering_angle": _steering_reach(vehicle),
        "max_steering_rate": vehicle.steering_slew,
        "max_acceleration": vehicle.acceleration,
        "motor_torque": vehicle.motor_torque,
        "regenerative_torque": vehicle.regenerative_torque,
        "motor_power": vehicle.motor_power,
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
    inertia = 2.0 * vehicle.front_wheel_inertia + vehicle.rear_wheel_inertia
    return vehicle.mass + inertia / vehicle.tyre_radius**2
