"""Combinations of parameters that the drives do not show."""

import math

import numpy as np

from excitation_planner.design.prior import SHOWN, UNIFORM_STD
from parameter_identification.estimation.optimum import Optimum
from parameter_identification.estimation.problem import LeastSquares
from parameter_identification.estimation.results import Combination

SMALL_WEIGHT = 0.25  # of a parameter that is not named in a combination


def hidden_combinations(problem: LeastSquares, optimum: Optimum) -> tuple[Combination, ...]:
    """Return the directions whose standard deviation stays above half of that of the ranges.

    They are eigenvectors of the posterior covariance, in ranges.

    Parameters
    ----------
    problem : LeastSquares
        Holds the prior.
    optimum : Optimum
        Holds what is known after the drives.
    """
    k, names = problem.k, tuple(problem.models[0].vehicle.unknown)
    share, vectors = np.linalg.eigh(optimum.covariance[:k, :k] / UNIFORM_STD**2)
    found = []
    for variance, vector in zip(share[::-1], vectors.T[::-1], strict=True):
        if variance < SHOWN**2:
            break
        direction = vector * np.sign(vector[np.argmax(np.abs(vector))])
        order = [i for i in np.argsort(-np.abs(direction)) if abs(direction[i]) > SMALL_WEIGHT]
        weights = {names[i]: float(direction[i]) for i in order}
        found.append(Combination(weights, float(min(1.0, math.sqrt(variance)))))
    return tuple(found)
