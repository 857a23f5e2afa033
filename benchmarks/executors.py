"""Speed-up of a design on processes of this machine, and on dask.distributed with two workers.

    python benchmarks/executors.py [--dask]

The simulator is the math model made to cost 20 ms per call of 100 samples. All designs must agree.
"""

import argparse
import time

import numpy as np

from excitation_planner import design_excitation
from excitation_planner.test_functions import MATH_MODEL_UNKNOWN, math_model

OPERATION = {f"x{i}": (-5.0, -0.1) for i in (1, 2, 3, 4)}


def simulator(x, P):
    end = time.process_time() + 0.02
    while time.process_time() < end:
        m = math_model(x, P)
    return m


def timed(name, **arguments):
    start = time.perf_counter()
    design = design_excitation(
        simulator, OPERATION, MATH_MODEL_UNKNOWN, "p1", budget=8000, **arguments
    )
    return name, time.perf_counter() - start, design


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--dask", action="store_true", help="needs the extra dask")
    runs = [timed("this process", workers=1), timed("2 processes", workers=2)]
    if parser.parse_args().dask:
        from dask.distributed import Client, LocalCluster

        with (
            LocalCluster(
                n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
            ) as cluster,
            Client(cluster) as client,
        ):
            runs.append(timed("dask, 2 workers", executor=client.get_executor()))
    _, serial, reference = runs[0]
    for name, seconds, design in runs:
        same = np.array_equal(design.x, reference.x) and design.cost == reference.cost
        print(f"{name:16s} {seconds:6.1f} s  speed-up {serial / seconds:4.2f}  same design: {same}")


if __name__ == "__main__":
    main()
