"""Where the noise alone promises too much."""

import numpy as np
import pytest
from scipy.special import ndtri

from parameter_identification.estimation.interval_correction import (
    AGREEING,
    MIN_DRIVES_FOR_SCATTER,
    beyond_ranges,
    corrected,
    heterogeneity_factors,
    jackknife_factors,
    pulled_effects,
    scatter_factors,
    with_prior_variance,
)
from parameter_identification.estimation.quadratic import Quadratic


def test_deviations_of_a_mean_are_those_of_its_samples():
    rng = np.random.default_rng(0)
    samples = rng.normal(0.0, 5.0, 2000)  # taken for ones of deviation 1
    covariance = np.array([[1.0 / len(samples)]])
    slopes = (samples - samples.mean())[:, None]
    assert scatter_factors(covariance, slopes, np.zeros((1, 1)), 0.95)[0] == pytest.approx(
        5.0, rel=0.05
    )
    ratio, factors = scatter_factors(
        covariance, slopes[: MIN_DRIVES_FOR_SCATTER - 1], np.zeros((1, 1)), 0.95
    )
    assert np.isnan(ratio).all()
    assert factors.tolist() == [1.0]


@pytest.mark.parametrize("level", [0.8, 0.95])
@pytest.mark.parametrize("drives", [10, 20])
def test_intervals_by_the_scatter_of_drives_that_contradict_each_other_hold(drives, level):
    rng = np.random.default_rng(drives)
    samples = rng.normal(0.0, 10.0, (4000, drives, 1))  # taken for ones of deviation 1
    mean, covariance = samples.mean(axis=1)[:, 0], np.array([[1.0 / drives]])
    factors = [
        scatter_factors(covariance, s - s.mean(), np.zeros((1, 1)), level)[1][0] for s in samples
    ]
    reach = ndtri(0.5 + 0.5 * level) * np.array(factors) / np.sqrt(drives)
    # three deviations of so many repeats
    error = 3.0 * np.sqrt(level * (1.0 - level) / len(samples))
    assert np.mean(np.abs(mean) < reach) == pytest.approx(level, abs=error)


@pytest.mark.parametrize("drives", [2, 3, 6])
@pytest.mark.parametrize(("bias", "told", "least"), [(0.0, AGREEING, 0.93), (20.0, 0.95, 0.85)])
def test_intervals_of_a_few_drives_hold_where_all_err_as_each_does(drives, bias, told, least):
    rng = np.random.default_rng(drives)
    noise = rng.uniform(0.5, 2.0, (1000, drives, 1))
    alike = rng.normal(0.0, bias, (1000, 1, 1))
    found, weights = alike + rng.normal(0.0, np.hypot(noise, bias)), noise**-2
    factors = np.array(
        [heterogeneity_factors(*of, 0.95) for of in zip(found, noise**2, strict=True)]
    )[..., 0]
    assert np.mean(factors[:, 0] > 1.0) == pytest.approx(told, abs=0.1)
    mean = np.sum(weights * found, axis=1) / np.sum(weights, axis=1)
    reach = 1.96 * factors[:, 1] / np.sqrt(np.sum(weights[:, :, 0], axis=1))
    assert np.mean(np.abs(mean[:, 0]) < reach) > least


def test_drives_that_agree_to_the_last_digit_do_not_scatter():
    rng = np.random.default_rng(0)
    for drives in range(2, 6):  # what is left of their sum of squares is round-off, of either sign
        estimates, variances = rng.normal(size=(1, 300)), rng.uniform(0.01, 1.0, (1, 300))
        every = estimates.repeat(drives, axis=0), variances.repeat(drives, axis=0)
        assert np.all(np.array(heterogeneity_factors(*every, 0.95)) == 1.0)


@pytest.mark.parametrize(("drives", "level"), [(2, 0.8), (2, 0.95), (3, 0.95), (6, 0.95)])
def test_intervals_by_what_changes_without_each_drive_hold_where_all_err_as_each_does(
    drives, level
):
    """The interval for a further sample: by Student's distribution it holds exactly."""
    rng = np.random.default_rng(drives)
    samples = rng.normal(0.0, 7.0, (2000, 1)) + rng.normal(0.0, 7.0, (2000, drives))
    mean = samples.mean(axis=1)
    without = (drives * mean[:, None] - samples) / (drives - 1)
    std = np.full(1, 1.0 / np.sqrt(drives))  # taken for ones of deviation 1
    factors = np.array([jackknife_factors(each[:, None], std, level)[1][0] for each in without])
    reach = ndtri(0.5 + 0.5 * level) * factors * std
    # three deviations of so many repeats
    error = 3.0 * np.sqrt(level * (1.0 - level) / len(samples))
    assert np.mean(np.abs(mean) < reach) == pytest.approx(level, abs=error)


def test_only_what_is_pulled_outwards_by_more_than_its_deviation_allows_is_beyond_its_range():
    at = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 0.5])
    free = at + np.array([-1.0, -0.2, 1.0, 1.0, -1.0, 9.0])
    beyond = beyond_ranges(at, free, np.full(6, 0.1), np.zeros(6), np.ones(6))
    assert beyond.tolist() == [True, False, False, True, False, False]


@pytest.mark.parametrize(("pull", "doubted"), [(0.0, False), (2.0, False), (4.0, True)])
def test_an_effect_at_its_limit_is_in_doubt_only_if_the_data_pull_it_beyond(pull, doubted):
    """Two parameters, an effect at its upper limit, and one that does not act and is left out."""
    J = np.random.default_rng(2).standard_normal((30, 4))
    information = J.T @ J
    at = np.array([0.5, 0.5, 2.0, 0.0])
    std = np.sqrt(np.linalg.inv(information[:3, :3])[2, 2])
    beyond = np.array([0.0, 0.0, pull * std])
    gradient = np.append(-information[:3, :3] @ beyond, -1e6)
    low, high = np.full(4, -2.0), np.full(4, 2.0)
    here = Quadratic(at, 0.0, gradient, information)
    assert pulled_effects(at, here, 2, low, high).any() == doubted
    covariance, before = np.linalg.inv(information), 100.0 * np.eye(2)
    for wrong, scatter in ((True, np.nan), (False, 2.1), (False, 1.9)):
        found = corrected(
            at, here, covariance, np.ones(4), before, (low, high),
            average=None, scatter=scatter, wrong=wrong,
        )  # fmt: skip
        doubt = doubted and scatter != 1.9
        assert found.beyond.tolist() == [doubt, doubt]
        assert np.sqrt(np.diag(found.covariance)[:2]) == pytest.approx(
            [10.0, 10.0] if doubt else np.sqrt(np.diag(covariance)[:2])
        )
        assert found.widening == pytest.approx(
            np.sqrt(np.diag(found.covariance) / np.diag(covariance))[:2]
        )


def test_what_follows_a_doubted_variable_is_doubted_as_far_as_it_follows():
    """Second variable: 3 times the first, and noise of its own."""
    rng = np.random.default_rng(0)
    first, own = rng.normal(0.0, 0.1, 4000), rng.normal(0.0, 0.2, 4000)
    after = np.cov([first, 3.0 * first + own, own])
    found = with_prior_variance(after, np.diag([1.0, 50.0]), np.array([True, False]))
    wide = 10.0 * first / np.std(first, ddof=1) / 10.0  # as uncertain as before: 1
    wanted = np.cov([wide, 3.0 * wide + own, own])
    np.testing.assert_allclose(found, wanted, rtol=0.1, atol=0.02)
    np.testing.assert_array_equal(
        with_prior_variance(after, np.eye(2), np.zeros(2, dtype=bool)), after
    )
