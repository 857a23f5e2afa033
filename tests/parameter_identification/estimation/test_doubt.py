"""Where the noise alone promises too much."""

import numpy as np
import pytest

from parameter_identification.estimation.doubt import SCATTER, beyond_ranges, doubted, grown


def test_deviations_of_a_mean_are_those_of_its_samples():
    rng = np.random.default_rng(0)
    samples = rng.normal(0.0, 5.0, 2000)  # taken for ones of deviation 1
    covariance = np.array([[1.0 / len(samples)]])
    slopes = (samples - samples.mean())[:, None]
    assert grown(covariance, slopes, np.zeros((1, 1))) == pytest.approx(5.0, rel=0.05)
    assert np.isnan(grown(covariance, slopes[: SCATTER - 1], np.zeros((1, 1)))).all()


def test_only_what_is_pulled_outwards_by_more_than_its_deviation_allows_is_beyond_its_range():
    at = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 0.5])
    step = np.array([-1.0, -0.2, 1.0, 1.0, -1.0, 9.0])
    beyond = beyond_ranges(at, step, np.full(6, 0.1), np.zeros(6), np.ones(6))
    assert beyond.tolist() == [True, False, False, True, False, False]


def test_what_is_doubted_is_as_uncertain_as_before_and_as_correlated_as_after():
    after = np.array([[0.04, 0.01], [0.01, 0.09]])
    found = doubted(after, np.array([1.0, 1.0]), np.array([True, False]))
    np.testing.assert_allclose(found, [[1.0, 0.05], [0.05, 0.09]])
