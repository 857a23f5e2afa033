"""Which vehicle a plan is for, of any structure."""

from importlib.resources import files
from types import SimpleNamespace

import pytest

from excitation_planner.planning.shaping import check_vehicle, shaping_constants
from tricycle_core.errors import PlanError
from tricycle_sim.vehicle import load_vehicle


@pytest.mark.parametrize("name", ["car_1_10", "cargo_tadpole", "delta_tricycle"])
def test_plans_of_vehicles_of_other_wheels_are_told_apart(name):
    vehicle = load_vehicle(files("tricycle_sim") / f"{name}.yaml")
    plan = SimpleNamespace(id="0", vehicle=name, constants=shaping_constants(vehicle))
    check_vehicle(plan, vehicle)
    with pytest.raises(PlanError, match=r"com_to_front_axle .* instead of 0\.724"):
        check_vehicle(plan, load_vehicle())
