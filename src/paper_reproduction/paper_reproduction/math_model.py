"""Table 1 and Figs. 5, 6, 8 and 9: the math model (Eq. 13), whose indices are known exactly."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.optimize import direct

from excitation_planner.box import Box
from excitation_planner.design.criteria import excitation_cost
from excitation_planner.design.excitation import Design, design_excitation
from excitation_planner.design.search import modelled_cost
from excitation_planner.indices.analytic import (
    MATH_MODEL_OPERATION,
    MATH_MODEL_UNKNOWN,
    math_model,
    quadrature_indices,
)
from excitation_planner.indices.sampling import sobol_sequence
from excitation_planner.indices.sensitivity import sensitivity
from excitation_planner.indices.sobol import Indices, monte_carlo_indices
from paper_reproduction import published
from paper_reproduction.comparison import (
    Agreement,
    Comparison,
    Item,
)
from paper_reproduction.first_stage import (
    OurBudget,
    PaperBudget,
    Predictions,
    faithful,
    fast,
    predictions,
)
from tricycle_core.quantities import FloatArray, Progress

_RANDOM_REPEATS = 200  # repetitions of the estimator with random numbers
_NOISE_VARIANCE = 1e-4  # that ends the degeneracy at x -> 0
_DIRECT_POINTS = 500
_VISIBLE = 0.05  # relative difference of two costs
_DRAWS = 16  # of the points of the second stage: which are drawn decides what DIRECT finds
_VALLEY = (-5.0, -0.5)  # range of x in which nothing is degenerate


def exact_indices(x: FloatArray, *, nodes: int = 20) -> Indices:
    """Return the indices of the math model by quadrature.

    Parameters
    ----------
    x : ndarray of float, shape (4,)
        Operation parameters.
    nodes : int
        Number of quadrature nodes per axis.
    """
    return quadrature_indices(partial(math_model, x), MATH_MODEL_UNKNOWN, nodes=nodes)


def largest_error(indices: Indices, exact: Indices) -> float:
    """Return the largest error of any main or total index.

    Parameters
    ----------
    indices, exact : Indices
        Indices, and the exact ones.
    """
    return float(
        max(np.abs(indices.main - exact.main).max(), np.abs(indices.total - exact.total).max())
    )


# --- Table 1 --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Table1:
    """S of p1 by Monte Carlo with N base samples, and the indices by projection.

    `sobol` with one Sobol' sequence, `random_std` the deviation with random numbers; `ours` the
    largest error of any index by projection and the runs of f it took.

    Attributes
    ----------
    exact, ours : Indices
        Indices by quadrature, and by Kriging and projection.
    samples : ndarray of float, shape (q,)
        Numbers N of base samples.
    published, sobol : ndarray of float, shape (q,)
        S of p1, as printed, and with one Sobol' sequence.
    random_std : ndarray of float, shape (q,)
        Standard deviation of S of p1 with random numbers.
    ours_samples : int
        Number of runs of f for `ours`.
    """

    exact: Indices
    samples: FloatArray
    published: FloatArray
    sobol: FloatArray
    random_std: FloatArray
    ours: Indices
    ours_samples: int


def table_1() -> Item[Table1]:
    """Exact indices, and how the paper's estimator comes near them."""
    x = np.array(published.TABLE_1_X)
    f, exact = partial(math_model, x), exact_indices(x)
    ours = sensitivity(f, MATH_MODEL_UNKNOWN, samples=300)
    samples = list(published.TABLE_1_MONTE_CARLO)
    by_sobol = [monte_carlo_indices(f, 4, samples=n).main[0] for n in samples]
    deviation = _random_deviation(f, exact)
    data = Table1(
        exact=exact,
        samples=np.array(samples, dtype=float),
        published=np.array(list(published.TABLE_1_MONTE_CARLO.values())),
        sobol=np.array(by_sobol),
        random_std=deviation / np.sqrt(samples),
        ours=ours,
        ours_samples=ours.simulations,
    )
    comparisons = [
        _rounded(f"{kind} of p{i + 1}, exact", printed, float(value), 5e-5)
        for kind, numbers, values in (
            ("S", published.TABLE_1_MAIN, exact.main),
            ("ST", published.TABLE_1_TOTAL, exact.total),
        )
        for i, (printed, value) in enumerate(zip(numbers, values, strict=True))
    ]
    errors = np.abs(np.array(by_sobol) - exact.main[0])
    for n, printed, value, error in zip(samples, data.published, by_sobol, errors, strict=True):
        better = error < abs(printed - exact.main[0])
        comparisons.append(
            Comparison(
                f"S of p1 by Monte Carlo, N = {n}",
                float(printed),
                float(value),
                Agreement.BETTER if better else Agreement.NOT_REPRODUCED,
            )
        )
    shares = (data.published - exact.main[0]) / data.random_std
    findings = (
        "The published Monte-Carlo numbers lie "
        + ", ".join(f"{share:.1f}" for share in shares)
        + " standard deviations of plain random sampling above the exact index: what random "
        "numbers would give. One Sobol' sequence for P and Q, as the paper describes it, comes "
        "nearer.",
        f"{ours.simulations} runs of f with Kriging and projection leave an error of "
        f"{largest_error(ours, exact):.1e} in the worst of all eight indices; the estimator takes "
        f"6 N runs.",
    )
    return Item("table1", "Table 1: indices of the math model", tuple(comparisons), findings, data)


