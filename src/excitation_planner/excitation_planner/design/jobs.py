"""Jobs done in this process or by workers that may die, hang, disagree in version, or come and go.

Each job returns once. A job whose worker is lost is done again by another one, which one line of
the log says; where that does not help, one line says why. Short jobs are sent several at a time.
"""

from __future__ import annotations

import logging
import os
import platform
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ThreadPoolExecutor,
)
from contextlib import suppress
from functools import lru_cache
from importlib import metadata
from queue import Empty, SimpleQueue
from typing import Any, Generic, Protocol, TypeVar

import cloudpickle

from tricycle_core import __version__
from tricycle_core.errors import DesignError, ExcitationError
from tricycle_core.optional import optional

_LOGGER = logging.getLogger(__name__)

CANCELLED = "the executor has cancelled its work: it was shut down, or its scheduler is lost"
"""Why there is no result of a future that somebody has cancelled."""

TRIES = 3
"""Times that jobs are sent again in a row without a result in between."""

TOGETHER = 0.5
"""Time that short jobs sent together take [s]; sending takes up to some ms."""

JobT = TypeVar("JobT")
ResultT = TypeVar("ResultT")
ResultT_co = TypeVar("ResultT_co", covariant=True)


class Jobs(Protocol[JobT, ResultT_co]):
    """Jobs that are to be done."""

    def add(self, job: JobT) -> None:
        """Take a job; also while results are read."""

    def results(self) -> Iterator[tuple[JobT, ResultT_co]]:
        """Each job with its result, in any order, until none is left."""

    def close(self) -> None:
        """Drop the jobs that are left."""


class JobsHere(Generic[JobT, ResultT]):
    """Jobs done in this process, one after the other.

    Parameters
    ----------
    work : callable
        Does a job.
    """

    def __init__(self, work: Callable[[JobT], ResultT]) -> None:
        self._work = work
        self._open: deque[JobT] = deque()

    def add(self, job: JobT) -> None:
        """Take a job."""
        self._open.append(job)

    def results(self) -> Iterator[tuple[JobT, ResultT]]:
        """Each job with its result, in the order in which they were added."""
        while self._open:
            job = self._open.popleft()
            yield job, self._work(job)

    def close(self) -> None:
        """Drop the jobs that are left."""
        self._open.clear()


