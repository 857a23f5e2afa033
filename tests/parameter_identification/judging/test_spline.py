"""The cubic spline against SciPy's."""

import numpy as np
import pytest
from scipy import interpolate

from parameter_identification.judging.spline import CubicSpline


@pytest.mark.parametrize("n", [2, 3, 4, 5, 50, 2000])
@pytest.mark.parametrize("even", [True, False])
def test_values_and_derivatives_are_those_of_scipy(n, even):
    rng = np.random.default_rng(n)
    x = 0.01 * np.arange(n) if even else np.cumsum(rng.uniform(0.001, 0.05, n))
    y = np.sin(3.0 * x) + 0.01 * rng.standard_normal(n)
    at = np.linspace(x[0] - 0.01, x[-1] + 0.01, 777)
    ours, theirs = CubicSpline(x, y), interpolate.CubicSpline(x, y)
    for derivative in (0, 1):
        expected = theirs(at, derivative)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(ours(at, derivative), expected, rtol=0, atol=1e-11 * scale)


def test_a_cubic_polynomial_is_reproduced():
    x = np.array([0.0, 0.3, 1.0, 1.1, 2.0])
    at = np.linspace(0.0, 2.0, 21)
    spline = CubicSpline(x, x**3 - 2.0 * x)
    np.testing.assert_allclose(spline(at), at**3 - 2.0 * at, atol=1e-14)
    np.testing.assert_allclose(spline(at, 1), 3.0 * at**2 - 2.0, atol=1e-13)
