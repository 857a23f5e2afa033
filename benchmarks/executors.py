"""Speed-up on two workers, and what a task costs, as ratios in one run.

    python benchmarks/executors.py [--repeats 5] [--designs]

Tasks of 100 and of 10 ms of processor time go through `JobsOfExecutor`, as simulations do: on
processes of this machine (loky, the default), on concurrent.futures and on dask with a scheduler
over TCP. The same tasks one after the other in this process are timed before each, so that both
see the same load; the speed-up is the median of these pairs. Empty tasks, sent one by one, give the
overhead, with the processor time that this process, dask's scheduler and a worker spend on each;
tasks of less than 0.25 s are otherwise sent several at a time.

Bars: speed-up of at least 1.8 for 100 ms and of 1.5 for 10 ms. They need two idle cores: the load
of the machine is printed, and the status is 1 where one is missed. "By processor time" is what two
idle cores would give if nothing ever waited: twice the tasks' own time over all that was used, by
the workers, this process and dask's scheduler. Other programs change it little.

`--designs` times whole designs and checks that they agree.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from excitation_planner import design_excitation
from excitation_planner.design.executors import process_pool
from excitation_planner.design.jobs import JobsHere, JobsOfExecutor
from excitation_planner.indices.analytic import MATH_MODEL_UNKNOWN, math_model

WORKERS = 2
BARS = {0.1: 1.8, 0.01: 1.5}
"""Least speed-up on two workers, by the processor time of a task [s]."""

TASKS = {0.1: 30, 0.01: 200}
EMPTY = 1000
OPERATION = {f"x{i}": (-5.0, -0.1) for i in (1, 2, 3, 4)}


def busy(cost, _):
    """Use the processor for so long [s]; return the process and its clock before and after."""
    begun = time.process_time()
    while time.process_time() < begun + cost:
        pass
    return os.getpid(), begun, time.process_time()


def timed(jobs, count):
    """Wall time of so many jobs, and processor time of the workers meanwhile [s]."""
    start = time.perf_counter()
    for job in range(count):
        jobs.add(job)
    results = dict(jobs.results())
    wall = time.perf_counter() - start
    assert sorted(results) == list(range(count))
    clocks = {}
    for process, begun, ended in results.values():
        first, last = clocks.get(process, (begun, ended))
        clocks[process] = min(first, begun), max(last, ended)
    return wall, sum(last - first for first, last in clocks.values())


@contextmanager
def dask():
    """A client of a scheduler with two workers, each a process of its own, over TCP."""
    from distributed import Client

    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        file = Path(folder) / "scheduler.json"
        common = ["--no-dashboard", "--scheduler-file", str(file)]
        worker = ["distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny"]
        scheduler = ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
        for command in (scheduler, *[worker] * WORKERS):
            process = subprocess.Popen(
                [sys.executable, "-m", *command, *common],
                stderr=subprocess.DEVNULL,
                env=os.environ | {"OMP_NUM_THREADS": "1"},
            )
            stack.callback(process.wait)
            stack.callback(process.kill)
        while not file.exists():
            time.sleep(0.1)
        client = stack.enter_context(Client(scheduler_file=str(file)))
        client.wait_for_workers(WORKERS, timeout=60)
        yield client


def clocks(client):
    """Processor time of this process and of dask's scheduler so far [s]."""
    found = {"this process": time.process_time()}
    if client is not None:
        found["scheduler"] = client.run_on_scheduler(time.process_time)
    return found


def overhead(executor, client):
    """Wall time of an empty task sent alone, and processor time of each party, per task [s]."""
    jobs = JobsOfExecutor(partial(busy, 0.0), executor, together=0.0)
    timed(jobs, 50)
    before = clocks(client)
    wall, workers = timed(jobs, EMPTY)
    used = {name: now - before[name] for name, now in clocks(client).items()}
    used["workers"] = workers
    return wall / EMPTY, {name: seconds / EMPTY for name, seconds in used.items()}


def measure(name, executor, client, repeats):
    """Print overhead and speed-ups; return whether the bars are met."""
    timed(JobsOfExecutor(partial(busy, 0.2), executor), 2 * WORKERS)  # all have started
    wall, processor = overhead(executor, client)
    parts = ", ".join(f"{1e3 * used:.2f} ms {party}" for party, used in processor.items())
    print(f"{name}: an empty task takes {1e3 * wall:.2f} ms; processor time per task: {parts}")
    met = True
    for cost, count in TASKS.items():
        ratios, ideal = [], []
        for _ in range(repeats):
            alone, _ = timed(JobsHere(partial(busy, cost)), count)
            before = sum(clocks(client).values())
            together, workers = timed(JobsOfExecutor(partial(busy, cost), executor), count)
            used = workers + sum(clocks(client).values()) - before
            ratios.append(alone / together)
            ideal.append(WORKERS * count * cost / used)
        speed_up, bar = statistics.median(ratios), BARS[cost]
        met &= speed_up >= bar
        print(
            f"{name}: tasks of {1e3 * cost:.0f} ms: speed-up {speed_up:.2f} on {WORKERS} workers "
            f"({min(ratios):.2f} to {max(ratios):.2f}), bar {bar}: "
            f"{'met' if speed_up >= bar else 'MISSED'}; by processor time "
            f"{statistics.median(ideal):.2f}"
        )
    return met


def simulator(x, P, cost):
    end = time.process_time() + cost
    while time.process_time() < end:
        m = math_model(x, P)
    return m


def compare_designs(client):
    """Whole designs, a call of 100 samples at 20 and at 300 ms."""
    ways = {
        "this process": {"workers": 1},
        "2 processes": {"workers": 2},
        "2 processes, chunks of 25": {"workers": 2, "chunk": 25},
        "dask, 2 workers": {"executor": client.get_executor(pure=False)},
    }
    for cost in (0.02, 0.3):
        print(f"designs with {1e3 * cost:.0f} ms per call of 100 samples")
        runs = {}
        for name, arguments in ways.items():
            f, start = partial(simulator, cost=cost), time.perf_counter()
            if "chunk" in arguments:
                f = partial(simulator, cost=cost / 4)
            design = design_excitation(
                f, OPERATION, MATH_MODEL_UNKNOWN, "p1", budget=8000, **arguments
            )
            runs[name] = (time.perf_counter() - start, design)
        serial, reference = runs["this process"]
        for name, (seconds, design) in runs.items():
            same = np.array_equal(design.x, reference.x) and design.cost == reference.cost
            print(
                f"{name:26s} {seconds:6.1f} s  speed-up {serial / seconds:4.2f}  same design {same}"
            )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--designs", action="store_true")
    arguments = parser.parse_args()
    print(f"load before {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    met = measure("loky", process_pool(WORKERS), None, arguments.repeats)
    with ProcessPoolExecutor(WORKERS, mp_context=get_context("spawn")) as pool:
        met &= measure("concurrent.futures", pool, None, arguments.repeats)
    with dask() as client:
        met &= measure("dask", client.get_executor(pure=False), client, arguments.repeats)
        if arguments.designs:
            compare_designs(client)
    print(f"load after {os.getloadavg()[0]:.1f}")
    sys.exit(not met)


if __name__ == "__main__":
    main()
