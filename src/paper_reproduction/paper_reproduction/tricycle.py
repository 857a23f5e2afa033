"""The screening and Figs. 13 to 18: the tricycle's trajectory error (Eq. 14).

The paper screens six unknown parameters, finds two that matter, and designs for them. Everything
here is done with those two (k = 2) and with all six (k = 6).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from concurrent.futures import Executor, Future, as_completed
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np
from scipy.optimize import direct

from excitation_planner.box import Box
from excitation_planner.design.criteria import excitation_cost
from excitation_planner.design.excitation import Design, Verdict, design_excitation
from excitation_planner.design.problem import Search
from excitation_planner.design.search import modelled_cost
from excitation_planner.indices.sensitivity import Sensitivity, sensitivity
from excitation_planner.indices.sobol import Indices
from excitation_planner.maneuver import Circle, DoubleLaneChange, ManeuverFamily
from excitation_planner.planning.replay import ReplayedTrajectoryError
from paper_reproduction import published
from paper_reproduction.comparison import Agreement, Comparison, Item
from paper_reproduction.first_stage import (
    FirstStage,
    OurBudget,
    PaperBudget,
    Predictions,
    faithful,
    fast,
    predictions,
)
from tricycle_core.errors import InfeasibleManeuver
from tricycle_core.quantities import FloatArray, Progress
from tricycle_sim.vehicle import Vehicle, load_vehicle
from tricycle_sim.vehicle.batch import simulate

T = TypeVar("T")

TARGETS = ("cornering_stiffness", "camber_stiffness")
NUMBERS = (2, 6)  # k
_VISIBLE = 0.05  # relative difference that counts as one
_SCREENED = 8  # random maneuvers per family


@dataclass(frozen=True)
class Bars:
    """Indices of a random and of the designed maneuver.

    Attributes
    ----------
    names : tuple of str
        The unknown parameters.
    x : dict of str to ndarray
        Operation parameters (l,) of each maneuver ("random", "designed").
    indices : dict of str to Sensitivity
        Indices of each maneuver by our method, with intervals.
    faithful : dict of str to Indices
        Indices of each maneuver by the paper's method, where asked for.
    costs : dict of str to float
        Cost H of each maneuver.
    """

    names: tuple[str, ...]
    x: dict[str, FloatArray]
    indices: dict[str, Sensitivity]
    faithful: dict[str, Indices]
    costs: dict[str, float]


@dataclass(frozen=True)
class Screening:
    """Shares of the variance, S and ST of all six parameters.

    Attributes
    ----------
    names : tuple of str
        Names of the six parameters.
    rows : dict of str to Sensitivity
        Indices of each maneuver.
    """

    names: tuple[str, ...]
    rows: dict[str, Sensitivity]


@dataclass(frozen=True)
class Trajectories:
    """One maneuver driven by two models.

    Attributes
    ----------
    time : ndarray of float, shape (t,)
        Time [s].
    soft, stiff : ndarray of float, shape (t, 2)
        Positions with the lowest and the highest cornering stiffness [m].
    distance : ndarray of float, shape (t,)
        Distance between them at equal times [m].
    """

    time: FloatArray
    soft: FloatArray
    stiff: FloatArray
    distance: FloatArray


@dataclass(frozen=True)
class Costs:
    """Searches for the cheapest maneuver of one family.

    Attributes
    ----------
    operation : Box
        Ranges of x.
    designs : dict
        Designs by (target, k, search).
    faithful : dict
        Points (n, l) at which DIRECT evaluates the paper's Kriging models, with their costs (n,),
        by (target, k).
    """

    operation: Box
    designs: dict[tuple[str, int, Search], Design]
    faithful: dict[tuple[str, int], tuple[FloatArray, FloatArray]]

    def best(self, target: str, k: int) -> Design:
        """Return the cheaper of the two designs.

        Parameters
        ----------
        target : str
            Parameter to excite.
        k : int
            Number of unknown parameters.
        """
        found = [design for key, design in self.designs.items() if key[:2] == (target, k)]
        return min(found, key=lambda design: design.cost)


FAMILIES: dict[str, ManeuverFamily] = {"circle": Circle(), "double_lane_change": DoubleLaneChange()}


class Tricycle:
    """The figures of the tricycle; designs that several of them need are made once.

    Parameters
    ----------
    executor : Executor
        Executor that runs the simulations.
    ours : OurBudget
        Budget of our own method.
    budget : PaperBudget, optional
        Budget of the paper's method; None: without it.
    vehicle : Vehicle, optional
        Vehicle; by default the paper's.
    seed : int
        Seed of the random maneuvers and of the searches.
    """

    def __init__(
        self,
        executor: Executor,
        *,
        ours: OurBudget,
        budget: PaperBudget | None = None,
        vehicle: Vehicle | None = None,
        seed: int = 0,
    ) -> None:
        self._executor, self._ours, self._budget = executor, ours, budget
        # the paper's maneuvers, which are simulated only: it keeps no margin to the end stop
        self._vehicle = (vehicle or load_vehicle()).replace(steering_margin=0.0)
        self._seed = seed
        self._costs: dict[str, Costs] = {}

    def simulator(self, family: str, k: int) -> tuple[ReplayedTrajectoryError, Box]:
        """Return TE as a function of x and of the first k parameters, and their box.

        Parameters
        ----------
        family : str
            Name of the family.
        k : int
            Number of unknown parameters.
        """
        names = list(self._vehicle.unknown)[:k]
        unknown = {name: self._vehicle.unknown[name] for name in names}
        vehicle = dataclasses.replace(self._vehicle, unknown=unknown)
        return ReplayedTrajectoryError(vehicle, FAMILIES[family]), Box.of(unknown)

    def random_maneuvers(self, family: str) -> Iterator[FloatArray]:
        """Operation parameters (l,) uniform over what the nominal vehicle can drive."""
        rng = np.random.default_rng(self._seed)
        f, _ = self.simulator(family, 6)
        box = FAMILIES[family].operation
        while True:
            x = box.from_unit(rng.uniform(size=len(box)))
            try:
                f.nominal(x)
            except InfeasibleManeuver:
                continue
            yield x

    def screening(self, progress: Progress) -> Item[Screening]:
        """All six parameters at the paper's and at random maneuvers of both families."""
        maneuvers = [("double_lane_change", np.array(published.FIG_13_X))]
        for family in FAMILIES:
            drawn = self.random_maneuvers(family)
            maneuvers += [(family, next(drawn)) for _ in range(_SCREENED)]
        futures = [
            self._executor.submit(_indices, *self.simulator(family, 6), x, self._ours.samples)
            for family, x in maneuvers
        ]
        results = _in_order(futures, progress)
        rows = {
            f"{family.replace('_', ' ')} ({x[0]:.2f}, {x[1]:.2f})": result
            for (family, x), result in zip(maneuvers, results, strict=True)
        }
        # what the others take part in is 1 less the closed index of the two
        shares = {label: 1.0 - float(result.total[2:].sum()) for label, result in rows.items()}
        worst = min(shares, key=lambda label: shares[label])
        comparison = Comparison(
            "share of the variance due to cornering and camber stiffness",
            "nearly all",
            f"at least {shares[worst]:.1%} (worst of {len(rows)} maneuvers: {worst}), "
            f"median {np.median(list(shares.values())):.1%}",
            Agreement.REPRODUCED if np.median(list(shares.values())) > 0.9
            else Agreement.NOT_REPRODUCED,
        )  # fmt: skip
        third = [2 + int(np.argmax(result.total[2:])) for result in rows.values()]
        most = max(set(third), key=third.count)
        names = next(iter(rows.values())).names
        findings = (
            "The share is 1 less the total indices of the other four: a lower bound of what the "
            "two explain together.",
            f"Next after them comes most often {_words(names[most])}.",
        )
        return Item(
            "screening",
            "Screening: all six unknown parameters",
            (comparison,),
            findings,
            Screening(names, rows),
        )

    def figure_13(self, progress: Progress) -> Item[Predictions]:
        """Kriging of TE for the double lane change x = (2, 2), validated on 10 000 simulations."""
        x, futures = np.array(published.FIG_13_X), {}
        samples = self._ours.samples
        for k in NUMBERS:
            f, unknown = self.simulator("double_lane_change", k)
            futures[f"k = {k}, {samples} samples"] = self._executor.submit(
                _fast, f, unknown, x, samples, self._ours.validation
            )
            if self._budget is not None:
                futures[f"k = {k}, faithful"] = self._executor.submit(
                    _faithful, f, unknown, x, self._budget, self._ours.validation
                )
        stages = dict(zip(futures, _in_order(list(futures.values()), progress), strict=True))
        data = predictions(stages, "m²")
        six = data.statistics[f"k = 6, {samples} samples"]
        mean, rms = six.output_mean, np.sqrt(six.output_mean)
        comparisons = (
            Comparison("R²", published.FIG_13_R2, six.r2, _at_least(six.r2, published.FIG_13_R2)),
            Comparison(
                "RAAE",
                published.FIG_13_RAAE,
                six.raae,
                _at_least(-six.raae, -published.FIG_13_RAAE),
            ),
            Comparison(
                "mean, in m²", published.FIG_13_MEAN, f"TE {mean:.3g} m²", Agreement.IMPOSSIBLE
            ),
        )
        findings = [
            f"A mean of {published.FIG_13_MEAN} cannot be in m²: it would be a distance of "
            f"{np.sqrt(published.FIG_13_MEAN):.1f} m between models that drive the same commands. "
            f"Ours is {mean:.3g} m² (rms {100 * rms:.1f} cm). In cm² the two are near each other: "
            f"{published.FIG_13_MEAN} and {1e4 * mean:.2f}.",
            f"The mean error of our metamodel is {six.mean:.1e} m² with {samples} samples, its "
            f"deviation {six.std:.1e} m².",
        ]
        if self._budget is not None:
            paper = data.statistics["k = 6, faithful"]
            findings.append(
                f"The paper's own budget gives 1 - R² = {1 - paper.r2:.1e} here, so its R² of "
                f"{published.FIG_13_R2} comes from its fit or its simulator, not from its samples."
            )
        return Item(
            "fig13",
            "Fig. 13: Kriging of the trajectory error, double lane change (2, 2)",
            comparisons,
            tuple(findings),
            data,
        )

    def bars(self, family: str, progress: Progress) -> Item[dict[tuple[str, int], Bars]]:
        """Figs. 14 (circle) and 15 (double lane change): a random beside the designed maneuver.

        Parameters
        ----------
        family : str
            Name of the family.
        progress : callable
            Called with (work done, work in all).
        """
        costs = self._designs(family, progress)
        random = next(self.random_maneuvers(family))
        data, comparisons, findings = {}, [], []
        wanted, faithful_wanted = {}, {}
        for target in TARGETS:
            for k in NUMBERS:
                f, unknown = self.simulator(family, k)
                for name, x in (("random", random), ("designed", costs.best(target, k).x)):
                    key = (target, k, name)
                    wanted[key] = self._executor.submit(_indices, f, unknown, x, 300)
                    if self._budget is not None:
                        faithful_wanted[key] = self._executor.submit(
                            _faithful, f, unknown, x, self._budget, 0
                        )
        for target in TARGETS:
            for k in NUMBERS:
                unknown = self.simulator(family, k)[1]
                axis = unknown.index(target)
                results = {
                    name: wanted[target, k, name].result() for name in ("random", "designed")
                }
                bars = Bars(
                    unknown.names,
                    {"random": random, "designed": costs.best(target, k).x},
                    results,
                    {
                        name: faithful_wanted[target, k, name].result().indices
                        for name in results
                        if faithful_wanted
                    },
                    {name: excitation_cost(r.main, r.total, axis) for name, r in results.items()},
                )
                data[target, k] = bars
                comparisons.append(_grows(target, k, axis, bars))
                verdict = costs.best(target, k)
                if verdict.verdict is Verdict.CANNOT_EXCITE:
                    findings.append(
                        f"k = {k}: this family cannot excite {_words(target)}: "
                        f"{verdict.explanation.replace('_', ' ')}."
                    )
        number = 14 if family == "circle" else 15
        title = f"Fig. {number}: indices of a random and the designed {_words(family)}"
        return Item(f"fig{number}", title, tuple(comparisons), tuple(findings), data)

    def figure_16(self, progress: Progress) -> Item[dict[tuple[str, str], Trajectories]]:
        """Trajectories of two models under a random and the maneuver designed for cornering."""
        data, comparisons = {}, []
        target = TARGETS[0]
        low, high = self._vehicle.unknown[target]
        for i, family in enumerate(FAMILIES):

            def report(done: int, total: int, i: int = i) -> None:
                progress(i * total + done, len(FAMILIES) * total)

            best = self._designs(family, report).best(target, 6)
            for name, x in (("random", next(self.random_maneuvers(family))), ("designed", best.x)):
                run = self.simulator(family, 6)[0].nominal(x)
                P = np.tile(self._vehicle.nominal_point(), (2, 1))
                P[:, list(self._vehicle.unknown).index(target)] = low, high
                motion = simulate(self._vehicle, run.commands, P, threads=1)
                path = np.stack([motion.x, motion.y], axis=-1)
                data[family, name] = Trajectories(
                    motion.time, path[0], path[1], np.hypot(*(path[1] - path[0]).T)
                )
            rms = {
                name: float(np.sqrt(np.mean(data[family, name].distance ** 2)))
                for name in ("random", "designed")
            }
            comparisons.append(
                Comparison(
                    f"distance of two models, {_words(family)}",
                    "visibly larger under the designed maneuver",
                    f"rms {100 * rms['random']:.1f} cm random, {100 * rms['designed']:.1f} cm "
                    "designed",
                    Agreement.REPRODUCED
                    if rms["designed"] > (1 + _VISIBLE) * rms["random"]
                    else Agreement.NOT_REPRODUCED,
                )
            )
        findings = (
            f"The two models differ in cornering stiffness alone: {low:g} and {high:g} N/rad, the "
            "ends of its range. H rewards a maneuver for what one parameter does beside the "
            "others, not for how much it does.",
        )
        title = "Fig. 16: trajectories of two models under a random and a designed maneuver"
        return Item("fig16", title, tuple(comparisons), findings, data)

    def figure_17_or_18(self, family: str, progress: Progress) -> Item[Costs]:
        """DIRECT on H over x for both targets (17: circle, 18: double lane change).

        Parameters
        ----------
        family : str
            Name of the family.
        progress : callable
            Called with (work done, work in all).
        """
        costs = self._designs(family, progress)
        comparisons, findings = [], []
        for target in TARGETS:
            for k in NUMBERS:
                by_direct = costs.designs[target, k, Search.DIRECT]
                ours = costs.designs[target, k, Search.ADAPTIVE]
                comparisons.append(
                    Comparison(
                        f"optimum of H, {_words(target)}, k = {k}",
                        "a picture",
                        f"DIRECT H = {by_direct.cost:.3f} at {_at(by_direct)}; ours "
                        f"H = {ours.cost:.3f} at {_at(ours)}",
                        Agreement.PICTURE,
                    )
                )
                if ours.verdict is Verdict.CANNOT_EXCITE:
                    findings.append(f"k = {k}: {ours.explanation.replace('_', ' ')}.")
        number = 17 if family == "circle" else 18
        title = f"Fig. {number}: DIRECT on the cost H, {_words(family)}"
        return Item(f"fig{number}", title, tuple(comparisons), tuple(findings), costs)

    def _designs(self, family: str, progress: Progress) -> Costs:
        if family not in self._costs:
            keys = [(t, k, s) for t in TARGETS for k in NUMBERS for s in _SEARCHES]
            futures = [
                self._executor.submit(
                    _design, *self.simulator(family, k), FAMILIES[family].operation, target,
                    search, self._ours, self._seed,
                )
                for target, k, search in keys
            ]  # fmt: skip
            designs = dict(zip(keys, _in_order(futures, progress), strict=True))
            operation = FAMILIES[family].operation
            self._costs[family] = Costs(operation, designs, self._faithful_costs(family))
        return self._costs[family]

    def _faithful_costs(self, family: str) -> dict[tuple[str, int], tuple[FloatArray, FloatArray]]:
        """The paper's second stage: full factorial, 2k Kriging models, DIRECT on them."""
        if self._budget is None:
            return {}
        box = FAMILIES[family].operation
        levels = np.linspace(0.0, 1.0, self._budget.levels)
        grid = np.stack(np.meshgrid(*[levels] * len(box), indexing="ij"), axis=-1)
        costs = {}
        for k in NUMBERS:
            f, unknown = self.simulator(family, k)
            evaluate = partial(_faithful_or_none, f, unknown, self._budget)
            points = grid.reshape(-1, len(box))
            stages = list(self._executor.map(evaluate, box.from_unit(points)))
            usable = [i for i, stage in enumerate(stages) if stage is not None]
            kept = [stage.indices for stage in stages if stage is not None]
            for target in TARGETS:
                cost = modelled_cost(
                    points[usable],
                    np.array([indices.main for indices in kept]),
                    np.array([indices.total for indices in kept]),
                    target=unknown.index(target),
                )
                asked: list[FloatArray] = []
                given: list[float] = []

                def noted(u: FloatArray) -> float:
                    asked.append(box.from_unit(u))  # noqa: B023
                    given.append(cost(u))  # noqa: B023
                    return given[-1]  # noqa: B023

                direct(noted, [(0.0, 1.0)] * len(box), maxfun=200, vol_tol=0, len_tol=1e-4)
                costs[target, k] = np.array(asked), np.array(given)
        return costs


