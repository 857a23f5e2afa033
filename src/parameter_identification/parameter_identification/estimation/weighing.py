"""Weighing effects by the data: the average over the models with and without each of them.

Near the minimum the residuals are linear in parameters and effects, so that the evidence of every
subset of the effects follows from one gram matrix (Laplace's method, exact for linear residuals).
The parameters' distribution is the mixture of those of all subsets: it counts that nobody knows
which effects act. An effect that the data cannot tell from a parameter keeps about the probability
that it had before, and with it widens the tails. The deviations are in every subset: their sizes
are estimated.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import logsumexp
from scipy.stats import norm

from parameter_identification.estimation.optimum import Optimum
from parameter_identification.estimation.problem import LeastSquares
from tricycle_core.quantities import FloatArray

ACTS = 0.1  # probability of each effect before the drives: about one of them acts
ROUNDS = 3  # of weights, and fit with the most probable effects


@dataclass(frozen=True, eq=False)
class Mixture:
    """Normal distributions of d variables, one per subset of the effects.

    Attributes
    ----------
    weights : ndarray of float, shape (s,)
        Probability of each subset.
    acting : ndarray of bool, shape (s, g)
        Which effects it has.
    means : ndarray of float, shape (s, d)
        Of the variables; 0 for effects that it lacks.
    covariances : ndarray of float, shape (s, d, d)
        Of the variables.
    """

    weights: FloatArray
    acting: NDArray[np.bool_]
    means: FloatArray
    covariances: FloatArray

    def covariance(self, about: FloatArray) -> FloatArray:
        """Return the second moments (d, d) about a point.

        Parameters
        ----------
        about : ndarray of float, shape (d,)
            The point.
        """
        off = self.means - about
        found: FloatArray = np.einsum("s,sij->ij", self.weights, self.covariances)
        return found + (self.weights[:, None] * off).T @ off

    def quantile(self, i: int, probability: float) -> float:
        """Return the value below which a variable is with a probability.

        Parameters
        ----------
        i : int
            Number of the variable.
        probability : float
            Between 0 and 1.
        """
        mean, std = self.means[:, i], np.sqrt(self.covariances[:, i, i])
        ends = mean + norm.ppf(probability) * std
        if np.ptp(ends) == 0.0:
            return float(ends[0])

        def excess(value: float) -> float:
            return float(self.weights @ norm.cdf((value - mean) / std)) - probability

        return float(brentq(excess, ends.min() - 1e-9, ends.max() + 1e-9))


def mixture(information: FloatArray, pull: FloatArray, groups: list[list[int]]) -> Mixture:
    """Return the average over all subsets of effects.

    Parameters
    ----------
    information : ndarray of float, shape (d, d)
        Of parameters and effects, with their priors; effects have a prior of mean 0, deviation 1.
    pull : ndarray of float, shape (d,)
        Information times the mean.
    groups : list of list of int
        Variables of each effect.

    References
    ----------
    A. E. Raftery, D. Madigan, J. A. Hoeting, J. Am. Stat. Assoc. 92 (1997) 179-191.
    """
    d = len(pull)
    acting = np.array(list(product((False, True), repeat=len(groups))))
    kept = np.ones((len(acting), d), dtype=bool)
    for g, members in enumerate(groups):
        kept[:, members] = acting[:, g : g + 1]
    both = kept[:, :, None] & kept[:, None, :]
    covariances = np.linalg.inv(np.where(both, information, np.eye(d)))
    pulls = np.where(kept, pull, 0.0)
    means = np.einsum("sij,sj->si", covariances, pulls)
    evidence = 0.5 * np.sum(means * pulls, axis=1) + 0.5 * np.linalg.slogdet(covariances)[1]
    evidence += np.sum(acting, axis=1) * np.log(ACTS / (1.0 - ACTS))
    return Mixture(
        np.exp(evidence - logsumexp(evidence)), acting, means, np.where(both, covariances, 0.0)
    )


def weigh_effects(
    problem: LeastSquares, optimum: Optimum
) -> tuple[Optimum, Mixture, dict[str, float]]:
    """Return the fit with the most probable effects, and what the average over all subsets says.

    That is the distribution of parameters and effects, and the probability of each effect by name.

    Parameters
    ----------
    problem : LeastSquares
        Its effects; the noise and the sizes of the deviations are estimated anew.
    optimum : Optimum
        The best fit with all effects.
    """
    names, places = zip(*problem.constant_effects().items(), strict=True)
    variables = np.append(np.arange(problem.k), sorted(i for at in places for i in at)).astype(int)
    where = {v: i for i, v in enumerate(variables.tolist())}
    groups = [[where[i] for i in at] for at in places]
    rest = np.setdiff1d(np.arange(problem.n), variables)
    fit, free = optimum.fit, np.ones(problem.n, dtype=bool)
    for _ in range(ROUNDS):
        gram = problem.gram(fit.at)
        H, pull = gram[:-1, :-1], gram[:-1, :-1] @ fit.at - gram[:-1, -1]
        onto = np.linalg.solve(H[np.ix_(rest, rest)], H[np.ix_(rest, variables)])
        found = mixture(
            H[np.ix_(variables, variables)] - H[np.ix_(variables, rest)] @ onto,
            pull[variables] - onto.T @ pull[rest],
            groups,
        )
        best = found.acting[np.argmax(found.weights)]
        acts = np.ones(problem.n, dtype=bool)
        for at, acting in zip(places, best, strict=True):
            acts[at] = acting
        if np.array_equal(acts, free):
            break
        free = acts
        fit = problem.minimise(np.where(free, fit.at, 0.0), free)
        problem.estimate_sizes(fit.at)
        problem.estimate_noise(fit.at)
        fit = problem.minimise(fit.at, free)
    covariance = np.zeros((problem.n, problem.n))
    covariance[np.ix_(free, free)] = np.linalg.inv(gram[:-1, :-1][np.ix_(free, free)])
    covariance[np.ix_(variables, variables)] = found.covariance(fit.at[variables])
    acting = (found.weights @ found.acting).tolist()
    return (
        replace(optimum, fit=fit, covariance=covariance),
        found,
        dict(zip(names, acting, strict=True)),
    )
