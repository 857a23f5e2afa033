"""Plans for an area: they fit, or the refusal names a change with which they do."""

import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from excitation_planner import Criterion
from excitation_planner.area.area import Area, StartRegion
from excitation_planner.area.room import Room
from excitation_planner.area.tube import footprint_of
from excitation_planner.box import Box
from excitation_planner.design.noise import MeasurementNoise
from excitation_planner.maneuver import Circle, family_by_name, with_ranges
from excitation_planner.maneuver.family import DrivenPath, ManeuverFamily
from excitation_planner.plan import load_plan, save_plan
from excitation_planner.planning import PlanRequest, plan_at, plan_maneuver
from excitation_planner.planning.fitting import FittingSearch
from excitation_planner.planning.replay import nominal_run
from tricycle_core.errors import PlanError
from tricycle_core.quantities import FloatArray
from tricycle_sim.vehicle import Vehicle, load_vehicle


def yard(width: float, height: float, margin: float = 0.5) -> Area:
    corners = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])
    return Area(corners, margin=margin)


def request(area: Area) -> PlanRequest:
    return PlanRequest(load_vehicle(), Circle(), "cornering_stiffness", samples=20, area=area)


def shortage(area: Area, x: ArrayLike) -> float:
    vehicle = load_vehicle()
    room = Room(area, footprint_of(vehicle), MeasurementNoise().position_std)
    return room.fit(vehicle, nominal_run(vehicle, Circle(), np.asarray(x)).commands).shortage


@pytest.mark.slow
def test_a_plan_says_where_on_the_area_it_is_driven(tmp_path: Path) -> None:
    area = yard(12.0, 25.0)
    plan = plan_at(request(area), np.array([3.0, 0.8]))
    save_plan(plan, tmp_path / "plan.json")
    plan = load_plan(tmp_path / "plan.json")
    assert plan.start_pose is not None
    assert plan.clearance is not None
    assert plan.area is not None
    np.testing.assert_array_equal(plan.area.keep_in, area.keep_in)
    outline = plan.stopping_zone[0]
    assert area.clearance(outline).min() == pytest.approx(plan.clearance, abs=0.02)
    assert plan.clearance > area.margin


@pytest.mark.slow
def test_a_lane_change_for_a_small_yard_is_shorter_and_fits() -> None:
    area = yard(12.0, 25.0)
    (family,) = with_ranges([family_by_name("double_lane_change")], {}, smaller=True)
    asked = PlanRequest(
        load_vehicle(), family, "cornering_stiffness", Criterion.C, budget=6000, area=area
    )
    told = list[tuple[int, int]]()
    plan = plan_maneuver(asked, progress=lambda done, total: told.append((done, total)))
    assert told == sorted(told)  # from the first maneuver tried to the last verified
    assert told[0][0] < 0.2 * told[-1][0]
    assert told[-1][0] < plan.simulations  # the plan counts its indices and its prediction too
    assert told[-1][1] == asked.budget
    assert plan.operation["length"] < 16.0
    assert plan.clearance is not None
    assert plan.clearance >= Room(area, plan.footprint, plan.noise.position_std).needed
    assert told[-1][0] < asked.budget
    free = plan_maneuver(replace(asked, family=family_by_name("double_lane_change"), area=None))
    assert free.criterion_cost / plan.criterion_cost > 0.8  # of the information


@pytest.mark.slow
def test_a_sweep_for_a_yard_shorter_than_itself_is_driven_about_a_turn() -> None:
    sweep, area = family_by_name("sine_sweep"), yard(12.0, 25.0)
    asked = PlanRequest(load_vehicle(), sweep, "cornering_stiffness", Criterion.C, budget=6000)
    free = plan_maneuver(asked)
    assert np.ptp(free.path, axis=0).max() > 25.0
    (smaller,) = with_ranges([sweep], {}, smaller=True)
    plan = plan_maneuver(replace(asked, family=smaller, area=area))
    assert plan.operation["turn"] > 0.1
    assert free.criterion_cost / plan.criterion_cost > 0.8  # of the information


