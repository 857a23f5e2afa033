"""Intervals of estimates."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from scipy.special import ndtri

from tricycle_core.errors import IdentificationError

if TYPE_CHECKING:
    from parameter_identification.estimation.mixture import Mixture


def half_width(level: float = 0.95) -> float:
    """Return half the width of a normal interval, in standard deviations.

    Parameters
    ----------
    level : float
        Probability of the interval.

    Examples
    --------
    >>> round(half_width(), 2)
    1.96
    """
    return float(ndtri(0.5 + 0.5 * level))


def check_level(level: float) -> None:
    """Raise where no interval has this probability.

    Parameters
    ----------
    level : float
        Probability of the intervals.

    Raises
    ------
    IdentificationError
        If it is not between 0 and 1.
    """
    if not 0.0 < level < 1.0:
        raise IdentificationError(f"level = {level:g}: must be between 0 and 1, as 0.95")


def relative_half_width(estimate: float, std: float) -> float:
    """Return half the width of a 95 % interval as a share of the estimate; infinite at 0.

    Parameters
    ----------
    estimate, std : float
        Estimate of a parameter and its standard deviation, in one unit.
    """
    return half_width() * std / abs(estimate) if estimate else math.inf


def interval(
    i: int,
    z: float,
    std: float,
    level: float,
    *,
    beyond: bool,
    average: Mixture | None = None,
    widening: float = 1.0,
) -> tuple[float, float]:
    """Return the interval of a variable; all of its range, 0 to 1, if the data pull it beyond that.

    Parameters
    ----------
    i : int
        Number of the variable.
    z, std : float
        Estimate and its standard deviation.
    level : float
        Probability of the interval.
    beyond : bool
        Whether the data pull it beyond its range.
    average : Mixture, optional
        Over models with and without effects, whose interval it is then.
    widening : float
        Factor on the interval of the average; with one above 1 it is no narrower than by `std`.
    """
    if beyond:
        return 0.0, 1.0
    half = half_width(level) * std
    if average is None:
        return z - half, z + half
    low, high = average.interval(i, z, level)
    if widening == 1.0:
        return low, high
    # of a vehicle that moves as the model cannot, the average may lie beside the estimate
    return min(z + widening * (low - z), z - half), max(z + widening * (high - z), z + half)
