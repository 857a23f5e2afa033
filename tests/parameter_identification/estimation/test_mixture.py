"""The average over all subsets of effects, against Bayes' rule written out for a linear model."""

from itertools import product

import numpy as np
import pytest
from scipy.special import logit, logsumexp
from scipy.stats import multivariate_normal, norm

from parameter_identification.estimation.intervals import half_width, interval
from parameter_identification.estimation.mixture import NEGLECTED, mixture_of

NOISE = 0.3
PARAMETERS = 2
GROUPS = [[2], [3, 4], [5]]  # the second effect is one of each drive
PROBABILITIES = np.array([0.1, 0.3, 0.1])


def linear(seed, strength):
    """Design (n, d) and what was measured (n,), with the second effect acting."""
    rng = np.random.default_rng(seed)
    design = rng.normal(size=(12, 6))
    design[:, 5] = design[:, 0] + 0.01 * rng.normal(size=12)  # hides behind a parameter
    values = np.array([0.5, -0.7, 0.0, strength, -strength, 0.0])
    return design, design @ values + NOISE * rng.normal(size=12)


def weighed(design, seen):
    """Parameters have the prior N(0, 1) here, as the effects."""
    information = design.T @ design / NOISE**2 + np.eye(design.shape[1])
    return mixture_of(information, design.T @ seen / NOISE**2, GROUPS, PROBABILITIES)


@pytest.mark.parametrize(("seed", "strength"), [(0, 0.0), (1, 0.1), (2, 1.0)])
def test_weights_are_those_of_bayes_rule(seed, strength):
    design, seen = linear(seed, strength)
    found = weighed(design, seen)
    expected = []
    for acting in product((False, True), repeat=len(GROUPS)):
        kept = list(range(PARAMETERS)) + [
            i for g, a in zip(GROUPS, acting, strict=True) if a for i in g
        ]
        covariance = design[:, kept] @ design[:, kept].T + NOISE**2 * np.eye(len(seen))
        likelihood = multivariate_normal(np.zeros(len(seen)), covariance).pdf(seen)
        expected.append(likelihood * np.prod(np.where(acting, PROBABILITIES, 1.0 - PROBABILITIES)))
    expected = np.array(expected) / np.sum(expected)
    number = found.acting @ [4, 2, 1]
    np.testing.assert_allclose(found.weights, expected[number], rtol=2 * NEGLECTED)
    assert expected[number].sum() > 1.0 - NEGLECTED
    assert list(found.weights) == sorted(found.weights, reverse=True)


@pytest.mark.parametrize("seed", range(6))
def test_the_search_of_many_effects_loses_no_more_than_it_may(seed):
    rng = np.random.default_rng(seed)
    effects = 11
    design = rng.normal(size=(40, PARAMETERS + effects))
    design[:, -1] = design[:, -2] + 0.2 * rng.normal(size=40)
    size = rng.normal(size=design.shape[1]) * (rng.uniform(size=design.shape[1]) < 0.4)
    information = design.T @ design + np.eye(design.shape[1])
    rhs = design.T @ (design @ size + rng.normal(size=40))
    probabilities = rng.uniform(0.02, 0.8, size=effects)
    groups = [[PARAMETERS + g] for g in range(effects)]
    found = mixture_of(information, rhs, groups, probabilities)
    evidence, subsets = [], list(product((False, True), repeat=effects))
    for acting in subsets:
        kept = np.append(np.full(PARAMETERS, True), acting)
        own = information[np.ix_(kept, kept)]
        fits = 0.5 * rhs[kept] @ np.linalg.solve(own, rhs[kept]) - 0.5 * np.linalg.slogdet(own)[1]
        evidence.append(fits + np.dot(acting, logit(probabilities)))
    assert found.evidence == pytest.approx(logsumexp(evidence), abs=2 * NEGLECTED)
    weights = np.exp(np.array(evidence) - logsumexp(evidence))
    np.testing.assert_allclose(
        found.weights @ found.acting, weights @ np.array(subsets), atol=2 * NEGLECTED
    )


