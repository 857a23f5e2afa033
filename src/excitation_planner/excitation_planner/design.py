"""Design of an excitation maneuver: second stage of the method (Fig. 1, Eqs. 11-12).

n: samples, k: unknown parameters, l: operation parameters.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import pickle
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]

from excitation_planner.box import Bounds, Box, FloatArray
from excitation_planner.criteria import cost_interval, excitation_cost
from excitation_planner.errors import DesignError, InfeasibleManeuver
from excitation_planner.search import Search, search_steps
from excitation_planner.sensitivity import (
    Sensitivity,
    call_simulator,
    fit_metamodel,
    parameter_samples,
    sensitivity_of_model,
)
from excitation_planner.sobol_indices import sobol_indices

__all__ = [
    "Design",
    "DesignError",
    "Evaluation",
    "InfeasibleManeuver",
    "Verdict",
    "design_excitation",
]

Simulator = Callable[[FloatArray, FloatArray], FloatArray]  # f(x (l,), P (n, k)) -> (n,)
NoiseVariance = float | Callable[[FloatArray], float]  # V_n, or V_n of the outputs (n,)

_VERIFIED = 3  # distinct candidates that are evaluated afresh before one is handed out
_VERIFICATION = 3  # times the samples of an evaluation during the search


class Verdict(StrEnum):
    """What a design is worth."""

    EXCITES = "excites"  # the target's main effect is the largest contribution to the output
    CANNOT_EXCITE = "cannot excite"  # it is not, at the best maneuver of the family


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
        Sobol' indices; NaN where the cost is infinite.
    variance : float
        Variance of the output.
    leave_one_out_q2 : float
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
    leave_one_out_q2: float
    simulations: int
    failed: int
    infeasible: str


@dataclass(frozen=True)
class Design:
    """The maneuver that excites one parameter best, and how far it can be trusted.

    Attributes
    ----------
    x : ndarray (l,)
        Operation parameters of the maneuver.
    cost : float
        Criterion at x, from the verification.
    cost_interval : (float, float)
        95 % interval of `cost`.
    predicted_cost : float
        What the search had found at x with fewer, other samples.
    sensitivity : Sensitivity
        Indices at x with intervals, from the verification: fresh samples, unseen by the search.
    verdict : Verdict
    explanation : str
        The verdict in a sentence with its numbers.
    history : tuple of Evaluation
        Everything the search evaluated, in order.
    simulations, failed : int
        Runs of f in all, verification included, and those of them that failed (NaN).
    """

    operation: Box
    target: str
    x: FloatArray
    cost: float
    cost_interval: tuple[float, float]
    predicted_cost: float
    sensitivity: Sensitivity
    verdict: Verdict
    explanation: str
    history: tuple[Evaluation, ...]
    simulations: int
    failed: int

    @property
    def main(self) -> FloatArray:
        """Main indices (k,) at x."""
        return self.sensitivity.main

    @property
    def total(self) -> FloatArray:
        """Total indices (k,) at x."""
        return self.sensitivity.total

    @property
    def infeasible(self) -> tuple[Evaluation, ...]:
        """Evaluations that could not be driven or judged, each with its reason."""
        return tuple(evaluation for evaluation in self.history if evaluation.infeasible)


def design_excitation(
    f: Simulator,
    operation: Box | Bounds,
    unknown: Box | Bounds,
    target: str,
    *,
    noise_variance: NoiseVariance = 0.0,
    samples: int = 100,
    budget: int = 25_000,
    seed: int = 0,
    search: Search = Search.ADAPTIVE,
    executor: Executor | None = None,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Design:
    """Find the maneuver that excites the parameter ``target`` best.

    Parameters
    ----------
    f : callable
        Simulator: operation parameters x (l,) and unknown parameters P (n, k) to outputs (n,).
        NaN marks a failed simulation; `InfeasibleManeuver` a maneuver that cannot be driven.
    operation, unknown : Box or dict
        ``{name: (low, high)}`` of the operation and the unknown parameters.
    target : str
        Name of the unknown parameter to excite.
    noise_variance : float or callable
        Variance V_n of the output's measurement noise, or that variance as a function of the
        outputs (n,) at one x; 0 is the paper's cost.
    samples : int
        Runs of f per maneuver during the search; its verification takes three times as many.
    budget : int
        Most runs of f in all.
    seed : int
        The same seed gives the same design, whatever the executor.
    search : Search
        How the operation box is searched.
    executor : Executor, optional
        Where f runs; by default in processes of this machine, made and ended by this call.
    workers : int, optional
        Number of those processes, by default one per core; 1 runs everything in this process.
    progress : callable, optional
        Called with (runs of f so far, budget).

    Raises
    ------
    DesignError
        Unknown target, budget too small, f that raises or cannot be sent to another process,
        no maneuver of the family that can be driven and judged.
    """
    problem = Problem(
        operation=Box.of(operation),
        unknown=Box.of(unknown),
        target=target,
        noise_variance=noise_variance,
        samples=samples,
        budget=budget,
        seed=seed,
        search=search,
    )
    # one BLAS thread here too: what it computes must not depend on the number of cores, and threads
    # of an executor share the setting
    with _THREADPOOLS.limit(limits=1), _evaluator(f, problem, executor, workers) as evaluate:
        return _design(problem, evaluate, progress)


@dataclass(frozen=True)
class Problem:
    """A design to be made: everything but the simulator. Arguments as of `design_excitation`."""

    operation: Box
    unknown: Box
    target: str
    noise_variance: NoiseVariance
    samples: int
    budget: int
    seed: int
    search: Search

    def __post_init__(self) -> None:
        self.unknown.index(self.target)
        if not callable(self.noise_variance) and not 0 <= self.noise_variance < math.inf:
            raise DesignError(
                f"noise variance {self.noise_variance:g} must be finite and not negative"
            )
        if self.points < 1:
            raise DesignError(
                f"budget = {self.budget} is too small for {self.samples} samples per maneuver: "
                f"{self.samples + _VERIFIED * _VERIFICATION * self.samples} runs or more"
            )
        parameter_samples(self.unknown, self.samples, seed=self.seed)

    @property
    def points(self) -> int:
        """Maneuvers that the search may evaluate."""
        return self.budget // self.samples - _VERIFIED * _VERIFICATION

    def parameters(self, *, verification: bool) -> FloatArray:
        """Points (n, k) of the unit box to simulate at.

        The same at every x, so that the cost is smooth in x; fresh ones for the verification.
        """
        if verification:
            return parameter_samples(self.unknown, _VERIFICATION * self.samples, seed=self.seed + 1)
        return parameter_samples(self.unknown, self.samples, seed=self.seed)


@dataclass(frozen=True)
class Task:
    """One maneuver to simulate; x in the units of the operation box, U (n, k) in the unit box."""

    x: FloatArray
    U: FloatArray
    verification: bool  # whether intervals and the model are wanted too


@dataclass(frozen=True)
class _Assessed:
    evaluation: Evaluation
    sensitivity: Sensitivity | None
    noise_share: float


Evaluator = Callable[[list[Task], Callable[[int], None]], list[_Assessed]]


def _design(
    problem: Problem, evaluate: Evaluator, progress: Callable[[int, int], None] | None
) -> Design:
    operation, done = problem.operation, 0

    def count(runs: int) -> None:
        nonlocal done
        done += runs
        if progress is not None:
            progress(done, problem.budget)

    history: list[Evaluation] = []
    U = problem.parameters(verification=False)
    steps = search_steps(problem.search, len(operation), points=problem.points, seed=problem.seed)
    X = next(steps, None)
    while X is not None:
        assessed = evaluate([Task(x, U, verification=False) for x in operation.from_unit(X)], count)
        history += [a.evaluation for a in assessed]
        try:
            X = steps.send(np.array([a.evaluation.cost for a in assessed]))
        except StopIteration:
            X = None

    candidates = _distinct_cheapest(operation, history)
    if not candidates:
        raise DesignError(f"no maneuver can be driven and judged: {_reasons(history)}")
    U = problem.parameters(verification=True)
    verified = evaluate(
        [Task(candidate.x, U, verification=True) for candidate in candidates], count
    )
    best = min(range(len(verified)), key=lambda i: verified[i].evaluation.cost)
    at_x, sensitivity = verified[best].evaluation, verified[best].sensitivity
    if sensitivity is None:
        raise DesignError(f"the verification failed: {at_x.infeasible}")
    target = problem.unknown.index(problem.target)
    verdict, explanation = _judge(problem, sensitivity, verified[best].noise_share, history)
    everything = history + [v.evaluation for v in verified]
    return Design(
        operation=operation,
        target=problem.target,
        x=at_x.x,
        cost=at_x.cost,
        cost_interval=cost_interval(sensitivity, target, noise_share=verified[best].noise_share),
        predicted_cost=candidates[best].cost,
        sensitivity=sensitivity,
        verdict=verdict,
        explanation=explanation,
        history=tuple(history),
        simulations=sum(e.simulations for e in everything),
        failed=sum(e.failed for e in everything),
    )


def _distinct_cheapest(operation: Box, history: list[Evaluation]) -> list[Evaluation]:
    """Return the cheapest evaluations, at least a tenth of the box apart on some axis."""
    chosen: list[Evaluation] = []
    for evaluation in sorted(history, key=lambda e: e.cost):
        if len(chosen) == _VERIFIED or not math.isfinite(evaluation.cost):
            break
        u = operation.to_unit(evaluation.x)
        if all(np.abs(u - operation.to_unit(other.x)).max() > 0.1 for other in chosen):
            chosen.append(evaluation)
    return chosen


def _judge(
    problem: Problem, at_x: Sensitivity, noise_share: float, history: list[Evaluation]
) -> tuple[Verdict, str]:
    target = problem.unknown.index(problem.target)
    share = float(at_x.main[target])
    rivals = {name: float(s) for name, s in zip(at_x.names, at_x.main, strict=True)}
    del rivals[problem.target]
    rivals["measurement noise"] = noise_share
    rival = max(rivals, key=lambda name: rivals[name])
    numbers = (
        f"main index of {problem.target} {share:.3f}, largest other contribution: "
        f"{rival} {rivals[rival]:.3f}"
    )
    if share >= rivals[rival]:
        return Verdict.EXCITES, numbers
    most = max(float(e.main[target]) for e in history if not e.infeasible)
    return Verdict.CANNOT_EXCITE, (
        f"{numbers}; in {len(history)} maneuvers of this family its main index reached "
        f"{most:.3f} at most: choose another family for this parameter"
    )


def _reasons(history: list[Evaluation]) -> str:
    """The most frequent reason for an infeasible maneuver, with its count."""
    reasons = [e.infeasible for e in history]
    frequent = max(sorted(set(reasons)), key=reasons.count)
    return f"{frequent} ({reasons.count(frequent)} of {len(reasons)})"


# --- where the simulator runs -------------------------------------------------------------------


@contextmanager
def _evaluator(
    f: Simulator, problem: Problem, executor: Executor | None, workers: int | None
) -> Iterator[Evaluator]:
    if executor is None and workers == 1:

        def in_process(tasks: list[Task], count: Callable[[int], None]) -> list[_Assessed]:
            assessed = []
            for task in tasks:
                assessed.append(_evaluate(f, problem, task))
                count(assessed[-1].evaluation.simulations)
            return assessed

        yield in_process
        return

    try:
        pickle.dumps((f, problem))
    except Exception as error:
        raise DesignError(
            "f or noise_variance cannot be sent to another process: define it at the top of a "
            f"module, or give workers=1 ({error})"
        ) from error
    own = executor is None
    pool = executor or ProcessPoolExecutor(
        workers or os.cpu_count(),
        # a forked child can hang on the locks of its parent's threads
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_single_threaded,
    )

    def in_pool(tasks: list[Task], count: Callable[[int], None]) -> list[_Assessed]:
        futures: list[Future[_Assessed]] = [pool.submit(_evaluate, f, problem, t) for t in tasks]
        try:
            for future in as_completed(futures):
                count(future.result().evaluation.simulations)
        except BrokenProcessPool as error:
            raise DesignError("a worker process died; was memory short?") from error
        finally:
            for future in futures:
                future.cancel()
        return [future.result() for future in futures]

    try:
        yield in_pool
    finally:
        if own:
            pool.shutdown(cancel_futures=True)


def _single_threaded() -> None:
    """Keep a worker process to one thread: more of them only wait for each other."""
    if "numba" in sys.modules:
        sys.modules["numba"].set_num_threads(1)
    else:
        os.environ["NUMBA_NUM_THREADS"] = "1"


_THREADPOOLS = ThreadpoolController()


def _evaluate(f: Simulator, problem: Problem, task: Task) -> _Assessed:
    """Simulate one maneuver and judge it. Runs wherever the executor says."""
    with _THREADPOOLS.limit(limits=1):
        try:
            m = call_simulator(lambda P: f(task.x, P), problem.unknown.from_unit(task.U))
        except InfeasibleManeuver as infeasible:
            return _rejected(
                problem, task.x, str(infeasible) or "infeasible", simulations=0, failed=0
            )
        except DesignError:
            raise
        except Exception as error:
            where = ", ".join(
                f"{name} = {value:g}"
                for name, value in zip(problem.operation.names, task.x, strict=True)
            )
            raise DesignError(f"f raised {type(error).__name__}: {error}, at {where}") from error
        return _assess(problem, task, m)


def _assess(problem: Problem, task: Task, m: FloatArray) -> _Assessed:
    """Indices and cost from outputs m (n,), NaN where failed."""
    target = problem.unknown.index(problem.target)
    try:
        model = fit_metamodel(task.U, m)
    except DesignError as error:
        failed = int(np.sum(~np.isfinite(m)))
        return _rejected(problem, task.x, str(error), simulations=len(m), failed=failed)
    indices, failed = sobol_indices(model), int(np.sum(~np.isfinite(m)))
    noise_variance = problem.noise_variance
    if callable(noise_variance):
        noise_variance = float(noise_variance(m[np.isfinite(m)]))
    noise_share = noise_variance / indices.variance
    cost = excitation_cost(indices.main, indices.total, target, noise_share=noise_share)
    evaluation = Evaluation(
        x=task.x,
        cost=cost,
        main=indices.main,
        total=indices.total,
        variance=indices.variance,
        leave_one_out_q2=model.leave_one_out_q2(),
        simulations=len(m),
        failed=failed,
        infeasible="",
    )
    sensitivity = (
        sensitivity_of_model(problem.unknown, model, indices, failed=failed)
        if task.verification
        else None
    )
    return _Assessed(evaluation, sensitivity, noise_share)


def _rejected(
    problem: Problem, x: FloatArray, reason: str, *, simulations: int, failed: int
) -> _Assessed:
    nothing = np.full(len(problem.unknown), np.nan)
    evaluation = Evaluation(
        x=x,
        cost=math.inf,
        main=nothing,
        total=nothing,
        variance=math.nan,
        leave_one_out_q2=math.nan,
        simulations=simulations,
        failed=failed,
        infeasible=reason,
    )
    return _Assessed(evaluation, None, math.nan)