def _random_deviation(f: Callable[[FloatArray], FloatArray], exact: Indices) -> float:
    """Standard deviation of Eq. 9 for S of p1 with random P and Q, times sqrt(N)."""
    n, rng = 2000, np.random.default_rng(0)
    found = []
    for _ in range(_RANDOM_REPEATS):
        P, Q = rng.uniform(size=(2, n, 4))
        R = P.copy()
        R[:, 0] = Q[:, 0]
        found.append(np.mean(f(Q) * (f(R) - f(P))) / exact.variance)
    return float(np.std(found) * np.sqrt(n))


def _rounded(quantity: str, printed: float, ours: float, tolerance: float) -> Comparison:
    agrees = abs(printed - ours) <= tolerance
    return Comparison(
        quantity, printed, ours, Agreement.REPRODUCED if agrees else Agreement.NOT_REPRODUCED
    )


# --- Fig. 5 ---------------------------------------------------------------------------------------


def figure_5(ours: OurBudget, budget: PaperBudget | None) -> Item[Predictions]:
    """Kriging of the math model with 1000 samples, validated on 10 000.

    Parameters
    ----------
    ours : OurBudget
        Budget of our method.
    budget : PaperBudget or None
        Budget of the paper's method; None: without it.
    """
    f, validation = partial(math_model, np.array(published.FIG_5_X)), ours.validation
    stages = {
        f"{n} samples": fast(f, MATH_MODEL_UNKNOWN, samples=n, validation=validation)
        for n in (300, published.FIG_5_TRAINING)
    }
    if budget is not None:
        paper = _for_math_model(budget)
        stages[f"faithful, {published.FIG_5_TRAINING} samples"] = faithful(
            f, MATH_MODEL_UNKNOWN, budget=paper, validation=validation
        )
    data = predictions(stages, "1")
    best = data.statistics[f"{published.FIG_5_TRAINING} samples"]
    comparisons = (
        _quality("R²", published.FIG_5_R2, best.r2, larger_is_better=True),
        _quality("RAAE", published.FIG_5_RAAE, best.raae, larger_is_better=False),
    )
    few = data.statistics["300 samples"]
    findings = (
        f"With the paper's {published.FIG_5_TRAINING} samples 1 - R² is {1 - best.r2:.1e}; 300 "
        f"samples give 1 - R² = {1 - few.r2:.1e} and RAAE = {few.raae:.1e}.",
    )
    return Item("fig5", "Fig. 5: Kriging of the math model", comparisons, findings, data)


def _for_math_model(budget: PaperBudget) -> PaperBudget:
    """The training samples of Fig. 5, and no infill."""
    return replace(budget, initial=min(budget.initial, published.FIG_5_TRAINING), infill=0)


