"""A quadratic cost against closed forms and SciPy."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from parameter_identification.estimation.quadratic import Quadratic

RNG = np.random.default_rng(0)
J, r = RNG.standard_normal((20, 4)), RNG.standard_normal(20)
AT = RNG.standard_normal(4)


@pytest.fixture
def quadratic():
    columns = np.column_stack([J, r])
    return Quadratic.of_gram(AT, columns.T @ columns)


def cost(step):
    return np.sum((r + J @ step) ** 2)


def test_the_least_cost_is_that_of_linear_least_squares(quadratic):
    step = quadratic.step(np.full(4, -9.0), np.full(4, 9.0))
    np.testing.assert_allclose(step, np.linalg.lstsq(J, -r, rcond=None)[0])
    np.testing.assert_allclose(quadratic.minimum(), AT + step)
    assert quadratic.decrease(step) == pytest.approx(quadratic.cost - cost(step))
    np.testing.assert_allclose(quadratic.covariance(), np.linalg.inv(J.T @ J))


def test_within_bounds_it_is_that_of_scipy_and_variables_that_are_not_free_stay(quadratic):
    low, high = AT - 0.05, AT + 0.05
    bounded = quadratic.step(low, high)
    np.testing.assert_allclose(bounded, lsq_linear(J, -r, (low - AT, high - AT)).x, atol=1e-9)
    free = np.array([True, False, True, False])
    step = quadratic.step(low, high, free=free)
    found = lsq_linear(J[:, free], -r, (low[free] - AT[free], high[free] - AT[free])).x
    np.testing.assert_allclose(step[free], found, atol=1e-9)
    assert not step[~free].any()


def test_the_pull_is_minus_the_gradient_at_zero(quadratic):
    np.testing.assert_allclose(quadratic.rhs, J.T @ (J @ AT - r))


def test_the_curvature_that_it_lacks_is_that_of_a_kink_on_the_way(quadratic):
    """Along the third variable the cost rises more steeply from half of the step on."""
    step = np.array([1e-3, 0.1, 0.8, -0.2])
    there = quadratic.gradient + quadratic.information @ step + [0.0, 0.0, 60.0 * 0.4, 0.0]
    other = Quadratic(AT + step, 0.0, there, quadratic.information)
    np.testing.assert_allclose(quadratic.lacking(step, other), [1.0, 1.0, 30.0, 1.0])


def test_damping_shortens_the_step(quadratic):
    far = np.full(4, 9.0)
    plain, damped = (quadratic.step(-far, far, damping=d) for d in (0.0, 100.0))
    assert np.linalg.norm(damped) < 0.5 * np.linalg.norm(plain)
    assert 0.0 < quadratic.decrease(damped) < quadratic.decrease(plain)


def test_a_prior_and_variables_that_are_held_change_the_cost_as_its_residuals_would():
    rng = np.random.default_rng(1)
    J, r, at, mean = rng.normal(size=(7, 3)), rng.normal(size=7), rng.normal(size=3), np.ones(2)
    root = rng.normal(size=(2, 2))
    columns = np.column_stack([J, r])
    more = np.column_stack([root, np.zeros(2), root @ (at[:2] - mean)])
    both = np.vstack([columns, more])
    found = Quadratic.of_gram(at, columns.T @ columns).with_prior(mean, root.T @ root)
    expected = Quadratic.of_gram(at, both.T @ both)
    for name in ("cost", "gradient", "information"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name))
    some = both[:, [0, 2, 3]]
    held = Quadratic.of_gram(at[[0, 2]], some.T @ some)
    np.testing.assert_allclose(found.of(np.array([0, 2])).minimum(), held.minimum())
