"""Searches of the operation box for the cheapest maneuver, as generators.

A search yields points X (b, l) of the unit box, receives their evaluations, whose cost is infinite
where the maneuver cannot be driven, and ends by returning. The evaluations may come from an
executor, a study on disk, or a function in the same process; the points of one batch are
independent of each other.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from queue import SimpleQueue
from threading import Thread

import cobyqa
import numpy as np
from scipy.optimize import direct

from excitation_planner.design.criteria import Criterion, excitation_cost
from excitation_planner.design.problem import DesignProblem, Evaluation, Search
from excitation_planner.indices.kriging import Kriging
from excitation_planner.indices.sampling import corners, sobol_sequence
from tricycle_core.errors import DesignError
from tricycle_core.quantities import FloatArray

SearchSteps = Generator[FloatArray, list[Evaluation], None]
Objective = Callable[[FloatArray], float]

_SOBOL_POINTS = 16  # of the screening
_STARTS = 4  # local searches side by side
_APART = 0.25  # least distance between their starts, on some axis
_FIRST_RADIUS, _LAST_RADIUS = 0.25, 2e-3  # of their trust regions
_LOCAL_POINTS = 60  # most points of one of them


def adaptive_search(
    dimensions: int,
    *,
    points: int,
    seed: int,
    criterion: Criterion,
    starts: FloatArray | None = None,
) -> SearchSteps:
    """Evaluate corners and Sobol' points of the unit box, then search by COBYQA from the best.

    Optima often lie on faces, which DIRECT never samples: hence the corners. A local search that
    ends, or comes close to a better one, is replaced by one from the best point far from all.

    Parameters
    ----------
    dimensions : int
        Number l of operation parameters.
    points : int
        Largest number of points.
    seed : int
        Seed of the Sobol' points.
    criterion : Criterion
        Decides the scale on which costs are searched.
    starts : ndarray of float, shape (n, l), optional
        Points that are evaluated first, instead of corners and Sobol' points.
    """
    if starts is None or not len(starts):
        screened = sobol_sequence(_SOBOL_POINTS, dimensions, seed=seed)
        starts = np.vstack([corners(dimensions, seed=seed), screened])
    X = starts[:points]
    costs = _scaled((yield X), criterion)
    if not np.isfinite(costs).any():
        return
    seen, seen_costs = X, costs
    begun, running, left = X[:0], list[_LocalSearch](), points - len(X)
    try:
        while left > 0:
            running = _going_on(running)
            while len(running) < _STARTS:
                start = _best_apart(X, costs, begun)
                if start is None:
                    break
                running.append(_LocalSearch(X[start], float(costs[start])))
                begun = np.vstack([begun, X[start]])
            if not running:
                return
            asking = [search for search in running if search.asked is not None][:left]
            if not asking:
                continue
            points_asked = np.array([search.asked for search in asking])
            new = _scaled((yield points_asked), criterion)
            seen, seen_costs = np.vstack([seen, points_asked]), np.concatenate([seen_costs, new])
            for search, point, cost in zip(asking, points_asked, new, strict=True):
                search.tell(
                    float(cost)
                    if np.isfinite(cost)
                    else _infeasible_cost(point, seen, seen_costs, search.cost)
                )
            left -= len(asking)
    finally:
        for search in running:
            search.stop()


def _infeasible_cost(x: FloatArray, X: FloatArray, costs: FloatArray, best: float) -> float:
    """Cost given to a local search at an infeasible x (l,): above that of the nearest of X (n, l).

    A high value would spoil its quadratic model, and hide optima at the limit of what is feasible.
    """
    X, costs = X[np.isfinite(costs)], costs[np.isfinite(costs)]
    nearest = float(costs[np.argmin(np.linalg.norm(X - x, axis=1))])
    return nearest + 0.1 * max(float(np.median(costs)) - best, 0.0)


def direct_search(dimensions: int, *, points: int, criterion: Criterion) -> SearchSteps:
    """Search by DIRECT on the cost itself.

    Over a box widened by a quarter and clipped, because DIRECT does not sample faces.

    Parameters
    ----------
    dimensions : int
        l, number of operation parameters.
    points : int
        Largest number of points.
    criterion : Criterion
        Decides the scale on which costs are searched.
    """
    search = _AskedMinimiser(lambda cost: _direct(cost, dimensions, points=points))
    try:
        for _ in range(points):
            if search.asked is None:
                return
            cost = float(_scaled((yield search.asked[None]), criterion)[0])
            search.tell(cost if np.isfinite(cost) else _DIRECT_INFINITY)
    finally:
        search.stop()


_DIRECT_INFINITY = 1e6  # DIRECT compares costs, but also subtracts them


def _direct(cost: Objective, dimensions: int, *, points: int) -> FloatArray:
    """Minimise over the unit box, widened and clipped, by locally biased DIRECT: best x (l,)."""
    result = direct(
        lambda z: cost(np.clip(z, 0.0, 1.0)),
        [(-0.125, 1.125)] * dimensions,
        maxfun=points,
        maxiter=points,
        vol_tol=0,
        len_tol=1e-4,
    )
    best: FloatArray = np.clip(result.x, 0.0, 1.0)
    return best


def one_shot_search(X: FloatArray, *, target: int, noise: bool) -> SearchSteps:
    """Search as the paper does: Kriging models of S and ST over x, DIRECT on them (Eq. 12).

    All points X (n, l) at once; then the minimum of the cost that the models give.

    Parameters
    ----------
    X : ndarray of float, shape (n, l)
        Points of the unit box, all evaluated at once.
    target : int
        Axis of the parameter to excite.
    noise : bool
        Whether the cost has a noise term.
    """
    evaluations = yield X
    usable = [i for i, evaluation in enumerate(evaluations) if not evaluation.infeasible]
    if len(usable) < 2:
        return
    found = [evaluations[i] for i in usable]
    cost = modelled_cost(
        X[usable],
        np.array([e.main for e in found]),
        np.array([e.total for e in found]),
        noise_share=np.array([e.noise_share for e in found]) if noise else None,
        target=target,
    )
    yield _direct(cost, X.shape[1], points=2000)[None]


def modelled_cost(
    X: FloatArray,
    main: FloatArray,
    total: FloatArray,
    *,
    target: int,
    noise_share: FloatArray | None = None,
) -> Objective:
    """Return the cost H of x (l,) by 2k Kriging models of the indices (Eq. 12).

    Parameters
    ----------
    X : ndarray of float, shape (n, l)
        Points of the unit box.
    main, total : ndarray of float, shape (n, k)
        Sobol' indices there.
    target : int
        Axis of the parameter to excite.
    noise_share : ndarray of float, shape (n,), optional
        V_n / V there.
    """

    def modelled(y: FloatArray) -> Callable[[FloatArray], float]:
        if np.ptp(y) <= 1e-12 * np.abs(y).max():
            return lambda _: float(y[0])
        model = Kriging().fit(X, y)
        return lambda x: float(model.predict(x[None])[0])

    main_models = [modelled(y) for y in main.T]
    total_models = [modelled(y) for y in total.T]
    share = None
    if noise_share is not None and noise_share.any():
        share = modelled(np.log(np.maximum(noise_share, 1e-12)))

    def cost(x: FloatArray) -> float:
        S, ST = np.array([g(x) for g in main_models]), np.array([g(x) for g in total_models])
        # the models may violate 0 < S <= ST
        S = np.maximum(S, 1e-6)
        noise = 0.0 if share is None else float(np.exp(share(x)))
        return excitation_cost(S, np.maximum(ST, S), target, noise_share=noise)

    return cost


def _scaled(evaluations: list[Evaluation], criterion: Criterion) -> FloatArray:
    """Costs (b,) on the scale that is searched; infinite where infeasible."""
    return np.array([criterion.search_scale(evaluation.cost) for evaluation in evaluations])


class _StoppedError(Exception):
    """Ends the thread of a minimiser whose search is stopped."""


class _AskedMinimiser:
    """Ask-and-tell interface to a minimiser that calls its objective.

    The minimiser runs in a thread of its own, which sleeps until `tell` gives it the cost.

    Attributes
    ----------
    asked : ndarray of float, shape (l,), or None
        Point whose cost is needed next; None when the minimiser has ended.
    """

    def __init__(self, minimise: Callable[[Objective], object]) -> None:
        self.asked: FloatArray | None = None
        self._questions: SimpleQueue[FloatArray | Exception | None] = SimpleQueue()
        self._answers: SimpleQueue[float | None] = SimpleQueue()
        Thread(target=self._run, args=(minimise,), daemon=True).start()
        self._wait()

    def tell(self, cost: float) -> None:
        self._answers.put(cost)
        self._wait()

    def stop(self) -> None:
        if self.asked is not None:
            self.asked = None
            self._answers.put(None)
            self._questions.get()

    def _wait(self) -> None:
        question = self._questions.get()
        if isinstance(question, Exception):
            raise question
        self.asked = question

    def _run(self, minimise: Callable[[Objective], object]) -> None:
        def objective(x: FloatArray) -> float:
            self._questions.put(np.array(x, dtype=float))
            cost = self._answers.get()
            if cost is None:
                raise _StoppedError
            return cost

        try:
            minimise(objective)
        except _StoppedError:
            self._questions.put(None)
        except Exception as error:
            self._questions.put(error)
        else:
            self._questions.put(None)


class _LocalSearch(_AskedMinimiser):
    """COBYQA (Ragonneau 2022) from one start, and the best point it has seen."""

    def __init__(self, x: FloatArray, cost: float) -> None:
        self.x, self.cost = x, cost

        def minimise(objective: Objective) -> None:
            cobyqa.minimize(
                lambda z: objective(np.clip(z, 0.0, 1.0)),
                x,
                bounds=[(0.0, 1.0)] * len(x),
                options={
                    "radius_init": _FIRST_RADIUS,
                    "radius_final": _LAST_RADIUS,
                    "maxfev": _LOCAL_POINTS,
                },
            )

        super().__init__(minimise)

    def tell(self, cost: float) -> None:
        if self.asked is not None and cost < self.cost:
            self.x, self.cost = self.asked, cost
        super().tell(cost)


def _going_on(searches: list[_LocalSearch]) -> list[_LocalSearch]:
    """Searches that have neither ended nor come close to a better one; the others are stopped."""
    kept: list[_LocalSearch] = []
    for search in sorted(searches, key=lambda search: search.cost):
        alone = all(np.abs(search.x - other.x).max() > 0.05 for other in kept)
        if search.asked is not None and alone:
            kept.append(search)
        else:
            search.stop()
    return kept


def _best_apart(X: FloatArray, costs: FloatArray, others: FloatArray) -> int | None:
    """Index of the cheapest point far from each of the others."""
    for i in np.argsort(costs, kind="stable"):
        if not np.isfinite(costs[i]):
            return None
        if len(others) == 0 or np.abs(X[i] - others).max(axis=1).min() >= _APART:
            return int(i)
    return None


def search_steps(problem: DesignProblem, starts: FloatArray | None = None) -> SearchSteps:
    """Return the search that the problem asks for.

    Parameters
    ----------
    problem : DesignProblem
        Has the search, its budget and its seed.
    starts : ndarray of float, shape (n, l), optional
        Points of the unit box that an adaptive search begins with.
    """
    dimensions, points = len(problem.operation), problem.points
    if problem.search is Search.ADAPTIVE:
        return adaptive_search(
            dimensions,
            points=points,
            seed=problem.seed,
            criterion=problem.criterion,
            starts=starts,
        )
    if problem.search is Search.DIRECT:
        return direct_search(dimensions, points=points, criterion=problem.criterion)
    if problem.criterion is not Criterion.H or problem.target_index is None:
        raise DesignError(f"search {problem.search} models Sobol' indices: it needs criterion h")
    if points < 3:
        raise DesignError(
            f"search {problem.search}: the budget allows {points} points, 3 are needed"
        )
    if problem.search is Search.ONE_SHOT_SOBOL:
        X = sobol_sequence(points - 1, dimensions, seed=problem.seed)
    else:
        c = int((points - 1 + 1e-9) ** (1 / dimensions))
        if c < 2:
            raise DesignError(
                f"search {problem.search}: the budget allows {points} points, "
                f"{2**dimensions + 1} are needed for two levels per axis"
            )
        levels = np.linspace(0.0, 1.0, c)
        X = np.stack(np.meshgrid(*[levels] * dimensions, indexing="ij"), axis=-1).reshape(
            -1, dimensions
        )
    noisy = callable(problem.noise_variance) or problem.noise_variance > 0
    return one_shot_search(X, target=problem.target_index, noise=noisy)
