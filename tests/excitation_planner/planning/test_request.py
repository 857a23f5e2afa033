"""Requests that cannot be met."""

import dataclasses

import pytest

from excitation_planner import Criterion, MeasurementNoise
from excitation_planner.maneuver import Circle, DoubleLaneChange
from excitation_planner.planning import PlanRequest, plan_maneuver
from tricycle_core.errors import DesignError, PlanError
from tricycle_sim.vehicle import load_vehicle

VEHICLE = load_vehicle()


def test_an_unknown_target_lists_the_unknown_parameters():
    with pytest.raises(PlanError, match="cornering_stiffness, camber_stiffness"):
        PlanRequest(VEHICLE, Circle(), "mass")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"criterion": Criterion.C, "noise": MeasurementNoise(noise_std=0.0)},
            "criterion c needs noise_std above 0",
        ),
        ({"others": (DoubleLaneChange(),)}, "criterion h judges one maneuver"),
        ({"effects": ("steering-zero",)}, "criterion h counts no effects"),
    ],
)
def test_a_request_that_cannot_be_judged_is_refused(change, message):
    request = PlanRequest(VEHICLE, Circle(), "cornering_stiffness")
    with pytest.raises(PlanError, match=message):
        dataclasses.replace(request, **change)


def test_the_families_are_in_the_order_in_which_they_are_driven():
    request = PlanRequest(
        VEHICLE,
        Circle(),
        "cornering_stiffness",
        criterion=Criterion.C,
        others=(DoubleLaneChange(),),
    )
    assert [family.name for family in request.families] == ["circle", "double_lane_change"]


@pytest.mark.parametrize(
    "asked", [{"criterion": Criterion.H}, {"criterion": Criterion.C, "effects": ("steering-zero",)}]
)
def test_a_budget_is_refused_before_planning_as_planning_would(asked):
    request = PlanRequest(VEHICLE, Circle(), "cornering_stiffness", budget=10, **asked)
    with pytest.raises(DesignError, match="budget = 10 is too small") as planned:
        plan_maneuver(request)
    with pytest.raises(DesignError) as checked:
        request.check_budget()
    assert str(checked.value) == str(planned.value)
    dataclasses.replace(request, budget=int(str(checked.value).split()[-2])).check_budget()