class JobsOfExecutor(Generic[JobT, ResultT]):
    """Jobs done by the workers of an executor.

    Parameters
    ----------
    work : callable
        Does a job; sent by value, so that workers need not find what a notebook defines.
    executor : Executor
        Has the workers.
    replaced : callable, optional
        Ends a broken or hanging executor and gives another one; without it a broken executor is an
        error, and jobs of hanging workers go to the others.
    timeout : float, optional
        Time without any result [s] after which all open jobs are sent again. Longer than any job
        takes; what it costs to be wrong is that jobs are done twice.
    together : float
        Time that jobs sent together take at least [s], if there are enough of them for all
        workers; 0: each is sent alone.

    Raises
    ------
    DesignError
        Work that cannot be sent to another process.
    """

    def __init__(
        self,
        work: Callable[[JobT], ResultT],
        executor: Executor,
        *,
        replaced: Callable[[], Executor] | None = None,
        timeout: float | None = None,
        together: float = TOGETHER,
    ) -> None:
        if timeout is not None and not timeout > 0:
            raise DesignError(f"timeout = {timeout:g} s must be positive")
        self._work: Any = work  # threads take it as it is
        try:
            if not isinstance(executor, ThreadPoolExecutor):
                self._work = cloudpickle.dumps(work)
        except Exception as error:
            raise DesignError(
                "f or noise_variance holds something that cannot be sent to another process: "
                f"make it inside the function, or give workers=1 ({error})"
            ) from error
        self._executor, self._replaced, self._timeout = executor, replaced, timeout
        self._listening = _LostWorkers(executor)
        self._round = self._in_vain = 0
        self._together = together if timeout is None else min(together, timeout / 4)
        self._workers = _workers_of(executor)
        self._seconds: float | None = None  # per job, of those that have returned
        self._open: dict[JobT, None] = {}
        self._waiting: deque[JobT] = deque()  # those of them that are not sent yet
        self._sent: set[Future[_Done[ResultT]]] = set()
        self._returned: SimpleQueue[_Returned[JobT, ResultT]] = SimpleQueue()

    def add(self, job: JobT) -> None:
        """Take a job, which must be hashable."""
        self._open[job] = None
        self._waiting.append(job)
        # alone, unless jobs may be short, and there are enough for all workers already
        if not self._may_be_short or (
            self._seconds is None and len(self._sent) < 2 * self._workers
        ):
            self._send_waiting(alone=True)

    def results(self) -> Iterator[tuple[JobT, ResultT]]:
        """Each job with its result, as soon as it is known.

        Raises
        ------
        DesignError
            Workers that die or hang again and again, or have other versions than this process.
        """
        while self._open:
            if not self._may_be_short or self._seconds is not None:
                self._send_waiting()
            try:
                jobs, sent, future = self._returned.get(
                    timeout=self._together if self._waiting else self._timeout
                )
            except Empty:
                if self._waiting:  # no job is so short that they were better sent together
                    self._send_waiting(alone=True)
                else:
                    self._send_again(f"no result for {self._timeout:g} s")
                continue
            self._sent.discard(future)
            if not any(job in self._open for job in jobs):
                continue  # copies of them came first
            try:
                results, seconds = future.result()
            except ExcitationError:
                raise
            except Exception as error:
                if sent == self._round:  # else another copy is on its way
                    self._failed(error)
                continue
            self._in_vain = 0
            took = seconds / len(jobs)
            self._seconds = took if self._seconds is None else 0.5 * (self._seconds + took)
            for job, result in zip(jobs, results, strict=True):
                if job in self._open:
                    del self._open[job]
                    yield job, result

    def close(self) -> None:
        """Drop the jobs that are left."""
        for future in self._sent:
            future.cancel()
        self._sent.clear()
        self._open.clear()
        self._waiting.clear()
        self._listening.close()

    @property
    def _may_be_short(self) -> bool:
        """Whether jobs may be better sent together, as far as is known."""
        short = self._seconds is None or self._seconds <= 0.5 * self._together
        return short and self._workers > 0 and self._together > 0.0

    def _send_waiting(self, *, alone: bool = False) -> None:
        """Send the jobs that wait: fewer and fewer together, so that workers end together."""
        if not alone and len(self._waiting) >= 4:
            self._workers = _workers_of(self._executor)  # they come and go
        while self._waiting:
            size = 1
            if not alone and self._may_be_short and self._seconds is not None:
                size = int(self._together / max(self._seconds, 1e-6))
                size = max(1, min(size, len(self._waiting) // (2 * self._workers)))
            self._send([self._waiting.popleft() for _ in range(size)])

    def _send(self, jobs: Sequence[JobT]) -> None:
        sent = self._round
        future: Future[_Done[ResultT]]
        try:
            future = self._executor.submit(do, versions(), self._work, jobs, sent)
        except BrokenExecutor as error:
            future = Future()
            future.set_exception(error)
        except RuntimeError as error:
            raise DesignError(f"the executor takes no work: {error}") from error
        self._sent.add(future)
        future.add_done_callback(lambda done: self._returned.put((jobs, sent, done)))

    def _failed(self, error: Exception) -> None:
        """Go on after an error of the executor; those of f are DesignErrors already."""
        if isinstance(error, ValueError) and _is_of_dask(self._executor):
            # a result that is fetched while its worker dies: distributed unpacks what is not there
            self._send_again("dask lost a result with its worker")
            return
        if isinstance(error, CancelledError):
            raise DesignError(CANCELLED) from error
        if not isinstance(error, BrokenExecutor):
            raise DesignError(
                f"a worker could not do its work, {type(error).__name__}: "
                f"{' '.join(str(error).split())}"
            ) from error
        died = "a worker process died: memory was short, or f crashed it"
        if self._replaced is None:
            raise DesignError(
                f"{died}; this executor ends with its first dead process, that of workers=... or "
                "dask would have gone on"
            ) from error
        self._send_again(died)

    def _send_again(self, reason: str) -> None:
        """Send every open job again, alone; whichever copy returns first counts."""
        self._round += 1
        self._in_vain += 1
        if self._replaced is not None:
            self._executor = self._replaced()
        if self._in_vain > TRIES:
            raise DesignError(f"{reason}; {TRIES} more tries ended alike")
        _LOGGER.warning("%s; %d tasks are sent again", reason, len(self._open))
        self._waiting = deque(self._open)
        self._send_waiting(alone=True)


_Done = tuple[list[ResultT], float]
_Returned = tuple[Sequence[JobT], int, Future[_Done[ResultT]]]


def _workers_of(executor: Executor) -> int:
    """Return the number of workers of an executor; 0 if unknown, or if they are threads."""
    if isinstance(executor, ThreadPoolExecutor):
        return 0  # to which nothing is sent
    if _is_of_dask(executor):
        return sum(executor._client.nthreads().values())  # type: ignore[attr-defined]  # noqa: SLF001
    return int(getattr(executor, "_max_workers", 0))


def _is_of_dask(executor: Executor) -> bool:
    return type(executor).__module__.startswith("distributed.")


class _LostWorkers:
    """Says when dask loses a worker, whose tasks it gives to others by itself."""

    def __init__(self, executor: Executor) -> None:
        self._client: Any = None
        if _is_of_dask(executor):
            with suppress(ValueError):  # no client is the default one
                self._client = optional("distributed", "this executor").default_client()
                self._client.subscribe_topic("all", self._tell)

    def close(self) -> None:
        if self._client is not None:
            self._client.unsubscribe_topic("all")
            self._client = None

    @staticmethod
    def _tell(event: tuple[float, dict[str, Any]]) -> None:
        message = event[1]
        if message.get("action") == "remove-worker" and not message.get("expected"):
            _LOGGER.warning(
                "dask lost worker %s; %d tasks are sent again",
                message["worker"],
                len(message["processing-tasks"]),
            )


@lru_cache(maxsize=1)
def versions() -> tuple[tuple[str, str], ...]:
    """Return the names and versions of what results depend on, in this process."""
    python = ".".join(platform.python_version_tuple()[:2])
    packages = [(name, metadata.version(name)) for name in ("numpy", "scipy", "numba")]
    return (("tricycle-excitation", __version__), ("Python", python), *packages)


def difference_from(expected: tuple[tuple[str, str], ...]) -> str:
    """Return how the versions of this worker differ from those of the caller; empty: not at all.

    Parameters
    ----------
    expected : tuple of (str, str)
        `versions` of the caller.
    """
    here = dict(versions())
    different = [
        f"{name} {here.get(name, 'missing')} instead of {version}"
        for name, version in expected
        if here.get(name) != version
    ]
    if not different:
        return ""
    return (
        f"worker {platform.node()}, process {os.getpid()}, has {', '.join(different)}: install the "
        "same there, or leave it out"
    )


def do(
    expected: tuple[tuple[str, str], ...],
    work: Any,
    jobs: Sequence[Any],
    sent: int,  # noqa: ARG001
) -> tuple[list[Any], float]:
    """Return the results of jobs on a worker, and the time that they took [s].

    Its versions are compared before the work is unpacked.

    Parameters
    ----------
    expected : tuple of (str, str)
        `versions` of the process that sent the job.
    work : bytes or callable
        Function of a job, as bytes by cloudpickle.
    jobs : sequence of object
        Jobs that are done one after the other.
    sent : int
        Differs between copies of jobs, which dask would otherwise take for one.

    Raises
    ------
    DesignError
        This process has other versions.
    """
    if different := difference_from(expected):
        raise DesignError(different)
    done = _loaded(work) if isinstance(work, bytes) else work
    began = time.perf_counter()
    results = [done(job) for job in jobs]
    return results, time.perf_counter() - began


@lru_cache(maxsize=2)
def _loaded(work: bytes) -> Any:
    return cloudpickle.loads(work)
