"""The recipes of docs/how-to-cluster.md: the same design on each, also when a worker is killed.

    benchmarks/two_machines.sh .venv/bin/python benchmarks/clusters.py dask
    benchmarks/local_slurm.sh .venv/bin/python benchmarks/clusters.py slurm

The simulator takes 20 ms of processor time per run; a task is five runs of one maneuver.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from functools import partial

import numpy as np

from excitation_planner import design_excitation

UNKNOWN = {"p": (0.0, 1.0), "q": (0.0, 1.0)}


def simulator(x, P, cost=0.0):
    m = np.empty(len(P))
    for i, (p, q) in enumerate(P):
        end = time.process_time() + cost
        while time.process_time() < end:
            pass
        m[i] = p * np.exp(-q) + (0.1 + np.sin(x[0]) ** 2) * q
    return m


def design(f=simulator, **arguments):
    return design_excitation(
        f, {"x": (-1.0, 1.0)}, UNKNOWN, "p", samples=20, budget=1200, **arguments
    )


def spread(client, kill):
    """The design on the workers of a client, of which one is killed half way."""
    killed = []

    def kill_one(done, _):
        if done > 400 and not killed:
            killed.append(kill())

    start = time.perf_counter()
    found = design(
        partial(simulator, cost=0.02),
        executor=client.get_executor(pure=False),
        chunk=5,
        progress=kill_one,
    )
    seconds = time.perf_counter() - start
    reference = design(workers=1)
    same = [e.cost for e in found.history] == [e.cost for e in reference.history]
    print(
        f"{found.simulations} simulations of 20 ms in {seconds:.1f} s, "
        f"{killed[0] if killed else 'nothing'} killed half way, same design: "
        f"{same and found.cost == reference.cost}"
    )


def dask():
    from distributed import Client

    if "SCHEDULER" not in os.environ:
        raise SystemExit("SCHEDULER is not set: benchmarks/two_machines.sh sets it")
    with Client(os.environ["SCHEDULER"]) as client:
        client.wait_for_workers(2, timeout=60)
        hosts = {worker["host"] for worker in client.scheduler_info()["workers"].values()}
        print(f"workers on {', '.join(sorted(hosts))}")
        first = int(os.environ["WORKERS"].split()[0])

        def kill():
            os.kill(first, signal.SIGKILL)
            return f"process {first}"

        spread(client, kill)


def slurm():
    from dask_jobqueue import SLURMCluster
    from distributed import Client

    with (
        tempfile.TemporaryDirectory() as folder,
        SLURMCluster(
            queue="local",
            cores=1,
            memory="1GB",
            walltime="00:10:00",
            interface="lo",
            python=sys.executable,
            local_directory=folder,
            log_directory=folder,
            scheduler_options={"dashboard_address": None},
        ) as cluster,
        Client(cluster) as client,
    ):
        cluster.adapt(minimum_jobs=2, maximum_jobs=2)
        client.wait_for_workers(2, timeout=400)

        def kill():
            jobs = subprocess.run(
                ["squeue", "--noheader", "--format=%i"], capture_output=True, text=True, check=True
            ).stdout.split()
            subprocess.run(["scancel", jobs[0]], check=True)
            return f"job {jobs[0]} of {len(jobs)}"

        spread(client, kill)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recipe", choices=["dask", "slurm"])
    {"dask": dask, "slurm": slurm}[parser.parse_args().recipe]()


if __name__ == "__main__":
    main()
