"""Are residuals white? The test of Ljung and Box (Biometrika 65, 1978).

Residuals that are correlated in time show that something is missing: an effect that the model
lacks, or a sensor that drifts. One drive does not show which.
"""

from dataclasses import dataclass

import numpy as np

from parameter_identification.estimation import chi_square
from tricycle_core.quantities import FloatArray

LONGEST_LAG = 1.0  # s
SAMPLES_PER_LAG = 20  # at least: with fewer, white residuals are rejected more often than they may
SIGNIFICANCE = 0.01  # of all channels together: the smallest p value is multiplied by their number


@dataclass(frozen=True)
class Whiteness:
    """Test of the residuals of one channel of one drive.

    Attributes
    ----------
    drive, channel : str
        Names of the drive and the channel.
    rms : float
        Root mean square of the residuals, in the channel's unit.
    correlation : float
        From one sample to the next.
    statistic : float
        Q of Ljung and Box.
    lags : int
        Number of lags in it.
    p : float
        Probability of a Q this large if the residuals were white; NaN where the residuals are no
        larger than the steps of the sensor's values, which are never white.
    """

    drive: str
    channel: str
    rms: float
    correlation: float
    statistic: float
    lags: int
    p: float


def ljung_box(residuals: FloatArray, lags: int) -> tuple[float, float]:
    """Return statistic and p value of Ljung and Box.

    The variance of the statistic of white residuals is 1 + 2 lags / m times that of the chi-squared
    distribution with as many degrees of freedom: p is by a scaled one of the same moments.

    Parameters
    ----------
    residuals : ndarray of float, shape (m,)
        Evenly spaced.
    lags : int
        Number of lags in the statistic.

    References
    ----------
    G. M. Ljung, G. E. P. Box, Biometrika 65 (1978) 297-303, Eq. 1.3.
    """
    m = len(residuals)
    size = 1 << (2 * m - 1).bit_length()  # zero padding: no wrap-around
    spectrum = np.fft.rfft(residuals - residuals.mean(), size)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2, size)[: lags + 1]
    rho = covariance[1:] / covariance[0]
    statistic = float(m * (m + 2) * np.sum(rho**2 / (m - np.arange(1, lags + 1))))
    spread = 1.0 + 2.0 * lags / m
    return statistic, chi_square.tail(statistic / spread, lags / spread)


def whiteness(
    drive: str, channel: str, time: FloatArray, measured: FloatArray, residuals: FloatArray
) -> Whiteness:
    """Test one channel.

    Parameters
    ----------
    drive, channel : str
        Names of the drive and the channel.
    time : ndarray of float, shape (m,)
        Times of the samples [s].
    measured, residuals : ndarray of float, shape (m,)
        Values, and their deviations from the model, in the channel's unit.
    """
    rms = float(np.sqrt(np.mean(residuals**2)))
    m = len(time)
    lags = max(1, min(round(LONGEST_LAG / float(np.median(np.diff(time)))), m // SAMPLES_PER_LAG))
    centred = residuals - residuals.mean()
    power = float(centred @ centred)
    if rms <= resolution(measured) or power == 0.0:
        return Whiteness(drive, channel, rms, float("nan"), float("nan"), lags, float("nan"))
    statistic, p = ljung_box(residuals, lags)
    correlation = float(centred[1:] @ centred[:-1]) / power
    return Whiteness(drive, channel, rms, correlation, statistic, lags, p)


def resolution(values: FloatArray) -> float:
    """Return the smallest step between values that repeat; 0 if hardly any repeat.

    Parameters
    ----------
    values : ndarray of float, shape (m,)
        Values of one channel.

    Examples
    --------
    >>> resolution(np.array([0.0, 0.5, 0.5, 2.0, 0.0, 0.5]))
    0.5
    """
    levels = np.unique(np.round(values, 12))
    if len(levels) < 2 or len(levels) > 0.8 * len(values):
        return 0.0
    return float(np.min(np.diff(levels)))


def coloured(tests: tuple[Whiteness, ...]) -> tuple[Whiteness, ...]:
    """Return the channels whose residuals are not white.

    `SIGNIFICANCE` is that of all channels together (Bonferroni).

    Parameters
    ----------
    tests : tuple of Whiteness
        Tests of all channels; those whose residuals cannot be tested do not count.
    """
    tested = [test for test in tests if np.isfinite(test.p)]
    return tuple(test for test in tested if test.p * len(tested) < SIGNIFICANCE)
