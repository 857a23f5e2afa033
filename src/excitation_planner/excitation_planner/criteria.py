"""What a maneuver is worth: the cost of exciting one parameter."""

from __future__ import annotations

import math

import numpy as np

from excitation_planner.box import FloatArray
from excitation_planner.sensitivity import Sensitivity


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
    """95 % interval of `excitation_cost` from those of the indices, taken as independent."""
    cost = excitation_cost(result.main, result.total, target, noise_share=noise_share)
    if not math.isfinite(cost):
        return (0.0, math.inf)
    main_half = np.ptp(result.main_interval, axis=1) / 2
    total_half = np.ptp(result.total_interval, axis=1) / 2
    slope = np.ones(len(main_half))  # of H S_i with respect to each main index
    slope[target] = -(1.0 + cost)
    half = float(np.sqrt(np.sum((slope * main_half) ** 2) + total_half[target] ** 2))
    half /= float(result.main[target])
    return (max(0.0, cost - half), cost + half)
