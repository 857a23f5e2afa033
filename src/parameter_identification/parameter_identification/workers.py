"""Jobs done in order by the workers of an executor, or by this process.

A worker that dies is told, and one of other versions refuses its work.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor
from functools import partial
from typing import Any, TypeVar

import cloudpickle

from excitation_planner.design.jobs import CANCELLED, difference_from, versions
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import Progress

T = TypeVar("T")
R = TypeVar("R")


class Steps:
    """Counts work that is done, and tells it.

    Parameters
    ----------
    progress : callable, optional
        Called with the number of steps done, and that in all as far as it is known.
    """

    def __init__(self, progress: Progress | None = None) -> None:
        self._progress, self._done, self._total = progress, 0, 0

    def expect(self, count: int) -> None:
        """Take what is left, as far as it is known now.

        Parameters
        ----------
        count : int
            Number of steps.
        """
        self._total = self._done + count

    def did(self, count: int = 1) -> None:
        """Count further steps.

        Parameters
        ----------
        count : int
            Number of steps.
        """
        self._done += count
        if self._progress is not None:
            self._progress(self._done, self._total)


def each(executor: Executor | None, work: Callable[[T], R], jobs: Iterable[T]) -> Iterator[R]:
    """Yield results in the order of the jobs.

    Parameters
    ----------
    executor : concurrent.futures.Executor, optional
        Default: this process.
    work : callable
        Function that is called with each job.
    jobs : iterable
        One argument each.

    Raises
    ------
    IdentificationError
        If a worker dies, has other versions than this process, or the work is cancelled.
    """
    if executor is None:
        yield from map(work, jobs)
        return
    packed = [cloudpickle.dumps((work, job)) for job in jobs]
    try:
        yield from executor.map(partial(_done, versions()), packed)
    except Exception as error:
        # dask gives a task to other workers first, and then raises an error of its own
        of_dask = type(error).__module__.startswith("distributed.")
        if not (of_dask or isinstance(error, BrokenExecutor | CancelledError)):
            raise
        cancelled = isinstance(error, CancelledError)
        why = f"{CANCELLED}." if cancelled else "a worker died; was memory short?"
        raise IdentificationError(
            f"{why} The same call goes on with the drives that were read"
        ) from error


def _done(expected: tuple[tuple[str, str], ...], packed: bytes) -> Any:
    """Do a job, which is unpacked only where the versions are the same."""
    if different := difference_from(expected):
        raise IdentificationError(different)
    work, job = cloudpickle.loads(packed)
    return work(job)
