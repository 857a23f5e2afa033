"""The design of an excitation maneuver: second stage of the method (Fig. 1, Eqs. 11-12).

n: samples, k: unknown parameters, l: operation parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from excitation_planner.box import Bounds, Box
from excitation_planner.design.criteria import Criterion
from excitation_planner.design.executors import evaluations
from excitation_planner.design.noise import TrajectoryNoise
from excitation_planner.design.prior import (
    NO_NUISANCES,
    SHOWN,
    BoxPrior,
    NuisanceParameters,
)
from excitation_planner.design.problem import (
    DRAWS,
    VERIFIED,
    DesignProblem,
    Evaluation,
    NoiseVariance,
    Search,
    Simulator,
    Verified,
)
from excitation_planner.design.search import search_steps
from excitation_planner.design.store import Store
from excitation_planner.indices.sensitivity import Sensitivity
from excitation_planner.indices.threads import THREADPOOLS
from tricycle_core.errors import DesignError
from tricycle_core.optional import optional, own_axes
from tricycle_core.palette import BLUE, GREY, VERMILLION
from tricycle_core.quantities import FloatArray, Progress


class Verdict(StrEnum):
    """Whether a design excites its target."""

    EXCITES = "excites"  # the target contributes most to the output, or is learnt
    CANNOT_EXCITE = "cannot excite"  # it does not, even at the best maneuver of the family
    UNDECIDED = "may excite"  # the metamodel predicts too little of the output to tell


@dataclass(frozen=True)
class Design:
    """The maneuver that excites one parameter best, and how far it can be trusted.

    Attributes
    ----------
    operation : Box
        Ranges of the operation parameters.
    target : str or None
        Unknown parameter to excite.
    criterion : Criterion
        Criterion that was minimised.
    x : ndarray of float, shape (l,)
        Operation parameters of the maneuver.
    cost : float
        Criterion at x, from the verification.
    cost_interval : (float, float)
        95 % interval of `cost`.
    predicted_cost : float
        Criterion at x as found by the search, with fewer and other samples.
    posterior_std : ndarray of float, shape (k,)
        Standard deviations of the parameters after the drive, in ranges; NaN for the criterion H.
    verdict : Verdict
        Whether the maneuver excites the target.
    explanation : str
        The verdict in a sentence with its numbers.
    history : tuple of Evaluation
        Everything the search evaluated, in order.
    simulations, failed : int
        Number of runs of f, verification included, and how many of them failed (NaN).
    verification : Sensitivity or callable
        Indices at x from fresh samples, or a function that computes them; see `sensitivity`.
    """

    operation: Box
    target: str | None
    criterion: Criterion
    x: FloatArray
    cost: float
    cost_interval: tuple[float, float]
    predicted_cost: float
    posterior_std: FloatArray
    verdict: Verdict
    explanation: str
    history: tuple[Evaluation, ...]
    simulations: int
    failed: int
    verification: Sensitivity | Callable[[], Sensitivity] = field(repr=False)

    def __repr__(self) -> str:
        low, high = self.cost_interval
        x = zip(self.operation.names, self.x, strict=True)
        return (
            f"Design: {self.verdict} {self.target or 'all'}, criterion {self.criterion} = "
            f"{self.cost:.4g} ({low:.4g} to {high:.4g}), {self.simulations} simulations\n"
            f"  at {', '.join(f'{name} {value:.4g}' for name, value in x)}\n"
            f"  {self.explanation}"
        )

    def to_dataframe(self) -> Any:
        """Return the search as a pandas DataFrame, a row per maneuver in the order of evaluation.

        Raises
        ------
        ReportError
            If pandas is not installed.
        """
        X = np.array([evaluation.x for evaluation in self.history])
        columns: dict[str, Any] = dict(zip(self.operation.names, X.T, strict=True))
        for name in ("cost", "simulations", "failed", "infeasible"):
            columns[name] = [getattr(evaluation, name) for evaluation in self.history]
        return optional("pandas", "to_dataframe").DataFrame(columns)

    def plot(self, axes: Any = None) -> Any:
        """Draw the search in the box: cost over one parameter, or as colour over the first two.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Drawn on; default: those of a new figure.

        Returns
        -------
        axes : matplotlib.axes.Axes
            Axes that are drawn on.

        Raises
        ------
        ReportError
            If matplotlib is not installed.
        """
        axes = own_axes() if axes is None else axes
        X = np.array([evaluation.x for evaluation in self.history])
        costs = np.array([evaluation.cost for evaluation in self.history])
        kept, names = np.isfinite(costs), self.operation.names
        scaled = [self.criterion.search_scale(cost) for cost in costs[kept]]
        scale = {"h": "ln(1 + H)", "d": "D"}.get(self.criterion, f"ln {self.criterion.upper()}")
        best: FloatArray = self.x[:2]
        if len(names) == 1:
            axes.plot(X[kept, 0], scaled, "o", color=BLUE, markersize=4, label="evaluated")
            best = np.array([self.x[0], self.criterion.search_scale(self.cost)])
            axes.set(xlabel=names[0], ylabel=scale)
        else:
            points = axes.scatter(*X[kept, :2].T, c=scaled, s=18, cmap="viridis", label="evaluated")
            axes.figure.colorbar(points, ax=axes, label=scale)
            axes.set(xlabel=names[0], ylabel=names[1])
            if not kept.all():
                left_out = X[~kept, :2].T
                axes.plot(*left_out, "x", color=GREY, markersize=4, label="cannot be driven")
        axes.plot(*best, "*", color=VERMILLION, markersize=14, label="the design")
        axes.set_title(f"{self.verdict} {self.target or 'all parameters'}")
        axes.legend(fontsize="small")
        axes.grid(alpha=0.3)
        return axes

    @cached_property
    def sensitivity(self) -> Sensitivity:
        """Indices at x with intervals, from the verification: fresh samples, unseen by the search.

        For the criteria C, D and A of the mean squared deviation from the middle of the box; they
        are found when they are asked for.
        """
        found = self.verification
        return found if isinstance(found, Sensitivity) else found()

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


FEW = 10
"""Maneuvers of a box below which a search may miss those that can be driven."""


def design_excitation(
    f: Simulator,
    operation: Box | Bounds,
    unknown: Box | Bounds,
    target: str | None,
    *,
    criterion: Criterion | str = Criterion.H,
    noise_variance: NoiseVariance = 0.0,
    trajectory_noise: TrajectoryNoise = TrajectoryNoise(),  # noqa: B008  (frozen)
    samples: int = 100,
    prior: BoxPrior | None = None,
    nuisances: NuisanceParameters = NO_NUISANCES,
    draws: int = DRAWS,
    budget: int = 25_000,
    seed: int = 0,
    search: Search | str = Search.ADAPTIVE,
    executor: Executor | None = None,
    workers: int | None = None,
    chunk: int | None = None,
    timeout: float | None = None,
    store: Path | None = None,
    starts: FloatArray | None = None,
    progress: Progress | None = None,
) -> Design:
    """Find the maneuver that excites the parameter ``target`` best.

    Parameters
    ----------
    f : callable
        Simulator: operation parameters x (l,) and unknown parameters P (n, k) to outputs (n,), or
        for the criteria C, D and A to trajectories (n, time points, channels) of one
        maneuver, or a tuple of them for a set of maneuvers (see `ManeuverSet`).
        NaN marks a failed simulation; `InfeasibleManeuver` a maneuver that cannot be driven.
    operation, unknown : Box or dict
        ``{name: (low, high)}`` of the operation and the unknown parameters.
    target : str or None
        Name of the unknown parameter to excite; the criteria D and A need none.
    criterion : Criterion or str
        Criterion that is minimised: ``"h"``, the paper's, ``"c"``, ``"d"`` or ``"a"``.
    noise_variance : float or callable
        For H: variance V_n of the output's measurement noise, or that variance as a function of
        the outputs (n,) at one x, e.g. `TrajectoryErrorNoise`; 0 is the paper's cost.
    trajectory_noise : TrajectoryNoise
        For C, D and A: noise of the trajectory.
    samples : int
        Runs of f per maneuver during the search for H; its verification takes three times as many.
    prior : BoxPrior, optional
        For C, D and A: knowledge from earlier drives; None: uniform.
    nuisances : NuisanceParameters
        For C, D and A: the e inputs that f takes after the k parameters, which are uncertain but
        not of interest (nuisance parameters).
    draws : int
        For C, D and A: parameter values over which the criterion is averaged, k + e + 1 runs each.
    budget : int
        Most runs of f in all.
    seed : int
        The same seed gives the same design, whatever the executor.
    search : Search or str
        How the operation box is searched.
    executor : Executor, optional
        Executor in which f runs; by default processes of this machine, made and ended by this call.
        They get f by value: it may be defined in a notebook or in a script.
    workers : int, optional
        Number of those processes, by default one per core; 1 runs everything in this process.
    chunk : int, optional
        Runs of f that one task of the executor simulates. By default all of a maneuver, which is
        best while they take less than a second together; 1 for a simulator that takes seconds per
        run. The design is the same as long as a row of f's outputs depends on its row of P alone.
    timeout : float, optional
        Time without any result [s] after which tasks are given to other workers: longer than any
        task takes. By default a worker that hangs is waited for.
    store : Path, optional
        Directory of a `Study` that keeps every run of f; what is there is not run again.
    starts : ndarray of float, shape (n, l), optional
        Points of the unit box that an adaptive search begins with; default: corners and others.
    progress : callable, optional
        Called with (runs of f so far, budget).

    Raises
    ------
    DesignError
        If target, criterion or search is unknown, the budget too small, f raises or cannot be sent
        to another process, workers die or hang again and again or have another version, no maneuver
        of the family can be driven and judged, or the store is of another design.
    """
    problem = DesignProblem(
        operation=Box.of(operation),
        unknown=Box.of(unknown),
        target=target,
        criterion=Criterion(criterion),
        noise_variance=noise_variance,
        trajectory_noise=trajectory_noise,
        samples=samples,
        draws=draws,
        budget=budget,
        seed=seed,
        search=Search(search),
        prior=prior,
        nuisances=nuisances,
    )
    if starts is not None:
        starts = np.asarray(starts, dtype=float)
        if starts.shape[1:] != (len(problem.operation),):
            raise DesignError(
                f"starts have shape {starts.shape}: (starts, {len(problem.operation)}) is needed"
            )
        if not ((starts >= 0.0) & (starts <= 1.0)).all():
            raise DesignError("starts must be points of the unit box, from 0 to 1")
    # one BLAS thread here too: what it computes must not depend on the number of cores, and the
    # threads of an executor share the setting
    with (
        THREADPOOLS.limit(limits=1),
        evaluations(
            f,
            problem,
            executor=executor,
            workers=workers,
            chunk=chunk,
            timeout=timeout,
            store=None if store is None else Store.of(Path(store), problem),
            progress=None if progress is None else lambda done: progress(done, budget),
        ) as evaluate_all,
    ):
        return search_design(problem, evaluate_all, starts)


def search_design(
    problem: DesignProblem,
    evaluate_all: Callable[[list[FloatArray], bool], list[Verified]],
    starts: FloatArray | None = None,
) -> Design:
    """Search a maneuver, verify it on fresh samples, and give the verdict.

    Parameters
    ----------
    problem : DesignProblem
        Design problem to be solved.
    evaluate_all : callable
        Evaluates points x (l,); its second argument says whether to verify.
    starts : ndarray of float, shape (n, l), optional
        Points of the unit box that an adaptive search begins with.
    """
    history: list[Evaluation] = []
    known: dict[bytes, Evaluation] = {}  # searches ask again for their start, and at the faces
    steps = search_steps(problem, starts)
    try:
        X = next(steps)
        while True:
            points = [(x.tobytes(), x) for x in problem.operation.from_unit(X)]
            new = {key: x for key, x in points if key not in known}
            if new:
                judged = evaluate_all(list(new.values()), False)
                known |= zip(new, (verified.evaluation for verified in judged), strict=True)
            evaluated = [known[key] for key, _ in points]
            history += evaluated
            X = steps.send(evaluated)
    except StopIteration:
        pass
    finally:
        steps.close()

    candidates = _distinct_cheapest(problem.operation, history)
    if not candidates:
        raise DesignError(
            f"no maneuver can be driven and judged: {_reasons(history)}{_larger_budget(problem)}"
        )
    verified = evaluate_all([candidate.x for candidate in candidates], True)
    best = min(range(len(verified)), key=lambda i: verified[i].evaluation.cost)
    at_x, sensitivity = verified[best].evaluation, verified[best].sensitivity
    if sensitivity is None:
        raise DesignError(f"the verification failed: {at_x.infeasible}")
    unexplained = sensitivity.unexplained if isinstance(sensitivity, Sensitivity) else 0.0
    verdict, explanation = _judge(problem, at_x, history, unexplained)
    everything = [*known.values(), *(v.evaluation for v in verified)]
    return Design(
        operation=problem.operation,
        target=problem.target,
        criterion=problem.criterion,
        x=at_x.x,
        cost=at_x.cost,
        cost_interval=verified[best].cost_interval,
        predicted_cost=candidates[best].cost,
        posterior_std=at_x.posterior_std,
        verdict=verdict,
        explanation=explanation,
        history=tuple(history),
        simulations=sum(e.simulations for e in everything),
        failed=sum(e.failed for e in everything),
        verification=sensitivity,
    )


def _larger_budget(problem: DesignProblem) -> str:
    """Advice where the budget, not the family, left hardly any maneuver to be tried; else ""."""
    if problem.points >= FEW:
        return ""
    tried = "1 maneuver" if problem.points == 1 else f"{problem.points} maneuvers"
    more = (FEW - problem.points) * problem.runs(verification=False)
    return f"; the budget allows {tried} of the box only: raise it by {more} for {FEW}"


def _distinct_cheapest(operation: Box, history: list[Evaluation]) -> list[Evaluation]:
    """Return the cheapest evaluations, at least a tenth of the box apart on some axis."""
    chosen: list[Evaluation] = []
    for evaluation in sorted(history, key=lambda e: e.cost):
        if len(chosen) == VERIFIED or not math.isfinite(evaluation.cost):
            break
        u = operation.to_unit(evaluation.x)
        if all(np.abs(u - operation.to_unit(other.x)).max() > 0.1 for other in chosen):
            chosen.append(evaluation)
    return chosen


def _judge(
    problem: DesignProblem,
    at_x: Evaluation,
    history: list[Evaluation],
    unexplained: float,
) -> tuple[Verdict, str]:
    target, names = problem.target_index, problem.unknown.names
    if problem.criterion is not Criterion.H or target is None:
        # what is left of the prior's deviation; of the worst parameter when all are meant
        prior = problem.prior or BoxPrior.uniform(len(names))
        left = at_x.posterior_std / prior.std
        judged = int(np.argmax(left)) if target is None else target
        text = f"the drive leaves {left[judged]:.1%} of the prior deviation of {names[judged]}"
        learnt = left[judged] <= SHOWN
        return (Verdict.EXCITES if learnt else Verdict.CANNOT_EXCITE), text

    share = float(at_x.main[target])
    rivals = dict(zip(names, at_x.main.tolist(), strict=True))
    del rivals[names[target]]
    rivals["measurement noise"] = at_x.noise_share
    rival = max(rivals, key=lambda name: rivals[name])
    numbers = (
        f"main index of {names[target]} {share:.3f}, largest other contribution: "
        f"{rival} {rivals[rival]:.3f}"
    )
    if unexplained > (1.0 - unexplained) * abs(share - rivals[rival]):
        return Verdict.UNDECIDED, (
            f"{numbers}; the metamodel misses {unexplained:.0%} of the output's variance, more "
            "than these differ by: simulate more samples of each maneuver"
        )
    if share >= rivals[rival]:
        return Verdict.EXCITES, numbers
    most = max(float(e.main[target]) for e in history if not e.infeasible)
    tried = "1 maneuver" if len(history) == 1 else f"{len(history)} maneuvers"
    remedy = _larger_budget(problem) or ": choose another family for this parameter"
    return Verdict.CANNOT_EXCITE, (
        f"{numbers}; in {tried} of this family its main index reached {most:.3f} at most{remedy}"
    )


def _reasons(history: list[Evaluation]) -> str:
    """The most frequent reason for an infeasible maneuver, with its count."""
    reasons = [e.infeasible for e in history]
    frequent = max(sorted(set(reasons)), key=reasons.count)
    return f"{frequent} ({reasons.count(frequent)} of {len(reasons)})"
