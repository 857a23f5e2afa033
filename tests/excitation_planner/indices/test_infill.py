"""Infill points against brute force."""

import numpy as np
import pytest

from excitation_planner import Infill, Kriging
from excitation_planner.indices.infill import _Posterior, infill_points
from excitation_planner.indices.kriging import amplitudes
from excitation_planner.indices.sampling import training_points


@pytest.fixture(scope="module")
def model():
    U = training_points(25, 2, seed=0)
    return Kriging(length_scale_bounds=(0.2, 0.5)).fit(U, np.sin(5 * U[:, 0]) * U[:, 1])


def grid():
    t = np.linspace(0, 1, 61)
    return np.stack(np.meshgrid(t, t), axis=-1).reshape(-1, 2)


def test_largest_variance_is_the_largest_on_a_fine_grid(model):
    (point,) = infill_points(model, by=Infill.LARGEST_VARIANCE)
    _, here = model.predict(point[None], return_std=True)
    _, everywhere = model.predict(grid(), return_std=True)
    assert here[0] >= everywhere.max() * 0.999


def test_the_variance_has_the_gradient_by_which_its_maximum_is_found():
    U = training_points(60, 2, seed=0)
    model = Kriging().fit(U, np.exp(-4 * U[:, 0]) * np.sin(8 * U[:, 1]))
    assert np.abs(model.amplitude_).max(axis=1).min() > 0.1  # both kinds of its coefficients
    posterior = _Posterior(model, U[::4])  # else hardly any variance is left
    for u in np.random.default_rng(0).uniform(size=(5, 2)):
        value, gradient = posterior.negative_variance(u)
        assert value == pytest.approx(-posterior.variance(u[None])[0])
        quotient = [
            (posterior.negative_variance(u + h)[0] - posterior.negative_variance(u - h)[0]) / 2e-6
            for h in 1e-6 * np.eye(2)
        ]
        assert gradient == pytest.approx(quotient, rel=1e-5, abs=1e-7)


def test_integrated_variance_beats_largest_variance_on_the_integral(model):
    def integral(new):
        U = np.vstack([model.X_train_, new])
        K = model.covariances(U, U) + model.nugget_ * np.eye(len(U))
        cross = model.covariances(grid(), U)
        prior = amplitudes(grid(), model.amplitude_) ** 2
        return np.mean(prior - np.sum(cross * np.linalg.solve(K, cross.T).T, axis=1))

    by_integral = integral(infill_points(model, by=Infill.INTEGRATED_VARIANCE, batch=3))
    by_largest = integral(infill_points(model, by=Infill.LARGEST_VARIANCE, batch=3))
    assert by_integral < by_largest


@pytest.mark.parametrize("by", Infill)
def test_points_of_a_batch_keep_apart_and_away_from_failures(model, by):
    first = infill_points(model, by=by)
    batch = infill_points(model, by=by, batch=4)
    assert np.array_equal(batch[0], first[0])
    gaps = np.linalg.norm(batch[:, None] - batch, axis=2)[np.triu_indices(4, 1)]
    assert gaps.min() > 0.05
    elsewhere = infill_points(model, by=by, avoid=first)
    assert np.linalg.norm(elsewhere - first) > 0.05


@pytest.mark.slow
@pytest.mark.parametrize("by", Infill)
def test_points_of_a_large_batch_differ(model, by):
    points = infill_points(model, by=by, batch=1100, polish=False)
    assert len(np.unique(points, axis=0)) == 1100
