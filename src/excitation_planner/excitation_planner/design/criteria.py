"""What a maneuver is worth: the cost of exciting one parameter, and how costs are compared."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from excitation_planner.indices.sensitivity import Sensitivity, half_width
from tricycle_core.errors import DesignError
from tricycle_core.quantities import FloatArray


class Criterion(StrEnum):
    """What a design minimises."""

    H = "h"  # cost of exciting the target (Eq. 11), from the Sobol' indices of a scalar output
    C = "c"  # expected posterior variance of the target, from the information of trajectories
    D = "d"  # log volume of the posterior of all unknown parameters, likewise
    A = "a"  # sum of the posterior variances of all unknown parameters, likewise

    def search_scale(self, cost: float) -> float:
        """Monotone image of a cost that a quadratic follows better: H and variances have poles."""
        if self is Criterion.H:
            return math.log1p(cost)
        return cost if self is Criterion.D else math.log(cost)


@dataclass(frozen=True)
class TrajectoryErrorNoise:
    """Variance that noise of the measured position gives to a trajectory error (Eq. 14).

    ``V_n = 4 std² (E[TE] + std²) / points``

    Attributes
    ----------
    std : float
        Standard deviation of the position noise per axis, m.
    points : int
        Number of independent noise values in a trajectory. 1 bounds noise so slow that it is a
        constant offset.
    """

    std: float
    points: int = 1

    def __post_init__(self) -> None:
        if not (0 <= self.std < math.inf and self.points >= 1):
            raise DesignError("noise: std must not be negative, points at least 1")

    def __call__(self, m: FloatArray) -> float:
        """V_n (m⁴) from trajectory errors m (n,), m², of one maneuver."""
        return 4 * self.std**2 * (float(m.mean()) + self.std**2) / self.points


def excitation_cost(
    main: FloatArray, total: FloatArray, target: int, *, noise_share: float = 0.0
) -> float:
    """Cost H of exciting parameter ``target`` (Eq. 11); 0 is perfect.

    ``H_i = (ST_i - S_i + sum_{j != i} S_j + V_n / V) / S_i``: the interactions of the target,
    everybody else's main effects and, as one more contributor, the measurement noise.

    Parameters
    ----------
    main, total : ndarray (k,)
        Sobol' indices S and ST.
    noise_share : float
        V_n / V, variance of the output's noise by variance of the output. 0 is the paper's cost,
        which is degenerate where nothing moves: there it can find a perfect maneuver
        that excites nothing.
    """
    if main[target] <= 0.0:
        return math.inf
    others = float(main.sum() - main[target])
    return float((total[target] - main[target] + others + noise_share) / main[target])


def cost_interval(
    result: Sensitivity, target: int, *, noise_share: float = 0.0
) -> tuple[float, float]:
    """95 % interval of `excitation_cost`, from the folds of the indices."""
    cost = excitation_cost(result.main, result.total, target, noise_share=noise_share)
    folds = [
        # the noise keeps its variance, so that its share follows that of the output
        excitation_cost(
            f.main, f.total, target, noise_share=noise_share * result.variance / f.variance
        )
        for f in result.folds
    ]
    if not np.all(np.isfinite([cost, *folds])):
        return (0.0, math.inf)
    half = float(half_width(np.array(folds) - cost))
    return (max(0.0, cost - half), cost + half)
