"""Samples of one quantity, and the times at which several are known."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tricycle_core.quantities import FloatArray

CLOCK_STEP = 1e-6  # s; times since 1970 are rounded to a quarter of it
MAX_GAP = 0.2  # s between poses, or samples of an input, that are interpolated between
LOST, LOST_PERIODS = 0.5, 10.0  # s, and periods, without a sample from which some were lost
GAP = 2.5  # periods between samples beyond which nothing is known between them


def measures_nothing(values: FloatArray) -> bool:
    """Return whether samples are all 0 or missing, as messages are made.

    Parameters
    ----------
    values : ndarray of float, shape (m,) or (m, c)
        Samples of a sensor, in any unit; NaN where one is missing.
    """
    return not np.nan_to_num(values).any()


def missing(time: FloatArray, begin: float, end: float) -> float:
    """Return for how long samples of a sensor are missing [s]; 0 where it has none at all.

    Parameters
    ----------
    time : ndarray of float, shape (m,)
        Times of the samples [s], increasing.
    begin, end : float
        Time in which they are looked for [s].
    """
    there = time[(time >= begin) & (time <= end)]
    if not len(there):
        return 0.0
    period = float(np.median(np.diff(there))) if len(there) > 1 else 0.0
    steps = np.diff(there, prepend=begin, append=end)
    return float(steps[steps > max(LOST, LOST_PERIODS * period)].sum())


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of one quantity.

    Attributes
    ----------
    time : ndarray of float, shape (m,)
        Times of the samples in the recording [s], strictly increasing.
    values : ndarray of float, shape (m,)
        In SI units.
    """

    time: FloatArray
    values: FloatArray

    def at(self, time: FloatArray, *, held: bool = False) -> FloatArray:
        """Return the values at other times, linearly or each held until the next.

        Parameters
        ----------
        time : ndarray of float, shape (t,)
            Times in the recording [s] for which values are wanted.
        held : bool
            A command holds until the next one.
        """
        if not held:
            return np.interp(time, self.time, self.values)
        just_after = time + CLOCK_STEP
        return self.values[np.maximum(np.searchsorted(self.time, just_after, side="right") - 1, 0)]

    def known(self, time: FloatArray) -> NDArray[np.bool_]:
        """Return whether the values at other times (t,) are known: at a sample, or within no gap.

        Parameters
        ----------
        time : ndarray of float, shape (t,)
            Times in the recording [s] that are asked about.
        """
        own = np.concatenate([[-math.inf], self.time, [math.inf]])
        after = np.searchsorted(self.time, time - CLOCK_STEP) + 1
        apart = np.diff(self.time)
        widest = GAP * float(np.median(apart)) if len(apart) else 0.0
        at_a_sample = np.abs(own[after] - time) <= CLOCK_STEP
        found: NDArray[np.bool_] = at_a_sample | (own[after] - own[after - 1] <= widest)
        return found


def common_times(columns: Sequence[Samples]) -> FloatArray:
    """Return the times (m,) at which all of some quantities are known [s].

    They are those of the one with the fewest samples, so that none counts more often than it was
    measured.

    Parameters
    ----------
    columns : sequence of Samples
        Each with a sample or more.
    """
    times = min((samples.time for samples in columns), key=len)
    for samples in columns:
        times = times[samples.known(times)]
    return times
