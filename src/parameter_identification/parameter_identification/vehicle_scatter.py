"""Whether the drives of a vehicle contradict each other, by their shares of the cost.

The rules are those of `identify` (`estimation.interval_correction`). Only how it is found that a
drive misses what the others tell differs: of a drive its information and slope are left, which
stand for all its samples, and not its positions.

Letters of shapes: `n` variables of a vehicle, of which c are common to its drives: k parameters and
the effects; the rates are the last ones.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from excitation_planner.design.prior import UNIFORM_STD
from parameter_identification.estimation.interval_correction import (
    MIN_DRIVES_FOR_SCATTER,
    Trend,
    few_drives_factors,
    scatter_factors,
)
from parameter_identification.estimation.quadratic import Quadratic
from parameter_identification.estimation.validation import LEAST_CHANCE
from parameter_identification.estimation.variables import at_bounds
from parameter_identification.vehicle_fit import VehicleFit
from tricycle_core.quantities import FloatArray


@dataclass(frozen=True, eq=False)
class VehicleScatter:
    """By how much the drives of a vehicle scatter more than their noise explains.

    Attributes
    ----------
    ratio : ndarray of float, shape (n,)
        Ratio of the deviations by the scatter and by the noise; NaN for one drive.
    factors : ndarray of float, shape (n,)
        Factors on the deviations by the noise, for intervals.
    missed : bool
        Whether one of a few drives is farther from what the others tell than by chance.
    """

    ratio: FloatArray
    factors: FloatArray
    missed: bool


def scatter_of(
    fit: VehicleFit, level: float, covariance: FloatArray | None = None
) -> VehicleScatter:
    """Return by how much the drives of a vehicle scatter.

    Parameters
    ----------
    fit : VehicleFit
        At the best fit.
    level : float
        Probability of the intervals.
    covariance : ndarray of float, shape (n, n), optional
        By the noise. Default: that of the fit.
    """
    here, variables, n = fit.quadratic, fit.variables, len(fit.at)
    if len(here.slopes) >= MIN_DRIVES_FOR_SCATTER:
        found = scatter_factors(here.covariance(), here.slopes, variables.information, level)
        return VehicleScatter(*found, missed=False)
    ratio, factors = np.full(n, np.nan), np.ones(n)
    if len(here.shares) < 2:
        return VehicleScatter(ratio, factors, missed=False)
    k, c = len(fit.setting.vehicle.unknown), variables.common
    places = [*range(k), *range(c, n)]
    std = np.sqrt(np.diag(here.covariance() if covariance is None else covariance))[places]
    drives = list(_costs(fit))
    without = _where_missed(fit, drives, k)
    trend = None
    if variables.changing:
        trend = Trend(fit.since, variables.changing, float(variables.information[-1, -1]))
    ratio[:] = 1.0
    ratio[places], factors[places] = few_drives_factors(
        _alone(fit, drives, k),
        k,
        std,
        level,
        without=None if without is None else without[:, places],
        trend=trend,
    )
    return VehicleScatter(ratio, factors, missed=without is not None)


def _costs(fit: VehicleFit) -> Iterator[Quadratic]:
    """Cost of each drive by its c common variables, without their priors, at the best fit."""
    for since, share in zip(fit.since, fit.quadratic.shares, strict=True):
        at = fit.variables.of_drive(since) @ fit.at
        gradient = share.gradient + share.information @ (at - share.at)
        yield Quadratic(at, share.cost, gradient, share.information)


def _alone(fit: VehicleFit, drives: Sequence[Quadratic], k: int) -> Iterator[Quadratic]:
    """Cost of each drive by parameters and effects that act, with the priors of these."""
    variables = fit.variables
    c = variables.common
    acting = np.flatnonzero((fit.at[:c] != 0.0) | (np.arange(c) < k))
    prior = variables.information[:c, :c].copy()
    prior[:k], prior[:, :k] = 0.0, 0.0
    for drive in drives:
        yield drive.with_prior(variables.mean[:c], prior).of(acting)


def _where_missed(fit: VehicleFit, drives: Sequence[Quadratic], k: int) -> FloatArray | None:
    """Variables (d, n) without each drive, if one is farther from them than by chance."""
    variables, at, c = fit.variables, fit.at, fit.variables.common
    effect = np.zeros(len(at), dtype=bool)
    effect[k:c] = True
    free = ~at_bounds(at, variables.low, variables.high) & ~(effect & (at == 0.0))
    designs = [variables.of_drive(since) for since in fit.since]
    informations = np.array([d.T @ q.information @ d for d, q in zip(designs, drives, strict=True)])
    gradients = np.array([d.T @ q.gradient for d, q in zip(designs, drives, strict=True)])
    before = variables.information @ (at - variables.mean)
    found, chances = [], []
    for i, (design, drive) in enumerate(zip(designs, drives, strict=True)):
        # summed without this drive: a difference loses the prior where the drive tells far more
        information = variables.information + np.delete(informations, i, axis=0).sum(axis=0)
        gradient = before + np.delete(gradients, i, axis=0).sum(axis=0)
        covariance = Quadratic(at, np.nan, gradient, information).covariance(free)
        change = -covariance @ gradient
        found.append(at + change)
        moved = replace(drive, gradient=drive.gradient + drive.information @ (design @ change))
        expected, samples = design @ covariance @ design.T, fit.quadratic.shares[i].samples
        chances.append(_chance(moved, expected, samples, free[:c], k))
    return np.array(found) if min(chances) < LEAST_CHANCE else None


def _chance(
    drive: Quadratic, expected: FloatArray, samples: int, free: NDArray[np.bool_], k: int
) -> float:
    """Chance of so high a cost of a drive where the others say, known to a covariance (c, c).

    Only directions count of which the drive tells more than is known before it. The noise of all
    its samples is in what chance explains, as where positions are compared (`validation`).
    """
    scale = np.where(np.arange(len(free)) < k, UNIFORM_STD, 1.0)[free]
    own = np.ix_(free, free)
    told, directions = np.linalg.eigh(drive.information[own] * np.outer(scale, scale))
    directions, told = directions[:, told > 1.0], told[told > 1.0]
    slope = (drive.gradient[free] * scale) @ directions / np.sqrt(told)
    root = directions * np.sqrt(told) / scale[:, np.newaxis]
    by_others = root.T @ expected[own] @ root
    mean = samples + float(np.trace(by_others))
    half_variance = mean + float(np.trace(by_others) + np.sum(by_others**2))
    degrees = mean**2 / half_variance
    found = samples - len(told) + float(slope @ slope)
    return float(chdtrc(degrees, degrees * found / mean))
