"""The problem of a design, and what is found out about a maneuver: data without computation.

n: samples, k: unknown parameters, e: nuisance parameters, l: operation parameters, t: time points,
c: channels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from excitation_planner.box import Box
from excitation_planner.choice import Choice
from excitation_planner.design.criteria import Criterion
from excitation_planner.design.noise import TrajectoryNoise
from excitation_planner.design.prior import NO_NUISANCES, BoxPrior, NuisanceParameters
from excitation_planner.indices.sampling import check_seed
from tricycle_core.errors import DesignError
from tricycle_core.quantities import FloatArray

if TYPE_CHECKING:  # it needs SciPy
    from excitation_planner.indices.sensitivity import Sensitivity

Trajectories = FloatArray | tuple[FloatArray, ...]
"""Trajectories (n, t, c) of one maneuver, or of each maneuver of a set."""

Simulator = Callable[[FloatArray, FloatArray], Trajectories]
"""f of x (l,) and P (n, k + e): outputs (n,), or trajectories."""

Outcome = tuple[FloatArray, ...] | str
"""Result of f at one x: outputs or trajectories of each maneuver; or why it is infeasible."""

NoiseVariance = float | Callable[[FloatArray], float]
"""V_n, or V_n as a function of the outputs (n,)."""

DRAWS = 16
"""Parameter values over which the criteria C, D and A are averaged."""

VERIFIED = 3
"""Distinct candidates that are evaluated on fresh samples before one is handed out."""

VERIFICATION = 3
"""Samples of a verification, as a multiple of those of an evaluation during the search."""


class Search(Choice):
    """Method by which the second stage searches for the cheapest maneuver."""

    ADAPTIVE = "adaptive"  # corners and Sobol' points, then trust regions from the best of them
    DIRECT = "direct"  # DIRECT on the cost itself
    ONE_SHOT_SOBOL = "one-shot-sobol"  # the paper: 2k Kriging models over a Sobol' sequence
    ONE_SHOT_FACTORIAL = "one-shot-factorial"  # the same over a c-level full factorial


@dataclass(frozen=True)
class Evaluation:
    """One maneuver of the family, evaluated.

    Attributes
    ----------
    x : ndarray of float, shape (l,)
        Operation parameters.
    cost : float
        Criterion at x; infinite for a maneuver that is infeasible or excites nothing.
    main, total : ndarray of float, shape (k,)
        Sobol' indices; NaN where they were not asked for or the cost is infinite.
    posterior_std : ndarray of float, shape (k,)
        Standard deviations of the parameters after the drive, in ranges; NaN for the criterion H.
    simulations, failed : int
        Number of runs of f, and how many of them failed (NaN).
    variance, noise_share : float
        Variance of the output, and the share of it that is noise; only for the criterion H.
    leave_one_out_q2 : float
        Leave-one-out Q² of the metamodel; only for the criterion H.
    infeasible : str
        Why the maneuver cannot be driven or judged; empty when it can.
    """

    x: FloatArray
    cost: float
    main: FloatArray
    total: FloatArray
    posterior_std: FloatArray
    simulations: int
    failed: int
    variance: float = math.nan
    noise_share: float = math.nan
    leave_one_out_q2: float = math.nan
    infeasible: str = ""


@dataclass(frozen=True)
class Verified:
    """An evaluation on fresh samples, with the sensitivity of the output.

    Attributes
    ----------
    evaluation : Evaluation
        Evaluation on the fresh samples.
    cost_interval : (float, float)
        95 % interval of its cost.
    sensitivity : Sensitivity, callable or None
        Sobol' indices, or a function that computes them; None if the maneuver is infeasible.
    """

    evaluation: Evaluation
    cost_interval: tuple[float, float]
    sensitivity: Sensitivity | Callable[[], Sensitivity] | None


@dataclass(frozen=True)
class DesignProblem:
    """A design problem: everything but the simulator.

    Attributes
    ----------
    operation, unknown : Box
        Ranges of the operation and of the unknown parameters.
    target : str or None
        Unknown parameter to excite; the criteria D and A need none.
    criterion : Criterion
        Criterion that is minimised.
    noise_variance : float or callable
        For H: variance V_n that noise gives to the output.
    trajectory_noise : TrajectoryNoise
        For C, D and A: noise of the trajectory.
    samples : int
        For H: runs per maneuver during the search.
    draws : int
        For C, D and A: parameter values over which the criterion is averaged.
    budget : int
        Largest number of runs in all.
    seed : int
        The same seed gives the same design.
    search : Search
        How the operation box is searched.
    prior : BoxPrior, optional
        For C, D and A: knowledge of the parameters before the drive; None: uniform.
    nuisances : NuisanceParameters
        For C, D and A: further uncertain inputs of f (nuisance parameters).

    Raises
    ------
    DesignError
        If the target is unknown, the noise impossible or the budget too small.
    """

    operation: Box
    unknown: Box
    target: str | None
    criterion: Criterion
    noise_variance: NoiseVariance
    trajectory_noise: TrajectoryNoise
    samples: int
    draws: int
    budget: int
    seed: int
    search: Search
    prior: BoxPrior | None = None
    nuisances: NuisanceParameters = NO_NUISANCES

    def __post_init__(self) -> None:
        if self.target is not None:
            self.unknown.index(self.target)
        elif self.criterion in (Criterion.H, Criterion.C):
            raise DesignError(f"criterion {self.criterion} needs a target: {self._names}")
        if not callable(self.noise_variance):
            checked_variance(self.noise_variance)
        if self.prior is not None and len(self.prior.mean) != len(self.unknown):
            raise DesignError(f"prior: must be about {self._names}")
        if self.criterion is Criterion.H and self.nuisances.steps:
            raise DesignError("criterion h counts nothing beside the parameters; c, d and a do")
        for name in ("samples", "draws", "budget"):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or isinstance(value, bool):
                raise DesignError(f"{name} = {value!r}: a whole number is needed")
        check_seed(self.seed)
        if self.draws < 1:
            raise DesignError(f"draws = {self.draws}: at least one is needed")
        self.unknown.check_samples(self.samples)
        if self.points < 1:
            raise DesignError(
                f"budget = {self.budget} is too small: an evaluation and the verification take "
                f"{self.runs(verification=False) + self._reserve} runs"
            )

    @property
    def _names(self) -> str:
        return ", ".join(self.unknown.names)

    @property
    def target_index(self) -> int | None:
        """Axis of the target."""
        return None if self.target is None else self.unknown.index(self.target)

    def runs(self, *, verification: bool) -> int:
        """Return the runs of f per maneuver, in the search or in the verification."""
        times = VERIFICATION if verification else 1
        if self.criterion is Criterion.H:
            return times * self.samples
        differences = times * self.draws * (len(self.unknown) + len(self.nuisances.steps) + 1)
        return differences + (1 + times * self.samples if verification else 0)

    @property
    def _reserve(self) -> int:
        return VERIFIED * self.runs(verification=True)

    @property
    def points(self) -> int:
        """Maneuvers that the search may evaluate."""
        return (self.budget - self._reserve) // self.runs(verification=False)


def checked_variance(value: float) -> float:
    """Return V_n as a float; refuse what is not a finite number of 0 or more.

    Parameters
    ----------
    value : float
        Variance V_n.
    """
    if not isinstance(value, int | float | np.number) or not 0 <= value < math.inf:
        raise DesignError(f"noise variance {value!r}: must be a finite number, 0 or more")
    return float(value)
