"""Execution of simulations: in this process, in processes of this machine, or on any executor."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

from excitation_planner.design.evaluation import (
    joined,
    judge_outcome,
    parameter_points,
    simulate,
)
from excitation_planner.design.jobs import Jobs, JobsHere, JobsOfExecutor
from excitation_planner.design.problem import DesignProblem, Outcome, Simulator, Verified
from excitation_planner.design.store import Store
from excitation_planner.indices.threads import THREADPOOLS
from tricycle_core.cores import usable_cores
from tricycle_core.errors import DesignError
from tricycle_core.quantities import FloatArray

IDLE_TIME = 60  # s, after which a process without work ends


@dataclass(frozen=True, eq=False)
class _Job:
    """Simulations of a maneuver, its judgement, or both.

    Attributes
    ----------
    maneuver : int
        Number in its batch.
    x : ndarray of float, shape (l,)
        Operation parameters.
    verification : bool
        Whether the samples are those of the verification.
    samples : range
        Numbers of the samples to simulate.
    U : ndarray of float, shape (q, k + e)
        Parameters of those samples in the unit box; of all samples if the job evaluates them.
    outcome : tuple or str, optional
        Result of f at all samples; None: still to be simulated.
    judged : bool
        Whether indices and cost are computed.
    sent_back : bool
        Whether the outcome is returned.
    """

    maneuver: int
    x: FloatArray
    verification: bool
    samples: range
    U: FloatArray
    outcome: Outcome | None
    judged: bool
    sent_back: bool


_Result = tuple[Outcome | None, Verified | None]


def _work(f: Simulator, problem: DesignProblem, job: _Job) -> _Result:
    with THREADPOOLS.limit(limits=1):
        outcome, verified = job.outcome, None
        if outcome is None:
            outcome = simulate(f, problem, job.x, job.U)
        if job.judged:
            verified = judge_outcome(problem, job.x, job.U, outcome, verification=job.verification)
        # otherwise trajectories stay where they were simulated: they are large
        return (outcome if job.sent_back else None), verified


class Evaluations:
    """Evaluates maneuvers by jobs; simulations in the store are not run again.

    Parameters
    ----------
    jobs : Jobs
        Runs the jobs.
    problem : DesignProblem
        Design problem of the maneuvers.
    chunk : int or None
        Simulations per job; None: all of a maneuver.
    store : Store, optional
        Keeps every simulation; those it has are not run again.
    progress : callable, optional
        Called with the number of simulations of all maneuvers so far.
    """

    def __init__(
        self,
        jobs: Jobs[_Job, _Result],
        problem: DesignProblem,
        *,
        chunk: int | None,
        store: Store | None,
        progress: Callable[[int], None] | None,
    ) -> None:
        self._jobs, self._problem = jobs, problem
        self._chunk, self._store, self._progress = chunk, store, progress
        self._done = 0

    def __call__(self, points: list[FloatArray], verification: bool) -> list[Verified]:
        """Evaluate maneuvers x (l,), side by side where the jobs' workers can."""
        U = parameter_points(self._problem, verification=verification)
        size = self._chunk or len(U)
        chunks = [range(i, min(i + size, len(U))) for i in range(0, len(U), size)]
        whole = len(chunks) == 1
        outcomes: list[dict[int, Outcome]] = [{} for _ in points]
        verified: dict[int, Verified] = {}
        counted = [0 for _ in points]

        def count(number: int, simulations: int) -> None:
            self._done += simulations - counted[number]
            counted[number] = simulations
            if self._progress is not None:
                self._progress(self._done)

        def judge(number: int) -> None:
            outcome = joined([outcomes[number][chunk.start] for chunk in chunks])
            self._jobs.add(
                _Job(number, points[number], verification, range(0), U, outcome, True, False)
            )

        for number, x in enumerate(points):
            for chunk in chunks:
                known = None
                if self._store is not None:
                    known = self._store.recall(x, chunk, verification=verification)
                if known is not None:
                    outcomes[number][chunk.start] = known
                    continue
                back = self._store is not None or not whole
                here = U[chunk.start : chunk.stop]
                self._jobs.add(_Job(number, x, verification, chunk, here, None, whole, back))
            if len(outcomes[number]) == len(chunks):
                judge(number)

        for job, (outcome, judged) in self._jobs.results():
            number = job.maneuver
            if outcome is not None:
                outcomes[number][job.samples.start] = outcome
                if self._store is not None:
                    self._store.keep(job.x, job.samples, outcome, verification=verification)
                if not isinstance(outcome, str) and not whole:
                    count(number, counted[number] + len(job.samples))
            if judged is not None:
                verified[number] = judged
                count(number, judged.evaluation.simulations)
            elif len(outcomes[number]) == len(chunks):
                judge(number)
        return [verified[number] for number in range(len(points))]


