"""Linear systems in the shape of an arrow: variables of all groups, and of each group alone.

Each group's own variables are eliminated (Schur complement), which leaves a small system of the
common ones. Time and memory grow in proportion to the groups.

Letters of shapes: `v` groups of n variables each, of which s are common to all.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tricycle_core.quantities import FloatArray

PATIENCE = 3  # exchanges of all variables without fewer at a wrong place
EXCHANGES = 200  # at most; a handful are the rule


@dataclass(frozen=True, eq=False)
class Arrow:
    """A quadratic cost; half its second and first derivatives at a point.

    Attributes
    ----------
    information : ndarray of float, shape (v, n, n)
        Half the second derivatives of the cost of each of v groups, by its n variables.
    gradient : ndarray of float, shape (v, n)
        Half the first derivatives of the cost of each group, by its variables.
    common : ndarray of int, shape (s,)
        Indices of those of the n variables that are the same in all groups.
    prior_information : ndarray of float, shape (s, s)
        Information of the common ones beside the groups.
    prior_gradient : ndarray of float, shape (s,)
        Gradient of the common ones beside the groups.
    """

    information: FloatArray
    gradient: FloatArray
    common: NDArray[np.int64]
    prior_information: FloatArray
    prior_gradient: FloatArray

    @property
    def own(self) -> NDArray[np.int64]:
        """Indices of the variables that each group has for itself."""
        return np.setdiff1d(np.arange(self.information.shape[1]), self.common)

    def _eliminated(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Information (s, s), gradient (s,) of the common ones; sensitivities (v, m, s)."""
        own, common = self.own, self.common
        alone = self.information[:, own[:, None], own]
        across = self.information[:, own[:, None], common]
        both = np.concatenate([across, self.gradient[:, own, None]], axis=2)
        solved = np.linalg.solve(alone, both)
        information = (
            self.information[:, common[:, None], common].sum(axis=0) + self.prior_information
        )
        information = information - np.einsum("vms,vmt->st", across, solved[:, :, :-1])
        gradient = self.gradient[:, common].sum(axis=0) + self.prior_gradient
        gradient = gradient - np.einsum("vms,vm->s", across, solved[:, :, -1])
        return information, gradient, -solved[:, :, :-1]

    def covariances(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the covariance, taken apart.

        Returns
        -------
        common : ndarray of float, shape (s, s)
            Covariance of the common variables.
        own : ndarray of float, shape (v, m, m)
            Covariance of the own variables of each group, if the common ones were known.
        sensitivity : ndarray of float, shape (v, m, s)
            By how much own ones change with the common ones: the covariance of the own variables of
            groups a and b is `sensitivity[a] @ common @ sensitivity[b].T`, plus `own[a]` where they
            are the same.
        """
        information, _, sensitivity = self._eliminated()
        own = self.own
        alone = np.linalg.inv(self.information[:, own[:, None], own])
        return np.asarray(np.linalg.inv(information)), np.asarray(alone), sensitivity

    def step(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """Return the step (v, n) to the minimum within bounds.

        Variables beyond a bound are held there, and held ones that the cost draws back inside are
        released, all at once; one at a time where that does not lead to fewer of them.

        Parameters
        ----------
        low, high : ndarray of float, shape (v, n)
            Bounds of the step, which include 0; those of a common variable are the same in all
            groups.

        References
        ----------
        J. J. Judice, F. M. Pires, Computers & Operations Research 21 (1994) 587-596.
        """
        side = np.zeros(self.gradient.shape, dtype=np.int64)  # -1, 1: held at the low, high bound
        counted = np.ones(side.shape, dtype=bool)
        counted[1:, self.common] = False
        least, patience = side.size + 1, PATIENCE
        for _ in range(EXCHANGES):
            step = self._holding(side != 0, np.where(side < 0, low, high))
            slope = self._slope(step)
            beyond = (side == 0) & ((step < low) | (step > high))
            drawn_back = side * slope > 1e-12 * np.abs(self.gradient).max()
            wrong = beyond | drawn_back
            count = int(np.count_nonzero(wrong & counted))
            if not count:
                break
            least, patience = (count, PATIENCE) if count < least else (least, patience - 1)
            if patience < 0:
                last = np.zeros(side.shape, dtype=bool)
                group, variable = np.argwhere(wrong & counted)[-1]
                last[slice(None) if variable in self.common else group, variable] = True
                wrong &= last
            side = np.where(wrong, np.where(beyond, np.where(step < low, -1, 1), 0), side)
        return np.clip(step, low, high)

    def _slope(self, step: FloatArray) -> FloatArray:
        """Half the derivatives (v, n) of the cost after a step; of common variables in all."""
        slope: FloatArray = self.gradient + np.einsum("vij,vj->vi", self.information, step)
        shared = self.prior_gradient + self.prior_information @ step[0, self.common]
        slope[:, self.common] = slope[:, self.common].sum(axis=0) + shared
        return slope

    def decrease(self, step: FloatArray) -> float:
        """Return by how much a step lowers the cost.

        Parameters
        ----------
        step : ndarray of float, shape (v, n)
            Step of all variables, by group.
        """
        shared = step[0, self.common]
        lowers = np.einsum("vi,vi->", step, 2.0 * self.gradient)
        lowers += np.einsum("vi,vij,vj->", step, self.information, step)
        return -float(
            lowers + shared @ (2.0 * self.prior_gradient + self.prior_information @ shared)
        )

    def _holding(self, held: NDArray[np.bool_], at: FloatArray) -> FloatArray:
        """The step (v, n) where some variables make the steps that they have."""
        known = np.where(held, at, 0.0)
        gradient = self.gradient + np.einsum("vij,vj->vi", self.information, known)
        free = ~held
        kept = free[:, :, None] & free[:, None, :]
        fixed_common = held[0, self.common]
        free_common = ~fixed_common
        prior_gradient = self.prior_gradient + self.prior_information @ known[0, self.common]
        reduced = Arrow(
            np.where(kept, self.information, 0.0) + held[:, :, None] * np.eye(held.shape[1]),
            np.where(free, gradient, 0.0),
            self.common,
            np.where(np.outer(free_common, free_common), self.prior_information, 0.0),
            np.where(free_common, prior_gradient, 0.0),
        )
        information, slope, sensitivity = reduced._eliminated()
        own, common = self.own, self.common
        step = known.copy()
        shared = np.linalg.solve(information, -slope)
        alone = reduced.information[:, own[:, None], own]
        lone = np.linalg.solve(alone, -reduced.gradient[:, own, None])[:, :, 0]
        step[:, common] += np.where(free_common, shared, 0.0)
        step[:, own] += np.where(held[:, own], 0.0, lone + sensitivity @ shared)
        return step
