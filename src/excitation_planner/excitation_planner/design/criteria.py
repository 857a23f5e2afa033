"""Criteria: what a design minimises, and the paper's cost H of exciting one parameter."""

from __future__ import annotations

import math

from excitation_planner.choice import Choice
from tricycle_core.quantities import FloatArray


class Criterion(Choice):
    """Quantity that a design minimises."""

    H = "h"  # cost of exciting the target (Eq. 11), from the Sobol' indices of a scalar output
    C = "c"  # expected posterior variance of the target, from the information of trajectories
    D = "d"  # log volume of the posterior of all unknown parameters, likewise
    A = "a"  # sum of the posterior variances of all unknown parameters, likewise

    def search_scale(self, cost: float) -> float:
        """Monotone image of a cost that a quadratic follows better: H and variances have poles."""
        if self is Criterion.H:
            return math.log1p(cost)
        return cost if self is Criterion.D else math.log(cost)


def excitation_cost(
    main: FloatArray, total: FloatArray, target: int, *, noise_share: float = 0.0
) -> float:
    """Return the cost H of exciting parameter ``target`` (Eq. 11); 0 is perfect.

    ``H_i = (ST_i - S_i + sum_{j != i} S_j + V_n / V) / S_i``: the interactions of the target, the
    main effects of all others and, as one more contributor, the measurement noise.

    Parameters
    ----------
    main, total : ndarray of float, shape (k,)
        Sobol' indices S and ST.
    target : int
        Axis of the parameter.
    noise_share : float
        V_n / V, variance of the output's noise divided by the variance of the output. 0 is the
        paper's cost, which is degenerate where nothing moves: there it can find a perfect maneuver
        that excites nothing.
    """
    if main[target] <= 0.0:
        return math.inf
    others = float(main.sum() - main[target])
    return float((total[target] - main[target] + others + noise_share) / main[target])
