"""Second stage: how often a design comes within 1 % of the best known H, and at what price.

    python benchmarks/search.py [--seeds 10] [--only NAME ...] [--search adaptive ...]

Six cases of the math model (Eq. 13), whose best H is known, and three problems with interior and
face optima, whose best H is searched for by brute force on exact indices. Each design is judged by
the exact H at the x that it hands out. Beside it the paper's one-shot way with the same runs of f.
"""

import argparse
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.optimize import differential_evolution

from excitation_planner import Box, Search, design_excitation
from excitation_planner.design.criteria import excitation_cost
from excitation_planner.indices.analytic import (
    MATH_MODEL_UNKNOWN,
    math_model,
    quadrature_indices,
)


@dataclass(frozen=True)
class Case:
    """A family of maneuvers and the best H that is known of it."""

    name: str
    f: Callable
    operation: Box
    unknown: Box
    target: str
    noise_variance: float = 0.0
    best_known: float | None = None  # None: searched for by brute force

    def exact_cost(self, x, nodes=12):
        """H at x (l,) by quadrature."""
        indices = quadrature_indices(lambda P: self.f(x, P), self.unknown, nodes=nodes)
        return excitation_cost(
            indices.main,
            indices.total,
            self.unknown.index(self.target),
            noise_share=self.noise_variance / indices.variance,
        )

    def best(self):
        """Best known H."""
        if self.best_known is not None:
            return self.best_known
        bounds = list(zip(self.operation.low, self.operation.high, strict=True))
        return min(
            differential_evolution(self.exact_cost, bounds, seed=seed, tol=1e-10).fun
            for seed in range(3)
        )


def oscillator(x, P):
    """Free oscillation seen at time x1 after a start mixed by x2 of deflection and velocity.

    Unknown: stiffness, damping ratio, amplitude. Which one matters changes with the phase, so that
    H has many local minima inside the box.
    """
    frequency = np.sqrt(P[:, 0])
    decay = np.exp(-P[:, 1] * frequency * x[0])
    phase = frequency * x[0]
    return P[:, 2] * decay * (np.cos(x[1]) * np.cos(phase) + np.sin(x[1]) * np.sin(phase))


def infusion(x, P):
    """Concentration of a drug at time x1 after an infusion that lasted x2 (one compartment).

    Unknown: elimination rate, volume, bioavailability of an oral share. The elimination rate shows
    best late: the optimum is on a face.
    """
    rate, volume, oral = P.T
    after = np.exp(-rate * (x[0] - x[1])) * (1 - np.exp(-rate * x[1])) / (rate * x[1])
    return (after + oral * np.exp(-rate * x[0])) / volume


def waves(x, P):
    """Four weights that each peak inside the box of four operation parameters; interactions."""
    weight = 0.2 + np.cos(2.2 * (x - np.array([0.3, 0.6, 0.4, 0.7]))) ** 2
    weight = weight * (1 + 0.3 * np.sin(7 * np.roll(x, 1)))
    g = np.stack([P[:, 0], P[:, 1] ** 2, np.sin(3 * P[:, 2]), np.exp(-P[:, 3])], axis=1)
    return g @ weight + x[0] * x[2] * P[:, 0] * P[:, 3] + (x[1] - 0.5) ** 2 * P[:, 1] * P[:, 2]


def math_cases():
    for high, noise, p1, p3 in [
        (-0.5, 0.0, 2.35237, 1.08057),
        (-0.1, 0.0, 1.34827, 1.02008),
        (0.0, 1e-4, 1.02544, 1.01181),
    ]:
        operation = Box.of({f"x{i}": (-5.0, high) for i in (1, 2, 3, 4)})
        for target, best in (("p1", p1), ("p3", p3)):
            name = f"Eq. 13 {target} x<={high:g}" + (" noisy" if noise else "")
            yield Case(name, math_model, operation, MATH_MODEL_UNKNOWN, target, noise, best)


def own_cases():
    yield Case(
        "oscillator damping (interior)",
        oscillator,
        Box.of({"time": (0.5, 8.0), "mix": (0.0, 3.1)}),
        Box.of({"stiffness": (0.8, 1.2), "damping": (0.05, 0.3), "amplitude": (0.9, 1.1)}),
        "damping",
    )
    yield Case(
        "infusion rate (face)",
        infusion,
        Box.of({"time": (6.0, 24.0), "duration": (0.5, 5.0)}),
        Box.of({"rate": (0.05, 0.2), "volume": (8.0, 12.0), "oral": (0.1, 0.5)}),
        "rate",
    )
    box = Box.of({f"x{i}": (0.0, 1.0) for i in (1, 2, 3, 4)})
    yield Case("waves p2 (interior and faces)", waves, box, MATH_MODEL_UNKNOWN, "p2")


def run(case, search, seed):
    start = time.perf_counter()
    design = design_excitation(
        case.f,
        case.operation,
        case.unknown,
        case.target,
        noise_variance=case.noise_variance,
        search=search,
        seed=seed,
        workers=1,
    )
    low, high = design.cost_interval
    exact = case.exact_cost(design.x, nodes=20)
    return exact, design.simulations, low <= exact <= high, time.perf_counter() - start, design.x


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", nargs="*", default=[""], help="parts of the cases' names")
    parser.add_argument(
        "--search", nargs="*", type=Search, default=[Search.ADAPTIVE, Search.ONE_SHOT_SOBOL]
    )
    arguments = parser.parse_args()
    every = [*math_cases(), *own_cases()]
    cases = [case for case in every if any(part in case.name for part in arguments.only)]
    if not cases:
        parser.error(f"--only: no such case; there are: {', '.join(case.name for case in every)}")
    print(
        f"{'case':32s} {'search':16s} {'best H':>8s} {'<=1 %':>6s} {'median':>8s} {'worst':>8s}"
        f" {'runs of f':>9s} {'H in interval':>13s} {'s':>5s}"
    )
    with ProcessPoolExecutor(2) as pool:
        for case in cases:
            best = case.best()
            for search in arguments.search:
                seeds = range(arguments.seeds)
                found = list(pool.map(run, [case] * len(seeds), [search] * len(seeds), seeds))
                costs, runs, held, seconds, points = (np.array(c) for c in zip(*found, strict=True))
                excess = costs / best - 1
                print(
                    f"{case.name:32s} {search:16s} {best:8.5f}"
                    f" {np.sum(excess <= 0.01):3d}/{len(seeds)} {np.median(excess):8.2%}"
                    f" {excess.max():8.2%} {runs.max():9d} {held.mean():13.0%}"
                    f" {np.median(seconds):5.1f}  x = {points[excess.argmin()].round(3)}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
