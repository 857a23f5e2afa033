"""The distribution of parameters and effects, averaged over the subsets of effects that may act.

Near the minimum the residuals are linear in parameters and effects, so that the evidence of every
subset of the effects follows from one quadratic cost (Laplace's method, exact where they are).
The parameters' distribution is the mixture of those of all subsets: it counts that nobody knows
which effects act. An effect that the data cannot tell from a parameter keeps about the probability
that it had before, and with it widens the tails.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import logit, logsumexp, ndtr, ndtri

from tricycle_core.quantities import FloatArray
from tricycle_sim.compilation import compiled

NEGLECTED = 1e-3  # probability of all the subsets that are left out
NOT_SEARCHED = 2e-3  # of it, that of subsets that begin alike, over those that were looked at
_LOG_ROOT_TAU = 0.5 * math.log(math.tau)  # of the normal distribution's density
_FAR_TAIL = 30.0  # standard deviations from which its tail is found by a series


@dataclass(frozen=True, eq=False)
class Mixture:
    """Normal distributions of d variables, one per subset of the effects.

    Attributes
    ----------
    weights : ndarray of float, shape (s,)
        Probability of each subset, the most probable ones first.
    acting : ndarray of bool, shape (s, g)
        True for the effects that act in a subset.
    means : ndarray of float, shape (s, d)
        Means of the variables in each subset; 0 for effects that it lacks.
    variances : ndarray of float, shape (s, d)
        Variances of the variables in each subset; 0 for effects that it lacks.
    within : ndarray of float, shape (d, d)
        Mean of the subsets' covariances.
    evidence : float
        Logarithm of the evidence of all subsets together, but for a constant that they have in
        common.
    """

    weights: FloatArray
    acting: NDArray[np.bool_]
    means: FloatArray
    variances: FloatArray
    within: FloatArray
    evidence: float

    @property
    def mean(self) -> FloatArray:
        """Mean of the variables (d,)."""
        mean: FloatArray = self.weights @ self.means
        return mean

    @property
    def standard_deviations(self) -> FloatArray:
        """Standard deviations of the variables (d,)."""
        return np.sqrt(np.diag(self.covariance(self.mean)))

    def covariance(self, about: FloatArray) -> FloatArray:
        """Return the second moments (d, d) about a point.

        Parameters
        ----------
        about : ndarray of float, shape (d,)
            The point.
        """
        off = self.means - about
        found: FloatArray = self.within + (self.weights[:, None] * off).T @ off
        return found

    def quantile(self, i: int, probability: float) -> float:
        """Return the value below which a variable is with a probability.

        Parameters
        ----------
        i : int
            Number of the variable.
        probability : float
            Between 0 and 1.
        """
        mean, std = self.means[:, i], np.sqrt(self.variances[:, i])
        ends = mean + ndtri(probability) * std
        if np.ptp(ends) == 0.0:
            return float(ends[0])

        def excess(value: float) -> float:
            return float(self.weights @ ndtr((value - mean) / std)) - probability

        return float(brentq(excess, ends.min() - 1e-9, ends.max() + 1e-9))

    def interval(self, i: int, at: float, level: float) -> tuple[float, float]:
        """Return the ends of the interval of a variable, which holds a point.

        Parameters
        ----------
        i : int
            Number of the variable.
        at : float
            A fit within bounds, of which the average knows nothing. Where it lies outside the
            interval of the average, this one holds what is between them too.
        level : float
            Probability of the interval.
        """
        low, middle, high = (self.quantile(i, 0.5 + s * 0.5 * level) for s in (-1, 0, 1))
        moved = 0.0 if low <= at <= high else at - middle
        return low + min(moved, 0.0), high + max(moved, 0.0)


def mixture_of(
    information: FloatArray,
    rhs: FloatArray,
    groups: Sequence[Sequence[int]],
    probabilities: Sequence[float],
    least: Mapping[int, float] | None = None,
    neglected: float = NEGLECTED,
) -> Mixture:
    """Return the average over subsets of effects, but for the least probable ones.

    Parameters
    ----------
    information : ndarray of float, shape (d, d)
        Inverse covariance of parameters and effects, with their priors; effects have a prior of
        mean 0 and deviation 1.
    rhs : ndarray of float, shape (d,)
        Information times the mean.
    groups : sequence of sequence of int
        Variables of each effect.
    probabilities : sequence of float
        Probability of each effect before the drives.
    least : mapping of int to float, optional
        Values below which variables of effects cannot be. Their distributions are cut off there,
        and replaced by normal ones of the same moments.
    neglected : float
        Probability of all the subsets that are left out, about.

    References
    ----------
    A. E. Raftery, D. Madigan, J. A. Hoeting, J. Am. Stat. Assoc. 92 (1997) 179-191.
    """
    d, bounds = len(rhs), dict(least or {})
    covariance = np.linalg.inv(information)
    mean = covariance @ rhs
    shown = np.array(
        [
            mean[at] @ np.linalg.solve(covariance[np.ix_(at, at)], mean[at])
            for at in map(list, groups)
        ]
    )
    # what the drives show most clearly is decided first: most of the search is then cut off early
    ranks = np.argsort(-shown, kind="stable").tolist()
    groups = [groups[rank] for rank in ranks]
    odds = logit(np.array(probabilities)[ranks])
    members = [i for at in groups for i in at]
    always = np.setdiff1d(np.arange(d), members)
    sequence = np.concatenate([always, members]).astype(np.int64)
    matrix = np.zeros((d + 1, d + 1))
    matrix[:d, :d] = information[np.ix_(sequence, sequence)]
    matrix[:d, d] = matrix[d, :d] = rhs[sequence]
    ends = len(always) + np.cumsum([0, *(len(at) for at in groups)])
    least_values = np.array([bounds.get(i, -math.inf) for i in sequence.tolist()])
    not_searched = math.log(NOT_SEARCHED * neglected)
    subsets, evidence = _evidence(matrix, ends, least_values, odds, shown[ranks], not_searched)
    order = np.argsort(-evidence)
    share = np.cumsum(np.exp(evidence[order] - logsumexp(evidence)))
    probable = subsets[order[: 1 + np.searchsorted(share, 1.0 - neglected)]]
    weights, means, variances, within = _moments(
        matrix, ends, least_values, odds, probable, float(evidence.max())
    )
    total = float(logsumexp(weights))
    weights = np.exp(weights - total)
    acting = _bits(probable, len(groups))[:, np.argsort(ranks)]
    order, back = np.argsort(-weights), np.argsort(sequence)
    return Mixture(
        weights[order],
        acting[order],
        means[np.ix_(order, back)],
        variances[np.ix_(order, back)],
        within[np.ix_(back, back)],
        total,
    )


def _bits(numbers: NDArray[np.int64], count: int) -> NDArray[np.bool_]:
    """True for the effects (s, g) in subsets, by number (s,); the last effect is the lowest bit."""
    found: NDArray[np.bool_] = (numbers[:, None] >> np.arange(count - 1, -1, -1)) & 1 == 1
    return found


@compiled
def _evidence(
    matrix: FloatArray,
    ends: NDArray[np.int64],
    least: FloatArray,
    odds: FloatArray,
    shown: FloatArray,
    not_searched: float,
) -> tuple[NDArray[np.int64], FloatArray]:
    """Logarithm of the evidence of the probable subsets of g effects.

    By leaps and bounds: effects are decided one after the other, in or out. None of the subsets of
    those that are not decided yet fits better than all of them; where even so all these subsets
    together are improbable, none of them is looked at.

    Parameters
    ----------
    matrix : ndarray of float, shape (d + 1, d + 1)
        Information, and the right-hand side in the last row and column. The variables of every
        subset come first, then those of the effects, one after the other.
    ends : ndarray of int, shape (g + 1,)
        Effect g has the variables from `ends[g]` to `ends[g + 1]`.
    least : ndarray of float, shape (d,)
        Least values of the variables; -inf: none.
    odds : ndarray of float, shape (g,)
        Logarithm of those of each effect before the drives.
    shown : ndarray of float, shape (g,)
        Chi squared by which the drives show each effect beside all others.
    not_searched : float
        Logarithm of the probability of subsets that begin alike, over those that were looked at,
        below which none of them is looked at.

    Returns
    -------
    subsets : ndarray of int, shape (s,)
        Their numbers: the last effect is the lowest bit.
    evidence : ndarray of float, shape (s,)
        Logarithm of the evidence of each subset, with the odds of its effects before the drives.

    References
    ----------
    J. H. Goodnight, The American Statistician 33 (1979) 149-158: the sweep operator.
    G. M. Furnival, R. W. Wilson, Technometrics 16 (1974) 499-511: leaps and bounds.
    """
    count, size = len(ends) - 1, len(matrix)
    bounded = np.flatnonzero(np.isfinite(least))
    kept = bounded[0] if len(bounded) else size - 1  # rows from here on are needed to the end
    # with the first so many effects decided: those that are not are all out, or all in
    without, others = np.empty((count + 1, size, size)), np.empty((count + 1, size, size))
    logarithms = np.zeros(count + 1)  # of what precedes the drives, and of the determinants
    most = np.zeros(count + 1)  # that bounds of those which act may add
    swept = np.zeros((count + 1, size), dtype=np.bool_)
    gains, undecided = _most_added(ends, least, odds)
    without[0] = matrix
    for v in range(ends[0]):
        logarithms[0] -= 0.5 * _sweep(without[0], v, 0)
    others[0] = without[0]
    for v in range(ends[0], size - 1):
        _sweep(others[0], v, 0)
    subsets, found, number = np.empty(1024, dtype=np.int64), np.empty(1024), 0
    subset, total, g = 0, -math.inf, 0
    tried = np.zeros(count + 1, dtype=np.int64)  # ways of deciding each effect: 1 with it, 2 both
    while g >= 0:
        if g == count:
            value = logarithms[g] - 0.5 * without[g, -1, -1]
            for i in bounded:
                if swept[g, i]:
                    value = _with_bound(value, without[g], i, least[i])
            if number == len(found):
                subsets = np.concatenate((subsets, subsets))
                found = np.concatenate((found, found))
            subsets[number], found[number] = subset, value
            number += 1
            larger = max(total, value)
            total = larger + math.log(math.exp(total - larger) + math.exp(value - larger))
            g -= 1
            continue
        if tried[g] == 2:
            tried[g] = 0
            g -= 1
            continue
        # the likelier way first: what is improbable beside it is then not looked at
        acts = (tried[g] == 0) == (0.5 * shown[g] + odds[g] > 0.0)
        tried[g] += 1
        first = min(ends[g], kept)
        without[g + 1, first:, first:] = without[g, first:, first:]
        others[g + 1, ends[g] :, ends[g] :] = others[g, ends[g] :, ends[g] :]
        logarithms[g + 1], most[g + 1], swept[g + 1] = logarithms[g], most[g], swept[g]
        bit = 1 << (count - 1 - g)
        if acts:
            subset |= bit
            logarithms[g + 1] += odds[g]
            most[g + 1] += gains[g]
            for v in range(ends[g], ends[g + 1]):
                logarithms[g + 1] -= 0.5 * _sweep(without[g + 1], v, min(v, kept))
                swept[g + 1, v] = True
        else:
            subset &= ~bit
            for v in range(ends[g], ends[g + 1]):
                _sweep(others[g + 1], v, ends[g])  # back out
        bound_of_all = logarithms[g + 1] + most[g + 1] + undecided[g + 1]
        if bound_of_all - 0.5 * others[g + 1, -1, -1] > total + not_searched:
            g += 1
    return subsets[:number], found[:number]


@compiled
def _most_added(
    ends: NDArray[np.int64], least: FloatArray, odds: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Most that effects may add to the logarithm of the evidence, beside a better fit.

    Parameters
    ----------
    ends, least, odds
        As those of `_evidence`.

    Returns
    -------
    gains : ndarray of float, shape (g,)
        By the bounds of each effect, if all of what the drives allow is above them.
    undecided : ndarray of float, shape (g + 1,)
        By all subsets together of each effect and those after it.
    """
    count = len(odds)
    gains, undecided = np.zeros(count), np.zeros(count + 1)
    for g in range(count - 1, -1, -1):
        for v in range(ends[g], ends[g + 1]):
            if np.isfinite(least[v]):
                gains[g] += math.log(2.0 / math.erfc(least[v] / math.sqrt(2.0)))
        undecided[g] = undecided[g + 1] + math.log1p(math.exp(odds[g] + gains[g]))
    return gains, undecided


