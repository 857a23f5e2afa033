"""The same design wherever the simulator runs, also when a worker dies or hangs."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import (
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from excitation_planner import design_excitation
from excitation_planner.design import jobs
from excitation_planner.design.executors import process_pool, processes
from excitation_planner.design.jobs import JobsOfExecutor, versions
from excitation_planner.indices.analytic import MATH_MODEL_UNKNOWN, math_model
from tricycle_core import __version__
from tricycle_core.errors import DesignError, InfeasibleManeuver

OPERATION = {f"x{i}": (-2.0, -0.2) for i in (1, 2, 3, 4)}


def design(f=math_model, **arguments):
    return design_excitation(
        f, OPERATION, MATH_MODEL_UNKNOWN, "p3", samples=30, budget=1800, **arguments
    )


def test_a_pool_has_a_process_for_each_core_that_is_usable(monkeypatch):
    """On a node of a cluster those of the job, not of the machine."""
    monkeypatch.setattr("loky.get_reusable_executor", lambda workers, **_: workers)
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    assert process_pool() == len(os.sched_getaffinity(0))


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


SMALL = {"p": (0.0, 1.0), "q": (10.0, 20.0)}
TIME = np.linspace(0.0, 1.0, 7)


def output(x, P):
    """Numbers; every row depends on its parameters alone."""
    if x[0] > 0.9:
        raise InfeasibleManeuver("too fast")
    q = (P[:, 1] - 10) / 10
    m = P[:, 0] * np.exp(-q) + (0.1 + np.sin(x[0] - 0.2) ** 2) * q
    return np.where(q > 0.97, np.nan, m)


def trajectory(x, P):
    """The like over time, in an order of memory that NumPy's sums would follow."""
    Y = np.empty((2, len(TIME), len(P)))
    Y[:] = output(x, P) * TIME[:, None]
    Y[1] += P[:, 0] * np.sqrt(TIME)[:, None] * x[0]
    return Y.transpose(2, 1, 0)


def small_design(f=output, **arguments):
    return design_excitation(
        f, {"x": (-1.0, 1.0)}, SMALL, "p", samples=8, draws=2, budget=260, **arguments
    )


@pytest.mark.parametrize(("f", "criterion"), [(output, "h"), (trajectory, "c")])
@pytest.mark.parametrize("chunk", [1, 3, 1000])
def test_the_same_design_however_the_simulations_are_spread(f, criterion, chunk):
    whole = small_design(f, criterion=criterion, workers=1)
    assert_same(small_design(f, criterion=criterion, workers=1, chunk=chunk), whole)
    with ThreadPoolExecutor(3) as pool:
        assert_same(small_design(f, criterion=criterion, executor=pool, chunk=chunk), whole)


@pytest.mark.slow
@pytest.mark.parametrize(("f", "criterion"), [(output, "h"), (trajectory, "c")])
def test_the_same_design_by_processes(f, criterion):
    whole = small_design(f, criterion=criterion, workers=1)
    counts = []
    for workers, chunk in ((2, None), (2, 2), (3, 5)):
        found = small_design(
            f,
            criterion=criterion,
            workers=workers,
            chunk=chunk,
            progress=lambda done, _: counts.append(done),
        )
        assert_same(found, whole)
        assert counts[-1] == found.simulations
        assert counts == sorted(counts)
        counts.clear()


def test_processes_end_at_once_and_silently_with_cancelled_work_in_the_queue(caplog):
    begun = time.monotonic()
    with pytest.raises(DesignError, match="first"), processes(1) as pool:
        for _ in pool.map(fails_or_sleeps, range(30)):
            pass
    assert time.monotonic() - begun < 30.0
    assert not caplog.records


def fails_or_sleeps(number):
    if number == 0:
        raise DesignError("the first one fails")
    time.sleep(60.0)


def once(marker: Path) -> bool:
    """Whether this is the first call of all processes."""
    try:
        marker.touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


def dies_once(x, P, marker):
    if once(marker):
        os.kill(os.getpid(), signal.SIGKILL)
    return output(x, P)


def stops_once(x, P, marker):
    if once(marker):
        os.kill(os.getpid(), signal.SIGSTOP)
    return output(x, P)


@pytest.mark.slow
def test_tasks_of_a_killed_process_are_done_by_others(tmp_path, caplog):
    found = small_design(partial(dies_once, marker=tmp_path / "died"), workers=2, chunk=2)
    assert_same(found, small_design(workers=1))
    (said,) = caplog.messages
    assert said.startswith("a worker process died: memory was short, or f crashed it; ")


@pytest.mark.slow
def test_tasks_of_a_hanging_process_are_done_by_others(tmp_path, caplog):
    # longer than two processes take to start
    found = small_design(
        partial(stops_once, marker=tmp_path / "hung"), workers=2, chunk=2, timeout=15
    )
    assert_same(found, small_design(workers=1))
    assert caplog.messages[0].startswith("no result for 15 s; ")


def test_processes_that_die_again_and_again_are_reported(caplog):
    class Dead(Executor):
        def submit(self, *_):
            raise BrokenExecutor

    tasks = JobsOfExecutor(str, Dead(), replaced=Dead)
    tasks.add(1)
    with pytest.raises(DesignError, match=r"a worker process died: .*; 3 more tries ended alike"):
        list(tasks.results())
    assert len(caplog.messages) == 3


