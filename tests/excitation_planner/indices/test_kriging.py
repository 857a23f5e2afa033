"""Kriging against scikit-learn's own regressor and against brute force."""

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF

from excitation_planner import Kriging
from excitation_planner.indices.kriging import _objective, amplitudes, profiled_likelihood
from excitation_planner.indices.sampling import training_points


def smooth(U):
    return np.exp(-2 * U[:, 0]) * np.sin(3 * U[:, 1]) + U[:, 2] ** 2


@pytest.fixture(scope="module")
def model():
    U = training_points(60, 3, seed=1)
    return Kriging().fit(U, 100 + 5 * smooth(U))


def scikit_learns(model):
    """scikit-learn's regressor with the same hyperparameters, on the same standardised outputs.

    Its process is stationary: outputs are divided by the amplitude, and so is their noise.
    """
    amplitude = amplitudes(model.X_train_, model.amplitude_)
    return GaussianProcessRegressor(
        RBF(model.length_scale_), alpha=model.nugget_ / amplitude**2, optimizer=None
    ).fit(model.X_train_, model.y_train_ / amplitude)


@pytest.mark.parametrize("nugget_bounds", [(1e-12, 1e-3), (1e-6, 1e-3)])
def test_prediction_is_scikit_learns_at_the_same_hyperparameters(nugget_bounds):
    U = training_points(60, 3, seed=1)
    model = Kriging(nugget_bounds=nugget_bounds).fit(U, 100 + 5 * smooth(U))
    reference = scikit_learns(model)
    U = np.random.default_rng(0).uniform(size=(50, 3))
    mean, deviation = model.predict(U, return_std=True)
    # its weights are those of a solve with the same factor, ours of a solve with mean profiled out
    amplitude = amplitudes(model.X_train_, model.amplitude_)
    reference.alpha_, reference.L_ = model.alpha_ * amplitude, model.L_ / amplitude[:, None]
    expected, expected_deviation = reference.predict(U, return_std=True)
    expected *= amplitudes(U, model.amplitude_)
    expected_deviation *= amplitudes(U, model.amplitude_)
    expected_deviation = np.sqrt(expected_deviation**2 + model.nugget_)
    assert np.allclose(mean, model.mean_ + model.deviation_ * expected, rtol=1e-12)
    assert np.allclose(deviation, model.deviation_ * expected_deviation, rtol=1e-9)
    assert np.array_equal(mean, model.predict(U))
    assert np.allclose(mean, 100 + 5 * smooth(U), atol=0.05)


def test_fit_is_scikit_learns_at_the_same_hyperparameters():
    U = training_points(40, 2, seed=1)
    model = Kriging(nugget_bounds=(1e-6, 1e-3)).fit(U, np.sin(3 * U[:, 0]) + U[:, 1])
    reference = scikit_learns(model)
    amplitude = amplitudes(U, model.amplitude_)
    assert np.allclose(model.L_, amplitude[:, None] * reference.L_, rtol=1e-9, atol=1e-12)
    weights = reference.alpha_ / amplitude
    assert np.allclose(model.alpha_, weights, rtol=1e-9, atol=1e-9 * np.ptp(model.alpha_))
    # the likelihoods differ by what profiling leaves out, which does not depend on theta
    theta = np.concatenate(
        [np.log(model.length_scale_), model.amplitude_.ravel(), np.log([model.nugget_])]
    )
    y = (model.y_train_ - model.y_train_.mean()) / model.y_train_.std()
    value, gradient = profiled_likelihood(theta, U, y)
    assert np.all(np.isfinite(gradient))
    variance = float(model.y_train_.std()) ** -2  # of the process, in units of y
    of_scikit_learn = -reference.log_marginal_likelihood_value_
    of_scikit_learn += np.log(amplitude).sum()
    n = len(U)
    assert value + 0.5 * n * (1 + np.log(2 * np.pi)) == pytest.approx(
        of_scikit_learn + 0.5 * n * np.log(variance), rel=1e-9
    )


@pytest.mark.parametrize("objective", [profiled_likelihood, _objective])
def test_gradient_of_the_likelihood_is_its_difference_quotient(objective):
    rng = np.random.default_rng(0)
    U = rng.uniform(size=(25, 2))
    y = np.sin(4 * U[:, 0]) + U[:, 1]
    for theta in rng.uniform(-1.0, 0.5, size=(5, 7)) - [0, 0, 0, 0, 0, 0, 6]:
        _, gradient = objective(theta, U, y)
        h = 1e-5
        quotient = [
            (objective(theta + h * e, U, y)[0] - objective(theta - h * e, U, y)[0]) / (2 * h)
            for e in np.eye(7)
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
        # deviation of ordinary Kriging: the mean is estimated from the other samples
        here, others = model.X_train_[left_out], model.X_train_[~left_out]
        K = model.covariances(others, others) + model.nugget_ * np.eye(59)
        k, ones = model.covariances(others, here)[:, 0], np.ones(59)
        of_mean = (1 - ones @ np.linalg.solve(K, k)) ** 2 / (ones @ np.linalg.solve(K, ones))
        own = model.covariances(here, here)[0, 0] + model.nugget_
        variance = own - k @ np.linalg.solve(K, k) + of_mean
        assert deviation[i] == pytest.approx(model.deviation_ * np.sqrt(variance), rel=1e-2)
    assert 0 < 1 - model.leave_one_out_q2() < 1e-4


def test_reproduces_an_ill_conditioned_training_set():
    U = training_points(200, 2, seed=0)
    y = 1 / (1 + U[:, 0] + U[:, 1])
    assert np.allclose(Kriging().fit(U, y).predict(U), y, atol=1e-8)


def test_amplitude_is_larger_where_the_output_varies_more():
    U = training_points(100, 2, seed=0)
    y = np.exp(-4 * U[:, 0]) * np.sin(8 * U[:, 1])
    model = Kriging().fit(U, y)
    ends = np.array([[0.0, 0.5], [1.0, 0.5]])
    left, right = amplitudes(ends, model.amplitude_)
    assert left > 5 * right


def test_fit_does_not_stay_with_a_start_that_is_unlikely():
    U = training_points(60, 3, seed=1)
    bad = Kriging(length_scale_bounds=(40.0, 50.0)).fit(U, smooth(U))
    model = Kriging().fit(U, smooth(U), start=bad)
    assert 1 - model.leave_one_out_q2() < 1e-4


def test_noise_goes_into_the_nugget():
    U = training_points(200, 1, seed=0)
    noise = np.random.default_rng(0).normal(0, 0.02, size=200)
    fitted = Kriging(nugget_bounds=(1e-12, 1.0)).fit(U, np.sin(6 * U[:, 0]) + noise)
    assert np.sqrt(fitted.nugget_) * fitted.deviation_ == pytest.approx(0.02, rel=0.2)


@pytest.mark.parametrize(
    ("y", "message"),
    [
        (np.ones(10), "the output is constant"),
        (np.r_[np.nan, np.arange(9.0)], "NaN"),
        (np.arange(9.0), r"y \(n,\)"),
    ],
)
def test_what_cannot_be_modelled_is_refused(y, message):
    with pytest.raises(ValueError, match=message):
        Kriging().fit(np.linspace(0, 1, 10)[:, None], y)
