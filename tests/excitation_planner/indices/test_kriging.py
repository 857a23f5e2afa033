"""Kriging against scikit-learn's own regressor and against brute force."""

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.model_selection import cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import MinMaxScaler

from excitation_planner import Kriging
from excitation_planner.indices.kriging import _profiled_likelihood
from excitation_planner.indices.sampling import training_points


def smooth(U):
    return np.exp(-2 * U[:, 0]) * np.sin(3 * U[:, 1]) + U[:, 2] ** 2


@pytest.fixture(scope="module")
def model():
    U = training_points(60, 3, seed=1)
    return Kriging().fit(U, 100 + 5 * smooth(U))


def test_prediction_is_scikit_learns_at_the_same_hyperparameters(model):
    reference = GaussianProcessRegressor(model.kernel_, alpha=0.0, optimizer=None).fit(
        model.X_train_, model.y_train_
    )
    U = np.random.default_rng(0).uniform(size=(50, 3))
    mean, deviation = model.predict(U, return_std=True)
    expected, expected_deviation = reference.predict(U, return_std=True)
    assert np.allclose(mean, model.mean_ + model.deviation_ * expected, rtol=1e-5)
    assert np.allclose(deviation, model.deviation_ * expected_deviation, rtol=1e-2, atol=1e-4)
    assert np.allclose(mean, 100 + 5 * smooth(U), atol=0.05)


def test_gradient_of_the_likelihood_is_its_difference_quotient():
    rng = np.random.default_rng(0)
    U = rng.uniform(size=(25, 2))
    y = np.sin(4 * U[:, 0]) + U[:, 1]
    for theta in rng.uniform(-1.0, 0.5, size=(5, 3)) - [0, 0, 6]:
        _, gradient = _profiled_likelihood(theta, U, y)
        h = 1e-5
        quotient = [
            (
                _profiled_likelihood(theta + h * e, U, y)[0]
                - _profiled_likelihood(theta - h * e, U, y)[0]
            )
            / (2 * h)
            for e in np.eye(3)
        ]
        assert np.allclose(gradient, quotient, rtol=1e-4, atol=0.05)


def test_leave_one_out_is_what_leaving_one_out_gives(model):
    residual, deviation = model.leave_one_out()
    y = model.mean_ + model.deviation_ * model.y_train_
    for i in (0, 7, 59):
        left_out = np.arange(60) == i
        reduced = model.without(left_out)
        mean = reduced.predict(model.X_train_[left_out])[0]
        assert y[i] - mean == pytest.approx(residual[i], rel=1e-3, abs=1e-7)
    assert 0 < 1 - model.leave_one_out_q2() < 1e-4
    assert np.all(deviation > 0)


def test_reproduces_an_ill_conditioned_training_set():
    U = training_points(200, 2, seed=0)
    y = 1 / (1 + U[:, 0] + U[:, 1])
    assert np.allclose(Kriging().fit(U, y).predict(U), y, atol=1e-8)


def test_noise_goes_into_the_nugget():
    U = training_points(200, 1, seed=0)
    noise = np.random.default_rng(0).normal(0, 0.02, size=200)
    fitted = Kriging(nugget_bounds=(1e-12, 1.0)).fit(U, np.sin(6 * U[:, 0]) + noise)
    assert np.sqrt(fitted.nugget_) * fitted.deviation_ == pytest.approx(0.02, rel=0.2)


def test_is_a_scikit_learn_estimator():
    U = np.random.default_rng(0).uniform(10, 20, size=(80, 3))
    y = smooth((U - 10) / 10)
    estimator = Kriging(length_scale_bounds=(0.1, 10.0))
    assert estimator.get_params() == {
        "length_scale_bounds": (0.1, 10.0),
        "nugget_bounds": (1e-12, 1e-3),
    }
    assert clone(estimator).get_params() == estimator.get_params()
    scores = cross_val_score(make_pipeline(MinMaxScaler(), estimator), U, y, cv=4)
    assert scores.min() > 0.99
    assert estimator.fit((U - 10) / 10, y).score((U - 10) / 10, y) > 0.999999
    assert estimator.sample_y(U[:2] / 20, n_samples=3).shape == (2, 3)


@pytest.mark.parametrize(
    ("y", "message"),
    [
        (np.ones(10), "the output is constant"),
        (np.r_[np.nan, np.arange(9.0)], "NaN"),
    ],
)
def test_what_cannot_be_modelled_is_refused(y, message):
    with pytest.raises(ValueError, match=message):
        Kriging().fit(np.linspace(0, 1, 10)[:, None], y)
