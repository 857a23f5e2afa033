"""The vehicle: its file, its equations of motion and their integration."""

from tricycle_core.errors import VehicleError
from tricycle_sim.vehicle.file import UNKNOWN_PARAMETERS, Basis, Vehicle, constants, load_vehicle

__all__ = ["UNKNOWN_PARAMETERS", "Basis", "Vehicle", "VehicleError", "constants", "load_vehicle"]
