"""A parameter of many vehicles: what they have in common, how far they are apart, which one is odd.

Every vehicle v has its own true value θ_v, drawn from a normal population of mean μ and spread τ;
an identification gives y_v = θ_v + error with a known standard deviation s_v. Few vehicles show the
spread badly; everything is therefore averaged over τ with the weight that the estimates give it (a
uniform prior of τ: A. Gelman, Bayesian Analysis 1 (2006) 515-533), so that the intervals count it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import logsumexp
from scipy.stats import norm

from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray

FEWEST = 4
"""Vehicles from which there is a population: with a uniform prior of τ, 3 are the least."""

FALSE_ALARMS = 0.01
"""Probability that a population without odd vehicles has one that is called odd."""

_SPREADS = 400  # values of τ that are averaged
_FARTHEST = 6.0  # largest of them, in standard deviations of the estimates


@dataclass(frozen=True)
class Interval:
    """Median and interval of a quantity, in the parameter's unit."""

    middle: float
    low: float
    high: float


@dataclass(frozen=True)
class Member:
    """A vehicle in its population.

    Attributes
    ----------
    vehicle : str
        Its name.
    own : float
        Estimate from its drives alone.
    deviation : float
        Standard deviation of that estimate.
    value : Interval
        Of its parameter, from its own drives and from the population; of an odd one from its own.
    distance : float
        Of its own estimate from what the other vehicles let expect, in standard deviations of that
        expectation, spread and errors included.
    odd : bool
        Whether it is too far away for chance.
    """

    vehicle: str
    own: float
    deviation: float
    value: Interval
    distance: float
    odd: bool


@dataclass(frozen=True)
class Population:
    """A parameter of many vehicles.

    Attributes
    ----------
    mean, spread : Interval
        Of the population, odd vehicles left out.
    members : tuple of Member
        In the order of the estimates.
    """

    mean: Interval
    spread: Interval
    members: tuple[Member, ...]


def population(
    vehicles: Sequence[str], estimates: FloatArray, deviations: FloatArray, *, level: float = 0.95
) -> Population:
    """Return the population that vehicles come from.

    Parameters
    ----------
    vehicles : sequence of str
        Their names.
    estimates, deviations : ndarray of float, shape (v,)
        Of a parameter, each from the drives of one vehicle alone.
    level : float
        Probability of the intervals.

    Raises
    ------
    IdentificationError
        If there are fewer than `FEWEST` vehicles, or a deviation is not positive.
    """
    count = len(vehicles)
    if count < FEWEST:
        raise IdentificationError(f"{count} vehicles are no population: {FEWEST} are needed")
    if not (np.all(np.isfinite(estimates)) and np.all(deviations > 0.0)):
        raise IdentificationError("population: needs finite estimates and positive deviations")
    scale = float(np.hypot(np.std(estimates), np.median(deviations)))
    spreads = np.linspace(0.0, _FARTHEST * scale, _SPREADS)
    ends = 0.5, 0.5 - 0.5 * level, 0.5 + 0.5 * level
    distances, odd = _distances(spreads, estimates, deviations)
    if count - odd.sum() < FEWEST:
        odd[:] = False
    common = _given_spread(spreads, estimates[~odd], deviations[~odd])
    weights, means, variances = common
    share = np.cumsum(weights)
    members = []
    for i, vehicle in enumerate(vehicles):
        own = [estimates[i] + norm.ppf(p) * deviations[i] for p in ends]
        if not odd[i]:
            kept = spreads**2 / (spreads**2 + deviations[i] ** 2)  # of its own estimate
            centre = kept * estimates[i] + (1.0 - kept) * means
            std = np.sqrt(kept * deviations[i] ** 2 + (1.0 - kept) ** 2 * variances)
            own = [_quantile(weights, centre, std, p) for p in ends]
        members.append(
            Member(
                vehicle,
                float(estimates[i]),
                float(deviations[i]),
                Interval(*map(float, own)),
                float(distances[i]),
                bool(odd[i]),
            )
        )
    return Population(
        Interval(*(_quantile(weights, means, np.sqrt(variances), p) for p in ends)),
        Interval(*(float(np.interp(p, share, spreads)) for p in ends)),
        tuple(members),
    )


def _distances(
    spreads: FloatArray, estimates: FloatArray, deviations: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """How far each vehicle (v,) is from what the others let expect, and whether it is odd."""
    count = len(estimates)
    distances, odd = np.empty(count), np.zeros(count, dtype=bool)
    for i in range(count):
        others = np.arange(count) != i
        weights, means, variances = _given_spread(spreads, estimates[others], deviations[others])
        off = (estimates[i] - means) / np.sqrt(variances + spreads**2 + deviations[i] ** 2)
        below, above = float(weights @ norm.cdf(off)), float(weights @ norm.sf(off))
        tail = max(min(below, above), 1e-300)
        distances[i] = math.copysign(float(norm.isf(tail)), below - above)
        odd[i] = 2.0 * tail < FALSE_ALARMS / count
    return distances, odd


def _given_spread(
    spreads: FloatArray, estimates: FloatArray, deviations: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weight of each spread (t,), and mean and variance of the population's mean given it."""
    precision = 1.0 / (spreads[:, None] ** 2 + deviations**2)  # (t, v)
    total = precision.sum(axis=1)
    means = precision @ estimates / total
    off = estimates - means[:, None]
    evidence = 0.5 * np.log(precision).sum(axis=1) - 0.5 * np.log(total)
    evidence -= 0.5 * np.sum(precision * off**2, axis=1)
    weights: FloatArray = np.exp(evidence - logsumexp(evidence))
    return weights, means, 1.0 / total


def _quantile(weights: FloatArray, means: FloatArray, std: FloatArray, probability: float) -> float:
    """Value below which a mixture of normal distributions is with a probability."""
    reach = 10.0 * float(std.max()) + 1e-12
    return float(
        brentq(
            lambda x: float(weights @ norm.cdf(x, means, np.maximum(std, 1e-300))) - probability,
            float(means.min()) - reach,
            float(means.max()) + reach,
        )
    )
