"""Combinations of parameters that the drives do not show."""

import math

import numpy as np

from excitation_planner.design.prior import SHOWN
from parameter_identification.estimation.optimum import Optimum
from parameter_identification.estimation.problem import LeastSquares
from parameter_identification.estimation.results import Combination

SMALL_WEIGHT = 0.25  # of a parameter that is not named in a combination


def hidden_combinations(problem: LeastSquares, optimum: Optimum) -> tuple[Combination, ...]:
    """Return the directions whose standard deviation stays above half of the prior's.

    They are eigenvectors of the posterior covariance in units of the prior's.

    Parameters
    ----------
    problem : LeastSquares
        Holds the prior.
    optimum : Optimum
        Holds what is known after the drives.
    """
    k, names = problem.k, tuple(problem.models[0].vehicle.unknown)
    root = np.linalg.cholesky(problem.information)  # information = root rootᵀ
    share, vectors = np.linalg.eigh(root.T @ optimum.covariance[:k, :k] @ root)
    found = []
    for variance, vector in zip(share[::-1], vectors.T[::-1], strict=True):
        if variance < SHOWN**2:
            break
        direction = np.linalg.solve(root.T, vector)
        direction /= np.linalg.norm(direction)
        direction *= np.sign(direction[np.argmax(np.abs(direction))])
        order = [i for i in np.argsort(-np.abs(direction)) if abs(direction[i]) > SMALL_WEIGHT]
        weights = {names[i]: float(direction[i]) for i in order}
        found.append(Combination(weights, float(min(1.0, math.sqrt(variance)))))
    return tuple(found)
