"""Weighing effects by the data: which of them act, and the fit with those.

The average over the models with and without each effect is taken near a fit, whose effects are then
those that the average found most probable. The deviations are weighed alike: not at all, or of one
of several sizes.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import logit, logsumexp

from parameter_identification.drives.measured import Sensor
from parameter_identification.estimation.levenberg_marquardt import Fit
from parameter_identification.estimation.mixture import NEGLECTED, Mixture, joined, mixture_of
from parameter_identification.estimation.noise import NoiseLevel
from parameter_identification.estimation.optimum import Optimum
from parameter_identification.estimation.problem import LeastSquares
from parameter_identification.estimation.quadratic import Quadratic
from tricycle_core.quantities import FloatArray
from tricycle_sim.effects import Effect

CERTAIN = 3.0  # standard deviations of a prior below which a least value is not counted
NO_DEVIATION = 1e-3  # size of a deviation that does not act, in deviations of its prior
SIZES = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)  # of one that does, all as probable before the drives
MOST_SIZES = 8  # combinations of them that are averaged
ROUNDS = 5  # of weights, and fit with the most probable effects
ROUGHLY = 0.5  # probability of subsets that are left out where the most probable one is wanted
SURPRISE = 30.0  # of the cost, from which a fit shows that the motion is not linear in an effect
ENOUGH = 0.1  # of it, to which such fits are compared
NOTICEABLE = 0.1  # standard deviations of its prior, from which an effect may be the cause
CLEARLY = 2.0  # standard deviations of its prior, of an effect from which a search begins
SURELY = 0.99  # probability of one that needs no further look
INDISPENSABLE = 1.0 - 1e-15  # probability of such an effect

LikelySizes = Sequence[tuple[dict[str, float], float]]
"""Sizes of the deviations, and the logarithm of what precedes the drives, for each choice."""


def weigh_effects(
    problem: LeastSquares, optimum: Optimum
) -> tuple[Optimum, Mixture, dict[str, float]]:
    """Return the fit with the most probable effects, and what the average over all subsets says.

    That is the distribution of parameters and effects, and the probability of each effect by name.
    Where the motion is not linear in the effects, the most probable ones near a fit depend on the
    fit. So there are two searches, from all effects and from none. Where both ends are probable and
    differ, there are others, from each effect that brings another law, as of a tyre, and is in
    neither end. The average is that of all ends by their evidence.

    Parameters
    ----------
    problem : LeastSquares
        Problem whose effects are weighed; its noise and the sizes of the deviations are estimated
        anew.
    optimum : Optimum
        The best fit with all effects.
    """
    effects, noise, sizes = _Effects(problem), problem.noise, problem.sizes.by_name()

    def end_from(start: FloatArray, free: NDArray[np.bool_]) -> _End:
        problem.set_weights(noise, sizes, optimum.fit.at)
        return _end_of_search(problem, problem.minimise(start, free), free)

    ends = [_end_of_search(problem, optimum.fit, np.ones(problem.n, dtype=bool))]
    none = effects.free_in(np.zeros(len(effects.places), dtype=bool))
    if not np.array_equal(ends[0].free, none):
        start = np.where(none & ~problem.variables.of_deviations, optimum.fit.at, 0.0)
        ends = _distinct([*ends, end_from(start, none)])
        if len(ends) > 1:
            in_one = ends[0].free | ends[1].free
            for at in effects.laws:
                if not in_one[at].any():
                    free, with_law = none.copy(), start.copy()
                    free[at], with_law[at] = True, np.fmin(problem.high[at], CLEARLY)
                    ends.append(end_from(with_law, free))
    ends = [end.refined(problem) for end in _distinct(ends)]
    evidence = np.array([end.evidence for end in ends])
    best = ends[int(np.argmax(evidence))]
    problem.set_weights(best.noise, best.sizes, best.fit.at)
    average = joined([end.average for end in ends], evidence)
    variables, covariance = effects.variables, best.near.covariance(best.free)
    covariance[np.ix_(variables, variables)] = average.covariance(best.fit.at[variables])
    deviations = _mean([end.deviations for end in ends], np.exp(evidence - average.evidence))
    probable = effects.probabilities(average) | deviations
    # an end that is no minimum is less probable than it should be
    fit = replace(best.fit, converged=all(end.fit.converged for end in ends))
    return replace(optimum, fit=fit, covariance=covariance), average, probable


@dataclass(frozen=True, eq=False)
class _End:
    """Where a search for the effects that act ends: those are the most probable ones near the fit.

    Attributes
    ----------
    fit : Fit
        The minimum.
    free : ndarray of bool, shape (n,)
        True for variables that are free in it; the other effects do not act.
    noise, sizes
        Noise and sizes of the deviations that belong to it, as a `LeastSquares` has them.
    near : Quadratic
        The cost near the fit.
    likely : LikelySizes
        Sizes of the deviations that are not improbable near it.
    effects : _Effects
        Those that may act or not.
    average : Mixture
        Of their subsets, near the fit.
    by_sizes : ndarray of float
        Logarithm of the evidence of each of the likely sizes.
    of_drives : float
        Logarithm of the probability of the drives without effects and parameters, but for a
        constant.
    """

    fit: Fit
    free: NDArray[np.bool_]
    noise: dict[Sensor, NoiseLevel]
    sizes: dict[str, float]
    near: Quadratic
    likely: LikelySizes
    effects: "_Effects"
    average: Mixture
    by_sizes: FloatArray
    of_drives: float

    @property
    def evidence(self) -> float:
        """Logarithm of the probability of the drives by the subsets, but for a constant."""
        return self.average.evidence - self.effects.log_odds_added + self.of_drives

    @property
    def deviations(self) -> dict[str, float]:
        """Probability that each deviation acts, by name."""
        shares = np.exp(self.by_sizes - self.average.evidence)
        acting = [
            {n: float(s != NO_DEVIATION) for n, s in sizes.items()} for sizes, _ in self.likely
        ]
        return _mean(acting, shares)

    def refined(self, problem: LeastSquares) -> "_End":
        """Return it with the average over all subsets; its weights stay set."""
        problem.set_weights(self.noise, self.sizes, self.fit.at)
        effects = self.effects
        probable = effects.probabilities(self.average)
        doubtful = {name: at for name, at in effects.places.items() if probable[name] < SURELY}
        effects.count_as_acting(indispensable(problem, self.near, self.free, doubtful))
        average, by_sizes = effects.average(self.near, self.likely)
        return replace(self, average=average, by_sizes=by_sizes)


def _end_of_search(problem: LeastSquares, fit: Fit, free: NDArray[np.bool_]) -> _End:
    """Where a search ends that begins at a fit with some effects; its weights stay set."""
    effects, sizes = _Effects(problem), problem.sizes.by_name()
    for later in reversed(range(ROUNDS)):
        near = problem.quadratic(fit.at)
        likely = _likely_sizes(problem, near, free)
        average, by_sizes = effects.average(near, likely, ROUGHLY)
        acts = effects.free_in(average.acting[0])
        best = likely[int(np.argmax(by_sizes))][0]
        if later == 0 or (np.array_equal(acts, free) and best == sizes):
            break  # so that the weights are those of the fit
        problem.sizes.set(best)
        sizes = best
        fit, free, needed = refitted(problem, fit, acts, effects.places)
        effects.count_as_acting(needed)
        problem.estimate_noise(fit.at)
        fit = problem.minimise(fit.at, free)
    return _End(
        fit=fit,
        free=free,
        noise=problem.noise,
        sizes=sizes,
        near=near,
        likely=likely,
        effects=effects,
        average=average,
        by_sizes=by_sizes,
        of_drives=-0.5 * (near.cost_of_zero + problem.log_determinant(fit.at)),
    )


def _mean(of: Sequence[Mapping[str, float]], shares: FloatArray) -> dict[str, float]:
    """Mean of values by name, each set of which counts by its share."""
    return {
        name: float(sum(s * one[name] for s, one in zip(shares.tolist(), of, strict=True)))
        for name in of[0]
    }


def _distinct(ends: Sequence[_End]) -> list[_End]:
    """Ends of searches that are not improbable, each once, the most probable one first."""
    distinct: list[_End] = []
    for end in sorted(ends, key=lambda end: -end.evidence):
        known = any(
            np.array_equal(end.free, other.free) and end.sizes == other.sizes for other in distinct
        )
        if not known and (
            not distinct or end.evidence > distinct[0].evidence + math.log(NEGLECTED)
        ):
            distinct.append(end)
    return distinct


class _Effects:
    """Effects of a problem that may act or not, and the average over their subsets.

    Attributes
    ----------
    places : dict of str to list of int
        Variables of each effect, by its name.
    laws : list of list of int
        Variables of each effect by which a part of the vehicle has another law.
    variables : ndarray of int
        Indices of the mixture's variables among the problem's: the parameters and all effects that
        are weighed here.
    log_odds_added : float
        Logarithm of the odds that effects gained because they were counted as acting.
    """

    def __init__(self, problem: LeastSquares) -> None:
        effects = problem.variables.constant_effects
        self._problem = problem
        self.log_odds_added = 0.0
        self._prior = {effect.name: effect.prior_probability for effect in effects}
        self.places = {effect.name: at for effect, at in effects.items()}
        self.laws = [at for effect, at in effects.items() if effect.parts]
        of_effects = sorted(i for at in self.places.values() for i in at)
        self.variables = np.append(np.arange(problem.k), of_effects).astype(int)
        self._rest = np.setdiff1d(np.arange(problem.n), self.variables)
        number = {v: i for i, v in enumerate(self.variables.tolist())}
        self._groups = [[number[i] for i in at] for at in self.places.values()]
        low = problem.low
        self._least = {number[i]: low[i] for i in of_effects if low[i] > -CERTAIN}

    def count_as_acting(self, names: Sequence[str]) -> None:
        """Let these effects act in all subsets that are averaged."""
        for name in names:
            self.log_odds_added += float(logit(INDISPENSABLE) - logit(self._prior[name]))
            self._prior[name] = INDISPENSABLE

    def free_in(self, acting: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """True for the problem's variables (n,) that are free where these effects act."""
        free = np.ones(self._problem.n, dtype=bool)
        for at, acts in zip(self.places.values(), acting, strict=True):
            free[at] = acts
        return free

    def probabilities(self, found: Mixture) -> dict[str, float]:
        """Probability of each effect, by its name."""
        probable = np.fmin(found.weights @ found.acting, 1.0)  # 1 but for round-off
        return dict(zip(self.places, probable.tolist(), strict=True))

    def average(
        self, here: Quadratic, likely: LikelySizes, neglected: float = NEGLECTED
    ) -> tuple[Mixture, FloatArray]:
        """Average over all subsets and those sizes of the deviations, and the sizes' evidence."""
        variables, rest = self.variables, self._rest

        def weighed(chosen: tuple[dict[str, float], float]) -> tuple[Mixture, float]:
            sizes, prior = chosen
            H, rhs = here.information + np.diag(self._problem.sizes.more_precision(sizes)), here.rhs
            onto = np.linalg.solve(H[np.ix_(rest, rest)], H[np.ix_(rest, variables)])
            found = mixture_of(
                H[np.ix_(variables, variables)] - H[np.ix_(variables, rest)] @ onto,
                rhs[variables] - onto.T @ rhs[rest],
                self._groups,
                list(self._prior.values()),
                self._least,
                neglected,
            )
            return found, prior + found.evidence + _log_evidence(H, rhs, rest)

        mixtures, evidence = zip(*self._problem.each(weighed, likely), strict=True)
        return joined(mixtures, np.array(evidence)), np.array(evidence)


