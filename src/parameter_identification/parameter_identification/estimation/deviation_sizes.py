"""How large deviations are: the standard deviations of their priors, estimated from the drives.

A deviation has a value at each of its knots, in every drive. All values of one have the same prior,
of mean 0; its standard deviation, the size, is in those of the effect's prior.
"""

import math
from collections.abc import Mapping

import numpy as np

from parameter_identification.estimation import chi_square
from parameter_identification.estimation.quadratic import Quadratic
from parameter_identification.estimation.variables import ProblemVariables
from tricycle_core.quantities import FloatArray

LEAST_SIZE, FIRST_SIZE, MOST_SIZE = 0.02, 0.1, 20.0  # of a deviation, in deviations of its prior


class DeviationSizes:
    """Sizes of the deviations of a problem, and what follows from them.

    Parameters
    ----------
    variables : ProblemVariables
        Tell where the deviations are.

    Attributes
    ----------
    precision : ndarray of float, shape (n - k,)
        Inverse variance of the prior of each nuisance: 1 for those of no deviation.
    """

    def __init__(self, variables: ProblemVariables) -> None:
        self._k, self._n = variables.k, variables.n
        self._places = variables.deviations
        self.precision = np.ones(self._n - self._k)
        for at in self._places.values():  # they grow where the data ask for it
            self.precision[at - self._k] = 1.0 / FIRST_SIZE**2

    def by_name(self) -> dict[str, float]:
        """Return the size of each deviation, in standard deviations of its prior, by name."""
        return {
            e.name: 1.0 / math.sqrt(float(self.precision[at[0] - self._k]))
            for e, at in self._places.items()
        }

    def set(self, sizes: Mapping[str, float]) -> None:
        """Set how large the deviations are.

        Parameters
        ----------
        sizes : mapping of str to float
            Standard deviation of each, in those of its effect's prior, by name.
        """
        self.precision = self.precision + self.more_precision(sizes)[self._k :]

    def estimate(self, here: Quadratic) -> None:
        """Set how large the deviations are, for which their estimates are most likely.

        Parameters
        ----------
        here : Quadratic
            Cost at the estimates.

        References
        ----------
        D. J. C. MacKay, Neural Computation 4 (1992) 415-447, Eq. 4.8.
        """
        variance = np.diag(here.covariance())
        for at in self._places.values():
            of_priors = at - self._k
            shown = np.sum(1.0 - self.precision[of_priors] * variance[at])
            square = np.sum(here.at[at] ** 2) / max(shown, 1e-3)  # of the size
            self.precision[of_priors] = 1.0 / np.clip(square, LEAST_SIZE**2, MOST_SIZE**2)

    def more_precision(self, sizes: Mapping[str, float]) -> FloatArray:
        """Return the prior information (n,) that other sizes of the deviations add.

        Parameters
        ----------
        sizes : mapping of str to float
            As for `set`.
        """
        more = np.zeros(self._n)
        for e, at in self._places.items():
            more[at] = 1.0 / sizes[e.name] ** 2 - self.precision[at - self._k]
        return more

    def log_normaliser(self, sizes: Mapping[str, float]) -> float:
        """Return the logarithm of the density of no deviation, for their sizes, but for a constant.

        Parameters
        ----------
        sizes : mapping of str to float
            As for `set`.
        """
        return -sum(len(at) * math.log(sizes[e.name]) for e, at in self._places.items())

    def chances(self, here: Quadratic) -> dict[str, float]:
        """Return the probability of drives that show as much of each deviation, if there were none.

        The score test of a variance component: without the deviation, the derivatives of the cost
        along its bases are normal, with the information of the drives as their covariance. The sum
        of their squares is compared with a chi-squared distribution of the same mean and variance.

        Parameters
        ----------
        here : Quadratic
            Cost at the minimum.

        Returns
        -------
        chances : dict of str to float
            By name of the deviation.

        References
        ----------
        X. Lin, Biometrika 84 (1997) 309-326.
        """
        chances = {}
        information, rhs = here.information, here.rhs
        for e, at in self._places.items():
            rest = np.setdiff1d(np.arange(self._n), at)
            onto = np.linalg.solve(information[np.ix_(rest, rest)], information[np.ix_(rest, at)])
            scores = rhs[at] - onto.T @ rhs[rest]
            shown = information[np.ix_(at, at)] - information[np.ix_(at, rest)] @ onto
            shown -= np.diag(self.precision[at - self._k])  # by the drives, without the prior
            mean, half_variance = np.trace(shown), np.sum(shown**2)
            scale = half_variance / mean
            chances[e.name] = chi_square.tail(scores @ scores / scale, mean / scale)
        return chances
