"""Smoothing splines: as smooth as the noise asks for, and off by what they say."""

import numpy as np
import pytest
from scipy.integrate import quad

from parameter_identification.drives.smoothing import SLOPE, TIMES, VALUE, smooth

TIME = np.arange(0.0, 40.0, 0.02)


@pytest.mark.parametrize("noise", [1e-4, 1e-3, 1e-2])
def test_speed_and_position_are_off_by_what_is_said(noise: float) -> None:
    rng = np.random.default_rng(0)
    position = np.column_stack([np.sin(0.9 * TIME), 0.3 * np.cos(0.4 * TIME)])
    speed = np.column_stack([0.9 * np.cos(0.9 * TIME), -0.12 * np.sin(0.4 * TIME)])
    found = smooth(TIME, position + noise * rng.standard_normal(position.shape))
    inside = slice(100, -100)
    value = np.std((found.spline(TIME) - position)[inside])
    slope = np.std((found.spline.derivative()(TIME) - speed)[inside])
    assert found.white == pytest.approx(noise, rel=0.15)
    assert 0.4 < value / found.value_std < 1.2
    assert 0.4 < slope / found.slope_std < 1.2


def test_noise_that_is_left_is_the_integral_of_the_gain() -> None:
    def gain(x: float) -> float:
        return 1.0 - (x**4 / (1.0 + x**4)) ** TIMES

    assert quad(lambda x: gain(x) ** 2, 0.0, np.inf, limit=500)[0] == pytest.approx(VALUE, rel=1e-4)
    squared = quad(lambda x: (x * gain(x)) ** 2, 0.0, np.inf, limit=500)[0]
    assert squared == pytest.approx(SLOPE, rel=1e-4)


@pytest.mark.slow
def test_more_noise_is_smoothed_more() -> None:
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((len(TIME), 1))
    cutoffs = [
        smooth(TIME, np.sin(TIME)[:, np.newaxis] + size * noise).cutoff for size in (0.0, 1e-3, 0.1)
    ]
    assert cutoffs[0] > cutoffs[1] > cutoffs[2]
