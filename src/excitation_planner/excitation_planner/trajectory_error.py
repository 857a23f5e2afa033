"""Trajectory error TE (Eq. 14): mean squared distance of two trajectories at equal times.

``TE = (1/t) Σ_j (x_j - x⁰_j)² + (y_j - y⁰_j)²`` in m², over t = 10 000 points that divide the
duration evenly, both ends included. This module is the only place of Eq. 14.

Simulated trajectories are known every 10 ms, with their velocities: cubic Hermite interpolation
brings them to the 10 000 points. It is linear in the data, so the *deviation* from the nominal
trajectory is interpolated instead of either trajectory. The sum over the points of an interval is
a quadratic form of what is known at its ends, the same for all samples.

Letters: ``n`` samples, ``t`` grid times, ``j`` points of Eq. 14.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from tricycle_core.quantities import FloatArray

POINTS = 10_000
"""t in Eq. 14."""


def trajectory_error(x: FloatArray, y: FloatArray, x0: FloatArray, y0: FloatArray) -> float:
    """Return the trajectory error of matched points, Eq. 14.

    Parameters
    ----------
    x, y : ndarray of float, shape (j,)
        Positions of the trajectory [m].
    x0, y0 : ndarray of float, shape (j,)
        Positions of the nominal trajectory at the same times and in the same frame [m].

    Returns
    -------
    error : float
        Mean squared distance [m²]. A straight line at a constant distance of 0.1 m gives 0.01 m².

    Raises
    ------
    ValueError
        If the shapes differ, or the trajectories are empty.
    """
    shapes = {np.shape(values) for values in (x, y, x0, y0)}
    if len(shapes) != 1 or shapes & {(), (0,)}:
        raise ValueError(f"x, y, x0, y0 must be of one shape (j,), j >= 1; got {sorted(shapes)}")
    return float(np.mean((x - x0) ** 2 + (y - y0) ** 2))


@dataclass(frozen=True)
class NominalTrajectory:
    """Nominal trajectory on a time grid, against which blocks of samples are compared.

    Attributes
    ----------
    time : ndarray of float, shape (t,)
        Times, strictly increasing [s].
    x, y : ndarray of float, shape (t,)
        Position [m].
    vx, vy : ndarray of float, shape (t,)
        Velocity in the same frame [m/s].
    points : int
        Number of points in Eq. 14.
    """

    time: FloatArray
    x: FloatArray
    y: FloatArray
    vx: FloatArray
    vy: FloatArray
    points: int = POINTS
    _forms: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        shape = np.shape(self.time)
        if len(shape) != 1 or shape[0] < 2 or not np.all(np.diff(self.time) > 0):
            raise ValueError("time must be (t,), t >= 2, strictly increasing")
        for name in ("x", "y", "vx", "vy"):
            if np.shape(getattr(self, name)) != shape:
                raise ValueError(f"{name} must have the shape of time, {shape}")
        object.__setattr__(self, "_forms", _forms_of(self.time, self.points))

    def error(self, x: FloatArray, y: FloatArray, vx: FloatArray, vy: FloatArray) -> FloatArray:
        """Return the trajectory error (Eq. 14) of each sample of a block.

        Parameters
        ----------
        x, y, vx, vy : ndarray of float, shape (n, t)
            Samples on the grid of the nominal trajectory [m, m/s].

        Returns
        -------
        errors : ndarray of float, shape (n,)
            TE [m²]; NaN where the sample holds NaN.
        """
        if {np.shape(values) for values in (x, y, vx, vy)} != {(len(x), len(self.time))}:
            raise ValueError(f"x, y, vx, vy must be (n, {len(self.time)}); got {np.shape(x)}")
        result: FloatArray = np.zeros(len(x))
        for values, rates, nominal, nominal_rate in (
            (x, vx, self.x, self.vx),
            (y, vy, self.y, self.vy),
        ):
            _compiled()(values, rates, nominal, nominal_rate, self._forms, result)
        return result


def _forms_of(time: FloatArray, points: int) -> FloatArray:
    """Return the quadratic forms (10, t - 1) of the intervals; their sum is the mean square.

    Each is of the deviation at the interval's ends (a, b) and of its rate there (c, d): the
    coefficients of aa, ab, ac, ad, bb, bc, bd, cc, cd and dd.
    """
    at = np.linspace(time[0], time[-1], points)
    interval = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    step = time[interval + 1] - time[interval]
    s = (at - time[interval]) / step
    weights = (
        (1 + 2 * s) * (1 - s) ** 2,
        s**2 * (3 - 2 * s),
        step * s * (1 - s) ** 2,
        step * s**2 * (s - 1),
    )
    forms = [
        np.bincount(interval, (1 if i == j else 2) * weights[i] * weights[j], len(time) - 1)
        for i in range(4)
        for j in range(i, 4)
    ]
    return np.stack(forms) / points


@cache
def _compiled() -> Callable[..., None]:
    """Return `_add_mean_square` as machine code."""
    from tricycle_sim.compilation import compiled  # takes a while, and judging a drive does without

    add: Callable[..., None] = compiled(_add_mean_square)
    return add


def _add_mean_square(  # type: ignore[no-untyped-def]  # pragma: no cover
    values, rates, nominal, nominal_rate, forms, result
):
    """Add the mean square of one axis' interpolated deviation to result (n,)."""
    aa, ab, ac, ad = forms[0], forms[1], forms[2], forms[3]
    bb, bc, bd, cc, cd, dd = forms[4], forms[5], forms[6], forms[7], forms[8], forms[9]
    for sample in range(values.shape[0]):
        value, rate = values[sample], rates[sample]
        total = 0.0
        for i in range(forms.shape[1]):
            a, b = value[i] - nominal[i], value[i + 1] - nominal[i + 1]
            c, d = rate[i] - nominal_rate[i], rate[i + 1] - nominal_rate[i + 1]
            total += (
                a * (aa[i] * a + ab[i] * b + ac[i] * c + ad[i] * d)
                + b * (bb[i] * b + bc[i] * c + bd[i] * d)
                + c * (cc[i] * c + cd[i] * d)
                + dd[i] * d * d
            )
        result[sample] += total
