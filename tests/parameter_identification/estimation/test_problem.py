"""Least squares, its optimum, and what is read from it."""

import dataclasses

import numpy as np
import pytest
from simulated_drives import NAMES, TRUTH, VEHICLE, driven_pair, shares

from excitation_planner.design.prior import BoxPrior
from parameter_identification.drives.measured import Sensor
from parameter_identification.estimation.estimates import estimates_of
from parameter_identification.estimation.model import DriveModel
from parameter_identification.estimation.observability import hidden_combinations
from parameter_identification.estimation.optimum import counts_to_optimum, find_optimum
from parameter_identification.estimation.problem import LeastSquares, Loss
from parameter_identification.estimation.profiles import profile
from parameter_identification.estimation.validation import (
    fits_of_drives,
    predict_held_out,
    whiteness_of_residuals,
)
from tricycle_sim.effects import effects_of

PRIOR = BoxPrior.uniform(len(NAMES))


@pytest.fixture(scope="module")
def pair():
    return driven_pair()


@pytest.fixture(scope="module")
def problem(pair):
    models = [DriveModel(VEHICLE, drive) for drive in pair]
    with LeastSquares(models, PRIOR.mean, PRIOR.information, Loss.SQUARED) as problem:
        yield problem


@pytest.fixture(scope="module")
def counts():
    return []


@pytest.fixture(scope="module")
def optimum(problem, counts):
    return find_optimum(problem, starts=2, seed=0, level=0.95, count=lambda: counts.append(1))


def test_the_gradient_is_that_of_the_cost(problem):
    rng = np.random.default_rng(0)
    v = np.concatenate([shares(TRUTH), 0.1 * rng.standard_normal(problem.n - problem.k)])
    here = problem.quadratic(v)
    np.testing.assert_allclose(here.information, here.information.T)
    for i in (0, 3, problem.k, problem.n - 1):
        step = 1e-4 * np.eye(problem.n)[i]
        slope = (problem.quadratic(v + step).cost - problem.quadratic(v - step).cost) / 2e-4
        assert 2.0 * here.gradient[i] == pytest.approx(slope, rel=0.02, abs=0.5)


def test_what_an_earlier_identification_knew_does_not_make_drives_agree(problem, pair):
    models = [DriveModel(VEHICLE, drive) for drive in pair]
    v = np.concatenate([shares(TRUTH), np.zeros(problem.n - problem.k)])
    free = np.ones(problem.n, dtype=bool)
    with LeastSquares(models, v[: problem.k], 1e6 * PRIOR.information, Loss.SQUARED) as known:
        for one, other in zip(
            known.by_each_drive(v, free), problem.by_each_drive(v, free), strict=True
        ):
            np.testing.assert_allclose(one.gradient, other.gradient)
            np.testing.assert_allclose(one.information, other.information)


def test_variables_that_are_not_free_stay(problem):
    start = np.concatenate([np.full(problem.k, 0.4), np.zeros(problem.n - problem.k)])
    free = np.arange(problem.n) >= problem.k
    fit = problem.minimise(start, free)
    np.testing.assert_array_equal(fit.at[: problem.k], 0.4)
    assert fit.cost < problem.quadratic(start).cost


def test_the_search_is_counted_and_not_more_often_than_was_told(problem, optimum, counts):
    settled = 1 + len(problem.noise)  # once, at least
    assert 2 + settled + 1 <= len(counts) <= counts_to_optimum(problem, 2)


def test_the_optimum_is_near_the_truth_and_so_is_the_noise(problem, optimum):
    deviation = np.abs(optimum.fit.at[: problem.k] - shares(TRUTH))
    assert np.all(deviation < 4 * np.sqrt(np.diag(optimum.covariance))[: problem.k])
    assert problem.noise[Sensor.POSITION].white == pytest.approx(0.01, rel=0.1)
    assert optimum.starts == (2, 2)
    assert optimum.rivals == ()


def estimates_at(problem, optimum):
    std = np.sqrt(np.diag(optimum.covariance))[: problem.k]
    beyond = np.zeros(problem.k, dtype=bool)
    at = optimum.fit.at[: problem.k]
    return estimates_of(VEHICLE, at, std, 0.95, beyond=beyond, rivals=optimum.rivals)


def test_what_is_hidden_is_what_is_not_identifiable(problem, optimum):
    estimates = estimates_at(problem, optimum)
    assert estimates["cornering_stiffness"].identifiable
    assert not estimates["self_aligning_stiffness"].identifiable
    hidden = hidden_combinations(problem, optimum)
    assert "self_aligning_stiffness" in hidden[0].weights
    assert all(0.5 <= combination.remaining <= 1.0 for combination in hidden)


def test_what_is_pulled_beyond_its_range_is_not_identifiable_however_narrow_a_prior_was():
    z, beyond = np.full(len(NAMES), 0.5), np.arange(len(NAMES)) == 0
    found = estimates_of(VEHICLE, z, np.full(len(NAMES), 0.01), 0.95, beyond=beyond)
    assert [e.identifiable for e in found.values()] == (~beyond).tolist()
    assert (found[NAMES[0]].low, found[NAMES[0]].high) == found[NAMES[0]].range


