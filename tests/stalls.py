"""Tests in real time, run again where the machine stood still under them.

The boards stop a vehicle whose commands pause for 200 ms, and refuse commands whose echo is older
than 150 ms. Where this process gets no processor for so long, a test against the wall clock fails
although nothing is wrong; such a run says nothing, and its test gets another one. A failure without
a measured pause stays a failure, and the summary names every test that was run again.
"""

import threading
import time
from collections.abc import Iterable

import pytest
from _pytest.runner import runtestprotocol

PAUSE = 0.1  # s
RUNS = 3  # of one test, at most
_PERIOD = 0.01  # s
_AGAIN = "run again after a pause"  # user property of a report: the pause in s


class StallWatch:
    """The longest time for which a thread of this process that wants to run did not.

    Attributes
    ----------
    longest : float
        The longest pause since it was last set to zero [s].
    """

    def __init__(self) -> None:
        self.longest = 0.0
        threading.Thread(target=self._run, daemon=True, name="stall watch").start()

    def _run(self) -> None:
        before = time.monotonic()
        while True:
            time.sleep(_PERIOD)
            now = time.monotonic()
            self.longest = max(self.longest, now - before - _PERIOD)
            before = now


_watch: StallWatch | None = None


def _in_real_time(item: pytest.Item) -> bool:
    marks = {mark.name for mark in item.iter_markers()}
    return bool(marks & {"ros", "real_time"}) or "plc_pair" in item.fixturenames


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Run a test in real time until a run of it counts."""
    global _watch
    if not _in_real_time(item):
        return None
    _watch = _watch or StallWatch()
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for run in range(RUNS):
        _watch.longest = 0.0
        reports = runtestprotocol(item, log=False, nextitem=nextitem)
        if run + 1 == RUNS or _watch.longest < PAUSE or not any(r.failed for r in reports):
            break
        item.user_properties.append((_AGAIN, _watch.longest))
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
