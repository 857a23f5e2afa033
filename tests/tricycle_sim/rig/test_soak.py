"""A few of the drives that the soak drives by the thousand, and the stops that it relies on."""

import subprocess
import sys
from pathlib import Path

import pytest

from tricycle_core.stopping import BRAKED, RAMPED, Cause, stopping_distance

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"


def run(script, *arguments):
    return subprocess.run(
        [sys.executable, BENCHMARKS / script, "--jobs", "1", *map(str, arguments)],
        capture_output=True,
        text=True,
    )


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["emulation", "native"])
@pytest.mark.parametrize("more", [[], ["--healthy"]])
def test_random_drives_end_at_rest(backend, more, firmware_libraries):
    arguments = ["--backend", backend, "--build", firmware_libraries, "--drives", 6, *more]
    done = run("fault_soak.py", *arguments)
    assert "6 drives" in done.stdout, done.stderr
    assert done.returncode == 0, done.stdout


@pytest.mark.slow
def test_stops_are_as_short_as_is_published(firmware_libraries):
    done = run("stopping.py", "--backends", "native", "--build", firmware_libraries, "--speeds", 1)
    assert "| e-stop | 1 |" in done.stdout, done.stderr
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("script", "option"),
    [("stopping.py", "--backends"), ("detection.py", "--backend"), ("fault_soak.py", "--backend")],
)
def test_firmware_that_is_not_built_is_told_in_a_line(script, option, tmp_path):
    done = run(script, option, "native", "--build", tmp_path)
    assert done.returncode == 2
    assert "libsteer.so does not exist: build it with" in done.stderr.splitlines()[-1]


def test_distances_grow_with_the_speed():
    for law in (BRAKED, RAMPED):
        assert 0.0 < law.distance(0.0) < law.distance(1.0) < 0.5 * law.distance(2.0)
    for cause in Cause:
        assert stopping_distance(cause, 2.0) > stopping_distance(cause, 1.0)
