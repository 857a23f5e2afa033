"""Sobol' indices against exact ones: largest error, time, and coverage of the intervals.

    python benchmarks/sobol.py [--cases 20] [--seed 0] [--parts accuracy coverage estimator]

Seconds are those of all that `sensitivity` does: points, two fits, indices, intervals. Exact
indices by quadrature (Eq. 13, and the own functions of benchmarks/search.py at random operating
points) or in closed form (Ishigami, G function). One BLAS thread.
"""

import argparse
import time

import numpy as np
from search import own_cases
from threadpoolctl import threadpool_limits

from excitation_planner import Box, monte_carlo_indices, sensitivity
from excitation_planner.indices.analytic import (
    ISHIGAMI_UNKNOWN,
    MATH_MODEL_OPERATION,
    MATH_MODEL_UNKNOWN,
    g_function,
    g_function_indices,
    ishigami,
    ishigami_indices,
    math_model,
    quadrature_indices,
)


def largest_error(result, exact):
    return max(np.abs(result.main - exact.main).max(), np.abs(result.total - exact.total).max())


def at_random_points(f, operation, unknown, *, cases, nodes, rng):
    for _ in range(cases):
        x = operation.from_unit(rng.uniform(size=len(operation)))
        g = lambda P, x=x: f(x, P)  # noqa: E731
        yield g, unknown, quadrature_indices(g, unknown, nodes=nodes)


def accuracy(cases, seed):
    print(f"{'':24s} {'n':>4s} {'median error':>12s} {'worst':>9s} {'median s':>9s}")
    a4, a8 = np.array([0.0, 1.0, 4.5, 9.0]), np.array([0.0, 1.0, 4.5, 9.0, 99, 99, 99, 99])
    for name, problems, sizes in (
        (
            "Eq. 13 at random x",
            list(
                at_random_points(
                    math_model,
                    MATH_MODEL_OPERATION,
                    MATH_MODEL_UNKNOWN,
                    cases=cases,
                    nodes=20,
                    rng=np.random.default_rng(seed),
                )
            ),
            (100, 200, 300, 600),
        ),
        ("Ishigami", [(ishigami, ISHIGAMI_UNKNOWN, ishigami_indices())] * 5, (200, 300, 400)),
        *(
            (
                f"G function, k = {len(a)}",
                [(lambda P, a=a: g_function(P, a), _unit_box(len(a)), g_function_indices(a))] * 3,
                (400,),
            )
            for a in (a4, a8)
        ),
    ):
        for n in sizes:
            errors, seconds = [], []
            for case, (g, unknown, exact) in enumerate(problems):
                start = time.perf_counter()
                result = sensitivity(g, unknown, samples=n, seed=case)
                seconds.append(time.perf_counter() - start)
                errors.append(largest_error(result, exact))
            print(
                f"{name:24s} {n:4d} {np.median(errors):12.1e} {max(errors):9.1e}"
                f" {np.median(seconds):9.3f}",
                flush=True,
            )


def _unit_box(k):
    return Box.of({f"p{i}": (0.0, 1.0) for i in range(k)})


def coverage(cases):
    print("\n95 % intervals: share that holds the exact index, and their median half width")
    everything = []
    for n in (12, 25, 50, 100, 200, 300):
        rng = np.random.default_rng(n)
        problems = [
            ("Eq. 13", MATH_MODEL_OPERATION, MATH_MODEL_UNKNOWN, math_model),
            *((case.name, case.operation, case.unknown, case.f) for case in own_cases()),
        ]
        for name, operation, unknown, f in problems:
            hits, widths = [], []
            found = at_random_points(f, operation, unknown, cases=cases, nodes=14, rng=rng)
            for seed, (g, box, exact) in enumerate(found):
                hit, width = _hits(sensitivity(g, box, samples=n, seed=seed), exact)
                hits += hit
                widths += width
            everything += hits
            print(f"{name:32s} {n:4d} {np.mean(hits):7.1%} {np.median(widths):9.1e}", flush=True)
        hits = []
        for seed in range(cases):
            result = sensitivity(ishigami, ISHIGAMI_UNKNOWN, samples=n, seed=seed)
            hits += _hits(result, ishigami_indices())[0]
        everything += hits
        print(f"{'Ishigami':32s} {n:4d} {np.mean(hits):7.1%}", flush=True)
    print(f"{'all':32s}      {np.mean(everything):7.1%} of {len(everything)} intervals")


def _hits(result, exact):
    hits, widths = [], []
    for interval, truth in (
        (result.main_interval, exact.main),
        (result.total_interval, exact.total),
    ):
        hits += ((interval[:, 0] <= truth) & (truth <= interval[:, 1])).tolist()
        widths += (np.ptp(interval, axis=1) / 2).tolist()
    return hits, widths


def faithful():
    print(
        "\nThe paper's estimator on the true function, x = (-2, -0.5, -2, -0.5): main index of p1"
    )
    x = np.array([-2.0, -0.5, -2.0, -0.5])
    exact = quadrature_indices(lambda P: math_model(x, P), MATH_MODEL_UNKNOWN)
    print(f"  exact {exact.main[0]:.4f}")
    for samples in (10**3, 10**4, 10**5):
        result = monte_carlo_indices(lambda U: math_model(x, U), 4, samples=samples)
        print(f"  N = {samples:6d}: {result.main[0]:.4f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=20, help="operating points per function")
    parser.add_argument("--seed", type=int, default=0, help="of the operating points of Eq. 13")
    parts = {
        "accuracy": lambda: accuracy(arguments.cases, arguments.seed),
        "coverage": lambda: coverage(arguments.cases),
        "estimator": faithful,
    }
    parser.add_argument("--parts", nargs="+", choices=parts, default=parts, metavar="PART")
    arguments = parser.parse_args()
    with threadpool_limits(1):
        for part in arguments.parts:
            parts[part]()


if __name__ == "__main__":
    main()