def refitted(
    problem: LeastSquares,
    fit: Fit,
    acts: NDArray[np.bool_],
    places: Mapping[str, Sequence[int]],
) -> tuple[Fit, NDArray[np.bool_], list[str]]:
    """Return the fit with the effects that act, what is free in it, and indispensable effects.

    The weights are those of a motion that is linear in the effects. Where the fit is worse than
    that says, the effects that are left out are tried one by one, and the best one is kept.

    Parameters
    ----------
    problem : LeastSquares
        Problem to fit again; its `quadratic` and `minimise` are used.
    fit : Fit
        Fit with more effects.
    acts : ndarray of bool, shape (n,)
        True for variables that are free; the others are 0.
    places : mapping of str to sequence of int
        Variables of each effect, by its name.
    """
    here = problem.quadratic(fit.at)
    information, rhs = here.information, here.rhs

    def fitted(free: NDArray[np.bool_]) -> Fit:
        start = np.where(free, fit.at, 0.0)
        return problem.minimise(start, free, tolerance=ENOUGH * SURPRISE)

    def expected(free: NDArray[np.bool_]) -> float:
        inside = information[np.ix_(free, free)]
        return float(here.cost_of_zero - rhs[free] @ np.linalg.solve(inside, rhs[free]))

    found, free, needed = fitted(acts), acts, list[str]()
    while found.cost > expected(free) + SURPRISE:
        with_one = {}
        for name, at in places.items():
            if not free[at].any() and np.abs(fit.at[at]).max() > NOTICEABLE:
                more = free.copy()
                more[at] = True
                with_one[name] = fitted(more), more
        best = min(with_one, key=lambda name: with_one[name][0].cost, default=None)
        if best is None or with_one[best][0].cost > found.cost - SURPRISE:
            break
        found, free = with_one[best]
        needed.append(best)
    return found, free, needed


