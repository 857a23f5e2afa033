from .planner import plan_at, plan_maneuver, plan_set, random_feasible_point
from .request import PlanRequest
from .shaping import check_vehicle, planned_for

__all__ = [
    "PlanRequest",
    "check_vehicle",
    "plan_at",
    "plan_maneuver",
    "plan_set",
    "planned_for",
    "random_feasible_point",
]
