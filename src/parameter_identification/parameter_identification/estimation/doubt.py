"""Where intervals by the noise promise too much: drives that disagree, ranges that they contradict.

n: variables, k of them parameters.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from parameter_identification.estimation.optimum import Optimum
from parameter_identification.estimation.problem import LeastSquares
from tricycle_core.quantities import FloatArray

SCATTER = 20  # drives from which their scatter is an estimate
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
    at: FloatArray, step: FloatArray, std: FloatArray, low: FloatArray, high: FloatArray
) -> NDArray[np.bool_]:
    """Return which variables (n,) the data pull beyond the end of their range.

    The model contradicts such a range: inside it everything is improbable, and what is least so,
    next to the end, would pass for certain.

    Parameters
    ----------
    at : ndarray of float, shape (n,)
        Minimum within the ranges.
    step : ndarray of float, shape (n,)
        From there to the minimum without ranges.
    std : ndarray of float, shape (n,)
        Standard deviations.
    low, high : ndarray of float, shape (n,)
        Ends of the ranges.
    """
    below, above = at <= low + 1e-9, at >= high - 1e-9
    pulled: NDArray[np.bool_] = (below & (step < -PULL * std)) | (above & (step > PULL * std))
    return pulled


def doubted(covariance: FloatArray, before: FloatArray, beyond: NDArray[np.bool_]) -> FloatArray:
    """Return a covariance (n, n) in which some variables are as uncertain as before the drives.

    Parameters
    ----------
    covariance : ndarray of float, shape (n, n)
        After the drives.
    before : ndarray of float, shape (n,)
        Standard deviations before them.
    beyond : ndarray of bool, shape (n,)
        Which variables: those of `beyond_ranges`.
    """
    factors = np.ones(len(covariance))
    factors[beyond] = np.fmax(before[beyond] / np.sqrt(np.diag(covariance)[beyond]), 1.0)
    found: FloatArray = covariance * np.outer(factors, factors)
    return found


@dataclass(frozen=True, eq=False)
class Doubt:
    """What the intervals of a fit have to count beside the noise.

    Attributes
    ----------
    covariance : ndarray of float, shape (n, n)
        With it.
    growth : ndarray of float, shape (n,)
        Factor of the deviations for the drives' scatter, 1 or more.
    beyond : ndarray of bool, shape (n,)
        Parameters that the data pull beyond their ranges.
    scattered : bool
        Whether there are drives enough to tell their scatter.
    """

    covariance: FloatArray
    growth: FloatArray
    beyond: NDArray[np.bool_]
    scattered: bool


def doubt_of(problem: LeastSquares, optimum: Optimum) -> Doubt:
    """Return what the intervals of a fit have to count beside the noise.

    Parameters
    ----------
    problem : LeastSquares
        With the noise of the fit.
    optimum : Optimum
        The fit; its covariance may be that of an average over models.
    """
    at, k = optimum.fit.at, problem.k
    gram = problem.gram(at)
    by_noise = np.asarray(np.linalg.inv(gram[:-1, :-1]), dtype=np.float64)
    growth = np.ones(problem.n)
    scattered = len(problem.models) >= SCATTER
    if scattered:
        prior = problem.prior_information()
        growth = np.fmax(grown(by_noise, problem.slopes(at), prior), 1.0)
    covariance = optimum.covariance * np.outer(growth, growth)
    step, std = -by_noise @ gram[:-1, -1], growth * np.sqrt(np.diag(by_noise))
    beyond = beyond_ranges(at, step, std, problem.low, problem.high) & (np.arange(problem.n) < k)
    before = np.ones(problem.n)
    before[:k] = np.sqrt(np.diag(np.linalg.inv(problem.information)))
    return Doubt(doubted(covariance, before, beyond), growth, beyond, scattered)
