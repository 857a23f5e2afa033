"""Where intervals by the noise promise too much: drives that disagree, ranges that they contradict.

n: variables, k of them parameters.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from parameter_identification.estimation.optimum import Optimum
from parameter_identification.estimation.problem import LeastSquares
from parameter_identification.estimation.weighing import Mixture
from tricycle_core.quantities import FloatArray

SCATTER = 10  # drives from which their scatter is an estimate
PULL = 3.0  # standard deviations by which data may pull a parameter beyond the end of its range


def grown(covariance: FloatArray, slopes: FloatArray, prior: FloatArray) -> FloatArray:
    """Return by which factor (n,) deviations are larger by the clusters' scatter; NaN: too few.

    Parameters
    ----------
    covariance : ndarray of float, shape (n, n)
        By the noise.
    slopes : ndarray of float, shape (d, n)
        Gradient of each cluster, e.g. of each drive.
    prior : ndarray of float, shape (n, n)
        Information that is of no cluster.
    """
    count = len(slopes)
    if count < SCATTER:
        return np.full(len(covariance), math.nan)
    slopes = slopes - slopes.mean(axis=0)  # where a parameter ends at its range, there is one
    middle = slopes.T @ slopes * count / (count - 1) + prior
    robust = covariance @ middle @ covariance
    return np.asarray(np.sqrt(np.diag(robust) / np.diag(covariance)))


def beyond_ranges(
    at: FloatArray, free: FloatArray, std: FloatArray, low: FloatArray, high: FloatArray
) -> NDArray[np.bool_]:
    """Return which variables (k,) the data pull beyond the end of their range.

    The model contradicts such a range. All values inside are improbable then, and an interval by
    the noise would be narrow, next to the end.

    Parameters
    ----------
    at : ndarray of float, shape (k,)
        Minimum within the ranges.
    free : ndarray of float, shape (k,)
        Minimum without ranges.
    std : ndarray of float, shape (k,)
        Standard deviations.
    low, high : ndarray of float, shape (k,)
        Ends of the ranges.
    """
    below, above = at <= low + 1e-9, at >= high - 1e-9
    pulled: NDArray[np.bool_] = below & (free < at - PULL * std)
    return pulled | (above & (free > at + PULL * std))


def doubted(covariance: FloatArray, before: FloatArray, beyond: NDArray[np.bool_]) -> FloatArray:
    """Return a covariance (n, n) in which some variables are as uncertain as before the drives.

    The others are as uncertain as they become by following these.

    Parameters
    ----------
    covariance : ndarray of float, shape (n, n)
        After the drives.
    before : ndarray of float, shape (k, k)
        Covariance of the first k variables before them.
    beyond : ndarray of bool, shape (k,)
        Which of these variables: those of `beyond_ranges`.
    """
    places = np.flatnonzero(beyond)
    if not len(places):
        return covariance
    block = np.ix_(places, places)
    more, vectors = np.linalg.eigh(before[block] - covariance[block])
    follow = covariance[:, places] @ np.linalg.inv(covariance[block]) @ vectors
    found: FloatArray = covariance + follow * np.fmax(more, 0.0) @ follow.T
    return found


@dataclass(frozen=True, eq=False)
class Doubt:
    """What the intervals of a fit have to count beside the noise.

    Attributes
    ----------
    covariance : ndarray of float, shape (n, n)
        With it.
    widening : ndarray of float, shape (k,)
        By which factor it makes the deviations of the parameters larger.
    beyond : ndarray of bool, shape (k,)
        Parameters that the data pull beyond their ranges.
    scatter : float
        Largest factor for the drives' scatter; NaN for less than `SCATTER` drives.
    """

    covariance: FloatArray
    widening: FloatArray
    beyond: NDArray[np.bool_]
    scatter: float


def doubt_of(
    problem: LeastSquares,
    optimum: Optimum,
    average: Mixture | None,
    least: FloatArray | None = None,
) -> Doubt:
    """Return what the intervals of a fit have to count beside the noise.

    Parameters
    ----------
    problem : LeastSquares
        With the noise of the fit.
    optimum : Optimum
        The fit; its covariance is that of the average where there is one.
    average : Mixture, optional
        Over models with and without effects.
    least : ndarray of float, shape (k,), optional
        Standard deviations that the parameters have at least.
    """
    at, k = optimum.fit.at, problem.k
    gram = problem.gram(at)
    by_noise = np.asarray(np.linalg.inv(gram[:-1, :-1]), dtype=np.float64)
    growth = np.full(problem.n, math.nan)
    if len(problem.models) >= SCATTER:
        growth = grown(by_noise, problem.slopes(at), problem.common_information())
    factors = np.fmax(growth, 1.0)
    if least is not None:
        std = factors[:k] * np.sqrt(np.diag(optimum.covariance)[:k])
        factors[:k] *= np.fmax(least / std, 1.0)
    covariance = optimum.covariance * np.outer(factors, factors)
    free, std = at - by_noise @ gram[:-1, -1], np.sqrt(np.diag(by_noise))
    if average is not None:
        free, std = average.mean, average.standard_deviations
    low, high = problem.low[:k], problem.high[:k]
    beyond = beyond_ranges(at[:k], free[:k], factors[:k] * std[:k], low, high)
    before = np.asarray(np.linalg.inv(problem.information), dtype=np.float64)
    covariance = doubted(covariance, before, beyond)
    widening = np.sqrt(np.diag(covariance)[:k] / np.diag(optimum.covariance)[:k])
    return Doubt(covariance, widening, beyond, float(growth[:k].max()))
