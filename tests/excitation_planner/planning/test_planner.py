"""Planning: indices against a second method, predictions, and searches against chance."""

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.stats import qmc

from excitation_planner import Criterion, MeasurementNoise
from excitation_planner.maneuver import Circle, DoubleLaneChange
from excitation_planner.plan import load_plan, save_plan
from excitation_planner.planning import (
    PlanRequest,
    plan_at,
    plan_maneuver,
    plan_set,
    planner,
    prediction,
    random_feasible_point,
    replay,
)
from excitation_planner.planning.replay import nominal_run, replayed_errors
from tricycle_sim.vehicle import load_vehicle

VEHICLE = load_vehicle()


@pytest.fixture(scope="module")
def request_():
    return PlanRequest(VEHICLE, Circle(), "cornering_stiffness")


@pytest.fixture(scope="module")
def plan(request_):
    return plan_at(request_, np.array([3.0, 0.8]))


@pytest.mark.slow
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


def test_a_given_maneuver_has_the_cost_by_its_criterion(request_):
    asked = dataclasses.replace(request_, criterion=Criterion.C)
    plan = plan_at(asked, np.array([3.0, 0.8]))
    low, high = VEHICLE.unknown[plan.target]
    assert plan.criterion_cost == pytest.approx(
        (plan.predicted_std[plan.target] / (high - low)) ** 2
    )


@pytest.fixture
def simulated(monkeypatch):
    """Numbers of vehicles that the planner has simulated, a list that grows."""
    counts = []

    def counting(module, name, parameters):
        simulate = getattr(module, name)

        def counted(*args, **options):
            counts.append(len(args[parameters]))
            return simulate(*args, **options)

        monkeypatch.setattr(module, name, counted)

    counting(planner, "replayed_errors", 2)
    counting(replay, "replayed_errors", 2)
    counting(prediction, "replayed", 3)
    return counts


@pytest.mark.parametrize("noise", [MeasurementNoise(), MeasurementNoise(noise_std=0.0)])
def test_a_given_maneuvers_plan_counts_what_was_simulated(request_, simulated, noise):
    plan = plan_at(dataclasses.replace(request_, noise=noise), np.array([3.0, 0.8]))
    assert plan.simulations == sum(simulated) > 0


@pytest.mark.slow
@pytest.mark.parametrize("criterion", [Criterion.C, Criterion.H])
def test_a_plan_counts_what_was_simulated_after_the_search_too(request_, simulated, criterion):
    told = []
    plan = plan_maneuver(
        dataclasses.replace(
            request_,
            criterion=criterion,
            samples=20,
            budget=2500,
            effects=("steering-zero",) if criterion is Criterion.C else (),
        ),
        progress=lambda done, budget: told.append(done),
    )
    assert plan.simulations == sum(simulated) > told[-1]


def test_a_random_point_can_be_driven_and_follows_its_seed(request_):
    points = [random_feasible_point(request_, np.random.default_rng(s)) for s in (3, 3, 4)]
    assert np.array_equal(points[0], points[1])
    assert not np.array_equal(points[0], points[2])
    assert nominal_run(VEHICLE, request_.family, points[2]).commands.duration > 20


@pytest.mark.slow
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
@pytest.mark.parametrize("criterion", [Criterion.C, Criterion.H])
def test_a_plan_is_the_same_on_any_number_of_workers(request_, criterion):
    small = dataclasses.replace(request_, criterion=criterion, samples=20, budget=2500)
    with ThreadPoolExecutor(1) as one:
        alone = plan_maneuver(small, executor=one)
    beside = plan_maneuver(small)
    assert beside.id == alone.id
    assert beside.criterion_cost == alone.criterion_cost
    assert beside.predicted_std == alone.predicted_std
    assert np.array_equal(beside.search.cost, alone.search.cost)


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
