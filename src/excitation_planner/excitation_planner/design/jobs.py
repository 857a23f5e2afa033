"""Jobs done in this process or by workers that may die, hang, disagree in version, or come and go.

Each job returns once. A job whose worker is lost is done again by another one, which one line of
the log says; where that does not help, one line says why.
"""

from __future__ import annotations

import logging
import os
import platform
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
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

TRIES = 3
"""Times that jobs are sent again in a row without a result in between."""

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
        self._open: dict[JobT, list[Future[ResultT]]] = {}
        self._returned: SimpleQueue[tuple[JobT, int, Future[ResultT]]] = SimpleQueue()

    def add(self, job: JobT) -> None:
        """Send a job, which must be hashable."""
        self._open[job] = []
        self._send(job)

    def results(self) -> Iterator[tuple[JobT, ResultT]]:
        """Each job with its result, as soon as it is known.

        Raises
        ------
        DesignError
            Workers that die or hang again and again, or have other versions than this process.
        """
        while self._open:
            try:
                job, sent, future = self._returned.get(timeout=self._timeout)
            except Empty:
                self._send_again(f"no result for {self._timeout:g} s")
                continue
            if job not in self._open:
                continue  # a copy of it came first
            try:
                result = future.result()
            except ExcitationError:
                raise
            except Exception as error:
                if sent == self._round:  # else another copy is on its way
                    self._failed(error)
                continue
            self._in_vain = 0
            del self._open[job]
            yield job, result

    def close(self) -> None:
        """Drop the jobs that are left."""
        for futures in self._open.values():
            for future in futures:
                future.cancel()
        self._open.clear()
        self._listening.close()

    def _send(self, job: JobT) -> None:
        sent = self._round
        try:
            future: Future[ResultT] = self._executor.submit(do, versions(), self._work, job, sent)
        except BrokenExecutor as error:
            future = Future()
            future.set_exception(error)
        except RuntimeError as error:
            raise DesignError(f"the executor takes no work: {error}") from error
        self._open[job].append(future)
        future.add_done_callback(lambda done: self._returned.put((job, sent, done)))

    def _failed(self, error: Exception) -> None:
        """Go on after an error of the executor; those of f are DesignErrors already."""
        if isinstance(error, ValueError) and _is_of_dask(self._executor):
            # a result that is fetched while its worker dies: distributed unpacks what is not there
            self._send_again("dask lost a result with its worker")
            return
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
        """Send every open job again; whichever copy returns first counts."""
        self._round += 1
        self._in_vain += 1
        if self._replaced is not None:
            self._executor = self._replaced()
        if self._in_vain > TRIES:
            raise DesignError(f"{reason}; {TRIES} more tries ended alike")
        _LOGGER.warning("%s; %d tasks are sent again", reason, len(self._open))
        for job in list(self._open):
            self._send(job)


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


def do(expected: tuple[tuple[str, str], ...], work: Any, job: Any, sent: int) -> Any:  # noqa: ARG001
    """Do a job on a worker, whose versions are compared before the work is unpacked.

    Parameters
    ----------
    expected : tuple of (str, str)
        `versions` of the process that sent the job.
    work : bytes or callable
        Function of the job, as bytes by cloudpickle.
    job : object
        For it.
    sent : int
        Differs between copies of a job, which dask would otherwise take for one.

    Raises
    ------
    DesignError
        This process has other versions.
    """
    if expected != versions():
        here = dict(versions())
        different = [
            f"{name} {here.get(name, 'missing')} instead of {version}"
            for name, version in expected
            if here.get(name) != version
        ]
        raise DesignError(
            f"worker {platform.node()}, process {os.getpid()}, has {', '.join(different)}: install "
            "the same there, or leave it out"
        )
    return (_loaded(work) if isinstance(work, bytes) else work)(job)


@lru_cache(maxsize=2)
def _loaded(work: bytes) -> Any:
    return cloudpickle.loads(work)
