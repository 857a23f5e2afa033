"""Intervals by profile likelihood.

A parameter is moved away from its estimate in steps, everything else is fitted anew at each, until
the cost has risen beyond what the interval allows. Where the cost is not a parabola, e.g. at the
end of a range of another parameter, the linearised interval is wrong and this one is not.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from parameter_identification.estimation import chi_square
from parameter_identification.estimation.levenberg_marquardt import Fit
from parameter_identification.estimation.problem import LeastSquares
from tricycle_core.quantities import FloatArray

# standard deviations; the last one is at the end of the range
DISTANCES = (0.7, 1.4, 2.1, 2.8, 4.0, 6.0, 9.0, 13.0, 20.0, math.inf)
TOLERANCE = 0.1  # of the cost; the interval's level is some 4


@dataclass(frozen=True, eq=False)
class ProfileCurve:
    """Profile of one parameter, in its range.

    Attributes
    ----------
    z : ndarray of float, shape (g,)
        Parameter in its range, increasing; the estimate is one of them.
    rise : ndarray of float, shape (g,)
        Rise of the cost above its minimum at each value, the other variables fitted anew.
    interval : (float, float)
        Ends at which the rise is as high as the level allows, within 0 to 1.
    lower : Fit, optional
        The lowest point that was met, if it is below the estimate: that is no minimum of all.
    """

    z: FloatArray
    rise: FloatArray
    interval: tuple[float, float]
    lower: Fit | None = None


def profile(
    problem: LeastSquares, best: Fit, inverse: FloatArray, i: int, level: float
) -> ProfileCurve:
    """Compute the profile of one parameter.

    Parameters
    ----------
    problem : LeastSquares
        Problem of n variables.
    best : Fit
        Minimum of the problem.
    inverse : ndarray of float, shape (n, n)
        Inverse information there.
    i : int
        Number of the parameter.
    level : float
        Probability of the interval.

    References
    ----------
    D. J. Venzon, S. H. Moolgavkar, Applied Statistics 37 (1988) 87-94.
    """
    allowed = chi_square.quantile(level, 1)
    std = math.sqrt(inverse[i, i])
    free = np.arange(problem.n) != i
    sides, lowest = {}, best
    for sign, bound in ((-1, 0.0), (1, 1.0)):
        z, rise = [float(best.at[i])], [0.0]
        for distance in DISTANCES:
            at = float(np.clip(best.at[i] + sign * distance * std, 0.0, 1.0))
            if at == z[-1]:
                break
            start = best.at + inverse[:, i] / inverse[i, i] * (at - best.at[i])
            start[: problem.k] = np.clip(start[: problem.k], 0.0, 1.0)
            start[i] = at
            fit = problem.minimise(start, free, tolerance=TOLERANCE)
            lowest = min(lowest, fit, key=lambda fit: fit.cost)
            if fit.converged:  # otherwise its cost may be too high, and would end the interval
                z.append(at)
                rise.append(max(0.0, fit.cost - best.cost))
            if rise[-1] > allowed or at == bound:
                break
        sides[sign] = (z, rise, _crossing(z, rise, allowed, at))
    (z_low, rise_low, low), (z_high, rise_high, high) = sides[-1], sides[1]
    return ProfileCurve(
        np.array(z_low[:0:-1] + z_high),
        np.array(rise_low[:0:-1] + rise_high),
        (low, high),
        lowest if lowest.cost < best.cost - 2.0 * TOLERANCE else None,
    )


def _crossing(z: Sequence[float], rise: Sequence[float], allowed: float, end: float) -> float:
    """Where the rise first reaches `allowed`, or the end; its root is nearly a straight line."""
    root, wanted = np.sqrt(rise), math.sqrt(allowed)
    above = np.flatnonzero(root >= wanted)
    if not len(above):
        return end
    j = int(above[0])
    share = (wanted - root[j - 1]) / (root[j] - root[j - 1])
    return float(z[j - 1] + share * (z[j] - z[j - 1]))