_SEARCHES = (Search.DIRECT, Search.ADAPTIVE)


def _design(
    f: ReplayedTrajectoryError,
    unknown: Box,
    operation: Box,
    target: str,
    search: Search,
    ours: OurBudget,
    seed: int,
) -> Design:
    """Design with the paper's H: no noise term."""
    samples = ours.search_samples[len(unknown)]
    return design_excitation(
        f,
        operation,
        unknown,
        target,
        samples=samples,
        budget=(ours.maneuvers + 9) * samples,
        search=search,
        seed=seed,
        workers=1,
    )


def _indices(f: ReplayedTrajectoryError, unknown: Box, x: FloatArray, samples: int) -> Sensitivity:
    return sensitivity(partial(f, x), unknown, samples=samples)


def _fast(
    f: ReplayedTrajectoryError, unknown: Box, x: FloatArray, samples: int, validation: int
) -> FirstStage:
    return fast(partial(f, x), unknown, samples=samples, validation=validation)


def _faithful(
    f: ReplayedTrajectoryError, unknown: Box, x: FloatArray, budget: PaperBudget, validation: int
) -> FirstStage:
    return faithful(partial(f, x), unknown, budget=budget, validation=validation)


def _faithful_or_none(
    f: ReplayedTrajectoryError, unknown: Box, budget: PaperBudget, x: FloatArray
) -> FirstStage | None:
    """None where the maneuver cannot be driven."""
    try:
        return _faithful(f, unknown, x, budget, 0)
    except InfeasibleManeuver:
        return None


