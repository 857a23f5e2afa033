"""Where the nodes' parameters come from: the packaged YAML files and the vehicle file."""

from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from tricycle_bridge.protocol.limits import MAX_STEERING_ANGLE
from tricycle_sim.vehicle import Vehicle, load_vehicle
from tricycle_sim.vehicle.kinematics import road_angles, wheelbase

SIMULATION_CONFIG = str(files("tricycle_bringup") / "config" / "simulation.yaml")
VEHICLE_CONFIG = str(files("tricycle_bringup") / "config" / "vehicle.yaml")


TURNING_POINTS = 11  # of the steering, between which the bridge interpolates: within 0.2 %


def bridge_parameters(vehicle_file: str) -> dict[str, Any]:
    """Return the ROS parameters of the bridge that follow from the vehicle.

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
    reach = min(vehicle.steering_reach, MAX_STEERING_ANGLE)
    motor_angles = np.linspace(-reach, reach, TURNING_POINTS)
    return {
        "tyre_radius": vehicle.tyre_radius,
        "max_steering_angle": reach,
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
        "wheelbase": wheelbase(vehicle),
        "motor_angles": motor_angles.tolist(),
        "road_angles": road_angles(vehicle, motor_angles).tolist(),
    }


def _mass_at_the_tread(vehicle: Vehicle) -> float:
    """Mass that the motor accelerates [kg]: the wheels' inertia counts at the tread."""
    inertia = 2.0 * vehicle.front_wheel_inertia + vehicle.rear_wheel_inertia
    return vehicle.mass + inertia / vehicle.tyre_radius**2
