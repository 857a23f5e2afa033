"""Which vehicle a plan is for, of any structure."""

import dataclasses
from importlib.resources import files
from types import SimpleNamespace

import pytest

from excitation_planner.planning.shaping import check_vehicle, laws_of, shaping_constants
from tricycle_core.errors import PlanError
from tricycle_sim.vehicle import load_vehicle


def plan_of(vehicle):
    return SimpleNamespace(
        id="0",
        vehicle=vehicle.name,
        constants=shaping_constants(vehicle),
        parts=laws_of(vehicle),
    )


@pytest.mark.parametrize("name", ["car_1_10", "cargo_tadpole", "delta_tricycle"])
def test_plans_of_vehicles_of_other_wheels_are_told_apart(name):
    vehicle = load_vehicle(files("tricycle_sim") / f"{name}.yaml")
    plan = plan_of(vehicle)
    check_vehicle(plan, vehicle)
    with pytest.raises(PlanError, match=r"com_to_front_axle .* instead of 0\.724"):
        check_vehicle(plan, load_vehicle())


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"tyre": "fiala"}, r"parts\.tyre linear instead of fiala; plan again"),
        ({"rear.tyre": "fiala"}, r"parts\.tyre linear instead of several; plan again"),
    ],
)
def test_a_vehicle_of_another_law_alone_is_another_one(parts, message):
    vehicle = load_vehicle()
    other = dataclasses.replace(vehicle, parts=parts)
    assert shaping_constants(other) == shaping_constants(vehicle)
    check_vehicle(plan_of(other), other)
    with pytest.raises(PlanError, match=message):
        check_vehicle(plan_of(vehicle), other)
    same = dataclasses.replace(vehicle, parts={"tyre": "linear"})  # as it is without
    check_vehicle(plan_of(vehicle), same)


def test_of_many_differences_the_first_are_named():
    vehicle = load_vehicle()
    cargo = load_vehicle(files("tricycle_sim") / "cargo_tadpole.yaml")
    with pytest.raises(PlanError, match=r"mass 48\.3 .* and \d+ more; plan") as error:
        check_vehicle(plan_of(vehicle), cargo)
    assert str(error.value).count(" instead of ") <= 4
