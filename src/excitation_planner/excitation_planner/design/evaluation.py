"""Evaluation of one maneuver: from simulations to indices and cost.

n: samples, k: unknown parameters, e: nuisance parameters, l: operation parameters, t: time points,
c: channels.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from contextlib import nullcontext
from functools import partial

import numpy as np

from excitation_planner.design.criteria import Criterion, excitation_cost
from excitation_planner.design.information import (
    LEAST_SIMULATED,
    difference_points,
    information,
    information_costs,
    posterior_covariance,
    simulated_values,
)
from excitation_planner.design.problem import (
    VERIFICATION,
    DesignProblem,
    Evaluation,
    Outcome,
    Simulator,
    Verified,
    checked_variance,
)
from excitation_planner.indices.sampling import parameter_samples
from excitation_planner.indices.sensitivity import (
    Sensitivity,
    check_outputs,
    fit_metamodel,
    fold_half_width,
    real_outputs,
    sensitivity_of_model,
    sensitivity_of_outputs,
)
from excitation_planner.indices.sobol import sobol_indices
from tricycle_core.errors import DesignError, InfeasibleManeuver
from tricycle_core.quantities import FloatArray

NORMAL_HALF_WIDTH = 1.96  # of a 95 % interval, in standard deviations


def parameter_points(problem: DesignProblem, *, verification: bool) -> FloatArray:
    """Return the points (n, k + e) to simulate at: parameters in the unit box.

    The same at every x, so that the cost is smooth in x; fresh ones for the verification.

    Parameters
    ----------
    problem : DesignProblem
        Says how many, and the seed.
    verification : bool
        Whether they are for the verification.
    """
    times, seed = (VERIFICATION, problem.seed + 1) if verification else (1, problem.seed)
    k = len(problem.unknown)
    if problem.criterion is Criterion.H:
        return parameter_samples(problem.unknown, times * problem.samples, seed=seed)
    differences = difference_points(
        k, times * problem.draws, seed=seed, prior=problem.prior, nuisances=problem.nuisances
    )
    if not verification:
        return differences
    # the indices of the squared deviation from the middle of the box are reported as well
    samples = parameter_samples(problem.unknown, times * problem.samples, seed=seed)
    around = np.vstack([np.full((1, k), 0.5), samples])
    return np.vstack([differences, np.pad(around, ((0, 0), (0, len(problem.nuisances.steps))))])


# With few samples this is thousands of short calls of NumPy, between which threads wait for the
# interpreter: two side by side take longer than one after the other.
_ONE_AT_A_TIME = threading.Lock()


def judge_outcome(
    problem: DesignProblem, x: FloatArray, U: FloatArray, outcome: Outcome, *, verification: bool
) -> Verified:
    """Return indices and cost from the result of f at one maneuver.

    Parameters
    ----------
    problem : DesignProblem
        Design problem of the maneuvers.
    x : ndarray of float, shape (l,)
        Operation parameters.
    U : ndarray of float, shape (n, k + e)
        Points from `parameter_points` at which f was simulated, in the unit box.
    outcome : tuple or str
        Result of f there, or why the maneuver is infeasible.
    verification : bool
        Whether the samples are those of the verification.
    """
    if isinstance(outcome, str):
        return _rejected(problem, x, outcome, simulations=0, failed=0)
    with nullcontext() if verification else _ONE_AT_A_TIME:
        if problem.criterion is Criterion.H:
            return _assess(problem, x, U, outcome[0], verification=verification)
        return _assess_trajectories(problem, x, U, outcome, verification=verification)


def simulate(f: Simulator, problem: DesignProblem, x: FloatArray, U: FloatArray) -> Outcome:
    """Return the outcome of f at one maneuver.

    Parameters
    ----------
    f : callable
        Simulator f(x, P).
    problem : DesignProblem
        Design problem: the boxes, and the criterion, which decides the shape of the outputs.
    x : ndarray of float, shape (l,)
        Operation parameters.
    U : ndarray of float, shape (n, k + e)
        Parameters in the unit box, followed by the nuisance parameters.
    """
    try:
        returned = f(x.copy(), simulated_values(problem.unknown, U))
    except InfeasibleManeuver as infeasible:
        return str(infeasible) or "infeasible"
    except DesignError:
        raise
    except Exception as error:
        where = ", ".join(
            f"{name} = {value:g}" for name, value in zip(problem.operation.names, x, strict=True)
        )
        raise DesignError(f"f raised {type(error).__name__}: {error}, at {where}") from error
    outputs = tuple(map(real_outputs, returned if isinstance(returned, tuple) else (returned,)))
    n, shapes = len(U), [Y.shape for Y in outputs]
    told = f"f returned {' and '.join(map(str, shapes)) or 'nothing'} for {n} samples"
    if problem.criterion is Criterion.H:
        if shapes != [(n,)]:
            raise DesignError(f"{told}; it must be one array ({n},)")
    elif not shapes or any(len(shape) != 3 or shape[0] != n or 0 in shape for shape in shapes):
        raise DesignError(
            f"{told}; criterion {problem.criterion} needs trajectories ({n}, time points, channels)"
        )
    else:
        for shape in shapes:
            problem.trajectory_noise.check_channels(*shape[1:])
    return outputs


def joined(chunks: Sequence[Outcome]) -> Outcome:
    """Return the outcome of all samples of a maneuver.

    Parameters
    ----------
    chunks : sequence of Outcome
        Results of f at consecutive parts of the samples.

    Raises
    ------
    DesignError
        If trajectories have different shapes.
    """
    reasons = [chunk for chunk in chunks if isinstance(chunk, str)]
    if reasons:
        return reasons[0]
    parts = list(zip(*chunks, strict=True))
    for part in parts:
        shapes = sorted({Y.shape[1:] for Y in part if not isinstance(Y, str)})
        if len(shapes) > 1:
            raise DesignError(
                f"f returned trajectories of {shapes[0]} and of {shapes[1]} time points and "
                "channels at one maneuver; all of its samples must have the same"
            )
    return tuple(np.concatenate(part) for part in parts)


def _assess(
    problem: DesignProblem, x: FloatArray, U: FloatArray, m: FloatArray, *, verification: bool
) -> Verified:
    """Indices and cost H from outputs m (n,), NaN where failed."""
    failed = int(np.sum(~np.isfinite(m)))
    try:
        model = fit_metamodel(U, m)
    except DesignError as error:
        return _rejected(problem, x, str(error), simulations=len(m), failed=failed)
    indices = sobol_indices(model)
    noise_variance = problem.noise_variance
    if callable(noise_variance):
        noise_variance = checked_variance(noise_variance(m[np.isfinite(m)]))
    noise_share, target = noise_variance / indices.variance, problem.target_index
    if target is None:
        raise DesignError("criterion h needs a target")
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
    )
    if not verification:
        return Verified(evaluation, (math.nan, math.nan), None)
    sensitivity = sensitivity_of_model(problem.unknown, model, indices, failed=failed)
    interval = cost_interval(sensitivity, target, noise_share=noise_share)
    return Verified(evaluation, interval, sensitivity)


def _assess_trajectories(
    problem: DesignProblem,
    x: FloatArray,
    U: FloatArray,
    outputs: tuple[FloatArray, ...],
    *,
    verification: bool,
) -> Verified:
    """Cost C, D or A from trajectories (n, t, c) of each maneuver of a set."""
    k, n = len(problem.unknown), len(U)
    failed = int(np.sum(~np.all([np.isfinite(Y).all(axis=(1, 2)) for Y in outputs], axis=0)))
    if failed == n:
        reason = f"{failed} of {n} simulations failed"
        return _rejected(problem, x, reason, simulations=n, failed=failed)
    nuisances = problem.nuisances
    rows = (U.shape[1] + 1) * problem.draws * (VERIFICATION if verification else 1)
    F = sum(information(U[:rows], Y[:rows], problem.trajectory_noise, nuisances) for Y in outputs)
    F = np.asarray(F)[np.isfinite(np.asarray(F)).all(axis=(1, 2))]  # draws with no failed run
    if len(F) < LEAST_SIMULATED * (rows // (U.shape[1] + 1)):
        reason = f"{failed} of {n} simulations failed"
        return _rejected(problem, x, reason, simulations=n, failed=failed)
    covariance = posterior_covariance(F, problem.prior, nuisances)
    costs = information_costs(covariance, problem.criterion, problem.target_index)
    cost, nothing = float(costs.mean()), np.full(k, np.nan)
    half = NORMAL_HALF_WIDTH * float(costs.std()) / math.sqrt(len(costs))
    sensitivity = None
    if verification:
        # mean squared deviation from the middle of the box: Eq. 14 on the time points given
        m = np.sum([_squared_deviations(Y[rows + 1 :], Y[rows]) for Y in outputs], axis=0)
        m /= sum(Y.shape[1] for Y in outputs)
        samples = U[rows + 1 :, :k]
        try:
            check_outputs(samples, m)
        except DesignError as error:
            return _rejected(problem, x, str(error), simulations=n, failed=failed)
        sensitivity = partial(sensitivity_of_outputs, problem.unknown, samples, m)
    evaluation = Evaluation(
        x=x,
        cost=cost,
        main=nothing,
        total=nothing,
        posterior_std=np.sqrt(np.mean(np.diagonal(covariance, axis1=1, axis2=2), axis=0)),
        simulations=n,
        failed=failed,
    )
    return Verified(evaluation, (cost - half, cost + half), sensitivity)


def _squared_deviations(Y: FloatArray, middle: FloatArray) -> FloatArray:
    """Squares (n,) of trajectories (n, t, c) about one, or about their mean if that failed."""
    valid = np.isfinite(Y).all(axis=(1, 2))
    if not np.isfinite(middle).all() and valid.any():
        middle = Y[valid].mean(axis=0)
    squares: FloatArray = ((Y - middle) ** 2).sum(axis=(1, 2))
    return squares


def cost_interval(
    result: Sensitivity, target: int, *, noise_share: float = 0.0
) -> tuple[float, float]:
    """Return the 95 % interval of `excitation_cost`.

    From the cost if the target explained all that the metamodel leaves unexplained, to that if the
    other parameters did; widened by how the cost changes without a fifth of the samples.

    Parameters
    ----------
    result : Sensitivity
        Indices with their folds.
    target : int
        Axis of the parameter to excite.
    noise_share : float
        V_n / V.
    """
    cost = excitation_cost(result.main, result.total, target, noise_share=noise_share)
    folds = [
        # the noise keeps its variance, so that its share follows that of the output
        excitation_cost(
            f.main, f.total, target, noise_share=noise_share * result.variance / f.variance
        )
        for f in result.folds
        if f.variance > 0.0
    ]
    if len(folds) < len(result.folds) or not np.all(np.isfinite([cost, *folds])):
        return (0.0, math.inf)
    half = float(fold_half_width(np.array(folds) - cost))
    unexplained = result.unexplained
    explained, main = 1.0 - unexplained, float(result.main[target])
    low = explained * cost * main / (explained * main + unexplained)
    high = cost + unexplained / (explained * main) if explained > 0.0 else math.inf
    return (max(0.0, low - half), high + half)


def _rejected(
    problem: DesignProblem, x: FloatArray, reason: str, *, simulations: int, failed: int
) -> Verified:
    """Evaluation of a maneuver that cannot be driven or judged."""
    nothing = np.full(len(problem.unknown), np.nan)
    evaluation = Evaluation(
        x=x,
        cost=math.inf,
        main=nothing,
        total=nothing,
        posterior_std=nothing,
        simulations=simulations,
        failed=failed,
        infeasible=reason,
    )
    return Verified(evaluation, (math.inf, math.inf), None)
