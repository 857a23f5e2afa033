"""Maneuver families: operation parameters to paths or commands."""

from excitation_planner.maneuver.family import (
    DrivenPath,
    ManeuverFamily,
    family_by_name,
    family_names,
    operation_point,
)
from excitation_planner.maneuver.lead_in import LedInFamily, lead_in_of, with_lead_in
from excitation_planner.maneuver.paths import Circle, DoubleLaneChange, Slalom, evenly_spaced
from excitation_planner.maneuver.ranges import (
    load_ranges,
    parse_ranges,
    shown_ranges,
    with_ranges,
)
from tricycle_core.errors import PlanError

Drive = DrivenPath  # the name that the documentation of version 0.1 showed

__all__ = [
    "Circle",
    "DoubleLaneChange",
    "Drive",
    "DrivenPath",
    "LedInFamily",
    "ManeuverFamily",
    "PlanError",
    "Slalom",
    "evenly_spaced",
    "family_by_name",
    "family_names",
    "lead_in_of",
    "load_ranges",
    "operation_point",
    "parse_ranges",
    "shown_ranges",
    "with_lead_in",
    "with_ranges",
]