def test_nothing_is_identifiable_where_other_parameters_fit_as_well(problem, optimum):
    ambiguous = dataclasses.replace(optimum, rivals=(np.full(problem.k, 0.5),))
    for estimate in estimates_at(problem, ambiguous).values():
        assert not estimate.identifiable
        assert estimate.low <= sum(estimate.range) / 2.0 <= estimate.high


def test_a_profile_agrees_with_the_linear_interval(problem, optimum):
    curve = profile(problem, optimum.fit, optimum.covariance, 0, 0.95)
    estimate, std = optimum.fit.at[0], np.sqrt(optimum.covariance[0, 0])
    assert np.all(np.diff(curve.z) > 0)
    assert curve.rise[curve.z == estimate].tolist() == [0.0]
    assert curve.interval == pytest.approx((estimate - 1.96 * std, estimate + 1.96 * std), rel=0.05)


def test_a_profile_ends_at_the_range(problem, optimum):
    curve = profile(problem, optimum.fit, optimum.covariance, 2, 0.95)
    assert curve.interval == (0.0, 1.0)


def test_a_drive_left_out_leaves_what_the_others_find_alone(problem, optimum):
    v, free = optimum.fit.at, np.ones(problem.n, dtype=bool)
    for drive, (found, covariance, own_cost) in enumerate(problem.by_the_others(v, free)):
        left, shared = 1 - drive, slice(problem.k)
        with LeastSquares(
            [problem.models[left]], PRIOR.mean, PRIOR.information, Loss.SQUARED
        ) as one:
            one.noise = problem.noise
            at = np.append(np.arange(problem.k), problem.variables.nuisances_of(left))
            alone = one.quadratic(v[at])
            np.testing.assert_allclose(found[at], alone.minimum(), atol=1e-3)
            np.testing.assert_allclose(
                covariance[shared, shared], alone.covariance()[shared, shared], rtol=1e-3
            )
        own = problem.variables.nuisances_of(drive)
        np.testing.assert_allclose(found[own], 0.0, atol=1e-9)  # nothing says what they are
        assert own_cost.information.shape == (problem.k + len(own),) * 2


def test_a_drive_that_tells_far_more_than_the_others_is_left_out_as_any(
    problem, optimum, monkeypatch
):
    v, free = optimum.fit.at, np.ones(problem.n, dtype=bool)
    usual, covariance, _ = next(problem.by_the_others(v, free))
    grams = problem._grams

    def magnified(*given):
        first, *others = grams(*given)
        return [1e25 * first, *others]

    monkeypatch.setattr(problem, "_grams", magnified)
    without, expected, _ = next(problem.by_the_others(v, free))
    np.testing.assert_allclose(without, usual, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(expected, covariance, rtol=1e-6, atol=1e-9)


def test_estimates_predict_better_than_nominal_values(problem, optimum, pair):
    predictions = problem.predictions(optimum.fit.at)
    for fit in fits_of_drives(problem, optimum, predictions):
        before, after = (f[Sensor.POSITION].residual for f in (fit.before, fit.after))
        assert np.mean(after**2) < 0.5 * np.mean(before**2)
        assert abs(fit.nuisances["start heading"].estimate) < 0.02
        assert fit.weights[Sensor.POSITION].max() <= 1.0
    tests = whiteness_of_residuals(problem, predictions)
    assert [(t.drive, t.channel) for t in tests] == [
        (d.name, c) for d in pair for c in ("x", "y")
    ]  # fmt: skip
    held = predict_held_out(problem, optimum, pair[0], Loss.SQUARED, 0.95, 0.0)
    assert held.rms_estimated < 0.5 * held.rms_nominal
    assert held.inside > 0.9  # it was used, so that it fits


def test_poses_that_jumped_do_not_count_for_a_robust_prediction(problem, optimum, pair):
    signal = pair[0].signals[Sensor.POSITION]
    values = signal.values.copy()
    values[::20] += 0.5
    jumped = dataclasses.replace(signal, values=values)
    drive = dataclasses.replace(pair[0], signals=pair[0].signals | {Sensor.POSITION: jumped})
    held = predict_held_out(problem, optimum, drive, Loss.ROBUST, 0.95, 0.0)
    assert held.inside > 0.85
    assert predict_held_out(problem, optimum, drive, Loss.SQUARED, 0.95, 0.0).inside < 0.5


@pytest.mark.parametrize("first", ["bag", "window"])
def test_an_effect_of_all_drives_is_what_each_of_them_allows(pair, first):
    """Angles that may have been logged late allow a dead time below 0, commands do not."""
    window = dataclasses.replace(pair[0], name="window", steering_late=0.08)
    drives = sorted(
        (pair[0], window), key=lambda drive: (drive.name == "window") ^ (first != "bag")
    )
    effects = effects_of(VEHICLE, ["servo-dead-time"])
    models = [DriveModel(VEHICLE, drive, effects) for drive in drives]
    with LeastSquares(models, PRIOR.mean, PRIOR.information, Loss.SQUARED) as both:
        assert both.low[both.k] == 0.0
