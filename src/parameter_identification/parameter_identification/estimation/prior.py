"""Prior knowledge of the parameters: their ranges, or an earlier identification."""

from dataclasses import dataclass

import numpy as np

from excitation_planner.design.prior import BoxPrior
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray
from tricycle_sim.vehicle import Vehicle


@dataclass(frozen=True, eq=False)
class GaussianPrior:
    """Gaussian knowledge of parameters before the drives.

    Attributes
    ----------
    names : tuple of str
        Names of the k parameters.
    mean : ndarray of float, shape (k,)
        In their units.
    covariance : ndarray of float, shape (k, k)
        In their units.
    """

    names: tuple[str, ...]
    mean: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        k = len(self.names)
        if len(set(self.names)) < k:
            raise IdentificationError(f"prior: a parameter is named twice: {', '.join(self.names)}")
        if self.mean.shape != (k,) or self.covariance.shape != (k, k):
            raise IdentificationError(f"prior: needs mean ({k},) and covariance ({k}, {k})")
        if not np.all(np.linalg.eigvalsh(self.covariance) > 0):
            raise IdentificationError("prior: the covariance must be positive definite")


def box_prior(vehicle: Vehicle, prior: GaussianPrior | None) -> BoxPrior:
    """Return the prior of the unknown parameters, in their ranges (0 to 1).

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with k unknown parameters and their ranges.
    prior : GaussianPrior, optional
        Replaces the ranges for the parameters that it names; those that are known by now are left.

    Raises
    ------
    IdentificationError
        A prior of parameters that the vehicle does not have.
    """
    names = tuple(vehicle.unknown)
    low, high = np.array(list(vehicle.unknown.values())).T
    uniform = BoxPrior.uniform(len(names))
    if prior is None:
        return uniform
    mean, covariance = uniform.mean.copy(), uniform.covariance.copy()
    if misspelt := [name for name in prior.names if name not in vehicle.declared]:
        raise IdentificationError(
            f"prior: {', '.join(misspelt)}: {vehicle.name} has no such parameter; unknown are "
            f"{', '.join(names)}"
        )
    given = [i for i, name in enumerate(names) if name in prior.names]
    taken = [prior.names.index(names[i]) for i in given]
    width = (high - low)[given]
    mean[given] = (prior.mean[taken] - low[given]) / width
    part = prior.covariance[np.ix_(taken, taken)] / np.outer(width, width)
    covariance[np.ix_(given, given)] = 0.5 * (part + part.T)  # round-off aside, the same
    return BoxPrior(mean, covariance)
