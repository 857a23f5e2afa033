"""Start points of the search for a set of maneuvers: the best combinations of single ones.

The information of drives adds up. A few maneuvers of each family, simulated alone, therefore judge
all their combinations without further simulations.
"""

import numpy as np

from excitation_planner.box import Box
from excitation_planner.design.criteria import Criterion
from excitation_planner.design.information import (
    LEAST_SIMULATED,
    ManeuverSet,
    difference_points,
    information,
    information_costs,
    posterior_covariance,
    simulated_values,
)
from excitation_planner.design.noise import TrajectoryNoise
from excitation_planner.design.prior import NO_NUISANCES, BoxPrior, NuisanceParameters
from excitation_planner.indices.sampling import corners, sobol_sequence
from tricycle_core.errors import InfeasibleManeuver
from tricycle_core.quantities import FloatArray

SINGLES = 16
"""Maneuvers of each family beside the corners of its box."""

KEPT = 200
"""Best combinations that are combined with the next family's maneuvers."""

STARTS = 12
"""Combinations from which the search begins."""

APART = 0.1
"""Least distance between them on some axis, in ranges."""


def best_combinations(
    maneuvers: ManeuverSet,
    unknown: Box,
    noise: TrajectoryNoise,
    criterion: Criterion,
    target: int | None,
    *,
    draws: int,
    seed: int,
    prior: BoxPrior | None = None,
    nuisances: NuisanceParameters = NO_NUISANCES,
) -> tuple[FloatArray, int]:
    """Return the cheapest combinations of a few maneuvers of each family.

    Parameters
    ----------
    maneuvers : ManeuverSet
        Families of the set.
    unknown : Box
        Ranges of the unknown parameters.
    noise : TrajectoryNoise
        Noise of the measurement.
    criterion : Criterion
        Criterion: C, D or A.
    target : int or None
        Index of the parameter to excite, for C.
    draws : int
        Number of parameter values over which the criterion is averaged.
    seed : int
        Seed of the draws and of the maneuvers tried.
    prior : BoxPrior, optional
        Knowledge of the parameters before the drive; None: uniform.
    nuisances : NuisanceParameters
        Further uncertain inputs of the simulator (nuisance parameters).

    Returns
    -------
    points : ndarray of float, shape (s, l)
        Combinations, in the unit box of the set; none if no maneuver of one family can be driven.
    simulations : int
        Number of simulations that this took.
    """
    k = len(unknown)
    U = difference_points(k, draws, seed=seed, prior=prior, nuisances=nuisances)
    P = simulated_values(unknown, U)
    shape, simulations = k + nuisances.shared, 0
    points, total = np.empty((1, 0)), np.zeros((1, draws, shape, shape))
    for simulate, box in zip(maneuvers.simulators, maneuvers.operations, strict=True):
        singles, singles_information = [], []
        for u in _singles(len(box), seed):
            try:
                Y = simulate(box.from_unit(u), P)
            except InfeasibleManeuver:
                continue
            simulations += len(P)
            singles.append(u)
            singles_information.append(information(U, Y, noise, nuisances))
        if not singles:
            return np.empty((0, len(maneuvers.operation))), simulations
        points = np.hstack(
            [np.repeat(points, len(singles), axis=0), np.tile(singles, (len(points), 1))]
        )
        total = (total[:, None] + np.array(singles_information)).reshape(-1, draws, shape, shape)
        costs = _costs(total, criterion, target, prior, nuisances)
        best = np.argsort(costs, kind="stable")[:KEPT]
        best = best[np.isfinite(costs[best])]
        points, total = points[best], total[best]
    return _apart(points), simulations


def _singles(dimensions: int, seed: int) -> FloatArray:
    """Points (n, l) of a family's unit box."""
    inside = sobol_sequence(SINGLES, dimensions, seed=seed)
    return np.vstack([corners(dimensions, seed=seed), inside])


def _costs(
    total: FloatArray,
    criterion: Criterion,
    target: int | None,
    prior: BoxPrior | None,
    nuisances: NuisanceParameters,
) -> FloatArray:
    """Criterion (n,) of the information (n, draws, k + s, k + s); infinite with too few."""
    n, draws = total.shape[:2]
    flat = total.reshape(n * draws, *total.shape[2:])
    costs = np.full(n * draws, np.nan)
    usable = np.isfinite(flat).all(axis=(1, 2))  # no vehicle rolled over
    covariance = posterior_covariance(flat[usable], prior, nuisances)
    costs[usable] = information_costs(covariance, criterion, target)
    kept = np.isfinite(costs).reshape(n, draws)
    summed = np.where(kept, costs.reshape(n, draws), 0.0).sum(axis=1)
    enough = kept.sum(axis=1) >= LEAST_SIMULATED * draws
    return np.where(enough, summed / np.maximum(kept.sum(axis=1), 1), np.inf)


def _apart(points: FloatArray) -> FloatArray:
    """The first of the points, best first, that are not close to one another."""
    chosen = points[:1]
    for point in points[1:]:
        if len(chosen) == STARTS:
            break
        if np.abs(chosen - point).max(axis=1).min() >= APART:
            chosen = np.vstack([chosen, point])
    return chosen
