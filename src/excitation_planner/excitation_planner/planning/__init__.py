"""Plans: a maneuver family, a vehicle and a target to the maneuver that is driven."""

from excitation_planner.planning.planner import (
    PlanRequest,
    plan_at,
    plan_maneuver,
    plan_set,
    random_feasible_point,
)

__all__ = [
    "PlanRequest",
    "plan_at",
    "plan_maneuver",
    "plan_set",
    "random_feasible_point",
]