def _quality(quantity: str, printed: float, ours: float, *, larger_is_better: bool) -> Comparison:
    better = ours >= printed if larger_is_better else ours <= printed
    return Comparison(
        quantity, printed, ours, Agreement.BETTER if better else Agreement.NOT_REPRODUCED
    )


# --- Fig. 6 ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Convergence:
    """Largest error of any index over runs of f.

    Attributes
    ----------
    curves : dict of str to (ndarray, ndarray)
        Runs (q,) and errors (q,), by method.
    published_error : (float, float)
        Range that the paper shows.
    published_runs : float
        Number of runs from which the paper shows them.
    """

    curves: dict[str, tuple[FloatArray, FloatArray]]
    published_error: tuple[float, float]
    published_runs: float


def figure_6(budget: PaperBudget | None) -> Item[Convergence]:
    """Convergence of the Monte-Carlo estimator, and of our method.

    Parameters
    ----------
    budget : PaperBudget or None
        Budget of the paper's method; None: without it.
    """
    x = np.array(published.TABLE_1_X)
    f, exact = partial(math_model, x), exact_indices(x)
    sizes = 2 ** np.arange(10, 20)
    monte_carlo = [monte_carlo_indices(f, 4, samples=int(n)) for n in sizes]
    samples = np.array([50, 100, 200, 300, 600])
    ours = [sensitivity(f, MATH_MODEL_UNKNOWN, samples=int(n)) for n in samples]
    curves = {
        "Eqs. 9–10 on f, Sobol' sequence": (
            6.0 * sizes,
            np.array([largest_error(indices, exact) for indices in monte_carlo]),
        ),
        "ours: Kriging and projection": (
            samples.astype(float),
            np.array([largest_error(indices, exact) for indices in ours]),
        ),
    }
    if budget is not None:
        paper = _for_math_model(budget)
        points = [2**10, 2**12, 2**14, 2**16]
        stages = [
            faithful(f, MATH_MODEL_UNKNOWN, budget=replace(paper, monte_carlo=n)) for n in points
        ]
        curves["faithful: Eqs. 9–10 on Kriging of 1000 samples"] = (
            6.0 * np.array(points),
            np.array([largest_error(stage.indices, exact) for stage in stages]),
        )
    at_least = monte_carlo[-1]  # N = 2^19, the first above 500 000
    error = float(np.abs(at_least.main - exact.main).max())
    low, high = published.FIG_6_ERROR
    agreement = (
        Agreement.REPRODUCED
        if low <= error <= high
        else (Agreement.BETTER if error < low else Agreement.NOT_REPRODUCED)
    )
    comparisons = (
        Comparison(
            f"error of S by Monte Carlo, N > {published.FIG_6_SAMPLES}",
            f"{low:g} to {high:g}",
            error,
            agreement,
        ),
    )
    enough = next(
        (int(n) for n, e in zip(*curves["ours: Kriging and projection"], strict=True) if e <= high),
        None,
    )
    findings = (
        f"{6 * int(sizes[-1])} runs of f leave the estimator an error of "
        f"{curves[next(iter(curves))][1][-1]:.1e} in the worst index; ours gets below {high:g} "
        + ("with none of the numbers of samples tried." if enough is None else f"with {enough}."),
    )
    data = Convergence(curves, published.FIG_6_ERROR, 6.0 * published.FIG_6_SAMPLES)
    return Item("fig6", "Fig. 6: convergence of the indices", comparisons, findings, data)


# --- Figs. 8 and 9 --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Verification:
    """Searches for the cheapest x of one target.

    Attributes
    ----------
    target : str
        Parameter to excite.
    histories : dict of str to ndarray
        Cost (q,) of each evaluation of each search, in order.
    optima : dict of str to (ndarray, Indices, float)
        Best maneuver of each search: x (4,), exact indices and exact H there, without noise.
    """

    target: str
    histories: dict[str, FloatArray]
    optima: dict[str, tuple[FloatArray, Indices, float]]


