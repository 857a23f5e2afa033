"""The vehicle: its constants and files, its equations of motion and their integration."""

from tricycle_core.errors import VehicleError
from tricycle_sim.vehicle.constants import UNKNOWN_PARAMETERS, Vehicle, draw_truth
from tricycle_sim.vehicle.file import Basis, load_vehicle, parse_vehicle, vehicle_document
from tricycle_sim.vehicle.plausibility import warnings_about
from tricycle_sim.vehicle.wheels import Wheel

__all__ = [
    "UNKNOWN_PARAMETERS",
    "Basis",
    "Vehicle",
    "VehicleError",
    "Wheel",
    "draw_truth",
    "load_vehicle",
    "parse_vehicle",
    "vehicle_document",
    "warnings_about",
]
