"""Search for the best fit: several starts, noise and fit in turns, and other minima as good."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from parameter_identification.drives.measured import Sensor
from parameter_identification.estimation import chi_square
from parameter_identification.estimation.levenberg_marquardt import Fit
from parameter_identification.estimation.noise import NoiseLevel
from parameter_identification.estimation.problem import LeastSquares
from parameter_identification.estimation.tally import uncounted
from tricycle_core.quantities import FloatArray

ROUGH = 0.3  # of the cost: tolerance of fits of which most are discarded
NOISE_ROUNDS = 6  # of noise and fit in turns
SAME_MINIMUM = 0.02  # of the ranges between minima that are counted as one


@dataclass(frozen=True, eq=False)
class Optimum:
    """Best fit of a least-squares problem of n variables, k of them parameters.

    Attributes
    ----------
    fit : Fit
        The minimum, or where the search for it was given up.
    covariance : ndarray of float, shape (n, n)
        Covariance of the variables: inverse information at the minimum.
    rivals : tuple of ndarray of float, shape (k,)
        Parameters, in their ranges, of other minima that fit as well.
    starts : (int, int)
        Number of fits, and how many of them ended at the best one.
    """

    fit: Fit
    covariance: FloatArray
    rivals: tuple[FloatArray, ...]
    starts: tuple[int, int]


def find_optimum(
    problem: LeastSquares,
    *,
    starts: int,
    seed: int,
    level: float,
    near: Sequence[FloatArray] | None = None,
    count: Callable[[], None] = uncounted,
) -> Optimum:
    """Find the best fit and the noise that belongs to it; the noise stays set in the problem.

    Parameters
    ----------
    problem : LeastSquares
        The problem, with its first guess of the noise.
    starts : int
        Number of fits from different starts.
    seed : int
        Seed of the starts.
    level : float
        Probability of the intervals: a minimum within what they allow is a rival.
    near : sequence of ndarray of float, shape (k,), optional
        Parameters, in their ranges, to start from instead.
    count : callable
        Called after each of at most `counts_to_optimum`.
    """
    candidates = [problem.variables.beginning(z) for z in near or ()]
    candidates = candidates or problem.candidates(starts, seed)
    fits = []
    for start in candidates:
        fits.append(problem.minimise(start, tolerance=ROUGH))
        count()
    lowest = min(fits, key=lambda fit: fit.cost)
    first = settled(problem, lowest, count)
    if problem.variables.of_deviations.any():
        other = _after_one_without_deviations(problem, first)
        if other.cost < first.cost - ROUGH:
            first = settled(problem, other)
    others = [fit for fit in fits if fit is not lowest]
    best, rivals, agreed = _compare(problem, others, first, level, count)
    if best is not first:  # the noise is that of the other one
        best = settled(problem, best)
    covariance = problem.quadratic(best.at).covariance()
    return Optimum(best, covariance, tuple(rivals), (len(fits), 1 + agreed))


def counts_to_optimum(problem: LeastSquares, starts: int) -> int:
    """Return how often `find_optimum` counts at most.

    Parameters
    ----------
    problem : LeastSquares
        The problem.
    starts : int
        Number of fits from different starts.
    """
    return 2 * starts - 1 + NOISE_ROUNDS * (len(problem.noise) + 1)


def rough_minima(
    problem: LeastSquares, *, starts: int, seed: int, count: Callable[[], None] = uncounted
) -> list[FloatArray]:
    """Return the parameters (k,) of different minima, by the first guess of the noise.

    Parameters
    ----------
    problem : LeastSquares
        The problem.
    starts : int
        Number of fits from different starts.
    seed : int
        Seed of the starts.
    count : callable
        Called after each of them.
    """
    found: list[Fit] = []
    for start in problem.candidates(starts, seed):
        fit = problem.minimise(start, tolerance=ROUGH)
        if not any(_near(fit, other, problem.k) for other in found):
            found.append(fit)
        count()
    return [fit.at[: problem.k] for fit in found]


def settled(problem: LeastSquares, fit: Fit, count: Callable[[], None] = uncounted) -> Fit:
    """Return the fit with the noise that belongs to it; the noise stays set in the problem.

    Parameters
    ----------
    problem : LeastSquares
        The problem.
    fit : Fit
        Fit by another noise, near which the search begins.
    count : callable
        Called after each fit, and each sensor's noise.
    """
    for _ in range(NOISE_ROUNDS):
        before = problem.noise
        problem.estimate_sizes(fit.at)
        problem.estimate_noise(fit.at, count)
        fit = problem.minimise(fit.at)
        count()
        if _same_noise(before, problem.noise):
            break
    return fit


def _after_one_without_deviations(problem: LeastSquares, fit: Fit) -> Fit:
    """A fit that begins where deviations, which adapt easily, cannot yet do what an effect does."""
    start = np.where(problem.variables.of_deviations, 0.0, fit.at)
    without = problem.minimise(start, ~problem.variables.of_deviations, tolerance=ROUGH)
    return problem.minimise(without.at, tolerance=ROUGH)


def _same_noise(a: Mapping[Sensor, NoiseLevel], b: Mapping[Sensor, NoiseLevel]) -> bool:
    """Whether another round would hardly change the weights."""
    return all(
        abs(math.log(a[s].white / b[s].white)) < 0.02
        and abs(a[s].drift - b[s].drift) < 0.05 * b[s].white
        for s in a
    )


def _compare(
    problem: LeastSquares,
    fits: Sequence[Fit],
    best: Fit,
    level: float,
    count: Callable[[], None],
) -> tuple[Fit, list[FloatArray], int]:
    """Repeat other fits with the final noise: the best of all, its rivals (k,), and the agreement.

    A rival is a different minimum whose cost is within what the interval allows, at parameters
    that the intervals do not hold anyway: along a valley fits end wherever they are near enough.
    """
    allowed, k = chi_square.quantile(level, 1), problem.k
    ends = [best]
    for fit in fits:
        count()
        if not _near(fit, best, k):
            ends.append(problem.minimise(fit.at, tolerance=ROUGH))
    lowest, rivals = min(ends, key=lambda end: end.cost), []
    agreed = len(fits) + 1 - len(ends) if lowest is best else 0
    for end in ends:
        if end is lowest:
            continue
        if _near(end, lowest, k) or _in_one_valley(problem, end, lowest, allowed):
            agreed += 1
        elif end.cost < lowest.cost + allowed:
            rivals.append(end.at[:k])
    return lowest, rivals, agreed


def _in_one_valley(problem: LeastSquares, fit: Fit, best: Fit, allowed: float) -> bool:
    """Whether the intervals of the best fit hold the parameters of another one."""
    apart = (fit.at - best.at)[: problem.k]
    covariance = problem.quadratic(best.at).covariance()[: problem.k, : problem.k]
    return bool(apart @ np.linalg.solve(covariance, apart) < allowed)


def _near(a: Fit, b: Fit, k: int) -> bool:
    return bool(np.all(np.abs(a.at[:k] - b.at[:k]) < SAME_MINIMUM))
