"""Discrete-event simulation of a scheduler, its workers and the client of a design.

    python benchmarks/scheduler_load.py [--validate] [--figure docs/figures/scheduler_load.svg]

The scheduler is one thread: each task costs it `SCHEDULER` of processor time, half when it is sent
to a worker and half when its result comes back. The client submits tasks one after the other at
`CLIENT` each. A worker is sent its next task as soon as the scheduler has taken its last result;
a message takes `LATENCY`. A task fills its worker for its time plus `WORKER`. Task times are
exponential about their mean beyond half of it, as simulators differ in theirs.

Without options: throughput and use of the workers for 10 to 10,000 workers, a design of criterion
H, and the passes over 10^6 bags. `--validate` runs tasks that sleep on dask with two workers,
measures the costs in that run, simulates it with them, and prints both.
"""

import argparse
import dataclasses
import heapq
import os
import statistics
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

CLIENT, SCHEDULER, WORKER, LATENCY = 0.6e-3, 1.05e-3, 1.5e-3, 0.2e-3
"""Costs [s] that --validate printed for dask, and a guess of the network's."""

BAG = 0.11, 0.13
"""Time to read a bag, and to look at its drive in one of five passes [s]: task_costs.py."""

WORKERS, EMPTY = 2, 300
"""Of the validation: workers, and empty tasks that tell the load."""

SUBMIT, RETURN = 0, 1


@dataclass(frozen=True)
class Costs:
    """Processor time of a task [s] beside its own, and of a message."""

    client: float = CLIENT
    scheduler: float = SCHEDULER
    worker: float = WORKER
    latency: float = LATENCY


def simulate(times, workers, costs=Costs()):
    """Time [s] from the first submission to the last result, and busy time of the scheduler [s].

    times (n,): of the tasks [s].
    """
    # events of the scheduler: a task is submitted, a result has come back
    events = [((i + 1) * costs.client, SUBMIT, i) for i in range(len(times))]
    queue, idle = [], workers
    free = busy = end = 0.0
    first = 0
    half = costs.scheduler / 2
    while events:
        now, kind, task = heapq.heappop(events)
        free = max(free, now)
        if kind == SUBMIT:
            queue.append(task)
        else:
            free, busy, idle = free + half, busy + half, idle + 1
            end = free + costs.latency  # the client has it
        while idle and first < len(queue):
            free, busy, idle = free + half, busy + half, idle - 1
            done = free + 2 * costs.latency + costs.worker + times[queue[first]]
            heapq.heappush(events, (done, RETURN, queue[first]))
            first += 1
    return end, busy


def task_times(mean, count, rng):
    """Times of tasks [s], shape (count,)."""
    return mean / 2 + rng.exponential(mean / 2, count)


def of_workers():
    """Use of the workers, by their number and the time of a task."""
    rng = np.random.default_rng(0)
    found = {}
    for mean in (0.1, 1.0, 10.0, 100.0):
        for workers in (10, 30, 100, 300, 1000, 3000, 10_000):
            times = task_times(mean, max(20 * workers, 2000), rng)
            end, _ = simulate(times, workers)
            found[mean, workers] = times.sum() / end / workers
    return found


