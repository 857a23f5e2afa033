"""The vehicle: its constants and files, its equations of motion and their integration."""

from tricycle_core.errors import VehicleError
from tricycle_sim.vehicle.constants import UNKNOWN_PARAMETERS, Vehicle, constant_fields, draw_truth
from tricycle_sim.vehicle.file import Basis, load_vehicle
from tricycle_sim.vehicle.plausibility import warnings_about

__all__ = [
    "UNKNOWN_PARAMETERS",
    "Basis",
    "Vehicle",
    "VehicleError",
    "constant_fields",
    "draw_truth",
    "load_vehicle",
    "warnings_about",
]
