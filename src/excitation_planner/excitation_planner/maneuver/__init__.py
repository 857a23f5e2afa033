"""Maneuver families: operation parameters to paths or commands."""

from excitation_planner.maneuver.family import (
    Circle,
    DoubleLaneChange,
    Drive,
    ManeuverFamily,
    PlanError,
    Slalom,
    evenly_spaced,
    family_by_name,
    family_names,
    operation_point,
)

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