def figure_8_or_9(
    target: str,
    ours: OurBudget,
    budget: PaperBudget | None,
    executor: Executor,
    progress: Progress,
) -> Item[Verification]:
    """Compare DIRECT on exact indices, DIRECT on Kriging models of them, and our search.

    Parameters
    ----------
    target : str
        Parameter to excite: p1 (Fig. 8) or p3 (Fig. 9).
    ours : OurBudget
        Budget of our method.
    budget : PaperBudget or None
        Budget of the paper's method; None: without it.
    executor : Executor
        Executor that runs the designs.
    progress : callable
        Called with the number of searches done and of all.
    """
    axis = MATH_MODEL_UNKNOWN.index(target)
    valley = Box.of(dict.fromkeys(MATH_MODEL_OPERATION.names, _VALLEY))
    searches: dict[str, tuple[Box, Callable[[FloatArray], float]]] = {
        "DIRECT, exact indices": (MATH_MODEL_OPERATION, partial(_exact_cost, axis)),
        "DIRECT, Kriging": (
            MATH_MODEL_OPERATION,
            _kriging_cost(axis, partial(_indices, ours), executor),
        ),
    }
    progress(1, 4)
    if budget is not None:
        searches["DIRECT, faithful Kriging"] = (
            MATH_MODEL_OPERATION,
            _kriging_cost(axis, partial(_indices, budget), executor),
        )
    histories, optima = {}, {}
    for label, (box, cost) in searches.items():
        x, histories[label] = _minimise(cost, box)
        optima[label] = _at(x, axis)
    progress(2, 4)
    designs: dict[str, Design] = {}
    for label, box, noise in (
        ("ours, x ≤ −0.5", valley, 0.0),
        ("ours, noise", MATH_MODEL_OPERATION, _NOISE_VARIANCE),
    ):
        designs[label] = design_excitation(
            math_model,
            box,
            MATH_MODEL_UNKNOWN,
            target,
            noise_variance=noise,
            budget=ours.design_runs,
            executor=executor,
        )
        histories[label] = np.array([e.cost for e in designs[label].history])
        optima[label] = _at(designs[label].x, axis)
        progress(len(designs) + 2, 4)

    x, _, cost_at = optima["DIRECT, exact indices"]
    _, _, kriging_cost_at = optima["DIRECT, Kriging"]
    published_pair = {"p1": "p1 and p2", "p3": "p3 and p4"}[target]
    predicted = np.min(histories["DIRECT, Kriging"])
    noisy, bounded = designs["ours, noise"], designs["ours, x ≤ −0.5"]
    drawn = [
        _at(
            _minimise(_kriging_cost(axis, _exact, executor, seed=seed), MATH_MODEL_OPERATION)[0],
            axis,
        )
        for seed in range(_DRAWS)
    ]
    biased = sum(abs(cost / cost_at - 1) > _VISIBLE for _, _, cost in drawn)
    as_published = biased if target == "p3" else _DRAWS - biased
    _, at_noisy, _ = optima["ours, noise"]
    noisy_cost = excitation_cost(
        at_noisy.main, at_noisy.total, axis, noise_share=_NOISE_VARIANCE / at_noisy.variance
    )
    shrunk = [(scale, *_at(scale * noisy.x, axis)[1:]) for scale in (1.0, 0.1, 0.01)]
    comparisons = (
        Comparison(
            f"DIRECT on Kriging beside DIRECT on exact indices, {published_pair}",
            "a visible bias" if target == "p3" else "agreement",
            f"exact H {kriging_cost_at:.3f} (predicted {predicted:.3f}) beside {cost_at:.3f}; off "
            f"by more than {_VISIBLE:.0%} with {biased} of {_DRAWS} draws of the "
            f"{published.SECOND_STAGE_POINTS} points",
            # the paper has one draw: reproduced unless its outcome is an unusual one
            Agreement.REPRODUCED if 4 * as_published >= _DRAWS else Agreement.NOT_REPRODUCED,
        ),
        Comparison(
            "optimum of H on the box [-5, 0]⁴",
            "an optimum",
            f"none: H falls to {shrunk[-1][2]:.5f} as x → 0, where the variance of the output is "
            f"{shrunk[-1][1].variance:.1e}",
            Agreement.IMPOSSIBLE,
        ),
    )
    findings = [
        "On [-5, 0]⁴ the cost is degenerate, a maneuver that moves nothing looks best: at "
        + "; ".join(
            f"x = {_text(scale * noisy.x)} H = {cost:.5f} with a variance of {at.variance:.1e}"
            for scale, at, cost in shrunk
        )
        + f". DIRECT stops before, at {_text(x)} with H = {cost_at:.3f} after {_DIRECT_POINTS} "
        "evaluations: it never samples the faces.",
        f"With a noise variance of {_NOISE_VARIANCE:g} as one more contributor there is an "
        f"optimum, {_told(noisy, noisy_cost)}; with x ≤ -0.5 and no noise it is "
        f"{_told(bounded, optima['ours, x ≤ −0.5'][2])}.",
    ]
    if target == "p3":
        findings.append(
            "p3 and p4 enter Eq. 13 alike, so S of p4 equals S of p3 at every x and H of either is "
            "never below 1: no x excites one of the two alone."
        )
    else:
        mirrored = bounded.x[[2, 3, 0, 1]]
        findings.append(
            f"p2 is p1 with the two exponentials exchanged: H of p2 at {_text(mirrored)} is "
            f"{_exact_cost(1, mirrored):.4f}."
        )
    return Item(
        "fig8" if target == "p1" else "fig9",
        f"Fig. {8 if target == 'p1' else 9}: second stage on the math model, {published_pair}",
        comparisons,
        tuple(findings),
        Verification(target, histories, optima),
    )