def design_of(workers, cost, chunk, samples=100, points=241, judge=0.05):
    """Time of a design by criterion H [s], and what perfect use of the workers would take.

    A screening of 32 maneuvers, then four at a time, then the verification of three.
    """
    rng = np.random.default_rng(0)
    batches = [(32, samples), *[(4, samples)] * ((points - 32) // 4), (3, 3 * samples)]
    whole = work = 0.0
    for maneuvers, runs in batches:
        tasks = maneuvers * -(-runs // chunk)
        times = task_times(cost * chunk, tasks, rng)
        whole += simulate(times, workers)[0] + simulate(np.full(maneuvers, judge), workers)[0]
        work += times.sum() + maneuvers * judge
    return whole, work / workers


def of_bags(workers, bags, read, look, together, passes):
    """Time [s] to read the bags and to pass over their drives, and the scheduler's use."""
    whole = busy = 0.0
    for count, mean in ((bags, read), *[(bags // together, look * together)] * passes):
        end, used = simulate(np.full(count, mean), workers)
        whole, busy = whole + end, busy + used
    return whole, busy / whole


def draw(found, path):
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    mpl.rcParams["svg.hashsalt"] = "scheduler_load"
    figure, axes = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    for mean, marker in zip((0.1, 1.0, 10.0, 100.0), "osd^", strict=True):
        workers = [w for m, w in found if m == mean]
        axes.semilogx(
            workers, [100 * found[mean, w] for w in workers], marker=marker, label=f"{mean:g} s"
        )
    axes.axhline(80, color="0.6", linewidth=0.8)
    axes.set(xlabel="workers", ylabel="use of the workers [%]", ylim=(0, 105))
    axes.legend(title="time of a task")
    axes.grid(alpha=0.3)
    figure.savefig(path, metadata={"Date": None})


def idle(cost, _):
    """Leave the processor alone: on a cluster, scheduler and client have others."""
    time.sleep(cost)
    return 0, 0.0, 0.0


def validate():
    """The real thing beside its simulation."""
    import cloudpickle
    import executors

    from excitation_planner.design.jobs import JobsHere, JobsOfExecutor

    cloudpickle.register_pickle_by_value(executors)  # workers do not find the benchmarks
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    with executors.dask() as client:
        executor = client.get_executor(pure=False)

        def real(cost, count):
            jobs = JobsOfExecutor(partial(idle, cost), executor, together=0.0)
            return executors.timed(jobs, count)[0]

        real(0.2, 4)
        wall, used = executors.overhead(executor, client)
        party = ", ".join(f"{1e3 * seconds:.2f} ms {name}" for name, seconds in used.items())
        print(f"an empty task takes {1e3 * wall:.2f} ms; processor time per task: {party}")
        costs = Costs(used["this process"], used["scheduler"], used["workers"])
        for cost, count in ((0.01, 300), (0.1, 60)):
            pairs = []
            for _ in range(5):
                # other programs stretch all costs: by how much, empty tasks tell just before
                empty = simulate(np.zeros(EMPTY), WORKERS, costs)[0]
                stretch = real(0.0, EMPTY) / empty
                alone = executors.timed(JobsHere(partial(idle, cost)), 10)[0] / 10
                stretched = Costs(*(stretch * value for value in dataclasses.astuple(costs)))
                simulated = simulate(np.full(count, alone), WORKERS, stretched)[0]
                pairs.append((real(cost, count), simulated, stretch))
            took, simulated, stretch = (
                statistics.median(values) for values in zip(*pairs, strict=True)
            )
            ratios = sorted(s / r for r, s, _ in pairs)
            print(
                f"{count} tasks of {1e3 * cost:.0f} ms on two workers: {took:.2f} s, simulated "
                f"{simulated:.2f} s, ratio {statistics.median(ratios):.2f} ({ratios[0]:.2f} to "
                f"{ratios[-1]:.2f}), costs stretched {stretch:.1f} times"
            )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--validate", action="store_true")
    parser.add_argument("--figure", type=Path)
    arguments = parser.parse_args()
    if arguments.validate:
        validate()
        return
    found = of_workers()
    print("use of the workers, by their number and the time of a task")
    counts = sorted({workers for _, workers in found})
    print("            " + "".join(f"{count:>8,d}" for count in counts))
    for mean in (0.1, 1.0, 10.0, 100.0):
        print(f"{mean:8g} s  " + "".join(f"{found[mean, w]:8.0%}" for w in counts))
    print("a design by H, 24,100 simulations of 30 s, a task each")
    for workers in (2, 20, 200, 400, 1000, 10_000):
        end, perfect = design_of(workers, 30.0, 1)
        print(f"{workers:8,d} workers: {end / 3600:7.2f} h, {perfect / end:4.0%} of perfect")
    print("10^6 bags of 20 s: read, then 5 passes over blocks of 4 drives")
    for workers in (100, 1000, 10_000):
        end, share = of_bags(workers, 1_000_000, *BAG, 4, 5)
        print(f"{workers:8,d} workers: {end / 60:7.1f} min, scheduler busy {share:4.0%}")
    for together in (40, 400):
        end, share = of_bags(
            1000, 1_000_000 // together, BAG[0] * together, BAG[1] * together, 1, 5
        )
        print(
            f"   1,000 workers, {together} bags a task: {end / 60:5.1f} min, scheduler {share:4.0%}"
        )
    if arguments.figure:
        draw(found, arguments.figure)


if __name__ == "__main__":
    main()