@compiled
def _with_bound(value: float, moments: FloatArray, i: int, least: float) -> float:
    """Logarithm of evidence that counts a bound too, other variables taken as not bounded.

    Parameters
    ----------
    value : float
        The logarithm without this bound.
    moments, i, least
        As those of `_cut_off`.
    """
    above = (moments[i, -1] - least) / math.sqrt(2.0 * moments[i, i])
    value += math.log(max(math.erfc(-above), 1e-300))
    return value - math.log(math.erfc(least / math.sqrt(2.0)))


@compiled
def _moments(
    matrix: FloatArray,
    ends: NDArray[np.int64],
    least: FloatArray,
    odds: FloatArray,
    subsets: NDArray[np.int64],
    about: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Evidence and moments of subsets (s,) of g effects.

    Parameters
    ----------
    matrix, ends, least, odds
        As those of `_evidence`.
    subsets : ndarray of int, shape (s,)
        Their numbers.
    about : float
        About the largest logarithm of evidence.

    Returns
    -------
    evidence : ndarray of float, shape (s,)
        Logarithm of the evidence of each subset.
    means, variances : ndarray of float, shape (s, d)
        Means and variances of the variables in each subset; 0 for effects that it lacks.
    within : ndarray of float, shape (d, d)
        Mean of their covariances, by their evidence.
    """
    count, d, number = len(odds), len(matrix) - 1, len(subsets)
    evidence, within = np.zeros(number), np.zeros((d, d))
    means, variances = np.zeros((number, d)), np.zeros((number, d))
    total = 0.0
    at = np.arange(d + 1)  # up to ends[0] those of every subset
    for s in range(number):
        m = ends[0]
        for g in range(count):
            if subsets[s] >> (count - 1 - g) & 1:
                evidence[s] += odds[g]
                for v in range(ends[g], ends[g + 1]):
                    at[m] = v
                    m += 1
        at[m] = d
        own = np.empty((m + 1, m + 1))
        for i in range(m + 1):
            for j in range(m + 1):
                own[i, j] = matrix[at[i], at[j]]
        for i in range(m):
            evidence[s] -= 0.5 * _sweep(own, i, 0)
        evidence[s] -= 0.5 * own[m, m]
        for i in range(m):
            if np.isfinite(least[at[i]]):
                evidence[s] += _cut_off(own, i, least[at[i]])
        share = math.exp(evidence[s] - about)
        total += share
        for i in range(m):
            means[s, at[i]], variances[s, at[i]] = own[i, m], own[i, i]
            for j in range(m):
                within[at[i], at[j]] += share * own[i, j]
    return evidence, means, variances, within / total


@compiled
def _cut_off(moments: FloatArray, i: int, least: float) -> float:
    """Let a normal distribution end where a variable is least, in place; log of what that adds.

    Parameters
    ----------
    moments : ndarray of float, shape (m + 1, m + 1)
        Covariance, and the mean in the last column.
    i : int
        The variable.
    least : float
        Least value that the variable may have, in standard deviations of its prior.
    """
    m = len(moments) - 1
    std = math.sqrt(moments[i, i])
    start = (least - moments[i, m]) / std
    if start < _FAR_TAIL:
        kept = math.log(0.5 * math.erfc(start / math.sqrt(2.0)))
        hazard = math.exp(-0.5 * start**2 - _LOG_ROOT_TAU - kept)
    else:
        hazard = start + 1.0 / start
        kept = -0.5 * start**2 - _LOG_ROOT_TAU - math.log(hazard)
    shrinks = min(max(hazard * (hazard - start), 0.0), 1.0 - 1e-9)  # of the variance, by this share
    gains = moments[:m, i] / moments[i, i]
    change = moments[i, i] * shrinks
    for j in range(m):
        moments[j, m] += gains[j] * std * hazard
        for k in range(m):
            moments[j, k] -= change * gains[j] * gains[k]
    return kept - math.log(0.5 * math.erfc(least / math.sqrt(2.0)))


@compiled
def _sweep(matrix: FloatArray, pivot: int, first: int) -> float:
    """Invert rows and columns from `first` on by one variable, in place; return its logarithm."""
    p = matrix[pivot, pivot]
    size = len(matrix)
    for i in range(first, size):
        if i != pivot:
            share = matrix[i, pivot] / p
            for j in range(first, size):
                if j != pivot:
                    matrix[i, j] -= share * matrix[pivot, j]
            matrix[i, pivot] = -share
    for j in range(first, size):
        if j != pivot:
            matrix[pivot, j] /= p
    matrix[pivot, pivot] = 1.0 / p
    return math.log(p)


def joined(mixtures: Sequence[Mixture], evidence: FloatArray) -> Mixture:
    """Return the average of mixtures.

    Parameters
    ----------
    mixtures : sequence of Mixture
        Mixtures, all of the same variables and effects.
    evidence : ndarray of float, shape (m,)
        Logarithm of the evidence of each mixture.
    """
    total = float(logsumexp(evidence))
    shares = np.exp(evidence - total)
    weights = np.concatenate([share * m.weights for share, m in zip(shares, mixtures, strict=True)])
    order = np.argsort(-weights)
    return Mixture(
        weights[order],
        np.concatenate([m.acting for m in mixtures])[order],
        np.concatenate([m.means for m in mixtures])[order],
        np.concatenate([m.variances for m in mixtures])[order],
        np.tensordot(shares, np.array([m.within for m in mixtures]), 1),
        total,
    )
