"""The test of Ljung and Box against its definition and against drawn noise."""

import numpy as np
import pytest

from parameter_identification.drives.simulated import SensorNoise
from parameter_identification.estimation.whiteness import (
    coloured,
    ljung_box,
    resolution,
    whiteness,
)


def test_statistic_is_that_of_ljung_and_box():
    r = np.random.default_rng(0).standard_normal(200)
    centred = r - r.mean()
    rho = [centred[k:] @ centred[: 200 - k] / (centred @ centred) for k in range(1, 11)]
    expected = 200 * 202 * sum(v**2 / (200 - k) for k, v in enumerate(rho, start=1))
    assert ljung_box(r, 10)[0] == pytest.approx(expected)


def test_p_values_of_white_noise_are_uniform():
    rng = np.random.default_rng(1)
    p = [ljung_box(rng.standard_normal(400), 20)[1] for _ in range(500)]
    assert np.mean(np.array(p) < 0.1) == pytest.approx(0.1, abs=0.045)


@pytest.mark.parametrize("samples", [100, 750])
def test_white_residuals_are_rejected_no_more_often_than_the_level_says(samples):
    rng = np.random.default_rng(3)
    time = 0.01 * np.arange(samples)
    p = []
    for _ in range(3000):
        noise = rng.standard_normal(samples)
        p.append(whiteness("a", "x", time, time + noise, noise).p)
    assert np.mean(np.array(p) < 0.01) == pytest.approx(0.01, abs=0.006)


def test_a_drift_as_large_as_the_noise_is_seen():
    rng = np.random.default_rng(2)
    time = 0.05 * np.arange(400)
    for _ in range(20):
        noise = SensorNoise(0.01, 0.01, 2.0).draw(400, rng)
        assert coloured((whiteness("a", "x", time, time + noise, noise),))


def test_rounded_values_are_not_tested():
    time = 0.01 * np.arange(2000)
    exact = np.sin(time)
    rounded = np.round(exact, 3)
    assert resolution(rounded) == pytest.approx(0.001)
    assert resolution(exact) == 0.0
    test = whiteness("a", "wheel speed", time, rounded, rounded - exact)
    assert np.isnan(test.p)
    assert not coloured((test,))