def _exact(x: FloatArray) -> Indices:
    return exact_indices(x, nodes=10)


def _exact_cost(axis: int, x: FloatArray) -> float:
    indices = _exact(x)
    return excitation_cost(indices.main, indices.total, axis)


def _kriging_cost(
    axis: int, indices: Callable[[FloatArray], Indices], executor: Executor, *, seed: int = 0
) -> Callable[[FloatArray], float]:
    """Cost by 2k Kriging models of the indices at 96 points (Eq. 12)."""
    box = MATH_MODEL_OPERATION
    X = sobol_sequence(published.SECOND_STAGE_POINTS, len(box), seed=seed)
    found = list(executor.map(indices, box.from_unit(X)))
    cost = modelled_cost(
        X,
        np.array([at_x.main for at_x in found]),
        np.array([at_x.total for at_x in found]),
        target=axis,
    )
    return lambda x: cost(box.to_unit(x))


def _indices(budget: OurBudget | PaperBudget, x: FloatArray) -> Indices:
    """Indices at x by the first stage."""
    f = partial(math_model, x)
    if isinstance(budget, OurBudget):
        return fast(f, MATH_MODEL_UNKNOWN, samples=budget.samples).indices
    return faithful(f, MATH_MODEL_UNKNOWN, budget=_for_math_model(budget)).indices


def _minimise(cost: Callable[[FloatArray], float], box: Box) -> tuple[FloatArray, FloatArray]:
    """DIRECT, locally biased (the paper says DIRECT): best x (l,), cost of each evaluation (q,)."""
    history: list[float] = []

    def noted(x: FloatArray) -> float:
        history.append(cost(x))
        return history[-1]

    bounds = list(zip(box.low, box.high, strict=True))
    result = direct(noted, bounds, maxfun=_DIRECT_POINTS, vol_tol=0, len_tol=1e-4)
    return np.asarray(result.x), np.array(history)


def _at(x: FloatArray, axis: int) -> tuple[FloatArray, Indices, float]:
    indices = exact_indices(x)
    return x, indices, excitation_cost(indices.main, indices.total, axis)


def _told(design: Design, exact: float) -> str:
    """The maneuver of a design, and H there: exactly, and as the design estimates it."""
    low, high = design.cost_interval
    return (
        f"{_text(design.x)}, H = {exact:.5f} (estimated {design.cost:.5f}, 95 %: {low:.5f} to "
        f"{high:.5f})"
    )


def _text(x: FloatArray) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in x) + ")"
