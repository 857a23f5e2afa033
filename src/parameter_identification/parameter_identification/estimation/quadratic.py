"""A cost near a point, to the second order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from tricycle_core.quantities import FloatArray


@dataclass(frozen=True, eq=False)
class Quadratic:
    """A cost near a point: a step s changes it by 2 gradient · s + sᵀ information s.

    Attributes
    ----------
    at : ndarray of float, shape (n,)
        The point.
    cost : float
        There: squared residuals over their variances.
    gradient : ndarray of float, shape (n,)
        Half the first derivatives.
    information : ndarray of float, shape (n, n)
        Half the second ones, as Gauss and Newton approximate them: the inverse covariance.
    """

    at: FloatArray
    cost: float
    gradient: FloatArray
    information: FloatArray

    @classmethod
    def of_gram(cls, at: FloatArray, gram: FloatArray) -> Self:
        """Return the cost of linear residuals.

        Parameters
        ----------
        at : ndarray of float, shape (n,)
            The point.
        gram : ndarray of float, shape (n + 1, n + 1)
            [J r]ᵀ[J r], of the residuals r there and their derivatives J.
        """
        return cls(at, float(gram[-1, -1]), gram[:-1, -1], gram[:-1, :-1])

    def of(self, places: NDArray[np.int64] | NDArray[np.bool_]) -> Quadratic:
        """Return the cost by some of the variables, the others held.

        Parameters
        ----------
        places : ndarray of int, shape (m,), or of bool, shape (n,)
            Indices of these variables, or True where they are.
        """
        block = self.information[np.ix_(places, places)]
        return Quadratic(self.at[places], self.cost, self.gradient[places], block)

    def with_prior(self, mean: FloatArray, information: FloatArray) -> Quadratic:
        """Return the cost with that of a prior of the first k variables.

        Parameters
        ----------
        mean : ndarray of float, shape (k,)
            Mean of the prior.
        information : ndarray of float, shape (k, k)
            Inverse covariance of the prior; less 0 where one is taken out of the cost.
        """
        k = len(mean)
        off = self.at[:k] - mean
        pull = information @ off
        gradient, whole = self.gradient.copy(), self.information.copy()
        gradient[:k] += pull
        whole[:k, :k] += information
        return Quadratic(self.at, self.cost + float(off @ pull), gradient, whole)

    @property
    def finite(self) -> bool:
        """Whether cost, gradient and information are finite."""
        return bool(np.isfinite([self.cost, self.gradient.sum(), self.information.sum()]).all())

    @property
    def rhs(self) -> FloatArray:
        """Right-hand side (n,) of the normal equations, `information @ minimum() = rhs`."""
        rhs: FloatArray = self.information @ self.at - self.gradient
        return rhs

    @property
    def cost_of_zero(self) -> float:
        """Cost of variables that are all 0."""
        return self.cost + float((self.rhs - self.gradient) @ self.at)

    def covariance(self, free: NDArray[np.bool_] | None = None) -> FloatArray:
        """Return the inverse of the information, shape (n, n).

        Parameters
        ----------
        free : ndarray of bool, shape (n,), optional
            Variables that are not held; the others have no variance. Default: all.
        """
        if free is None:
            return np.asarray(np.linalg.inv(self.information), dtype=np.float64)
        found, block = np.zeros_like(self.information), np.ix_(free, free)
        found[block] = np.linalg.inv(self.information[block])
        return found

    def minimum(self) -> FloatArray:
        """Return the point (n,) of the least cost, without bounds."""
        found: FloatArray = self.at - np.linalg.solve(self.information, self.gradient)
        return found

    def step(
        self,
        low: FloatArray,
        high: FloatArray,
        *,
        free: NDArray[np.bool_] | None = None,
        damping: FloatArray | float = 0.0,
    ) -> FloatArray:
        """Return the step (n,) to the least cost within bounds.

        Parameters
        ----------
        low, high : ndarray of float, shape (n,)
            Bounds of the point.
        free : ndarray of bool, shape (n,), optional
            Variables that change. Default: all.
        damping : float or ndarray of float, shape (n,)
            Damping of Levenberg and Marquardt: added to the information's diagonal.
        """
        at = np.arange(len(self.at)) if free is None else np.flatnonzero(free)
        factor = np.linalg.cholesky(
            self.information[np.ix_(at, at)] + np.diag(np.broadcast_to(damping, self.at.shape)[at])
        )
        wanted = np.linalg.solve(factor, -self.gradient[at])
        bounds = low[at] - self.at[at], high[at] - self.at[at]
        found = np.linalg.solve(factor.T, wanted)
        if np.any((found < bounds[0]) | (found > bounds[1])):
            found = lsq_linear(factor.T, wanted, bounds, method="bvls").x
        step = np.zeros(len(self.at))
        step[at] = found
        return step

    def lacking(self, step: FloatArray, there: Self) -> FloatArray:
        """Return the curvature (n,) along each variable that this cost lacks, from one elsewhere.

        That of the secant, as large as 1 at least; it is large where the slope has a kink.

        Parameters
        ----------
        step : ndarray of float, shape (n,)
            From the point to the other.
        there : Quadratic
            The cost near the other point.
        """
        change = there.gradient - self.gradient - self.information @ step
        work = change * step
        large = work > 0.1 * np.maximum(work, 0.0).sum()
        return np.maximum(1.0, np.divide(change, step, out=np.zeros(len(step)), where=large))

    def decrease(self, step: FloatArray) -> float:
        """Return by how much a step lowers the cost.

        Parameters
        ----------
        step : ndarray of float, shape (n,)
            From the point.
        """
        return -float(step @ (2.0 * self.gradient + self.information @ step))
