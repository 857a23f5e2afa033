"""Jobs done in order by the workers of an executor, or by this process; a dead worker is told."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor
from typing import TypeVar

from tricycle_core.errors import IdentificationError

T = TypeVar("T")
R = TypeVar("R")


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
        If a worker dies.
    """
    try:
        yield from map(work, jobs) if executor is None else executor.map(work, jobs)
    except Exception as error:
        # dask gives a task to other workers first, and then raises an error of its own
        of_dask = type(error).__module__.startswith("distributed.")
        if not (of_dask or isinstance(error, BrokenExecutor)):
            raise
        raise IdentificationError(
            "a worker died; was memory short? The same call goes on with the drives that were read"
        ) from error
