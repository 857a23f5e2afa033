"""Plans: indices against a second method, files that survive and files that do not lie."""

import dataclasses
import json

import numpy as np
import pytest
from scipy.stats import qmc

from excitation_planner import Criterion, MeasurementNoise
from excitation_planner.maneuver import Circle, DoubleLaneChange
from excitation_planner.plan import SearchHistory, load_plan, save_plan
from excitation_planner.planning import (
    PlanRequest,
    plan_at,
    plan_maneuver,
    plan_set,
    random_feasible_point,
)
from excitation_planner.planning.replay import nominal_run, replayed_errors
from tricycle_core.errors import PlanError
from tricycle_sim.vehicle import load_vehicle

VEHICLE = load_vehicle()


@pytest.fixture(scope="module")
def request_():
    return PlanRequest(VEHICLE, Circle(), "cornering_stiffness")


@pytest.fixture(scope="module")
def plan(request_):
    return plan_at(request_, np.array([3.0, 0.8]))


def test_indices_agree_with_saltelli_on_the_simulator(request_, plan):
    low, high = np.array(list(VEHICLE.unknown.values())).T
    u = qmc.Sobol(12, seed=1).random(1024)
    A, B = (low + (high - low) * half for half in (u[:, :6], u[:, 6:]))
    run = nominal_run(VEHICLE, request_.family, np.array([3.0, 0.8]))
    fa, fb = (replayed_errors(VEHICLE, run, P) for P in (A, B))
    variance = np.var(np.concatenate([fa, fb]))
    for i, name in enumerate(VEHICLE.unknown):
        mixed = A.copy()
        mixed[:, i] = B[:, i]
        fm = replayed_errors(VEHICLE, run, mixed)
        assert plan.main[name].value == pytest.approx(np.mean(fb * (fm - fa)) / variance, abs=0.02)
        total = np.mean((fa - fm) ** 2) / (2 * variance)
        assert plan.total[name].value == pytest.approx(total, abs=0.02)
    assert plan.variance == pytest.approx(variance, rel=0.1)


def plan_measured(request, **noise):
    return plan_at(
        dataclasses.replace(request, noise=MeasurementNoise(**noise)), np.array([3.0, 0.8])
    )


def test_cost_is_eq_11_with_the_noise_as_one_more_contributor(request_, plan):
    main = {name: index.value for name, index in plan.main.items()}
    target = plan.target
    paper = plan.total[target].value - main[target] + sum(main.values()) - main[target]
    quiet = plan_at(
        dataclasses.replace(request_, noise=MeasurementNoise(noise_std=0.0)), np.array([3.0, 0.8])
    )
    assert quiet.cost == pytest.approx(paper / main[target], rel=1e-9)
    assert plan.cost > quiet.cost


def test_a_saved_plan_is_the_same_plan(plan, tmp_path):
    file = tmp_path / "deep" / "plan.json"
    save_plan(plan, file)
    loaded = load_plan(file)
    assert loaded.id == plan.id
    assert (loaded.operation, loaded.main, loaded.unknown) == (
        dict(plan.operation),
        dict(plan.main),
        dict(plan.unknown),
    )
    assert np.array_equal(loaded.reference.yaw, plan.reference.yaw)
    assert [entry.name for entry in file.parent.iterdir()] == ["plan.json"]  # nothing half-written


def test_the_search_is_kept_with_what_cannot_be_driven(plan, tmp_path):
    search = SearchHistory(np.array([[3.0, 0.8], [2.0, 1.0]]), np.array([1.5, np.inf]))
    save_plan(dataclasses.replace(plan, search=search), tmp_path / "plan.json")
    loaded = load_plan(tmp_path / "plan.json").search
    assert np.array_equal(loaded.x, search.x)
    assert np.array_equal(loaded.cost, search.cost)


def _without(document, *path):
    inner = document
    for key in path[:-1]:
        inner = inner[key]
    del inner[path[-1]]