@pytest.mark.slow
def test_a_slalom_in_a_small_yard_teaches_as_much_whatever_the_seed() -> None:
    vehicle, slalom, area = load_vehicle(), family_by_name("slalom"), yard(12.0, 25.0)
    (smaller,) = with_ranges([slalom], {}, smaller=True)
    asked = PlanRequest(vehicle, slalom, "cornering_stiffness", Criterion.C, budget=6000)
    free = plan_maneuver(asked).criterion_cost
    asked = replace(asked, family=smaller, area=area)
    plans = [plan_maneuver(replace(asked, seed=seed)) for seed in (0, 4)]
    # it has several optima there
    assert max(plan.criterion_cost for plan in plans) < free / 0.8
    for plan in plans:  # all that were tried are in its history
        assert len(plan.search.cost) > 100
        assert np.isinf(plan.search.cost).any()
        assert list(plan.operation.values()) in plan.search.x.tolist()


def fitting(family: ManeuverFamily, area: Area) -> FittingSearch:
    vehicle, noise = load_vehicle(), MeasurementNoise()
    room = Room(area, footprint_of(vehicle), noise.position_std)
    return FittingSearch(vehicle, family, room, Criterion.C, 0, noise)


@pytest.mark.slow
def test_a_search_by_a_few_simulations_ends_with_what_fits() -> None:
    area = yard(9.0, 14.0)
    search = fitting(Circle(), area)
    starts = search.starts(0)
    assert len(starts) > 0
    for u in starts:
        assert shortage(area, Circle().operation.from_unit(u)) <= 0.0
    # nothing fits a yard that is as wide as the vehicle
    assert len(fitting(Circle(), yard(3.0, 3.0)).starts(0)) == 0


@dataclass(frozen=True)
class Laden:
    """A circle with five parameters, three of which change nothing."""

    name: str = "laden"
    operation: Box = field(
        default_factory=lambda: Box.of(
            Circle().operation.bounds() | dict.fromkeys("abc", (0.0, 1.0))
        )
    )

    def drive(self, x: FloatArray, vehicle: Vehicle) -> DrivenPath:
        return Circle().drive(x[:2], vehicle)


@pytest.mark.slow
def test_a_family_of_five_parameters_is_searched_too() -> None:
    # corners of its box are drawn, some of them twice
    area = yard(12.0, 25.0)
    starts = fitting(Laden(), area).starts(0)
    assert len(starts) > 0
    for u in starts:
        assert shortage(area, Laden().operation.from_unit(u)[:2]) <= 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("width", "length", "keep_out"),
    [(9.0, 16.0, ()), (12.0, 14.0, (yard(1.0, 1.0).keep_in + np.array([1.0, 10.0]),))],
)
def test_a_refusal_names_changes_that_are_enough(
    width: float, length: float, keep_out: tuple[FloatArray, ...]
) -> None:
    x, area = np.array([6.0, 1.0]), replace(yard(width, length), keep_out=keep_out)
    with pytest.raises(PlanError, match=r"needs .* m more room in the area") as caught:
        plan_at(request(area), x)
    message = str(caught.value)
    (radius,) = map(float, re.findall(r"radius ([\d.]+)", message))
    assert shortage(area, [radius - 0.01, 1.0]) <= 0.0  # it is rounded
    (further,) = map(float, re.findall(r"keep_in ([\d.]+) m further out", message))
    more = further + 0.01
    wider = yard(width + 2.0 * more, length + 2.0 * more).keep_in - more
    assert shortage(replace(area, keep_in=wider), x) <= 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("parts", "blamed"),
    [
        ({"keep_out": (yard(24.0, 24.0).keep_in - 2.0,)}, r"keep_in \d+\.\d+ m further out"),
        ({"start": StartRegion((19.0, 20.0), (4.0, 5.0))}, "further out on every side would do"),
        (
            {"keep_out": (yard(4.0, 4.0).keep_in + 8.0,), "start": StartRegion((7.8, 9), (9, 11))},
            "a keep_out is in its way, however large keep_in is",
        ),
    ],
)
def test_a_refusal_blames_what_is_in_the_way(parts: dict[str, Any], blamed: str) -> None:
    area = replace(yard(20.0, 20.0), **parts)
    with pytest.raises(PlanError, match=blamed):
        plan_at(request(area), np.array([3.0, 0.8]))


@pytest.mark.slow
def test_a_search_that_finds_nothing_says_what_comes_closest() -> None:
    asked = replace(request(yard(4.0, 4.0)), budget=600)
    with pytest.raises(PlanError) as caught:
        plan_maneuver(asked)
    assert "the circle that comes closest (radius 2" in str(caught.value)
    assert "keep_in" in str(caught.value)
    with pytest.raises(PlanError) as caught:
        plan_maneuver(replace(asked, area=yard(40.0, 40.0), budget=10))
    assert str(caught.value).startswith("budget = 10 is too small")
    assert "keep_in" not in str(caught.value)  # which is large enough
