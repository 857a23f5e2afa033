"""Noise of a sensor: a white part and an exponentially correlated one, estimated from residuals.

The covariance of samples at times t is σ² I + δ² exp(-|Δt| / T). Its inverse square root is applied
by a Kalman filter with the drift as its state (one pass over the samples, any spacing), so that
generalised least squares costs no more than ordinary. The three numbers maximise the restricted
likelihood, which accounts for the part of the noise that the fitted parameters have absorbed.

Letters of shapes: `m` samples, `c` columns.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from tricycle_core.quantities import FloatArray
from tricycle_sim.compilation import compiled

IMPOSSIBLE = 1e25  # cost of levels that cannot be judged


@dataclass(frozen=True)
class NoiseLevel:
    """Noise of a sensor.

    Attributes
    ----------
    white : float
        σ, standard deviation of the white part, in the sensor's unit.
    drift : float
        δ, standard deviation of the correlated part, in the sensor's unit; 0: none.
    drift_time : float
        T, its correlation time [s].
    """

    white: float
    drift: float = 0.0
    drift_time: float = 1.0


@compiled
def _whiten(
    columns: FloatArray,
    time: FloatArray,
    weights: FloatArray,
    stamps: FloatArray,
    white: float,
    drift: float,
    drift_time: float,
    out: FloatArray,
) -> float:
    """Write whitened columns (m, c) to `out`; return the log-determinant of the covariance."""
    m, c = columns.shape
    state = np.zeros(c)
    variance = drift * drift
    log_determinant = 0.0
    for k in range(m):
        if k > 0 and drift > 0.0:
            a = math.exp(-(time[k] - time[k - 1]) / drift_time)
            variance = a * a * variance + (1.0 - a * a) * drift * drift
            for j in range(c):
                state[j] *= a
        total = variance + white * white / weights[k] + stamps[k]
        gain = variance / total
        scale = 1.0 / math.sqrt(total)
        log_determinant += math.log(total)
        for j in range(c):
            innovation = columns[k, j] - state[j]
            out[k, j] = innovation * scale
            state[j] += gain * innovation
        variance *= 1.0 - gain
    return log_determinant


def whiten(
    columns: FloatArray, time: FloatArray, noise: NoiseLevel, samples: "SampleWeights | None" = None
) -> tuple[FloatArray, float]:
    """Make the noise of columns white and of unit variance.

    Parameters
    ----------
    columns : ndarray of float, shape (m, c)
        Each with noise of that covariance, or a derivative of such a column.
    time : ndarray of float, shape (m,)
        Increasing [s].
    noise : NoiseLevel
        Noise of the sensor.
    samples : SampleWeights, optional
        Weights, where samples are not all alike.

    Returns
    -------
    columns : ndarray of float, shape (m, c)
        Whitened.
    log_determinant : float
        Logarithm of the determinant of the noise's covariance.
    """
    out = np.empty(columns.shape)
    samples = samples or SampleWeights.alike(len(time))
    log_determinant = _whiten(
        np.ascontiguousarray(columns),
        time,
        samples.weights,
        samples.stamps,
        noise.white,
        noise.drift,
        noise.drift_time,
        out,
    )
    return out, float(log_determinant)


@dataclass(frozen=True, eq=False)
class SampleWeights:
    """Weights of the samples of a signal.

    Attributes
    ----------
    weights : ndarray of float, shape (m,)
        The white variance is divided by them.
    stamps : ndarray of float, shape (m,)
        Variance that the errors of their stamps add, in the sensor's unit squared.
    """

    weights: FloatArray
    stamps: FloatArray

    @classmethod
    def alike(cls, m: int) -> "SampleWeights":
        """Return `m` samples of weight 1 with exact stamps."""
        return cls(np.ones(m), np.zeros(m))


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of one channel with their derivatives, as the noise estimate needs them.

    Attributes
    ----------
    time : ndarray of float, shape (m,)
        Times of the samples [s].
    columns : ndarray of float, shape (m, c + 1)
        Jacobian by the variables `at`, then the residual.
    at : ndarray of int, shape (c,)
        Place of these variables among all.
    samples : SampleWeights
        Their weights.
    """

    time: FloatArray
    columns: FloatArray
    at: NDArray[np.int64]
    samples: SampleWeights


def white_level(time: FloatArray, values: FloatArray) -> float:
    """Return the standard deviation of the white part of a smooth signal.

    Third differences of white noise of variance σ² have variance 20 σ²; their median absolute value
    is robust against outliers.

    Parameters
    ----------
    time : ndarray of float, shape (m,)
        Times of the samples [s].
    values : ndarray of float, shape (m, c)
        Values of c channels, in the sensor's unit.
    """
    differences = np.diff(values, 3, axis=0)
    spacing = np.diff(time)
    even = np.abs(spacing / np.median(spacing) - 1.0) < 0.5
    usable = even[:-2] & even[1:-1] & even[2:]
    if not usable.any():
        return 0.0
    return float(np.median(np.abs(differences[usable])) / 0.6745 / math.sqrt(20.0))


def restricted_noise(
    channels: Sequence[Residuals],
    others: FloatArray,
    start: NoiseLevel,
    *,
    floor: float,
) -> NoiseLevel:
    """Find the noise of the largest restricted likelihood (REML).

    Parameters
    ----------
    channels : sequence of Residuals
        All those of the sensor, at the present estimate.
    others : ndarray of float, shape (n + 1, n + 1)
        Part of the other sensors and of the priors in [J r]ᵀ[J r], whitened.
    start : NoiseLevel
        Noise at which the search begins; with a drift of a third of the white part at least.
    floor : float
        Smallest level: that of rounding.

    References
    ----------
    H. D. Patterson, R. Thompson, Biometrika 58 (1971) 545-554.
    """
    span = max(float(np.ptp(channel.time)) for channel in channels)
    spacing = min(float(np.median(np.diff(channel.time))) for channel in channels)

    def criterion(theta: FloatArray) -> float:
        white, drift, drift_time = np.exp(theta)
        noise = NoiseLevel(white, drift, drift_time)
        gram, log_determinant = others.copy(), 0.0
        for channel in channels:
            whitened, part = whiten(channel.columns, channel.time, noise, channel.samples)
            log_determinant += part
            gram[np.ix_(channel.at, channel.at)] += whitened.T @ whitened
        information, gradient = gram[:-1, :-1], gram[:-1, -1]
        try:
            factor = np.linalg.cholesky(information)
        except np.linalg.LinAlgError:  # levels so far apart that round-off has the last word
            return IMPOSSIBLE
        reduced = np.linalg.solve(factor, gradient)
        misfit = gram[-1, -1] - reduced @ reduced
        return float(0.5 * (log_determinant + misfit) + np.log(np.diag(factor)).sum())

    # the rounding of a value that hardly changes is an error that hardly changes
    low = np.log([floor, max(1e-3 * start.white, floor), 2.0 * spacing])
    high = np.log([1e3 * start.white + floor, 1e3 * start.white + floor, 2.0 * span])
    # next to no drift the slope by its logarithm vanishes: a search that begins there stays there
    drift, drift_time = max((start.drift, start.drift_time), (0.3 * start.white, 1.0))
    begin = np.clip(np.log([start.white, drift, drift_time]), low, high)
    likeliest = minimize(
        criterion, begin, method="L-BFGS-B", bounds=list(zip(low, high, strict=True)),
        options={"maxiter": 25, "ftol": 1e-7},
    )  # fmt: skip
    white, drift, drift_time = (float(v) for v in np.exp(likeliest.x))
    return NoiseLevel(white, drift, drift_time)
