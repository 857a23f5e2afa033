"""Whitening and noise estimates against dense linear algebra and drawn noise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from parameter_identification.drives.simulated import SensorNoise
from parameter_identification.estimation.noise import (
    NoiseLevel,
    Residuals,
    SampleWeights,
    restricted_noise,
    white_level,
    whiten,
)


def dense_covariance(time, noise, samples):
    lag = np.abs(np.subtract.outer(time, time))
    drift = noise.drift**2 * np.exp(-lag / noise.drift_time)
    return drift + np.diag(noise.white**2 / samples.weights + samples.stamps)


@settings(max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    white=st.floats(0.1, 10.0),
    drift=st.floats(0.0, 10.0),
    drift_time=st.floats(0.01, 100.0),
)
def test_whitening_is_the_inverse_root_of_the_covariance(seed, white, drift, drift_time):
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.01, 1.0, 30))
    samples = SampleWeights(rng.uniform(0.1, 1.0, 30), rng.uniform(0.0, 1e-4, 30))
    columns = rng.standard_normal((30, 3))
    noise = NoiseLevel(white, drift, drift_time)
    V = dense_covariance(time, noise, samples)
    whitened, log_determinant = whiten(columns, time, noise, samples)
    np.testing.assert_allclose(
        whitened.T @ whitened, columns.T @ np.linalg.solve(V, columns), rtol=1e-7, atol=1e-9
    )
    assert log_determinant == pytest.approx(np.linalg.slogdet(V)[1], abs=1e-7)


def test_white_level_leaves_motion_and_outliers_aside():
    rng = np.random.default_rng(1)
    time = np.arange(0, 20, 0.05)
    values = 3 * np.sin(0.5 * time) + 0.01 * rng.standard_normal(len(time))
    values[::40] += 5.0
    assert white_level(time, values[:, None]) == pytest.approx(0.01, rel=0.25)


def estimated(white, drift, drift_time, rng, m=800, start=None):
    """Noise estimated from residuals of a line fit, which takes some of the drift away."""
    noise = SensorNoise(white, drift, drift_time).draw(m, rng)
    time = 0.05 * np.arange(m)
    line = np.column_stack([np.ones(m), time - time.mean()])
    columns = np.column_stack([line, noise])
    channel = Residuals(time, columns, np.arange(3), SampleWeights.alike(m))
    others = np.diag([1e-9, 1e-9, 0.0])
    start = start or NoiseLevel(white_level(time, noise[:, None]))
    return restricted_noise([channel], others, start, floor=1e-6)


@pytest.mark.slow
def test_noise_is_found_again():
    found = [estimated(0.01, 0.02, 3.0, np.random.default_rng(seed)) for seed in range(12)]
    assert np.mean([f.white for f in found]) == pytest.approx(0.01, rel=0.03)
    assert np.mean([f.drift**2 for f in found]) == pytest.approx(0.02**2, rel=0.35)
    assert np.median([f.drift_time for f in found]) == pytest.approx(3.0, rel=0.4)


def test_white_noise_has_hardly_any_drift():
    found = [estimated(0.01, 0.0, 1.0, np.random.default_rng(seed)) for seed in range(6)]
    assert np.mean([f.white for f in found]) == pytest.approx(0.01, rel=0.03)
    assert np.median([f.drift for f in found]) < 0.001


@pytest.mark.parametrize("start", [NoiseLevel(0.01, 1e-5, 1.0), NoiseLevel(0.02, 0.03, 10.0)])
def test_noise_does_not_depend_on_where_the_search_begins(start):
    anew, again = (
        estimated(0.01, 0.01, 2.0, np.random.default_rng(0), start=at) for at in (None, start)
    )
    assert again.white == pytest.approx(anew.white, rel=0.01)
    assert again.drift == pytest.approx(anew.drift, rel=0.05)
    assert again.drift_time == pytest.approx(anew.drift_time, rel=0.1)
