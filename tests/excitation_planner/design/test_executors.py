"""The same design wherever the simulator runs, also when a worker dies."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from excitation_planner import design_excitation
from excitation_planner.indices.analytic import MATH_MODEL_UNKNOWN, math_model
from tricycle_core.errors import DesignError

OPERATION = {f"x{i}": (-2.0, -0.2) for i in (1, 2, 3, 4)}


def design(f=math_model, **arguments):
    return design_excitation(
        f, OPERATION, MATH_MODEL_UNKNOWN, "p3", samples=30, budget=1800, **arguments
    )


def assert_same(one, other):
    assert np.array_equal(one.x, other.x)
    assert one.cost == other.cost
    assert [e.cost for e in one.history] == [e.cost for e in other.history]


def dies(x, P):
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.slow
def test_an_executor_of_ones_own():
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        assert_same(design(executor=pool), design(workers=1))


@pytest.mark.slow
def test_a_worker_that_dies_is_reported():
    with (
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool,
        pytest.raises(DesignError, match="a worker process died"),
    ):
        design(dies, executor=pool)


SCRIPT = """
import numpy as np
from excitation_planner import design_excitation

print("run")
unknown = {"p": (0.0, 1.0), "q": (0.0, 1.0)}
weight = 0.1


def f(x, P):
    return x[0] * P[:, 0] + (weight + x[0] ** 2) * P[:, 1]


design = design_excitation(f, {"x": (0.0, 1.0)}, unknown, "p", samples=10, budget=200, workers=2)
print(design.verdict)
"""


@pytest.mark.slow
@pytest.mark.parametrize("notebook", [False, True])
def test_a_simulator_defined_where_no_worker_can_import_it(tmp_path: Path, notebook):
    """In a script without ``if __name__ == "__main__"``, or in no file at all."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    found = subprocess.run(
        [sys.executable, "-" if notebook else script],
        input=SCRIPT if notebook else "",
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.stderr == ""
    assert found.stdout.splitlines() == ["run", "excites"]


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # dask's own
def test_dask_with_a_worker_killed_half_way(tmp_path: Path):
    """A real scheduler and two workers in processes of their own, talking over TCP."""
    distributed = pytest.importorskip("distributed")
    scheduler_file = tmp_path / "scheduler.json"
    environment = os.environ | {"OMP_NUM_THREADS": "1"}

    def start(*arguments):
        return subprocess.Popen(
            [sys.executable, "-m", *arguments, "--scheduler-file", str(scheduler_file)],
            env=environment,
            stderr=subprocess.DEVNULL,
        )

    processes = [
        start(
            "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"
        )
    ]
    try:
        worker = ["distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny", "--no-dashboard"]
        processes += [start(*worker), start(*worker)]
        deadline = time.monotonic() + 60
        while not scheduler_file.exists() and time.monotonic() < deadline:
            time.sleep(0.1)
        with distributed.Client(scheduler_file=str(scheduler_file)) as client:
            client.wait_for_workers(2, timeout=60)
            killed = []

            def kill_one(done, total):
                if done > 900 and not killed:
                    killed.append(processes[1].kill())

            found = design(executor=client.get_executor(), progress=kill_one)
            assert killed
    finally:
        for process in processes:
            process.kill()
            process.wait()
    assert_same(found, design(workers=1))
