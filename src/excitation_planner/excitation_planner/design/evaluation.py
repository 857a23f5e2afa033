"""Evaluation of one maneuver: from simulations to indices and cost.

n: samples, k: unknown parameters, l: operation parameters, t: time points, c: channels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from excitation_planner.box import Box
from excitation_planner.design.criteria import Criterion, cost_interval, excitation_cost
from excitation_planner.design.information import (
    Prior,
    TrajectoryNoise,
    difference_points,
    information,
    information_costs,
    posterior_covariance,
)
from excitation_planner.design.search import Search
from excitation_planner.indices.sensitivity import (
    Sensitivity,
    fit_metamodel,
    parameter_samples,
    sensitivity_of_model,
)
from excitation_planner.indices.sobol import sobol_indices
from excitation_planner.indices.threads import THREADPOOLS
from tricycle_core.errors import DesignError, InfeasibleManeuver
from tricycle_core.quantities import FloatArray

Trajectories = FloatArray | tuple[FloatArray, ...]  # (n, t, c), of each maneuver of a set
Simulator = Callable[[FloatArray, FloatArray], Trajectories]  # x (l,), P (n, k) -> (n,) or those
# what f gave at one x: outputs (n,) or trajectories of each maneuver; or why it is infeasible
Outcome = tuple[FloatArray, ...] | str
NoiseVariance = float | Callable[[FloatArray], float]  # V_n, or V_n of the outputs (n,)

VERIFIED = 3  # distinct candidates that are evaluated afresh before one is handed out
VERIFICATION = 3  # times the samples of an evaluation during the search


@dataclass(frozen=True)
class Evaluation:
    """One maneuver of the family, evaluated.

    Attributes
    ----------
    x : ndarray (l,)
        Operation parameters.
    cost : float
        Criterion at x; infinite for a maneuver that is infeasible or excites nothing.
    main, total : ndarray (k,)
        Sobol' indices; NaN where they were not asked for or the cost is infinite.
    variance : float
        Variance of the output.
    noise_share : float
        Variance of its noise, as a share of that.
    leave_one_out_q2 : float
        Of the metamodel.
    posterior_std : ndarray (k,)
        Standard deviations of the parameters after the drive, in ranges; NaN for the criterion H.
    simulations, failed : int
        Runs of f, and those of them that failed (NaN).
    infeasible : str
        Why the maneuver cannot be driven or judged; empty when it can.
    """

    x: FloatArray
    cost: float
    main: FloatArray
    total: FloatArray
    variance: float
    noise_share: float
    leave_one_out_q2: float
    posterior_std: FloatArray
    simulations: int
    failed: int
    infeasible: str


@dataclass(frozen=True)
class Verified:
    """An evaluation on fresh samples, with what the metamodel of the output knows."""

    evaluation: Evaluation
    cost_interval: tuple[float, float]
    sensitivity: Sensitivity | None  # None where the maneuver is infeasible


@dataclass(frozen=True)
class Problem:
    """A design to be made: everything but the simulator. See `design_excitation`."""

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
    prior: Prior | None = None

    def __post_init__(self) -> None:
        if self.target is not None:
            self.unknown.index(self.target)
        elif self.criterion in (Criterion.H, Criterion.C):
            raise DesignError(f"criterion {self.criterion} needs a target: {self._names}")
        if not callable(self.noise_variance) and not 0 <= self.noise_variance < math.inf:
            raise DesignError(f"noise variance {self.noise_variance:g} must be 0 or more, finite")
        if self.prior is not None and len(self.prior.mean) != len(self.unknown):
            raise DesignError(f"prior: must be about {self._names}")
        if self.draws < 1:
            raise DesignError(f"draws = {self.draws}: at least one is needed")
        self.parameters(verification=False)
        if self.points < 1:
            raise DesignError(
                f"budget = {self.budget} is too small: an evaluation and the verification take "
                f"{self.runs_per_point + self._reserve} runs"
            )

    @property
    def _names(self) -> str:
        return ", ".join(self.unknown.names)

    @property
    def target_index(self) -> int | None:
        """Axis of the target."""
        return None if self.target is None else self.unknown.index(self.target)

    @property
    def runs_per_point(self) -> int:
        """Runs of f per maneuver during the search."""
        return len(self.parameters(verification=False))

    @property
    def _reserve(self) -> int:
        return VERIFIED * len(self.parameters(verification=True))

    @property
    def points(self) -> int:
        """Maneuvers that the search may evaluate."""
        return (self.budget - self._reserve) // self.runs_per_point

    def parameters(self, *, verification: bool) -> FloatArray:
        """Points (n, k) of the unit box to simulate at.

        The same at every x, so that the cost is smooth in x; fresh ones for the verification.
        """
        times, seed = (VERIFICATION, self.seed + 1) if verification else (1, self.seed)
        k = len(self.unknown)
        samples = parameter_samples(self.unknown, times * self.samples, seed=seed)
        if self.criterion is Criterion.H:
            return samples
        differences = difference_points(k, times * self.draws, seed=seed, prior=self.prior)
        if not verification:
            return differences
        # the indices of the squared deviation from the middle of the box are reported as well
        return np.vstack([differences, np.full((1, k), 0.5), samples])


def evaluate(
    f: Simulator,
    problem: Problem,
    x: FloatArray,
    *,
    verification: bool,
    outcome: Outcome | None = None,
) -> tuple[Outcome, Verified]:
    """Simulate one maneuver x (l,), unless its outcome is known, and judge it.

    Runs wherever an executor says.
    """
    with THREADPOOLS.limit(limits=1):
        if outcome is None:
            outcome = simulate(f, problem, x, problem.parameters(verification=verification))
        judged = judge_outcome(problem, x, outcome, verification=verification)
        # trajectories stay where they were simulated: they are large
        return (outcome if problem.criterion is Criterion.H else ""), judged


def judge_outcome(
    problem: Problem, x: FloatArray, outcome: Outcome, *, verification: bool
) -> Verified:
    """Indices and cost at x (l,) from what f gave there."""
    if isinstance(outcome, str):
        return _rejected(problem, x, outcome, simulations=0, failed=0)
    if problem.criterion is Criterion.H:
        return _assess(problem, x, outcome[0], verification=verification)
    return _assess_trajectories(problem, x, outcome, verification=verification)


def simulate(f: Simulator, problem: Problem, x: FloatArray, U: FloatArray) -> Outcome:
    """Outcome of f at x for parameters U (n, k) of the unit box."""
    try:
        returned = f(x, problem.unknown.from_unit(U))
    except InfeasibleManeuver as infeasible:
        return str(infeasible) or "infeasible"
    except DesignError:
        raise
    except Exception as error:
        where = ", ".join(
            f"{name} = {value:g}" for name, value in zip(problem.operation.names, x, strict=True)
        )
        raise DesignError(f"f raised {type(error).__name__}: {error}, at {where}") from error
    outputs = tuple(
        np.asarray(Y, dtype=float)
        for Y in (returned if isinstance(returned, tuple) else (returned,))
    )
    n, shapes = len(U), [Y.shape for Y in outputs]
    if problem.criterion is Criterion.H:
        if shapes != [(n,)]:
            raise DesignError(f"f returned shape {shapes[0]} for {n} samples; it must be ({n},)")
    elif any(len(shape) != 3 or shape[0] != n for shape in shapes):
        raise DesignError(
            f"f returned shape {shapes[0]} for {n} samples; criterion {problem.criterion} needs "
            f"trajectories ({n}, time points, channels)"
        )
    return outputs


def _assess(problem: Problem, x: FloatArray, m: FloatArray, *, verification: bool) -> Verified:
    """Indices and cost H from outputs m (n,), NaN where failed."""
    U, failed = problem.parameters(verification=verification), int(np.sum(~np.isfinite(m)))
    try:
        model = fit_metamodel(U, m)
    except DesignError as error:
        return _rejected(problem, x, str(error), simulations=len(m), failed=failed)
    indices = sobol_indices(model)
    noise_variance = problem.noise_variance
    if callable(noise_variance):
        noise_variance = float(noise_variance(m[np.isfinite(m)]))
    noise_share, target = noise_variance / indices.variance, problem.target_index
    assert target is not None  # Problem has checked
    evaluation = Evaluation(
        x=x,
        cost=excitation_cost(indices.main, indices.total, target, noise_share=noise_share),
        main=indices.main,
        total=indices.total,
        variance=indices.variance,
        noise_share=noise_share,
        leave_one_out_q2=model.leave_one_out_q2(),
        posterior_std=np.full(len(problem.unknown), np.nan),
        simulations=len(m),
        failed=failed,
        infeasible="",
    )
    if not verification:
        return Verified(evaluation, (math.nan, math.nan), None)
    sensitivity = sensitivity_of_model(problem.unknown, model, indices, failed=failed)
    interval = cost_interval(sensitivity, target, noise_share=noise_share)
    return Verified(evaluation, interval, sensitivity)


def _assess_trajectories(
    problem: Problem,
    x: FloatArray,
    outputs: tuple[FloatArray, ...],
    *,
    verification: bool,
) -> Verified:
    """Cost C, D or A from trajectories (n, t, c) of each maneuver of a set."""
    U = problem.parameters(verification=verification)
    k, n = len(problem.unknown), len(U)
    failed = int(np.sum(~np.all([np.isfinite(Y).all(axis=(1, 2)) for Y in outputs], axis=0)))
    rows = (k + 1) * problem.draws * (VERIFICATION if verification else 1)
    F = sum(information(U[:rows], Y[:rows], problem.trajectory_noise) for Y in outputs)
    F = np.asarray(F)[np.isfinite(np.asarray(F)).all(axis=(1, 2))]  # draws with no failed run
    if len(F) == 0:
        reason = f"{failed} of {n} simulations failed"
        return _rejected(problem, x, reason, simulations=n, failed=failed)
    covariance = posterior_covariance(F, problem.prior)
    costs = information_costs(covariance, problem.criterion, problem.target_index)
    cost, nothing = float(costs.mean()), np.full(k, np.nan)
    half = 1.96 * float(costs.std()) / math.sqrt(len(costs))
    sensitivity = None
    if verification:
        # mean squared deviation from the middle of the box: Eq. 14 on the time points given
        m = np.sum([((Y[rows + 1 :] - Y[rows]) ** 2).sum(axis=(1, 2)) for Y in outputs], axis=0)
        m /= sum(Y.shape[1] for Y in outputs)
        try:
            model = fit_metamodel(U[rows + 1 :], m)
        except DesignError as error:
            return _rejected(problem, x, str(error), simulations=n, failed=failed)
        bad = int(np.sum(~np.isfinite(m)))
        sensitivity = sensitivity_of_model(problem.unknown, model, sobol_indices(model), failed=bad)
    evaluation = Evaluation(
        x=x,
        cost=cost,
        main=nothing if sensitivity is None else sensitivity.main,
        total=nothing if sensitivity is None else sensitivity.total,
        variance=math.nan if sensitivity is None else sensitivity.variance,
        noise_share=math.nan,
        leave_one_out_q2=math.nan if sensitivity is None else sensitivity.leave_one_out_q2,
        posterior_std=np.sqrt(np.mean(np.diagonal(covariance, axis1=1, axis2=2), axis=0)),
        simulations=n,
        failed=failed,
        infeasible="",
    )
    return Verified(evaluation, (cost - half, cost + half), sensitivity)


def _rejected(
    problem: Problem, x: FloatArray, reason: str, *, simulations: int, failed: int
) -> Verified:
    """Evaluation of a maneuver that cannot be driven or judged."""
    nothing = np.full(len(problem.unknown), np.nan)
    evaluation = Evaluation(
        x=x,
        cost=math.inf,
        main=nothing,
        total=nothing,
        variance=math.nan,
        noise_share=math.nan,
        leave_one_out_q2=math.nan,
        posterior_std=nothing,
        simulations=simulations,
        failed=failed,
        infeasible=reason,
    )
    return Verified(evaluation, (math.inf, math.inf), None)