def indispensable(
    problem: LeastSquares,
    here: Quadratic,
    free: NDArray[np.bool_],
    places: Mapping[str, Sequence[int]],
) -> list[str]:
    """Return the effects without which the cost is more than a motion linear in them says.

    Where an effect is so large that it changes nothing any more, as at the shortest relaxation,
    its derivatives are 0, and the quadratic cost says that the fit is as good without it.

    Parameters
    ----------
    problem : LeastSquares
        Problem that was fitted; its `quadratic`, `low` and `high` are used.
    here : Quadratic
        At the fit.
    free : ndarray of bool, shape (n,)
        True for variables that are free in the fit.
    places : mapping of str to sequence of int
        Variables of each effect that is asked for, by its name.
    """
    found = []
    for name, at in places.items():
        if free[at].any() and np.abs(here.at[at]).max() > NOTICEABLE:
            off, others = np.zeros(len(free)), free.copy()
            off[at], others[at] = -here.at[at], False
            moved = replace(here, at=here.at + off, gradient=here.gradient + here.information @ off)
            off += moved.step(problem.low, problem.high, free=others)
            expected = here.cost - here.decrease(off)
            if problem.quadratic(here.at + off).cost > expected + SURPRISE:
                found.append(name)
    return found


def _likely_sizes(problem: LeastSquares, here: Quadratic, free: NDArray[np.bool_]) -> LikelySizes:
    """Sizes of the deviations that are not improbable, with the logarithm of what precedes drives.

    That is their probability before the drives, and the normaliser of the deviations' priors. Which
    sizes are probable is found with the effects that are free; there are no other deviations than
    of size `NO_DEVIATION` with a probability of 1 - `Effect.prior_probability`.
    """
    names, kept = list(problem.sizes.by_name()), np.flatnonzero(free)
    found, evidence = [], []
    acts = Effect.prior_probability
    before = [math.log(1.0 - acts), *[math.log(acts / len(SIZES))] * len(SIZES)]
    for chosen in product(range(1 + len(SIZES)), repeat=len(names)):
        sizes = {n: (NO_DEVIATION, *SIZES)[i] for n, i in zip(names, chosen, strict=True)}
        prior = sum(before[i] for i in chosen) + problem.sizes.log_normaliser(sizes)
        H = here.information + np.diag(problem.sizes.more_precision(sizes))
        found.append((sizes, prior))
        evidence.append(prior + _log_evidence(H, here.rhs, kept))
    order = np.argsort(-np.array(evidence))
    share = np.cumsum(np.exp(np.array(evidence)[order] - logsumexp(evidence)))
    count = min(MOST_SIZES, 1 + int(np.searchsorted(share, 1.0 - NEGLECTED)))
    return [found[i] for i in order[:count]]


def _log_evidence(information: FloatArray, rhs: FloatArray, at: NDArray[np.int64]) -> float:
    """Logarithm of the integral over variables, of which the others are 0."""
    factor = np.linalg.cholesky(information[np.ix_(at, at)])
    reduced = np.linalg.solve(factor, rhs[at])
    return float(0.5 * reduced @ reduced - np.log(np.diag(factor)).sum())
