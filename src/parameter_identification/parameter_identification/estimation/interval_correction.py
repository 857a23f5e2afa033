"""Corrections of intervals by the noise: drives that disagree, ranges that they contradict.

n: variables, k of them parameters.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, stdtrit

from excitation_planner.design.prior import BoxPrior
from parameter_identification.estimation.intervals import half_width
from parameter_identification.estimation.mixture import Mixture
from parameter_identification.estimation.optimum import Optimum
from parameter_identification.estimation.problem import LeastSquares
from parameter_identification.estimation.quadratic import Quadratic
from parameter_identification.estimation.variables import at_bounds
from tricycle_core.quantities import FloatArray

MIN_DRIVES_FOR_SCATTER = 10  # drives from which their scatter is an estimate
CONTRADICTING = 2.0  # times their noise by which drives scatter that contradict each other
AGREEING = 0.01  # chance of a scatter of fewer drives from which it is taken for noise
LEAST_DEGREES = 0.5  # of freedom from which drives tell their scatter about a line
PULL = 3.0  # standard deviations by which data may pull a parameter beyond the end of its range


def student_factor(degrees: float, level: float) -> float:
    """Return by how much an interval is wider where its deviation is estimated from few numbers.

    The quantile of Student's distribution over that of the normal one.

    Parameters
    ----------
    degrees : float
        Degrees of freedom of the deviation.
    level : float
        Probability of the interval.

    Examples
    --------
    >>> round(student_factor(9, 0.95), 2)
    1.15
    """
    return float(stdtrit(degrees, 0.5 + 0.5 * level)) / half_width(level)


def scatter_factors(
    covariance: FloatArray, slopes: FloatArray, prior: FloatArray, level: float
) -> tuple[FloatArray, FloatArray]:
    """Return two factors (n,) for the clusters' scatter.

    The first is the ratio of the deviations by the scatter and by the noise; NaN: too few clusters.
    The second, for intervals, is 1 where that is not larger, and counts that clusters do not tell
    their scatter exactly.

    Parameters
    ----------
    covariance : ndarray of float, shape (n, n)
        By the noise.
    slopes : ndarray of float, shape (d, n)
        Gradient of each cluster, e.g. of each drive.
    prior : ndarray of float, shape (n, n)
        Information that is of no cluster.
    level : float
        Probability of the intervals.
    """
    count = len(slopes)
    if count < MIN_DRIVES_FOR_SCATTER:
        return np.full(len(covariance), math.nan), np.ones(len(covariance))
    # their mean is not 0 where a parameter is held at an end of its range
    slopes = slopes - slopes.mean(axis=0)
    middle = slopes.T @ slopes * count / (count - 1) + prior
    robust = covariance @ middle @ covariance
    growth = np.asarray(np.sqrt(np.diag(robust) / np.diag(covariance)))
    return growth, np.where(growth > 1.0, growth * student_factor(count - 1, level), 1.0)


@dataclass(frozen=True, eq=False)
class Trend:
    """Which of k parameters change linearly in time, each at a rate of its own.

    Attributes
    ----------
    since : ndarray of float, shape (d,)
        Time of each drive, in units of the rates.
    changing : tuple of int
        Numbers of these r parameters.
    information : float
        Inverse variance of a rate before the drives.
    """

    since: FloatArray
    changing: tuple[int, ...]
    information: float


def heterogeneity_factors(
    estimates: FloatArray, variances: FloatArray, level: float, trend: Trend | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return two factors (k + r,) for the scatter of a few drives; 1 where it may be noise.

    The first is the ratio of the deviations of their mean by the scatter and by the noise. The
    second, for intervals, counts two things more. Drives that contradict each other show that the
    model is wrong, and what it errs by alike in all of them does not scatter: it is taken to be as
    large as what scatters, so that the interval is one for a further drive. And a few drives do not
    tell their scatter well: a normal interval becomes as wide as one by Student's distribution.

    Of a parameter that changes, the drives scatter about a line. What they err by alike does not
    change its slope, the rate.

    Parameters
    ----------
    estimates, variances : ndarray of float, shape (d, k)
        By each drive alone.
    level : float
        Probability of the intervals.
    trend : Trend, optional
        Times and the r parameters that change; their rates are the last entries. Default: none.

    References
    ----------
    R. DerSimonian, N. Laird, Controlled Clinical Trials 7 (1986) 177-188; J. P. T. Higgins,
    S. G. Thompson, D. J. Spiegelhalter, Journal of the Royal Statistical Society A 172 (2009)
    137-159, Eq. 12, with d - 1 degrees of freedom instead of d - 2, which two drives do not have.
    """
    d, k = estimates.shape
    changing = () if trend is None else trend.changing
    ratio, factors = np.ones((2, k + len(changing)))
    for i, (found, variance) in enumerate(zip(estimates.T, variances.T, strict=True)):
        design, before, places = np.ones((d, 1)), np.zeros((1, 1)), [i]
        if trend is not None and i in changing:
            design = np.column_stack([np.ones(d), trend.since])
            before = np.diag([0.0, trend.information])
            places.append(k + changing.index(i))
        weights = 1.0 / variance
        by_noise = np.linalg.inv(design.T * weights @ design + before)
        fitted = design @ by_noise @ (design.T * weights)
        degrees = d - float(np.trace(fitted))
        squares = max(0.0, found @ (weights * (found - fitted @ found)))  # but for round-off
        if degrees < LEAST_DEGREES or chdtrc(degrees, squares) * k >= AGREEING:
            continue
        of_scatter = (squares - degrees) / float(weights @ (1.0 - np.diag(fitted)))
        by_scatter = np.linalg.inv(design.T / (variance + of_scatter) @ design + before)
        alike = np.where(np.array(places) == i, of_scatter, 0.0)
        ratio[places] = np.sqrt(np.diag(by_scatter) / np.diag(by_noise))
        factors[places] = np.sqrt((np.diag(by_scatter) + alike) / np.diag(by_noise))
        factors[places] *= student_factor(max(degrees, 1.0), level)
    return ratio, factors


