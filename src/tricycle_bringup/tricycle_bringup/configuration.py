"""Where the nodes' parameters come from: the packaged YAML files and the vehicle file."""

from importlib.resources import files
from pathlib import Path

from tricycle_sim.vehicle import load_vehicle

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
        "max_steering_rate": vehicle.steering_slew,
        "max_acceleration": vehicle.acceleration,
    }