def test_each_job_returns_once_whichever_copy_comes_first():
    """Also when a copy that was given up returns after all, or fails."""
    sent = []

    class Slow(Executor):
        def submit(self, do, *arguments):
            sent.append((Future(), partial(do, *arguments)))
            if len(sent) == 6:  # twice three: all were sent again
                for number, (future, work) in enumerate(sent):
                    if number == 1:
                        future.set_exception(OSError("the connexion is lost"))
                    else:
                        future.set_result(work())
            return sent[-1][0]

    tasks = JobsOfExecutor(str, Slow(), timeout=0.05)
    for job in (1, 2, 3):
        tasks.add(job)
    assert sorted(tasks.results()) == [(1, "1"), (2, "2"), (3, "3")]


class Counted(Executor):
    """Two workers, and how many jobs each task held that they were given."""

    _max_workers = 2

    def __init__(self):
        self.sizes, self.dies_with = [], None

    def submit(self, do, expected, work, several, sent):
        self.sizes.append(len(several))
        future = Future()
        if self.dies_with == len(several):
            future.set_exception(BrokenExecutor())
        else:
            future.set_result(do(expected, work, several, sent))
        return future


def results_of(tasks, count):
    for job in range(count):
        tasks.add(job)
    found = list(tasks.results())
    assert sorted(found) == [(job, str(job)) for job in range(count)]


def test_short_jobs_are_sent_together():
    """After a few alone, fewer and fewer, so that all workers end at about the same time."""
    executor = Counted()
    results_of(JobsOfExecutor(str, executor), 200)
    assert executor.sizes[:4] == [1] * 4
    assert executor.sizes[4:] == sorted(executor.sizes[4:], reverse=True)
    assert executor.sizes[4] == 196 // 4
    assert executor.sizes[-1] == 1


@pytest.mark.parametrize(("count", "together"), [(200, 0.0), (200, 1e-9), (7, 10.0)])
def test_jobs_are_sent_alone(count, together):
    """Where that is asked for, where they are long, or where there are few for the workers."""
    executor = Counted()
    results_of(JobsOfExecutor(str, executor, together=together), count)
    assert executor.sizes == [1] * count


def test_jobs_wait_for_the_first_result_for_a_while_only():
    held = []

    class Waits(Counted):
        def submit(self, *arguments):
            held.append((Future(), partial(super().submit, *arguments)))
            if len(held) == 10:
                for future, work in held:
                    future.set_result(work().result())
            return held[-1][0]

    executor = Waits()
    results_of(JobsOfExecutor(str, executor, together=0.05), 10)
    assert executor.sizes == [1] * 10


def test_jobs_that_were_lost_together_are_done_again_alone(caplog):
    first, second = Counted(), Counted()
    first.dies_with = 24
    results_of(JobsOfExecutor(str, first, replaced=lambda: second), 100)
    assert first.sizes[4] == 24
    assert set(second.sizes) == {1}
    assert caplog.messages == [
        "a worker process died: memory was short, or f crashed it; "
        f"{len(second.sizes)} tasks are sent again"
    ]


def test_another_worker_takes_over_from_one_that_hangs(caplog):
    """On an executor of one's own, which nobody but its owner can end."""
    freed, calls = threading.Event(), []

    def hangs_at_first(x, P):
        calls.append(x)
        if len(calls) == 4:
            freed.wait(60)
        return output(x, P)

    with ThreadPoolExecutor(2) as pool:
        try:
            found = small_design(hangs_at_first, executor=pool, timeout=1.0)
        finally:
            freed.set()
    assert_same(found, small_design(workers=1))
    assert "no result for 1 s; 1 tasks are sent again" in caplog.messages


def test_workers_that_all_hang_are_reported(caplog):
    freed = threading.Event()
    with ThreadPoolExecutor(2) as pool:
        try:
            with pytest.raises(
                DesignError, match=r"no result for 0\.1 s; 3 more tries ended alike"
            ):
                small_design(lambda x, P: freed.wait(60), executor=pool, timeout=0.1)
        finally:
            freed.set()
    assert len(caplog.messages) == 3


class Cancelling(Executor):
    """As of a scheduler that was lost."""

    def submit(self, *_, **__):
        (future := Future()).cancel()
        return future


def test_work_that_is_cancelled_is_reported():
    with pytest.raises(DesignError, match="the executor has cancelled its work"):
        small_design(must_not_run, executor=Cancelling())


def _older() -> None:
    jobs.versions = lambda: (("tricycle-excitation", "0.0.9"), *versions()[1:])


def must_not_run(x, P):
    raise AssertionError


@pytest.mark.slow
def test_a_worker_of_another_version_gets_no_work():
    with (
        ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_older) as pool,
        pytest.raises(
            DesignError,
            match=r"worker .*, process \d+, has tricycle-excitation 0\.0\.9 instead of "
            rf"{re.escape(__version__)}: install the same there, or leave it out",
        ),
    ):
        small_design(must_not_run, executor=pool)


def test_what_is_no_chunk_no_time_and_no_number_of_workers():
    for arguments, message in [
        ({"chunk": 0}, "chunk = 0 must be 1 or more"),
        ({"workers": -1}, "workers = -1 must be 1 or more"),
        ({"timeout": 0.0}, "timeout = 0 s must be positive"),
    ]:
        with pytest.raises(DesignError, match=message):
            small_design(**{"workers": 2} | arguments)
    pool = ThreadPoolExecutor(1)
    pool.shutdown()
    with pytest.raises(DesignError, match="the executor takes no work: cannot schedule new"):
        small_design(executor=pool)


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
