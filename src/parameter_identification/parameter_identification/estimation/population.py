"""A parameter of many vehicles: what they have in common, how far they are apart, which one is odd.

Every vehicle v has its own true value θ_v, drawn from a normal population of mean μ and spread τ;
an identification gives y_v = θ_v + error with a known standard deviation s_v. Few vehicles show the
spread badly; everything is therefore averaged over τ with the weight that the estimates give it (a
uniform prior of τ: A. Gelman, Bayesian Analysis 1 (2006) 515-533), so that the intervals count it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import logsumexp, ndtr, ndtri

from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray

MIN_VEHICLES = 4
"""Vehicles from which there is a population: with a uniform prior of τ, 3 are the least."""

FALSE_ALARMS = 0.01
"""Probability that a population without odd vehicles has one that is called odd."""

_MOST_ODD = 10  # vehicles of a fleet
_SPREADS = 400  # values of τ that are averaged
_FARTHEST = 6.0  # largest of them, in standard deviations of the estimates


@dataclass(frozen=True)
class Interval:
    """Median and interval of a quantity, in the parameter's unit."""

    middle: float
    low: float
    high: float

    def scaled(self, factor: float) -> "Interval":
        """Return the interval in another unit.

        Parameters
        ----------
        factor : float
            Factor by which its numbers are larger in that unit; positive.
        """
        return Interval(factor * self.middle, factor * self.low, factor * self.high)


@dataclass(frozen=True)
class Member:
    """A vehicle in its population.

    Attributes
    ----------
    vehicle : str
        Name of the vehicle.
    own : float
        Estimate from its drives alone.
    deviation : float
        Standard deviation of that estimate, errors in common included.
    value : Interval
        Median and interval of the vehicle's parameter, from its own drives and from the population;
        of an odd vehicle from its own drives only.
    distance : float
        Signed distance of the vehicle's own estimate from its prediction by the other vehicles, in
        standard deviations of the prediction, spread and errors included.
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
        Mean and spread (a standard deviation) of the parameter in the population; odd vehicles are
        left out.
    members : tuple of Member
        In the order of the estimates.
    """

    mean: Interval
    spread: Interval
    members: tuple[Member, ...]


def population(
    vehicles: Sequence[str],
    estimates: FloatArray,
    deviations: FloatArray,
    *,
    common_errors: FloatArray | None = None,
    level: float = 0.95,
) -> Population:
    """Return the population that vehicles come from.

    Parameters
    ----------
    vehicles : sequence of str
        Their names.
    estimates, deviations : ndarray of float, shape (v,)
        Estimates of a parameter and their standard deviations, each from the drives of one vehicle
        alone.
    common_errors : ndarray of float, shape (v, s), optional
        Errors that the estimates have in common beside the deviations, e.g. by a parameter that all
        vehicles share: how much one standard deviation of each changes every estimate.
    level : float
        Probability of the intervals.

    Raises
    ------
    IdentificationError
        If there are fewer than `MIN_VEHICLES` vehicles, or a deviation is not positive.
    """
    count = len(vehicles)
    if count < MIN_VEHICLES:
        raise IdentificationError(f"{count} vehicles are no population: {MIN_VEHICLES} are needed")
    if not (np.all(np.isfinite(estimates)) and np.all(deviations > 0.0)):
        raise IdentificationError("population: needs finite estimates and positive deviations")
    columns = np.ones((count, 1))
    if common_errors is not None:
        columns = np.column_stack([columns, common_errors])
    about = float(np.median(estimates))
    given = _Given(estimates - about, deviations, columns)
    distances, odd = _distances(given)
    common = given.population(~odd)
    ends = 0.5, 0.5 - 0.5 * level, 0.5 + 0.5 * level
    share = np.cumsum(common.weights)
    whole = np.hypot(deviations, np.linalg.norm(columns[:, 1:], axis=1))
    members = []
    for i, vehicle in enumerate(vehicles):
        own = [estimates[i] + ndtri(p) * whole[i] for p in ends]
        if not odd[i]:
            kept = given.spreads**2 / (given.spreads**2 + deviations[i] ** 2)  # of its own estimate
            of_common = -kept[:, None] * columns[i]
            of_common[:, 0] = 1.0 - kept
            centre = kept * given.estimates[i] + np.sum(of_common * common.means, axis=1)
            variance = kept * deviations[i] ** 2 + common.variances(of_common)
            own = [about + _quantile(common.weights, centre, np.sqrt(variance), p) for p in ends]
        members.append(
            Member(
                vehicle,
                float(estimates[i]),
                float(whole[i]),
                Interval(*map(float, own)),
                float(distances[i]),
                bool(odd[i]),
            )
        )
    means, deviation = common.means[:, 0], np.sqrt(common.covariances[:, 0, 0])
    return Population(
        Interval(*(about + _quantile(common.weights, means, deviation, p) for p in ends)),
        Interval(*(float(np.interp(p, share, given.spreads)) for p in ends)),
        tuple(members),
    )