def _in_order(futures: list[Future[T]], progress: Progress) -> list[T]:
    """Results of the futures; progress is reported as they end."""
    for done, _ in enumerate(as_completed(futures), start=1):
        progress(done, len(futures))
    return [future.result() for future in futures]


def _grows(target: str, k: int, axis: int, bars: Bars) -> Comparison:
    random, designed = bars.indices["random"], bars.indices["designed"]
    grown = designed.main[axis] > (1 + _VISIBLE) * random.main[axis]
    others = [float(r.main.sum() - r.main[axis]) for r in (random, designed)]
    return Comparison(
        f"{_words(target)}, k = {k}: its main index grows, the others shrink",
        "they do",
        f"S {random.main[axis]:.3f} → {designed.main[axis]:.3f}, others together "
        f"{others[0]:.3f} → {others[1]:.3f}, H {bars.costs['random']:.3g} → "
        f"{bars.costs['designed']:.3g}",
        Agreement.REPRODUCED if grown and others[1] < others[0] else Agreement.NOT_REPRODUCED,
    )


def _at_least(ours: float, printed: float) -> Agreement:
    return Agreement.BETTER if ours >= printed else Agreement.NOT_REPRODUCED


def _at(design: Design) -> str:
    return ", ".join(
        f"{name} {value:.3g}" for name, value in zip(design.operation.names, design.x, strict=True)
    )


def _words(name: str) -> str:
    return name.replace("_", " ")