@contextmanager
def evaluations(
    f: Simulator,
    problem: DesignProblem,
    *,
    executor: Executor | None = None,
    workers: int | None = None,
    chunk: int | None = None,
    timeout: float | None = None,
    store: Store | None = None,
    progress: Callable[[int], None] | None = None,
) -> Iterator[Evaluations]:
    """Give, for a block, a function that evaluates maneuvers.

    Without an executor, processes of this machine run them.

    Parameters
    ----------
    f : callable
        Simulator f(x, P).
    problem : DesignProblem
        Design problem of the maneuvers.
    executor : Executor, optional
        Executor that runs the jobs.
    workers : int, optional
        Number of processes; 1 runs everything in this process.
    chunk : int, optional
        Simulations per job; by default all of a maneuver.
    timeout : float, optional
        Time without any result [s] after which jobs are given to other workers.
    store : Store, optional
        Keeps every simulation; those it has are not run again.
    progress : callable, optional
        Called with the number of simulations so far.

    Raises
    ------
    DesignError
        If a chunk, timeout or number of workers is not positive, or f cannot be sent to another
        process.
    """
    for name, number in (("chunk", chunk), ("workers", workers)):
        if number is not None and number < 1:
            raise DesignError(f"{name} = {number} must be 1 or more")
    work = partial(_work, f, problem)
    jobs: Jobs[_Job, _Result]
    if executor is not None:
        jobs = JobsOfExecutor(work, executor, timeout=timeout)
    elif workers == 1:
        jobs = JobsHere(work)
    else:
        pool = process_pool(workers)
        jobs = JobsOfExecutor(
            work, pool, replaced=partial(_replaced_pool, workers), timeout=timeout
        )
    try:
        yield Evaluations(jobs, problem, chunk=chunk, store=store, progress=progress)
    finally:
        jobs.close()


def process_pool(workers: int | None = None) -> Executor:
    """Give processes of this machine, kept for the next caller for a minute.

    A process takes seconds to import what simulates; the next step of a campaign or the next cell
    of a notebook finds it ready. Processes get functions by value and never import the caller's
    script, so that functions of a notebook or of a script without ``if __name__ == "__main__"``
    run in them too.

    Parameters
    ----------
    workers : int, optional
        Their number, by default one per core.
    """
    pool: Executor = _pool(workers)
    return pool


@contextmanager
def processes(workers: int | None = None) -> Iterator[Executor]:
    """Give processes of this machine that end with the block, at once where Ctrl-C ends it.

    They are those of `process_pool`. For the main thread.

    Parameters
    ----------
    workers : int, optional
        Their number, by default one per core.
    """
    # processes inherit it: one that Ctrl-C reached while it starts would print a traceback
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        pool = _pool(workers)
        pool.submit(int)  # starts them all
    finally:
        signal.signal(signal.SIGINT, before)
    try:
        yield pool
    finally:
        _end(pool)


def _pool(workers: int | None) -> Any:
    from loky import get_reusable_executor  # not needed with threads or a cluster

    # an idle process that ends just when work comes is replaced; loky warns of it
    warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
    return get_reusable_executor(
        workers or usable_cores(), timeout=IDLE_TIME, initializer=_prepare_worker
    )


def _replaced_pool(workers: int | None) -> Executor:
    """End the processes, also those that hang, and give others."""
    _end(_pool(workers))
    return process_pool(workers)


def _end(pool: Any) -> None:
    """End the processes at once, whatever they do."""
    # loky sets an error on queued futures, and its thread fails on one that was cancelled
    for item in list(pool._pending_work_items.values()):  # noqa: SLF001
        if item.future.cancelled():
            item.future = Future()
    pool.shutdown(kill_workers=True)


def _prepare_worker() -> None:
    """Leave Ctrl-C to the parent, and keep to one thread: more would only wait for each other."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if "numba" in sys.modules:
        sys.modules["numba"].set_num_threads(1)
    else:
        os.environ["NUMBA_NUM_THREADS"] = "1"
