"""Unknowns of one drive that are no parameters of the vehicle."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tricycle_core.quantities import FloatArray
from tricycle_sim.effects import Effect


@dataclass(frozen=True)
class Nuisance:
    """An unknown of one drive that is no vehicle parameter, with its Gaussian prior.

    Attributes
    ----------
    name : str
        E.g. "start heading".
    unit : str
        Unit of the mean, the standard deviation and the bounds.
    mean, std : float
        Mean and standard deviation of the prior.
    low, high : float
        Values between which it lies.
    effect : Effect, optional
        Effect that the nuisance belongs to; None: to no effect.
    """

    name: str
    unit: str
    mean: float
    std: float
    low: float = -math.inf
    high: float = math.inf
    effect: Effect | None = None


class InUnits:
    """Converts nuisances from standard deviations from their means to their units.

    Parameters
    ----------
    nuisances : sequence of Nuisance
        All q of them.

    Attributes
    ----------
    means, deviations : ndarray of float, shape (q,)
        Means and standard deviations of the nuisances' priors, in their units.
    """

    def __init__(self, nuisances: Sequence[Nuisance]) -> None:
        self.means = np.array([n.mean for n in nuisances])
        self.deviations = np.array([n.std for n in nuisances])

    def __call__(self, values: FloatArray) -> FloatArray:
        """Return values (..., q) in their units.

        Parameters
        ----------
        values : ndarray of float, shape (..., q)
            In standard deviations from the means.
        """
        found: FloatArray = self.means + self.deviations * values
        return found
