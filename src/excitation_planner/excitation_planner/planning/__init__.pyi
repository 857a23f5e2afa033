from .planner import plan_at, plan_maneuver, plan_set, random_feasible_point
from .request import PlanRequest

__all__ = [
    "PlanRequest",
    "plan_at",
    "plan_maneuver",
    "plan_set",
    "random_feasible_point",
]
