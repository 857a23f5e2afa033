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


def spelt_by_wheel(**values):
    """The packaged vehicle with places by wheel and axle, as the questions of a new one give."""
    vehicle = load_vehicle()
    own = dict(vehicle.values)
    for wheel in ("left", "right"):
        own[f"{wheel}.y"] = own.pop(f"{wheel}_wheel_y")
    own["front.x"] = own.pop("com_to_front_axle")
    own["rear.x"] = -own.pop("com_to_rear_axle")
    return dataclasses.replace(vehicle, values=own | values)


def test_a_vehicle_that_spells_the_same_values_otherwise_is_the_same():
    vehicle, same = load_vehicle(), spelt_by_wheel()
    check_vehicle(plan_of(vehicle), same)
    check_vehicle(plan_of(same), vehicle)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"left.y": 0.4}, r": left_wheel_y 0\.3065 instead of 0\.4; plan again"),
        ({"rear.x": -0.8}, r": com_to_rear_axle 0\.719 instead of 0\.8; plan again"),
        ({"left.tyre_radius": 0.3}, r": tyre_radius 0\.335 instead of 0\.3; plan again"),
    ],
)
def test_a_difference_is_told_however_the_vehicle_spells_it(values, message):
    with pytest.raises(PlanError, match=message):
        check_vehicle(plan_of(load_vehicle()), spelt_by_wheel(**values))
