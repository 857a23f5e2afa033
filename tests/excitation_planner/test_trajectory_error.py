"""Trajectory error (Eq. 14) against closed forms and SciPy's Hermite interpolation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline

from excitation_planner.trajectory_error import (
    POINTS,
    NominalTrajectory,
    trajectory_error,
)


def straight(t: int = 101, duration: float = 10.0) -> NominalTrajectory:
    time = np.linspace(0, duration, t)
    return NominalTrajectory(time, time.copy(), np.zeros(t), np.ones(t), np.zeros(t))


def test_constant_distance_gives_its_square() -> None:
    x = np.linspace(0, 5, POINTS)
    assert trajectory_error(x + 0.3, x - 0.4, x, x) == pytest.approx(0.25, rel=1e-14)


def test_identical_trajectories_give_zero() -> None:
    nominal = straight()
    te = nominal.error(*(v[None, :] for v in (nominal.x, nominal.y, nominal.vx, nominal.vy)))
    assert te == [0.0]


def test_linearly_growing_distance_matches_the_sum_of_squares() -> None:
    # deviation d·j/(t-1): mean square d²(2t-1)/(6(t-1)) over t points
    nominal = straight()
    drift = 0.2 * nominal.time / 10
    te = nominal.error(
        nominal.x[None], (nominal.y + drift)[None], nominal.vx[None], np.full((1, 101), 0.02)
    )
    assert te[0] == pytest.approx(0.04 * (2 * POINTS - 1) / (6 * (POINTS - 1)), rel=1e-12)


def assert_as_scipy(seed: int, samples: int, t: int, points: int) -> None:
    """Compare with SciPy, which interpolates each trajectory, not the deviation."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.001, 1.0, t))
    nominal = rng.normal(size=(4, t))
    block = rng.normal(size=(4, samples, t))
    at = np.linspace(time[0], time[-1], points)
    x0, y0 = (CubicHermiteSpline(time, nominal[i], nominal[i + 2])(at) for i in (0, 1))
    expected = []
    for s in range(samples):
        x, y = (CubicHermiteSpline(time, block[i, s], block[i + 2, s])(at) for i in (0, 1))
        expected.append(trajectory_error(x, y, x0, y0))
    te = NominalTrajectory(time, *nominal, points=points).error(*block)
    np.testing.assert_allclose(te, expected, rtol=1e-9)


def test_a_block_is_interpolated_as_scipy_does() -> None:
    assert_as_scipy(seed=0, samples=3, t=7, points=50)


@pytest.mark.slow
@given(
    seed=st.integers(0, 2**32 - 1),
    samples=st.integers(1, 4),
    t=st.integers(2, 30),
    points=st.integers(2, 200),
)
def test_any_block_is_interpolated_as_scipy_does(
    seed: int, samples: int, t: int, points: int
) -> None:
    assert_as_scipy(seed, samples, t, points)


def test_nan_in_one_sample_stays_in_that_sample() -> None:
    nominal = straight()
    x = np.stack([nominal.x, nominal.x])
    x[1, 50] = np.nan
    still = np.zeros_like(x)
    te = nominal.error(x, still, still + 1, still)
    assert te[0] == 0
    assert np.isnan(te[1])


def test_shapes_are_checked() -> None:
    nominal = straight()
    with pytest.raises(ValueError, match="one shape"):
        trajectory_error(np.zeros(3), np.zeros(3), np.zeros(4), np.zeros(3))
    with pytest.raises(ValueError, match="must be \\(n, 101\\)"):
        nominal.error(*np.zeros((4, 2, 100)))
    with pytest.raises(ValueError, match="strictly increasing"):
        NominalTrajectory(np.zeros(3), *np.zeros((4, 3)))
    with pytest.raises(ValueError, match="vy must have"):
        NominalTrajectory(np.arange(3.0), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(2))