def test_an_effect_with_a_least_value_is_weighed_as_by_integration():
    design, seen = linear(2, 0.4)
    information = design.T @ design / NOISE**2 + np.eye(6)
    rhs = design.T @ seen / NOISE**2
    one = [*range(PARAMETERS), 3]  # the only effect; it cannot be negative
    found = mixture_of(information[np.ix_(one, one)], rhs[one], [[2]], [0.1], {2: 0.0})
    rng = np.random.default_rng(0)
    draws = rng.standard_normal((400_000, 3))
    draws[:, 2] = np.abs(draws[:, 2])
    evidence, means = [], []
    for acting in (0.0, 1.0):
        misfit = seen - (draws * [1.0, 1.0, acting]) @ design[:, one].T
        likelihood = np.exp(-0.5 * np.sum(misfit**2, axis=1) / NOISE**2)
        evidence.append(likelihood.mean() * (0.1 if acting else 0.9))
        means.append(likelihood @ draws / likelihood.sum())
    expected = np.array(evidence) / np.sum(evidence)
    number = found.acting[:, 0].astype(int)
    np.testing.assert_allclose(found.weights, expected[number], rtol=0.1)
    acts = found.acting[:, 0]
    np.testing.assert_allclose(found.means[acts][0], means[1], atol=0.05)


def test_a_clear_effect_is_found_and_one_that_is_not_there_is_not():
    acts = {}
    for strength in (0.0, 3.0):
        found = weighed(*linear(3, strength))
        acts[strength] = found.weights @ found.acting[:, 1]
    assert acts[0.0] < 0.1
    assert acts[3.0] > 0.999


def test_quantiles_and_moments_are_those_of_draws():
    found = weighed(*linear(1, 0.1))
    rng = np.random.default_rng(5)
    subsets = rng.choice(len(found.weights), p=found.weights, size=200_000)
    mean, std = found.means[subsets, 0], np.sqrt(found.variances[subsets, 0])
    draws = rng.normal(mean, std)
    for probability in (0.025, 0.5, 0.975):
        at = found.quantile(0, probability)
        assert np.mean(draws < at) == pytest.approx(probability, abs=0.002)
    about = np.full(6, 0.1)
    assert found.covariance(about)[0, 0] == pytest.approx(np.mean((draws - 0.1) ** 2), rel=0.02)


def test_an_interval_reaches_to_a_fit_that_bounds_keep_off():
    found = weighed(*linear(1, 0.1))
    low, middle, high = (found.quantile(0, p) for p in (0.025, 0.5, 0.975))
    np.testing.assert_allclose(found.interval(0, middle, 0.95), (low, high))
    below = low - 1.0
    np.testing.assert_allclose(found.interval(0, below, 0.95), (below - middle + low, high))
    above = high + 1.0
    np.testing.assert_allclose(found.interval(0, above, 0.95), (low, above + high - middle))


def test_where_the_model_is_doubted_an_interval_is_no_narrower_than_its_standard_deviation():
    found = weighed(*linear(1, 0.1))
    at, std = found.quantile(0, 0.03), 2.0 * found.standard_deviations[0]
    ends = interval(0, at, std, 0.95, beyond=False, average=found, widening=2.0)
    high = found.quantile(0, 0.975)
    np.testing.assert_allclose(ends, (at - half_width() * std, at + 2.0 * (high - at)))
    plain = interval(0, at, std, 0.95, beyond=False, average=found)
    assert plain == found.interval(0, at, 0.95)


def test_an_effect_that_hides_behind_a_parameter_widens_its_tails():
    found = weighed(*linear(3, 0.0))
    without = found.weights.argmax()
    narrow = norm.ppf(0.9995) * np.sqrt(found.variances[without, 0])
    assert found.quantile(0, 0.9995) - found.means[without, 0] > 2.0 * narrow
    assert 0.05 < found.weights @ found.acting[:, 2] < 0.15
