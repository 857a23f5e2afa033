"""Cubic spline through points, twice continuously differentiable.

The numbers are those of `scipy.interpolate.CubicSpline`; importing that package takes longer than
judging a drive.
"""

import numpy as np

from tricycle_core.quantities import FloatArray


class CubicSpline:
    """Cubic spline with not-a-knot ends.

    Parameters
    ----------
    x : ndarray of float, shape (n,)
        Strictly increasing, n >= 2.
    y : ndarray of float, shape (n,)
        Values there.

    References
    ----------
    C. de Boor, A Practical Guide to Splines, Springer, 1978, chapter IV.
    """

    def __init__(self, x: FloatArray, y: FloatArray) -> None:
        step = np.diff(x)
        secant = np.diff(y) / step
        slope = _slopes(x, step, secant)
        curvature = (slope[:-1] + slope[1:] - 2 * secant) / step
        self._x = x
        self._cubic = curvature / step
        self._square = (secant - slope[:-1]) / step - curvature
        self._slope = slope[:-1]
        self._value = y[:-1]

    def __call__(self, at: FloatArray, derivative: int = 0) -> FloatArray:
        """Return values, or first derivatives; beyond the ends the outer cubics go on.

        Parameters
        ----------
        at : ndarray of float, shape (m,)
            Points at which the values are wanted.
        derivative : int
            0 or 1.
        """
        i = np.clip(np.searchsorted(self._x, at, side="right") - 1, 0, len(self._x) - 2)
        s = at - self._x[i]
        result: FloatArray
        if derivative:
            result = self._slope[i] + self._square[i] * s * 2 + self._cubic[i] * (s * s) * 3
        else:
            result = self._value[i] + self._slope[i] * s + self._square[i] * (s * s)
            result += self._cubic[i] * (s * s * s)
        return result


def _slopes(x: FloatArray, step: FloatArray, secant: FloatArray) -> FloatArray:
    """Slopes (n,) for which the second derivative is continuous, and the third near both ends."""
    if len(x) == 2:
        return np.array([secant[0], secant[0]])
    if len(x) == 3:  # the parabola through the points
        bend = (secant[1] - secant[0]) / (x[2] - x[0])
        return np.array(
            [secant[0] - bend * step[0], secant[0] + bend * step[0], secant[1] + bend * step[1]]
        )
    first, last = x[2] - x[0], x[-1] - x[-3]
    diagonal = np.concatenate([[step[1]], 2 * (step[:-1] + step[1:]), [step[-2]]])
    upper = np.concatenate([[first], step[:-1]])
    lower = np.concatenate([step[1:], [last]])
    right = np.concatenate(
        [
            [((step[0] + 2 * first) * step[1] * secant[0] + step[0] ** 2 * secant[1]) / first],
            3 * (step[1:] * secant[:-1] + step[:-1] * secant[1:]),
            [(step[-1] ** 2 * secant[-2] + (2 * last + step[-1]) * step[-2] * secant[-1]) / last],
        ]
    )
    return _solve_tridiagonal(lower.tolist(), diagonal.tolist(), upper.tolist(), right.tolist())


def _solve_tridiagonal(
    lower: list[float], diagonal: list[float], upper: list[float], right: list[float]
) -> FloatArray:
    """Gaussian elimination without pivots: the inner rows are dominated by their diagonal."""
    n = len(diagonal)
    for i in range(n - 1):
        factor = lower[i] / diagonal[i]
        diagonal[i + 1] -= factor * upper[i]
        right[i + 1] -= factor * right[i]
    right[-1] /= diagonal[-1]
    for i in range(n - 2, -1, -1):
        right[i] = (right[i] - upper[i] * right[i + 1]) / diagonal[i]
    return np.array(right)
