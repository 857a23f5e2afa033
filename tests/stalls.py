"""Tests in real time, on a machine that may stand still under them.

The boards stop a vehicle whose commands pause for 200 ms, and refuse commands whose echo is older
than 150 ms. Where this process gets no processor for so long, a test against the wall clock fails
although nothing is wrong.

- Where all that measures time is in the test's own process, its clock does not count such pauses.
- A test with processes beside it that failed after a pause is run again, once the machine has kept
  time for a while. After RUNS such runs it is skipped: this machine cannot judge it. The summary
  names every test that was run again, and each pause. A failure without a pause stays a failure.
"""

import atexit
import gc
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from _pytest.runner import runtestprotocol
from note_pauses import PAUSE

RUNS = 4  # of one test, at most
QUIET = 2.0  # s without a pause before a test is run again
PATIENCE = 60.0  # s to wait for that
_LONGEST_STEP = 0.03  # s of a RunningClock
_AGAIN = "run again after a pause"  # user property of a report: the pause in s


class RunningClock:
    """A monotonic clock of the time in which this process runs.

    The threads of a test and of its boards read it every 10 ms or so; what is longer than 30 ms
    between two readings is not counted.
    """

    def __init__(self) -> None:
        self._read = time.monotonic
        self._before = self._now = self._read()
        self._lock = threading.Lock()

    def __call__(self) -> float:
        """Return the time [s]."""
        with self._lock:
            now = self._read()
            self._now += min(now - self._before, _LONGEST_STEP)
            self._before = now
            return self._now


class StallWatch:
    """A process on each processor that notes when that stood still (`note_pauses.py`).

    Where the machine is a virtual one, one of its processors may stand still while the others run,
    and what ran there with it. They are processes of their own: a call that holds the interpreter's
    lock for long is the test's matter.
    """

    def __init__(self) -> None:
        self._notes, end = os.pipe()
        command = [sys.executable, "-S", "-E", Path(__file__).with_name("note_pauses.py")]
        self.processes = []
        for cpu in os.sched_getaffinity(0):
            self.processes.append(subprocess.Popen([*command, str(cpu)], stdout=end))
            os.read(self._notes, 16)  # it runs
        os.close(end)
        os.set_blocking(self._notes, False)
        atexit.register(self.close)

    def close(self) -> None:
        """End the processes."""
        for process in self.processes:
            process.kill()
            process.wait()

    def longest(self) -> float:
        """Return the longest pause since the last call [s]."""
        try:
            return max(float(line) for line in os.read(self._notes, 1 << 16).split())
        except BlockingIOError:
            return 0.0

    def wait_for_quiet(self) -> None:
        """Wait until the machine has kept time for QUIET, or PATIENCE is over."""
        for _ in range(round(PATIENCE / QUIET)):
            time.sleep(QUIET)
            if self.longest() < PAUSE:
                return


_watch: StallWatch | None = None


def _marks(item: pytest.Item) -> set[str]:
    marks = {mark.name for mark in item.iter_markers()}
    return marks | ({"real_time"} if "plc_pair" in item.fixturenames else set())


@contextmanager
def _pauses_not_counted(item: pytest.Item) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        if "ros" not in _marks(item):
            patch.setattr(time, "monotonic", RunningClock())
        yield


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Run a test in real time until a run of it counts."""
    global _watch
    if not _marks(item) & {"ros", "real_time"}:
        return None
    _watch = _watch or StallWatch()
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for run in range(RUNS):
        if run:
            _watch.wait_for_quiet()
        # a collection through all modules and tests would hold up the boards in this process
        gc.collect()
        gc.freeze()
        _watch.longest()
        with _pauses_not_counted(item):
            reports = runtestprotocol(item, log=False, nextitem=nextitem)
        failed = [report for report in reports if report.failed]
        # no pause excuses what is found after a test: processes that have not ended
        if not failed or failed[-1].when == "teardown" or (pause := _watch.longest()) < PAUSE:
            break
        item.user_properties.append((_AGAIN, pause))
    else:
        for report in failed:
            report.outcome = "skipped"
            reason = f"this machine pauses: {RUNS} runs, each with one"
            report.longrepr = (str(item.path), (item.location[1] or 0) + 1, f"Skipped: {reason}")
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name the tests that were run again, with the pauses."""
    for report in _calls(terminalreporter.stats.values()):
        for name, pause in report.user_properties:
            if name == _AGAIN:
                terminalreporter.write_line(f"{_AGAIN} of {pause:.2f} s: {report.nodeid}")


def _calls(stats: Iterable[list[object]]) -> Iterable[pytest.TestReport]:
    for reports in stats:
        for report in reports:
            if isinstance(report, pytest.TestReport) and report.when == "teardown":
                yield report