def _with(document, value, *path):
    inner = document
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: _without(d, "target"), "lacks `target`"),
        (lambda d: _with(d, 99, "schema"), "schema 99; this version reads 2"),
        (lambda d: _with(d, "b", "criterion"), "criterion: Invalid enum value 'b'"),
        (
            lambda d: _with(d, None, "predicted_std", "yaw_inertia"),
            r"predicted_std.*: expected `float`",
        ),
        (lambda d: _with(d, "x", "cost"), "cost: expected `float`, got `str`"),
        (lambda d: _with(d, True, "seed"), "seed: expected `int`, got `bool`"),
        (lambda d: _with(d, [1, 2], "commands", "time"), r"commands: .*"),
        (
            lambda d: _with(d, ["a"], "commands", "speed"),
            r"commands\.speed: expected a list of numbers",
        ),
        (lambda d: _with(d, [[1, 2, 3]], "path"), "path must be a list of finite numbers"),
        (lambda d: _without(d, "reference", "yaw"), "reference: lacks `yaw`"),
        (lambda d: _with(d, 0.5, "commands", "speed", 7), "changed after planning"),
        (lambda d: _with(d, {}, "main", "cornering_stiffness"), r"main.*: lacks `value`"),
        (lambda d: _with(d, {"x": [[1, 2]], "cost": []}, "search"), "search: cost must be a list"),
    ],
)
def test_a_damaged_plan_is_refused_with_file_and_field(plan, tmp_path, change, message):
    file = tmp_path / "plan.json"
    save_plan(plan, file)
    document = json.loads(file.read_text())
    change(document)
    file.write_text(json.dumps(document))
    with pytest.raises(PlanError, match=message) as error:
        load_plan(file)
    assert str(file) in str(error.value)


@pytest.mark.parametrize("text", ["", "{", "[1]", "null", '{"schema": 2, "cost": NaN}', "[" * 9999])
def test_what_is_no_plan_is_refused(tmp_path, text):
    file = tmp_path / "plan.json"
    file.write_text(text)
    with pytest.raises(PlanError, match=str(file)):
        load_plan(file)


def test_an_unknown_target_lists_the_unknown_parameters():
    with pytest.raises(PlanError, match="cornering_stiffness, camber_stiffness"):
        PlanRequest(VEHICLE, Circle(), "mass")


def test_a_random_point_can_be_driven_and_follows_its_seed(request_):
    points = [random_feasible_point(request_, np.random.default_rng(s)) for s in (3, 3, 4)]
    assert np.array_equal(points[0], points[1])
    assert not np.array_equal(points[0], points[2])
    assert nominal_run(VEHICLE, request_.family, points[2]).commands.duration > 20


def test_a_plan_says_what_the_drive_will_teach(request_, plan):
    assert set(plan.predicted_std) == set(VEHICLE.unknown)
    for name, (low, high) in VEHICLE.unknown.items():
        assert 0.0 < plan.predicted_std[name] <= 1.0001 * (high - low) / np.sqrt(12.0)
    better = plan_at(
        dataclasses.replace(request_, noise=MeasurementNoise(yaw_rate_std=0.002)),
        np.array([3.0, 0.8]),
    )
    worse = plan_at(
        dataclasses.replace(request_, noise=MeasurementNoise(drift_std=0.02)), np.array([3.0, 0.8])
    )
    for name in ("cornering_stiffness", "camber_stiffness", "yaw_inertia"):
        stds = [p.predicted_std[name] for p in (better, plan, worse)]
        assert stds == sorted(stds)
    quiet = plan_at(
        dataclasses.replace(request_, noise=MeasurementNoise(noise_std=0.0)), np.array([3.0, 0.8])
    )
    assert quiet.predicted_std == {}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"criterion": Criterion.C, "noise": MeasurementNoise(noise_std=0.0)},
            "criterion c needs noise_std above 0",
        ),
        ({"others": (DoubleLaneChange(),)}, "criterion h judges one maneuver"),
    ],
)
def test_a_request_that_cannot_be_judged_is_refused(request_, change, message):
    with pytest.raises(PlanError, match=message):
        dataclasses.replace(request_, **change)


@pytest.mark.slow
def test_two_different_maneuvers_teach_more_than_the_best_single_one(request_, tmp_path):
    small = dataclasses.replace(request_, criterion=Criterion.C, samples=20, budget=4500)
    single = plan_maneuver(small)
    first, second = plan_set(dataclasses.replace(small, others=(DoubleLaneChange(),)))
    assert (first.number, second.number, first.drives) == (1, 2, 2)
    assert first.predicted_std == second.predicted_std
    target = small.target
    assert second.predicted_std[target] < 0.5 * single.predicted_std[target]
    save_plan(second, tmp_path / "plan.json")
    assert load_plan(tmp_path / "plan.json").predicted_std == second.predicted_std


@pytest.mark.slow
def test_the_search_beats_random_maneuvers(request_):
    small = dataclasses.replace(request_, samples=60, budget=4000)
    designed = plan_maneuver(small)
    assert designed.verdict == ""
    rng = np.random.default_rng(0)
    others = [plan_at(small, random_feasible_point(small, rng)).cost for _ in range(5)]
    assert designed.cost < min(others)
    assert designed.predicted_cost == pytest.approx(designed.cost, rel=0.05)
    assert designed.predicted_cost in designed.search.cost
