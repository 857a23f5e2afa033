"""What the parts of a task cost: figures of docs/scale.md.

    python benchmarks/task_costs.py

Medians of processor time, of one thread each. What executors add is printed by executors.py.
"""

import statistics
import tempfile
import time
import tracemalloc
from concurrent.futures import Executor, Future
from functools import partial
from pathlib import Path

import cloudpickle
import numpy as np
from many_drives import TRUTH, VEHICLE, make

from excitation_planner import Study
from excitation_planner.box import Box
from excitation_planner.design.jobs import JobsOfExecutor
from excitation_planner.design.study_trajectories import read_trajectories, write_trajectories
from excitation_planner.indices.analytic import MATH_MODEL_UNKNOWN, math_model
from excitation_planner.indices.sampling import parameter_samples
from excitation_planner.indices.sensitivity import fit_metamodel
from excitation_planner.indices.sobol import sobol_indices
from excitation_planner.indices.threads import THREADPOOLS
from excitation_planner.maneuver import family_by_name
from excitation_planner.planning.replay import ReplayedTrajectoryError
from parameter_identification.many_drives import identify_many

OPERATION = {f"x{i}": (-5.0, -0.1) for i in (1, 2, 3, 4)}
DRIVES = 4
OPEN = 5000


def cost(work, repeats=7):
    """Median processor time of a call [s]; the first one is not counted."""
    work()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return statistics.median(times)


def sent():
    """What is sent with a task, and what an open task takes."""
    circle = ReplayedTrajectoryError(VEHICLE, family_by_name("circle"))
    for name, f in (("a function of ten lines", math_model), ("the tricycle on circles", circle)):
        work = partial(f, np.zeros(4))
        size, seconds = (
            len(cloudpickle.dumps(work)),
            cost(lambda work=work: cloudpickle.dumps(work)),
        )
        print(
            f"simulator sent, {name}: {size / 1e3:.1f} kB, {1e3 * seconds:.2f} ms once per design"
        )

    class Idle(Executor):
        def submit(self, *_):
            return Future()

    jobs = JobsOfExecutor(math_model, Idle())
    tracemalloc.start()
    for job in range(OPEN):
        jobs.add(job)
    size = tracemalloc.get_traced_memory()[0] / OPEN
    print(f"an open task here, besides its data: {size / 1e3:.1f} kB")
    tracemalloc.stop()


def judged():
    """Metamodel and indices."""
    box = Box.of(MATH_MODEL_UNKNOWN)
    for n in (100, 300):
        U = parameter_samples(box, n, seed=0)
        m = math_model(np.full(4, -1.0), box.from_unit(U))
        print(f"Kriging fit of {n} samples: {1e3 * cost(partial(fit_metamodel, U, m)):.0f} ms")
    model = fit_metamodel(U, m)
    print(f"Sobol' indices of it: {1e3 * cost(lambda: sobol_indices(model)):.1f} ms")


def kept():
    """Studies on disk."""
    with tempfile.TemporaryDirectory() as folder:
        Y = np.random.default_rng(0).standard_normal((96, 400, 4))
        path = Path(folder) / "a.parquet"
        samples = list(range(96))
        wrote = cost(lambda: write_trajectories(path, 0, samples, (Y,)))
        read = cost(lambda: read_trajectories(path))
        print(
            f"trajectories of a maneuver, {Y.size * 8 / 1e6:.1f} MB: written in "
            f"{1e3 * wrote:.0f} ms, read in {1e3 * read:.0f} ms, "
            f"{path.stat().st_size / 1e6:.1f} MB on disk"
        )
        study = Study.create(Path(folder) / "s", OPERATION, MATH_MODEL_UNKNOWN, "p1", budget=4000)
        asked = study.ask()
        for p in asked:
            study.tell(p.point, p.samples, math_model(p.x, p.P))
        again = cost(lambda: Study.open(Path(folder) / "s").ask(), repeats=3)
        print(f"a study asks anew: {1e3 * again / len(asked):.0f} ms per maneuver that is known")


def drives():
    """Bags."""
    with tempfile.TemporaryDirectory() as folder:
        bags = [make((Path(folder), i, TRUTH)) for i in range(DRIVES)]
        size = sum(f.stat().st_size for f in bags[0].rglob("*") if f.is_file())
        times = []
        for _ in range(2):
            start = time.process_time()
            identify_many(bags, VEHICLE, folder=Path(folder) / "work")
            times.append((time.process_time() - start) / DRIVES)
        kept = next((Path(folder) / "work").glob("*.npz")).stat().st_size
        print(
            f"a drive of 20 s: bag of {size / 1e3:.0f} kB read in "
            f"{1e3 * (times[0] - times[1]):.0f} ms, kept in {kept / 1e3:.0f} kB, "
            f"identified in {1e3 * times[1]:.0f} ms"
        )


def main():
    with THREADPOOLS.limit(limits=1):
        for part in (sent, judged, kept, drives):
            part()


if __name__ == "__main__":
    main()
