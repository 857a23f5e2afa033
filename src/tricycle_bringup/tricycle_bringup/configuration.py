"""Where the nodes' parameters come from: the packaged YAML files and the vehicle file."""

from importlib.resources import files
from pathlib import Path

from tricycle_bridge.protocol.limits import MAX_STEERING_ANGLE
from tricycle_sim.vehicle import Vehicle, load_vehicle

SIMULATION_CONFIG = str(files("tricycle_bringup") / "config" / "simulation.yaml")
VEHICLE_CONFIG = str(files("tricycle_bringup") / "config" / "vehicle.yaml")


def bridge_parameters(vehicle_file: str) -> dict[str, float]:
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
    return {
        "tyre_radius": vehicle.tyre_radius,
        "max_steering_angle": min(vehicle.steering_reach, MAX_STEERING_ANGLE),
        "max_steering_rate": vehicle.steering_slew,
        "max_acceleration": vehicle.acceleration,
        "motor_torque": vehicle.motor_torque,
        "regenerative_torque": vehicle.regenerative_torque,
        "motor_power": vehicle.motor_power,
        "mass": _mass_at_the_tread(vehicle),
        "wheelbase": vehicle.com_to_front_axle + vehicle.com_to_rear_axle,
        "caster_angle": vehicle.caster_angle,
    }


def _mass_at_the_tread(vehicle: Vehicle) -> float:
    """Mass that the motor accelerates [kg]: the wheels' inertia counts at the tread."""
    inertia = 2.0 * vehicle.front_wheel_inertia + vehicle.rear_wheel_inertia
    return vehicle.mass + inertia / vehicle.tyre_radius**2
