"""Prior knowledge about the unknown parameters, before a drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from tricycle_core.errors import DesignError
from tricycle_core.quantities import FloatArray

UNIFORM_STD = 12.0**-0.5
"""Standard deviation of a parameter that is uniform on its range, in ranges."""

SHOWN = 0.5
"""Share of a standard deviation that may be left of a parameter that is shown.

In an identification it is that of the range, as earlier drives count too; in a plan it is that of
the prior, as the planned drive is to tell more.
"""


@dataclass(frozen=True)
class NuisanceParameters:
    """Nuisance parameters: uncertain inputs after the parameters that are not of interest.

    They are normally distributed with mean 0 and standard deviation 1.

    Attributes
    ----------
    steps : tuple of float
        Finite-difference step of each nuisance parameter.
    own : int
        Number of them, the last ones, that have another value in each maneuver of a set.

    Raises
    ------
    DesignError
        If a step is zero or not finite, or `own` exceeds their number.
    """

    steps: tuple[float, ...] = ()
    own: int = 0

    def __post_init__(self) -> None:
        if not all(np.isfinite(step) and step != 0.0 for step in self.steps):
            raise DesignError(f"nuisances: steps = {self.steps} must be finite and not zero")
        if not 0 <= self.own <= len(self.steps):
            raise DesignError(f"nuisances: own = {self.own} must be from 0 to {len(self.steps)}")

    @property
    def shared(self) -> int:
        """Number of them that have the same value in all maneuvers of a set."""
        return len(self.steps) - self.own


NO_NUISANCES = NuisanceParameters()


@dataclass(frozen=True)
class BoxPrior:
    """Normal distribution of the parameters in their unit box, e.g. learnt from earlier drives.

    Attributes
    ----------
    mean : ndarray of float, shape (k,)
        Mean in the unit box.
    covariance : ndarray of float, shape (k, k)
        Covariance in squared ranges.

    Raises
    ------
    DesignError
        If shapes do not fit, or the matrix is not a covariance.
    """

    mean: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        k = len(self.mean)
        C = np.asarray(self.covariance)
        if not (C.shape == (k, k) and np.isfinite(C).all() and np.isfinite(self.mean).all()):
            raise DesignError(f"prior: the covariance must be ({k}, {k}) finite numbers")
        if not (np.allclose(C, C.T) and np.linalg.eigvalsh(C)[0] > 0.0):
            raise DesignError("prior: the covariance must be symmetric and positive definite")

    @classmethod
    def uniform(cls, k: int) -> Self:
        """Return the normal distribution with mean and variance of a uniform one in the unit box.

        Parameters
        ----------
        k : int
            Number of parameters.
        """
        return cls(np.full(k, 0.5), np.eye(k) / 12.0)

    @property
    def std(self) -> FloatArray:
        """Marginal standard deviation (k,) of each parameter, in ranges."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def information(self) -> FloatArray:
        """Inverse of the covariance, shape (k, k)."""
        return np.asarray(np.linalg.inv(self.covariance), dtype=np.float64)
