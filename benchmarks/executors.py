"""Speed-up of a design on processes of this machine, and on dask.distributed with two workers.

    python benchmarks/executors.py [--dask]

The simulator is the math model made to cost 20 and 300 ms per call of 100 samples: processes pay
once simulations take longer than starting them. All designs must agree.
"""

import argparse
import time
from functools import partial

import numpy as np

from excitation_planner import design_excitation
from excitation_planner.indices.analytic import MATH_MODEL_UNKNOWN, math_model

OPERATION = {f"x{i}": (-5.0, -0.1) for i in (1, 2, 3, 4)}


def simulator(x, P, cost):
    end = time.process_time() + cost
    while time.process_time() < end:
        m = math_model(x, P)
    return m


def timed(name, cost, **arguments):
    f = partial(simulator, cost=cost)
    start = time.perf_counter()
    design = design_excitation(f, OPERATION, MATH_MODEL_UNKNOWN, "p1", budget=8000, **arguments)
    return name, time.perf_counter() - start, design


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--dask", action="store_true", help="needs the extra dask")
    dask = parser.parse_args().dask
    for cost in (0.02, 0.3):
        print(f"{1e3 * cost:.0f} ms per call of 100 samples")
        compare(cost, dask=dask)


def compare(cost, *, dask):
    runs = [timed("this process", cost, workers=1), timed("2 processes", cost, workers=2)]
    if dask:
        from dask.distributed import Client, LocalCluster

        with (
            LocalCluster(
                n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
            ) as cluster,
            Client(cluster) as client,
        ):
            runs.append(timed("dask, 2 workers", cost, executor=client.get_executor()))
    _, serial, reference = runs[0]
    for name, seconds, design in runs:
        same = np.array_equal(design.x, reference.x) and design.cost == reference.cost
        print(f"{name:16s} {seconds:6.1f} s  speed-up {serial / seconds:4.2f}  same design: {same}")


if __name__ == "__main__":
    main()