@dataclass(frozen=True, eq=False)
class _Mixture:
    """Mean and common errors (p,), normal given each of t spreads; perhaps of v sets."""

    weights: FloatArray  # (t, [v]), of the spreads
    means: FloatArray  # (t, [v], p)
    covariances: FloatArray  # (t, [v], p, p)

    def variances(self, of: FloatArray) -> FloatArray:
        """Variance of linear combinations (..., p) of them."""
        found: FloatArray = np.einsum("...i,...ij,...j->...", of, self.covariances, of)
        return found


class _Given:
    """Estimates (v,) about 0 with deviations (v,), and their columns (v, p): mean, common errors.

    For every spread the population is a linear regression, whose sums over the vehicles are those
    of the precision, of its logarithm, and of what it weighs: columns, estimates, their squares.
    """

    def __init__(self, estimates: FloatArray, deviations: FloatArray, columns: FloatArray) -> None:
        self.estimates, self.deviations, self.columns = estimates, deviations, columns
        scale = float(np.hypot(np.std(estimates), np.median(deviations)))
        # dense at small spreads; the weights count how dense
        roots = (np.arange(_SPREADS) + 0.5) / _SPREADS
        self.spreads = _FARTHEST * scale * roots**2
        self._density = np.log(roots)
        precision = 1.0 / (self.spreads[:, None] ** 2 + deviations**2)  # (t, v)
        whole = np.column_stack([columns, estimates])
        self._each = np.einsum("tv,vi,vj->tvij", precision, whole, whole)
        self._logarithms = np.log(precision)
        self._before = np.diag(np.append(0.0, np.ones(columns.shape[1] - 1)))

    def population(self, kept: NDArray[np.bool_]) -> _Mixture:
        """Population of some of the vehicles."""
        return self._mixture(self._each[:, kept].sum(axis=1), self._logarithms[:, kept].sum(axis=1))

    def without_each(self, kept: NDArray[np.bool_]) -> _Mixture:
        """Population of some of the vehicles but for one of all, for each of them."""
        own = self._each * kept[:, None, None], self._logarithms * kept
        return self._mixture(*(part.sum(axis=1, keepdims=True) - part for part in own))

    def _mixture(self, sums: FloatArray, logarithms: FloatArray) -> _Mixture:
        information, pulls = sums[..., :-1, :-1] + self._before, sums[..., :-1, -1]
        covariances = np.asarray(np.linalg.inv(information), dtype=np.float64)
        means = np.einsum("...ij,...j->...i", covariances, pulls)
        evidence = logarithms - np.linalg.slogdet(information)[1]
        evidence -= sums[..., -1, -1] - np.sum(means * pulls, axis=-1)
        evidence = 0.5 * evidence + self._density.reshape(-1, *[1] * (evidence.ndim - 1))
        weights: FloatArray = np.exp(evidence - logsumexp(evidence, axis=0))
        return _Mixture(weights, means, covariances)


def _distances(given: _Given) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Signed distances (v,) of vehicles from predictions by the others, and which are odd.

    Several odd ones hide each other. The farthest is therefore taken away, then the farthest from
    those that are left, and so on; all up to the last one that is too far away are odd (B. Rosner,
    Technometrics 25 (1983) 165-172).
    """
    count = len(given.estimates)
    away, odd = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    for taken in range(min(_MOST_ODD, count // 4, count - MIN_VEHICLES)):
        distances = np.where(away, 0.0, _from_others(given, away))
        farthest = int(np.argmax(np.abs(distances)))
        away[farthest] = True
        if 2.0 * ndtr(-abs(distances[farthest])) < FALSE_ALARMS / (count - taken):
            odd = away.copy()
    return _from_others(given, odd), odd


def _from_others(given: _Given, away: NDArray[np.bool_]) -> FloatArray:
    """Signed distances (v,) of vehicles from predictions by the others, in standard deviations.

    Vehicles marked `away` are left out of the predictions.
    """
    found, x = given.without_each(~away), given.columns
    variance = given.spreads[:, None] ** 2 + given.deviations**2 + found.variances(x)
    off = (given.estimates - np.sum(found.means * x, axis=-1)) / np.sqrt(variance)
    below, above = (np.sum(found.weights * ndtr(side * off), axis=0) for side in (1.0, -1.0))
    tails = np.maximum(np.minimum(below, above), 1e-300)
    distances: FloatArray = np.copysign(-ndtri(tails), below - above)
    return distances


def _quantile(weights: FloatArray, means: FloatArray, std: FloatArray, probability: float) -> float:
    """Value below which a mixture of normal distributions is with a probability."""
    std = np.maximum(std, 1e-300)
    reach = 10.0 * float(std.max()) + 1e-12
    return float(
        brentq(
            lambda x: float(weights @ ndtr((x - means) / std)) - probability,
            float(means.min()) - reach,
            float(means.max()) + reach,
        )
    )
