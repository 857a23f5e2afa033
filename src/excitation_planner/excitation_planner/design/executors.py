"""Execution of simulations: in this process, in processes of this machine, or on any executor."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

import cloudpickle
from loky import get_reusable_executor

from excitation_planner.design.evaluation import evaluate
from excitation_planner.design.problem import DesignProblem, Outcome, Simulator, Verified
from tricycle_core.errors import DesignError
from tricycle_core.quantities import FloatArray

# x (l,), whether for verification, and its outcome if that is known already
Task = tuple[FloatArray, bool, Outcome | None]
Result = tuple[Outcome, Verified]
IDLE_TIME = 60  # s, after which a process without work ends

Run = Callable[[list[Task], Callable[[int, Result], None]], list[Result]]


@contextmanager
def running(
    f: Simulator, problem: DesignProblem, executor: Executor | None, workers: int | None
) -> Iterator[Run]:
    """Give a function that evaluates tasks and reports each (index, result) as soon as it is known.

    Without an executor, processes of this machine run them.

    Parameters
    ----------
    f : callable
        Simulator.
    problem : DesignProblem
        What is evaluated.
    executor : Executor, optional
        Where tasks run.
    workers : int, optional
        Number of processes; 1 runs everything in this process.
    """
    if executor is None and workers == 1:

        def run(tasks: list[Task], done: Callable[[int, Result], None]) -> list[Result]:
            results = []
            for i, (x, verification, outcome) in enumerate(tasks):
                results.append(evaluate(f, problem, x, verification=verification, outcome=outcome))
                done(i, results[-1])
            return results

        yield run
    elif executor is not None:
        yield _submitting(f, problem, executor)
    else:
        try:
            cloudpickle.dumps((f, problem))
        except Exception as error:
            raise DesignError(
                "f or noise_variance holds something that cannot be sent to another process: "
                f"make it inside the function, or give workers=1 ({error})"
            ) from error
        yield _submitting(f, problem, process_pool(workers))


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
    # an idle process that ends just when work comes is replaced; loky warns of it
    warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
    pool: Executor = get_reusable_executor(
        workers or os.cpu_count(), timeout=IDLE_TIME, initializer=_prepare_worker
    )
    return pool


def _submitting(f: Simulator, problem: DesignProblem, executor: Executor) -> Run:
    def run(tasks: list[Task], done: Callable[[int, Result], None]) -> list[Result]:
        futures: list[Future[Result]] = [
            executor.submit(evaluate, f, problem, x, verification=verification, outcome=outcome)
            for x, verification, outcome in tasks
        ]
        index = {future: i for i, future in enumerate(futures)}
        try:
            for future in as_completed(futures):
                done(index[future], future.result())
        except BrokenProcessPool as error:
            raise DesignError(
                "a worker process died: memory was short, f crashed it, or it could not import f "
                "(processes of an executor of your own do not find what a notebook defines)"
            ) from error
        finally:
            for future in futures:
                future.cancel()
        return [future.result() for future in futures]

    return run


def _prepare_worker() -> None:
    """Leave Ctrl-C to the parent, and keep to one thread: more would only wait for each other."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if "numba" in sys.modules:
        sys.modules["numba"].set_num_threads(1)
    else:
        os.environ["NUMBA_NUM_THREADS"] = "1"
