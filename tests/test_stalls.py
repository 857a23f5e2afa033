"""What is run again: a failed test in real time, after a pause; what a pause is to its clock."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import stalls

CONFTEST = """
import stalls
from stalls import pytest_runtest_protocol, pytest_terminal_summary

class Watch:
    noted = 0.0

    def longest(self):
        found, Watch.noted = Watch.noted, 0.0
        return found

    def wait_for_quiet(self):
        pass

stalls.StallWatch = Watch
"""
TESTS = '''
import ctypes, time
from pathlib import Path
import pytest, stalls

@pytest.fixture
def plc_pair():
    yield "fresh"

def runs(name):
    """How often a test has been run, with this time."""
    path = Path(name)
    path.write_text(path.read_text() + "x" if path.exists() else "x")
    return len(path.read_text())

def hold():
    ctypes.PyDLL(None).usleep(300_000)  # holds the interpreter's lock: no other thread runs

def pause():
    hold()
    type(stalls._watch).noted = 0.3

def test_paused_once(plc_pair):
    if runs("paused_once") == 1:
        pause()
        raise AssertionError("not this time")

def test_paused_always(plc_pair):
    runs("paused_always")
    pause()
    raise AssertionError("never")

def test_failed_without_a_pause(plc_pair):
    runs("no_pause")
    hold()
    raise AssertionError("a race, or a call that keeps the interpreter for itself")

@pytest.fixture
def left_behind():
    yield
    raise AssertionError("a process has not ended")

def test_leaves_something(plc_pair, left_behind):
    runs("left_something")
    pause()
    raise AssertionError("which explains why")

def test_passed_with_a_pause(plc_pair):
    runs("passed")
    pause()

def test_its_clock_does_not_count_a_pause(plc_pair):
    runs("own_clock")
    begun = time.monotonic()
    pause()
    assert time.monotonic() - begun < 0.1

@pytest.mark.ros
def test_the_clock_of_others_counts_a_pause():
    runs("others_clock")
    begun = time.monotonic()
    pause()
    assert time.monotonic() - begun >= 0.3

def test_not_in_real_time():
    runs("no_real_time")
    hold()
    raise AssertionError("wrong")
'''


@pytest.mark.slow
def test_only_a_failure_after_a_pause_in_real_time_is_run_again(tmp_path):
    (tmp_path / "conftest.py").write_text(CONFTEST)
    (tmp_path / "test_it.py").write_text(TESTS)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--rootdir={tmp_path}",
         "-o", f"pythonpath={Path(__file__).parent}", "-o", "markers=ros", "test_it.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )  # fmt: skip
    assert "3 failed, 4 passed, 1 skipped, 1 error" in done.stdout, done.stdout + done.stderr
    runs = {p.name: len(p.read_text()) for p in tmp_path.iterdir() if not p.suffix and p.is_file()}
    assert runs == {
        "paused_once": 2, "paused_always": 4, "no_pause": 1, "passed": 1, "no_real_time": 1,
        "own_clock": 1, "others_clock": 1, "left_something": 1,
    }  # fmt: skip
    again = [line for line in done.stdout.splitlines() if line.startswith("run again")]
    assert len(again) == 4
    assert sum("::test_paused_once" in line for line in again) == 1


def test_a_processor_that_stands_still_is_noted():
    watch = stalls.StallWatch()
    try:
        for process in watch.processes:
            watch.longest()
            process.send_signal(signal.SIGSTOP)
            time.sleep(0.3)
            process.send_signal(signal.SIGCONT)
            deadline, noted = time.monotonic() + 10.0, 0.0
            while noted < 0.25:
                assert time.monotonic() < deadline
                noted = watch.longest()
                time.sleep(0.01)
    finally:
        watch.close()
