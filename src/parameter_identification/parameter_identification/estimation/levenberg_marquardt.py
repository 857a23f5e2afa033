"""The minimum of a sum of squares within bounds, by the method of Levenberg and Marquardt.

Every step is a linear problem with bounds, so that a variable at one of them does not block the
others.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from parameter_identification.estimation.quadratic import Quadratic
from tricycle_core.quantities import FloatArray

MAX_STEPS = 50
ROUGHNESS = 0.3  # of the cost: a damped step that would lower it by less is not tried
UNEXPLAINED = 1.0  # of the cost, by which a step would lower it, of which no part does


@dataclass(frozen=True, eq=False)
class Fit:
    """A minimum, or where the search for one was given up.

    Attributes
    ----------
    at : ndarray of float, shape (n,)
        Variables.
    cost : float
        Squared residuals divided by their variances, with the priors' part.
    converged : bool
        Whether it is a minimum: no step would lower the quadratic cost by much.
    """

    at: FloatArray
    cost: float
    converged: bool = True


def minimum_of(
    quadratic: Callable[[FloatArray], Quadratic],
    start: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
    *,
    free: NDArray[np.bool_],
    rough: NDArray[np.bool_],
    own: NDArray[np.bool_],
    drives: int,
    samples: int,
    tolerance: float,
) -> Fit:
    """Search for a minimum from a start, in `MAX_STEPS` steps at most.

    Parameters
    ----------
    quadratic : callable
        Returns the cost near variables (n,), to the second order.
    start : ndarray of float, shape (n,)
        Variables.
    bounds : (ndarray of float, ndarray of float), shapes (n,)
        Lower and upper bounds of the variables that may change.
    free : ndarray of bool, shape (n,)
        True for variables that may change.
    rough : ndarray of bool, shape (n,)
        True for those of which the slope at a point is not that on average: they stay where they
        are from the first step on that fails.
    own : ndarray of bool, shape (n,)
        True for those that not all drives have in common. After a step that fails they are
        minimised once more, the others held (variable projection; Golub and Pereyra 1973).
    drives : int
        Number of drives.
    samples : int
        Number of residuals.
    tolerance : float
        The search ends when the next step would lower the quadratic cost by less; that step is
        taken, its cost is the quadratic one. Where the cost is more than one per sample, so much
        more.
    """
    low, high = bounds

    def within(v: FloatArray) -> FloatArray:
        return np.where(free, np.clip(v, low, high), v)

    here = quadratic(within(start))
    damping, undamped = np.zeros(len(start)), False  # the latter: tried since the last success
    for _ in range(MAX_STEPS):
        step = here.step(low, high, free=free, damping=damping)
        decrease = here.decrease(step)
        following = within(here.at + step)
        scale = max(1.0, here.cost / samples)
        if damping.any() and decrease < max(ROUGHNESS, tolerance) * scale:
            if undamped:
                break
            damping, undamped = np.zeros(len(start)), True  # it may be of a step long ago
            continue
        if decrease < tolerance * scale:
            return Fit(following, here.cost - decrease)
        trial = quadratic(following)
        if trial.finite and trial.cost >= here.cost - 0.1 * decrease:
            # in a narrow valley that bends: what is each drive's own follows the rest
            trial = quadratic(within(trial.at + trial.step(low, high, free=free & own)))
        if trial.finite and trial.cost < here.cost - 0.1 * decrease:
            here = trial
            damping, undamped = np.where(damping > 1.0, damping / 10.0, 0.0), False
        elif np.any(free & rough):
            free = free & ~rough
        else:
            # a secant over a long step may be of a kink near its start: not all of it at once
            most = 10.0 * np.maximum(damping, np.diag(here.information))
            damping = np.minimum(
                np.maximum(10.0 * damping, here.lacking(trial.at - here.at, trial)), most
            )
    # stamps that come between two ticks make small kinks in the cost of each drive
    of_own = here.decrease(here.step(low, high, free=free & own))
    of_common = here.decrease(here.step(low, high, free=free)) - of_own
    explained = max(UNEXPLAINED, tolerance) * max(1.0, here.cost / samples)
    return Fit(here.at, here.cost, of_common < explained and of_own < drives * explained)
