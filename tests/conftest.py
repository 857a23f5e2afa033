"""Hypothesis as all tests use it; the firmware, compiled once per run for those that need it."""

import dataclasses
import itertools
import os
import shutil
import signal
import subprocess
from pathlib import Path

import pytest
from hypothesis import settings
from stalls import pytest_runtest_protocol, pytest_terminal_summary

from tricycle_sim.vehicle import Vehicle, load_vehicle

__all__ = ["pytest_runtest_protocol", "pytest_terminal_summary"]  # hooks

# The same examples in every run; HYPOTHESIS_PROFILE=search looks at others.
settings.register_profile("same", derandomize=True, deadline=None)
settings.register_profile("search", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))

# A shell starts what it runs in the background with SIGINT ignored, nohup with SIGHUP; what a test
# starts would ignore them, too.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

FIRMWARE = Path(__file__).parents[1] / "firmware"


@pytest.hookimpl(trylast=True)  # of the tests that are left
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin both halves, which two processes are given to begin with, with the slow tests.

    A process that has run its half takes tests from the end of the other's: quick ones then, so
    that both end at the same time. The tests of a file stay together, as they share fixtures.
    """
    halves: tuple[list[pytest.Item], ...] = ([], [])
    for slow in (True, False):
        chosen = [item for item in items if (item.get_closest_marker("slow") is not None) is slow]
        for number, (_, tests) in enumerate(itertools.groupby(chosen, lambda item: item.path)):
            halves[number % 2].extend(tests)
    if "PYTEST_XDIST_WORKER" in os.environ:
        items[:] = halves[0] + halves[1]


@pytest.fixture
def install_distribution(tmp_path, monkeypatch):
    """Install a distribution of one module and its entry points of one group."""

    def install(group, distribution, module, source, entries):
        (tmp_path / f"{module}.py").write_text(source)
        folder = tmp_path / f"{distribution}-1.0.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\n")
        lines = [f"{name} = {value}" for name, value in entries.items()]
        (folder / "entry_points.txt").write_text("\n".join([f"[{group}]", *lines]))
        monkeypatch.syspath_prepend(str(tmp_path))

    return install


@pytest.fixture(scope="session")
def without_speed_loop() -> Vehicle:
    """The tricycle with a motor whose set-point is a torque."""
    vehicle = load_vehicle()
    constants = {n: v for n, v in vehicle.values.items() if not n.startswith("speed_")}
    return dataclasses.replace(
        vehicle, parts={"motor": "direct_torque"}, values=constants | {"setpoint_torque": 5.0}
    )


@pytest.fixture(scope="session")
def firmware_libraries(tmp_path_factory) -> Path:
    """The C logic as libraries of this machine; FIRMWARE_LIBRARIES names others (mutation.py)."""
    if others := os.environ.get("FIRMWARE_LIBRARIES"):
        return Path(others)
    if shutil.which("cc") is None:
        pytest.skip("no C compiler: the firmware's logic is not tested here")
    build = tmp_path_factory.mktemp("firmware")
    subprocess.run(["make", "-s", "-C", FIRMWARE, "host", f"BUILD={build}"], check=True)
    return build


@pytest.fixture(scope="session")
def firmware_images(tmp_path_factory) -> Path:
    """What is flashed, and the simulated UNO that runs it."""
    if shutil.which("avr-gcc") is None or not Path("/usr/include/simavr").exists():
        pytest.skip("no gcc-avr, avr-libc or libsimavr-dev: the firmware is not run here")
    build = tmp_path_factory.mktemp("avr")
    command = ["make", "-s", "-C", FIRMWARE, "avr", "simulator", f"BUILD={build}"]
    subprocess.run(command, check=True, capture_output=True)
    return build
