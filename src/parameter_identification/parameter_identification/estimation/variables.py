"""The variables of a least-squares problem of several drives: their order and their bounds.

A variable vector (n,) holds the parameters in their ranges, then the nuisances in standard
deviations of their priors: those that the drives share, then for each drive its own.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from parameter_identification.estimation.nuisance import Nuisance
from tricycle_core.quantities import FloatArray
from tricycle_sim.effects import Effect


def at_bounds(v: FloatArray, low: FloatArray, high: FloatArray) -> NDArray[np.bool_]:
    """Return which variables (n,) are at one of their bounds.

    Parameters
    ----------
    v, low, high : ndarray of float, shape (n,)
        The variables and their bounds.
    """
    found: NDArray[np.bool_] = np.fmin(v - low, high - v) <= 1e-9
    return found


class ProblemVariables:
    """Order and bounds of the variables of several drives.

    Parameters
    ----------
    k : int
        Number of parameters.
    nuisances : sequence of sequence of Nuisance
        Nuisances of each drive; those that all drives have in common come first.
    in_common : int
        Number of nuisances that all drives have in common.

    Attributes
    ----------
    n, k, shared : int
        Numbers of variables: all, the parameters among them, and those that all drives have in
        common.
    low, high : ndarray of float, shape (n,)
        Bounds.
    of_drives : list of ndarray of int
        Places of the variables of each drive: parameters, nuisances in common, its own nuisances.
    of_effects, rough : ndarray of bool, shape (n,)
        True for variables of effects, and for those of rough ones.
    deviations : dict of Effect to ndarray of int
        Places of the values of each deviation, in all drives.
    constant_effects : dict of Effect to list of int
        Places of each effect that is no deviation.
    """

    def __init__(self, k: int, nuisances: Sequence[Sequence[Nuisance]], in_common: int) -> None:
        self.k, self.shared = k, k + in_common
        ends = self.shared + np.cumsum([0, *(len(own) - in_common for own in nuisances)])
        self.n = int(ends[-1])
        self.of_drives = [
            np.concatenate([np.arange(self.shared), np.arange(first, last)])
            for first, last in itertools.pairwise(ends)
        ]
        self.low, self.high = np.zeros(self.n), np.ones(self.n)
        self.low[k:], self.high[k:] = -math.inf, math.inf
        self.of_effects, self.rough = np.zeros(self.n, dtype=bool), np.zeros(self.n, dtype=bool)
        deviations: dict[Effect, list[int]] = {}
        constant: dict[Effect, set[int]] = {}
        for drive, own in enumerate(nuisances):
            for nuisance, i in zip(own, self.nuisances_of(drive).tolist(), strict=True):
                self.low[i] = max(self.low[i], (nuisance.low - nuisance.mean) / nuisance.std)
                self.high[i] = min(self.high[i], (nuisance.high - nuisance.mean) / nuisance.std)
                if (effect := nuisance.effect) is None:
                    continue
                self.of_effects[i], self.rough[i] = True, effect.rough
                if effect.process:
                    deviations.setdefault(effect, []).append(i)
                else:
                    constant.setdefault(effect, set()).add(i)
        self.deviations = {effect: np.array(places) for effect, places in deviations.items()}
        self.constant_effects = {effect: sorted(places) for effect, places in constant.items()}

    def nuisances_of(self, drive: int) -> NDArray[np.int64]:
        """Return the place of each nuisance of a drive among the variables.

        Parameters
        ----------
        drive : int
            Number of the drive.
        """
        return self.of_drives[drive][self.k :]

    def beginning(self, first: FloatArray) -> FloatArray:
        """Return variables (n,) that begin with some, the others 0.

        Parameters
        ----------
        first : ndarray of float
            The first variables: parameters, and perhaps nuisances in common.
        """
        return np.append(first, np.zeros(self.n - len(first)))

    @property
    def of_deviations(self) -> NDArray[np.bool_]:
        """True for variables (n,) of deviations."""
        found = np.zeros(self.n, dtype=bool)
        for places in self.deviations.values():
            found[places] = True
        return found

    def at_an_end(self, v: FloatArray) -> NDArray[np.bool_]:
        """Return which variables (n,) are at an end of what is taken for possible.

        Parameters
        ----------
        v : ndarray of float, shape (n,)
            Variables; effects that are 0 do not act.
        """
        ends = at_bounds(v, self.low, self.high)
        ends[self.k :] &= v[self.k :] != 0.0
        return ends
