"""Poses that come out of a filter: a low-pass of the first order, as a gyro shows it.

Poses of most localisations are filtered. The delay of their clock stands for their coming late, but
not for quick motions being too small in them, which tyres and yaw inertia would explain instead. At
frequencies below that of the filter, any low-pass is one of the first order and a delay.
"""

import math

import numpy as np
from numpy.typing import NDArray

from parameter_identification.drives.samples import MAX_GAP, Samples
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK

PART, PARTS = 5.0, 4  # s in which a gyro's bias is steady, and the fewest of them
LATEST, LONGEST = 0.5, 0.6  # s, of the delay and of the time constant
LEAST, CERTAIN = 0.02, 4.0  # s, and standard deviations of its square, from which there is one
PASSING = 1e-5  # s, of a filter that changes nothing


def low_passed(rows: FloatArray, constants: FloatArray) -> FloatArray:
    """Return values behind low-passes of the first order; before the first, they change evenly.

    Parameters
    ----------
    rows : ndarray of float, shape (..., n, t)
        Values on the ticks, linear between them.
    constants : ndarray of float, shape (n,)
        Time constants [s]; 0: no filter.
    """
    from scipy.signal import lfilter  # takes as long as NumPy

    found = rows.copy()
    for i in np.flatnonzero(constants > PASSING):
        kept = math.exp(-TICK / constants[i])
        late = constants[i] / TICK
        now, before = 1.0 - late * (1.0 - kept), late * (1.0 - kept) - kept
        first, second = rows[..., i, :1], rows[..., i, 1:2]
        begun = first - late * (second - first)
        found[..., i, :1] = begun
        found[..., i, 1:], _ = lfilter(
            [now, before], [1.0, -kept], rows[..., i, 1:], zi=kept * begun + before * first
        )
    return found


def filter_of(time: FloatArray, yaw: FloatArray, yaw_rate: Samples) -> float:
    """Return the time constant of the filter that poses come out of [s]; 0 where none is certain.

    The yaw is that of the integrated yaw rate, filtered, late, and with a drift in each part of the
    recording. The parts tell how certain the constant is (the jackknife).

    Parameters
    ----------
    time : ndarray of float, shape (m,)
        Times of the poses [s].
    yaw : ndarray of float, shape (m,)
        Yaw of the poses, continuous [rad].
    yaw_rate : Samples
        Yaw rate of a gyro [rad/s].
    """
    from scipy.integrate import cumulative_trapezoid  # take as long as NumPy
    from scipy.optimize import least_squares

    parts = _parts(time, yaw_rate.time)
    if len(parts) < PARTS:
        return 0.0
    ticks = np.arange(time[0], time[-1], TICK)
    turned = cumulative_trapezoid(yaw_rate.at(ticks), dx=TICK, initial=0.0)[np.newaxis]
    rows, begins = np.concatenate(parts), np.cumsum([0, *map(len, parts[:-1])])
    at, measured = time[rows], _without_lines(time[rows], yaw[rows], begins)

    def off(point: FloatArray) -> FloatArray:
        delay, square, gain = point
        passed = low_passed(turned, np.sqrt([square]))[0]
        seen = _without_lines(at, np.interp(at - delay, ticks, passed), begins)
        left: FloatArray = measured - gain * seen
        return left

    bounds = [-LATEST, 0.0, 0.5], [LATEST, LONGEST**2, 2.0]
    begin, scale = [0.0, 0.01, 1.0], [0.1, 0.01, 0.1]
    best = least_squares(off, begin, bounds=bounds, x_scale=scale, ftol=1e-6, max_nfev=40)
    square, slopes = float(best.x[1]), best.jac
    by_part = np.add.reduceat(slopes * best.fun[:, np.newaxis], begins)
    bent = np.add.reduceat(slopes[:, :, np.newaxis] * slopes[:, np.newaxis], begins)
    try:
        without = np.linalg.solve(bent.sum(axis=0) - bent, by_part[:, :, np.newaxis])
    except np.linalg.LinAlgError:  # the vehicle does not turn
        return 0.0
    std = math.sqrt((len(parts) - 1.0) * float(np.var(without[:, 1])))
    return math.sqrt(square) if square > max(CERTAIN * std, LEAST**2) else 0.0


def _parts(time: FloatArray, rates: FloatArray) -> list[NDArray[np.int64]]:
    """Rows of the poses in each part without a gap of the poses or of the yaw rate."""
    first, last = max(time[0], rates[0]) + LATEST, min(time[-1], rates[-1]) - LATEST
    parts = []
    for begin in np.arange(first, last - PART, PART):
        rows = np.flatnonzero((time >= begin) & (time < begin + PART))
        near = rates[(rates >= begin - LATEST) & (rates < begin + PART + LATEST)]
        if all(len(t) > 2 and np.diff(t).max() <= MAX_GAP for t in (time[rows], near)):
            parts.append(rows)
    return parts


def _without_lines(time: FloatArray, values: FloatArray, begins: NDArray[np.int64]) -> FloatArray:
    """Values (m,) less, in each part, the line that fits them."""
    lengths = np.diff(begins, append=len(time))

    def centred(of: FloatArray) -> FloatArray:
        less: FloatArray = of - np.repeat(np.add.reduceat(of, begins) / lengths, lengths)
        return less

    t, v = centred(time), centred(values)
    slopes = np.add.reduceat(t * v, begins) / np.add.reduceat(t * t, begins)
    found: FloatArray = v - np.repeat(slopes, lengths) * t
    return found
