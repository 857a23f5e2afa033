"""Arrows against the dense system that they stand for."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from parameter_identification.estimation.arrow import Arrow

V, N, COMMON = 5, 4, [1, 3]
OWN = [0, 2]


def arrow(seed):
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((V, 9, N))
    prior = np.diag([2.0, 0.5])
    return Arrow(
        np.einsum("vij,vik->vjk", rows, rows), rng.standard_normal((V, N)), np.array(COMMON),
        prior, rng.standard_normal(2),
    )  # fmt: skip


def places(group):
    """Where a group's variables are in the dense system: common ones first."""
    found = np.empty(N, dtype=int)
    found[COMMON] = [0, 1]
    found[OWN] = 2 + 2 * group + np.arange(2)
    return found


def dense(of):
    size = 2 + 2 * V
    information, gradient = np.zeros((size, size)), np.zeros(size)
    information[:2, :2], gradient[:2] = of.prior_information, of.prior_gradient
    for group in range(V):
        at = places(group)
        information[np.ix_(at, at)] += of.information[group]
        gradient[at] += of.gradient[group]
    return information, gradient


def test_step_and_covariances_are_those_of_the_dense_system():
    of = arrow(0)
    information, gradient = dense(of)
    step = of.step(np.full((V, N), -np.inf), np.full((V, N), np.inf))
    expected = np.linalg.solve(information, -gradient)
    covariance = np.linalg.inv(information)
    common, alone, sensitivity = of.covariances()
    assert common == pytest.approx(covariance[:2, :2])
    for a in range(V):
        assert step[a] == pytest.approx(expected[places(a)])
        for b in range(V):
            block = sensitivity[a] @ common @ sensitivity[b].T + (alone[a] if a == b else 0.0)
            at = np.ix_(places(a)[OWN], places(b)[OWN])
            assert block == pytest.approx(covariance[at])
    lowers = -(2.0 * gradient @ expected + expected @ information @ expected)
    assert of.decrease(step) == pytest.approx(lowers)


@pytest.mark.parametrize("share", [0.03, 0.2, 0.5])
@pytest.mark.parametrize("seed", range(10))
def test_a_step_within_bounds_is_the_best_one(seed, share):
    of = arrow(seed)
    information, gradient = dense(of)
    bound = share * float(np.abs(np.linalg.solve(information, gradient)).max())
    step = of.step(np.full((V, N), -bound), np.full((V, N), bound))
    assert np.all(np.abs(step) <= bound)
    assert np.ptp(step[:, COMMON], axis=0) == pytest.approx(0.0)
    factor = np.linalg.cholesky(information)
    best = lsq_linear(factor.T, np.linalg.solve(factor, -gradient), (-bound, bound)).x
    least = -(2.0 * gradient @ best + best @ information @ best)
    assert of.decrease(step) == pytest.approx(least)


def test_what_another_bound_pushed_beyond_its_own_is_released():
    of = Arrow(
        np.array([[[1.0, -0.9], [-0.9, 1.0]]]), np.array([[0.91, -0.8]]), np.array([], int),
        np.empty((0, 0)), np.empty(0),
    )  # fmt: skip
    step = of.step(np.zeros((1, 2)), np.ones((1, 2)))  # without bounds: -1, -0.1
    assert step == pytest.approx(np.array([[0.0, 0.8]]))


def test_without_common_variables_groups_are_alone():
    of = arrow(1)
    none = Arrow(of.information, of.gradient, np.array([], int), np.empty((0, 0)), np.empty(0))
    step = none.step(np.full((V, N), -np.inf), np.full((V, N), np.inf))
    _, alone, sensitivity = none.covariances()
    assert sensitivity.shape == (V, N, 0)
    for group in range(V):
        assert step[group] == pytest.approx(
            np.linalg.solve(of.information[group], -of.gradient[group])
        )
        assert alone[group] == pytest.approx(np.linalg.inv(of.information[group]))
