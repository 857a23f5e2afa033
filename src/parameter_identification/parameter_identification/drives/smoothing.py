"""Splines that are as smooth as the noise of samples asks for, and what they are off by."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from tricycle_core.quantities import FloatArray

LEAST, MOST = 10, 1000  # samples that a smoothness can be found from, and that it is found from
CUTOFFS = np.geomspace(0.2, 5.5, 12)  # Hz, of the splines that are tried
TIMES = 3  # that a spline is fitted: to the samples, then to what is left of them
# With x the frequency over the cutoff, the spline passes 1 - (x⁴ / (1 + x⁴))^TIMES of an
# oscillation. Integrals of the square of this over x, and of x² and x⁴ times it:
VALUE, SLOPE, BEND = 1.2361, 0.7830, 1.3167


@dataclass(frozen=True, eq=False)
class Smooth:
    """A smoothing spline of samples.

    Attributes
    ----------
    spline : BSpline
        Smoothing spline of the values over time [s].
    white : float
        Standard deviation of the noise of a sample, in the unit of the values.
    spacing : float
        Between samples [s].
    cutoff : float
        Frequency [Hz] of an oscillation of which each of the `TIMES` fits passes half.
    """

    spline: Any
    white: float
    spacing: float
    cutoff: float

    @property
    def value_std(self) -> float:
        """Standard deviation of a value: noise that is left, and as much taken off the motion."""
        rate = 2.0 * math.pi * self.cutoff
        return self.white * math.sqrt(2.0 * self.spacing * rate * VALUE / math.pi)

    @property
    def slope_std(self) -> float:
        """Standard deviation of a derivative by time, likewise."""
        rate = 2.0 * math.pi * self.cutoff
        return self.white * math.sqrt(2.0 * self.spacing * rate**3 * SLOPE / math.pi)

    @property
    def bend_std(self) -> float:
        """Standard deviation of a second derivative by time, likewise."""
        rate = 2.0 * math.pi * self.cutoff
        return self.white * math.sqrt(2.0 * self.spacing * rate**5 * BEND / math.pi)


def smooth(time: FloatArray, values: FloatArray) -> Smooth:
    """Return the smoothing spline that predicts samples best.

    It is fitted to every other sample and predicts those between (two-fold cross-validation), where
    half of all changes have been. Errors of sensors are not quite white: there is a least
    smoothness. A cubic spline that keeps the motion lets much noise through above it, as its gain
    falls slowly; fitted again to what it leaves, it falls more steeply (twicing).

    Parameters
    ----------
    time : ndarray of float, shape (m,)
        Increasing, m of at least `LEAST` [s].
    values : ndarray of float, shape (m, c)
        Values of c channels, all in one unit.

    References
    ----------
    J. W. Tukey, Exploratory Data Analysis, 1977, chapter 16.
    """
    changes = np.cumsum(np.linalg.norm(np.diff(values, axis=0), axis=1))
    middle = int(np.searchsorted(changes, 0.5 * changes[-1]))
    begin = max(0, min(middle - MOST // 2, len(time) - MOST))
    t, v = time[begin : begin + MOST], values[begin : begin + MOST]
    spacing = float(np.median(np.diff(time)))

    def penalty(cutoff: float) -> float:
        """Penalty of the second derivative; for every other sample it is half of that."""
        return float(1.0 / (spacing * (2.0 * math.pi * cutoff) ** 4))

    def error(cutoff: float) -> float:
        """Mean error of samples that were left out."""
        total = 0.0
        for first in (0, 1):
            fitted, between = slice(first, None, 2), slice(first + 1, -1, 2)
            spline = _spline(t[fitted], v[fitted], 0.5 * penalty(cutoff))
            total += float(np.abs(spline(t[between]) - v[between]).sum())
        return total / v.size

    cutoff = min(CUTOFFS.tolist(), key=error)
    spline = _spline(time, values, penalty(cutoff))
    return Smooth(spline, error(cutoff) * math.sqrt(0.5 * math.pi), spacing, cutoff)


def _spline(time: FloatArray, values: FloatArray, penalty: float) -> Any:
    """Cubic smoothing spline, fitted again to what it leaves until it is fitted `TIMES`."""
    from scipy.interpolate import make_smoothing_spline  # takes as long as NumPy

    spline = make_smoothing_spline(time, values, lam=penalty)
    for _ in range(TIMES - 1):
        spline.c += make_smoothing_spline(time, values - spline(time), lam=penalty).c
    return spline