def jackknife_factors(
    estimates: FloatArray, std: FloatArray, level: float
) -> tuple[FloatArray, FloatArray]:
    """Return two factors (k,) for how much estimates change without each of a few drives.

    They are those of `heterogeneity_factors`, by the jackknife.

    Parameters
    ----------
    estimates : ndarray of float, shape (d, k)
        Without each drive.
    std : ndarray of float, shape (k,)
        Deviations by the noise.
    level : float
        Probability of the intervals.

    References
    ----------
    B. Efron, C. Stein, Annals of Statistics 9 (1981) 586-596.
    """
    d = len(estimates)
    ratio = math.sqrt(d - 1) * np.std(estimates, axis=0) / std
    return ratio, np.fmax(ratio * math.sqrt(d + 1) * student_factor(d - 1, level), 1.0)


def few_drives_factors(
    drives: Iterable[Quadratic],
    k: int,
    std: FloatArray,
    level: float,
    *,
    without: FloatArray | None,
    trend: Trend | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return two factors (k + r,) for the scatter of two or more, but few drives.

    The first is the ratio of the deviations by the scatter and by the noise, the second is that for
    intervals (`heterogeneity_factors`, `jackknife_factors`).

    Parameters
    ----------
    drives : iterable of Quadratic
        Cost of each drive near the fit, without what is known of the parameters before: an earlier
        identification would draw all drives to the same values, so that none could contradict
        another. Its first k variables are the parameters; of each drive's own variables and of
        effects the priors are included.
    k : int
        Number of parameters.
    std : ndarray of float, shape (k + r,)
        Deviations by the noise, of parameters and then of rates.
    level : float
        Probability of the intervals.
    without : ndarray of float, shape (d, k + r), optional
        Parameters and rates without each drive, if the drives miss each other.
    trend : Trend, optional
        Times and the r parameters that change. Default: none.
    """
    ranges, estimates, variances = BoxPrior.uniform(k), [], []
    for drive in drives:
        alone = drive.with_prior(ranges.mean, ranges.information)
        estimates.append(alone.minimum()[:k])
        variances.append(np.diag(alone.covariance())[:k])
    ratio, factors = heterogeneity_factors(np.array(estimates), np.array(variances), level, trend)
    if without is not None:
        changed, more = jackknife_factors(without, std, level)
        ratio, factors = np.fmax(ratio, changed), np.fmax(factors, more)
    return ratio, factors


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


def pulled_parameters(
    at: FloatArray,
    here: Quadratic,
    factors: FloatArray,
    low: FloatArray,
    high: FloatArray,
    average: Mixture | None = None,
) -> NDArray[np.bool_]:
    """Return which of k parameters the data pull beyond their ranges.

    Parameters
    ----------
    at : ndarray of float, shape (n,)
        The fit: the parameters, then other variables.
    here : Quadratic
        Cost near the fit, in n variables, to the second order.
    factors : ndarray of float, shape (k,)
        On the standard deviations by the noise, for the drives' scatter.
    low, high : ndarray of float, shape (n,)
        Bounds of the variables.
    average : Mixture, optional
        Over models with and without effects, which replaces mean and deviations of the cost.
    """
    free, variances = here.minimum(), np.diag(here.covariance())
    std = np.sqrt(variances)
    if average is not None:
        free, std = average.mean, average.standard_deviations
    first = slice(len(factors))
    return beyond_ranges(at[first], free[first], factors * std[first], low[first], high[first])


def pulled_effects(
    at: FloatArray, here: Quadratic, k: int, low: FloatArray, high: FloatArray
) -> NDArray[np.bool_]:
    """Return which nuisances that act in a fit the data pull beyond their bounds.

    Parameters
    ----------
    at : ndarray of float, shape (n,)
        The fit; effects that are 0 do not act.
    here : Quadratic
        Cost near the fit, in n variables, to the second order.
    k : int
        Number of the first variables, which are the parameters.
    low, high : ndarray of float, shape (n,)
        Bounds of the variables.

    Returns
    -------
    ndarray of bool, shape (a,)
        By nuisance that acts.
    """
    acts = np.flatnonzero((at != 0.0) | (np.arange(len(at)) < k))
    own = here.of(acts)
    std = np.sqrt(np.diag(own.covariance()))
    return beyond_ranges(at[acts], own.minimum(), std, low[acts], high[acts])[k:]


def with_prior_variance(
    covariance: FloatArray, before: FloatArray, beyond: NDArray[np.bool_]
) -> FloatArray:
    """Return a covariance (n, n) in which some variables are as uncertain as before the drives.

    The others are as uncertain as they become by following these.

    Parameters
    ----------
    covariance : ndarray of float, shape (n, n)
        After the drives.
    before : ndarray of float, shape (k, k)
        Covariance of the first k variables before them.
    beyond : ndarray of bool, shape (k,)
        True for those of the first k variables that are to be as uncertain as before the drives:
        the ones that the data pull beyond their ranges (`beyond_ranges`).
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
class IntervalCorrection:
    """Uncertainty of a fit beside the noise, from drives that disagree and ranges.

    Attributes
    ----------
    covariance : ndarray of float, shape (n, n)
        Corrected.
    widening : ndarray of float, shape (k,)
        Factors by which the correction makes the deviations of the parameters larger.
    beyond : ndarray of bool, shape (k,)
        Parameters that are as uncertain as before the drives: those that the data pull beyond
        their ranges, or all.
    scatter : float
        Largest factor for the drives' scatter; NaN for one drive.
    """

    covariance: FloatArray
    widening: FloatArray
    beyond: NDArray[np.bool_]
    scatter: float


def corrected(
    at: FloatArray,
    here: Quadratic,
    covariance: FloatArray,
    factors: FloatArray,
    prior_covariance: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
    *,
    average: Mixture | None,
    scatter: float,
    wrong: bool,
    converged: bool = True,
) -> IntervalCorrection:
    """Return a fit's covariance with the scatter of its drives and the ranges it contradicts.

    Parameters
    ----------
    at : ndarray of float, shape (n,)
        The fit: k parameters, then other variables.
    here : Quadratic
        Cost near the fit, in n variables, to the second order.
    covariance : ndarray of float, shape (n, n)
        By the noise; that of the average where there is one.
    factors : ndarray of float, shape (n,)
        On the standard deviations, for the drives' scatter.
    prior_covariance : ndarray of float, shape (k, k)
        Covariance of the parameters before the drives.
    bounds : (ndarray of float, ndarray of float), shapes (n,)
        Lower and upper bounds of the variables.
    average : Mixture, optional
        Over models with and without effects.
    scatter : float
        Largest factor for the drives' scatter; NaN: not known.
    wrong : bool
        Whether the model is known to be wrong for this vehicle, beside `scatter`. Then, or where
        the drives contradict each other, all parameters are as uncertain as before the drives as
        soon as one of them is at an end of its range, or an effect is pulled beyond its bounds.
    converged : bool
        Whether the fit is a minimum. If not, they all are, too.
    """
    k, (low, high) = len(prior_covariance), bounds
    beyond = pulled_parameters(at, here, factors[:k], low, high, average)
    held = at_bounds(at, low, high)[:k].any() or pulled_effects(at, here, k, low, high).any()
    # what is held at a bound makes the others wrong
    if not converged or (held and (wrong or scatter > CONTRADICTING)):
        beyond[:] = True
    scattered = covariance * np.outer(factors, factors)
    found = with_prior_variance(scattered, prior_covariance, beyond)
    widening = np.sqrt(np.diag(found)[:k] / np.diag(covariance)[:k])
    return IntervalCorrection(found, widening, beyond, scatter)


def interval_correction(
    problem: LeastSquares,
    optimum: Optimum,
    average: Mixture | None,
    least: FloatArray | None = None,
    *,
    missing: FloatArray | None = None,
    white: bool,
    level: float,
) -> IntervalCorrection:
    """Return the correction of a fit's intervals for drives that disagree and for ranges.

    Parameters
    ----------
    problem : LeastSquares
        Problem of n variables, k of them parameters, set to the noise of the fit.
    optimum : Optimum
        The fit; its covariance is that of the average where there is one.
    average : Mixture, optional
        Over models with and without effects.
    least : ndarray of float, shape (k,), optional
        Standard deviations that the parameters have at least.
    missing : ndarray of float, shape (d, k), optional
        Estimates without each of a few drives, if these miss each other (`CrossPrediction`).
    white : bool
        Whether residuals look white. If they do not, or if drives miss each other, the model is
        wrong for this vehicle (`corrected`).
    level : float
        Probability of the intervals.
    """
    at, k = optimum.fit.at, problem.k
    quadratic = problem.quadratic(at)
    by_noise = quadratic.covariance()
    scatter, factors = np.array([math.nan]), np.ones(problem.n)
    if len(problem.models) >= MIN_DRIVES_FOR_SCATTER:
        growth, factors = scatter_factors(
            by_noise, problem.slopes(at), problem.common_information(), level
        )
        scatter = growth[:k]
    elif len(problem.models) > 1:
        acting = at != 0.0  # other effects are held there
        acting[:k] = True
        scatter, factors[:k] = few_drives_factors(
            problem.by_each_drive(at, acting),
            k,
            np.sqrt(np.diag(optimum.covariance)[:k]),
            level,
            without=missing,
        )
    if least is not None:
        std = factors[:k] * np.sqrt(np.diag(optimum.covariance)[:k])
        factors[:k] *= np.fmax(least / std, 1.0)
    return corrected(
        at,
        quadratic,
        optimum.covariance,
        factors,
        np.asarray(np.linalg.inv(problem.information), dtype=np.float64),
        (problem.low, problem.high),
        average=average,
        scatter=float(scatter.max()),
        wrong=not white or missing is not None,
        converged=optimum.fit.converged,
    )
