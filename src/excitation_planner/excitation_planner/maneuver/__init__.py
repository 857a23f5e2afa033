"""Maneuver families: operation parameters to paths or commands."""

from excitation_planner.maneuver.family import (
    Circle,
    DoubleLaneChange,
    Drive,
    ManeuverFamily,
    Slalom,
    evenly_spaced,
    family_by_name,
    family_names,
    operation_point,
)
from tricycle_core.errors import PlanError

__all__ = [
    "Circle",
    "DoubleLaneChange",
    "Drive",
    "ManeuverFamily",
    "PlanError",
    "Slalom",
    "evenly_spaced",
    "family_by_name",
    "family_names",
    "operation_point",
]
