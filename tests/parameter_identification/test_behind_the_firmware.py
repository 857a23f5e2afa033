"""A vehicle behind the firmware's own logic, which is no part of the model."""

from importlib import import_module
from pathlib import Path

import pytest

from parameter_identification.identification import EFFECTS, identify

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return import_module("firmware_world")


@pytest.mark.slow
def test_what_is_shown_holds_and_the_start_is_told(benchmark, firmware_libraries):
    drives = benchmark.native_drives_of(1, firmware_libraries)
    found = identify(drives, benchmark.VEHICLE, effects=EFFECTS, weighed=True)
    assert {e.name for e in found.deviations} == {"start deviation"}
    for name in ("cornering_stiffness", "yaw_inertia"):
        estimate = found.parameters[name]
        assert estimate.identifiable
        assert estimate.low <= drives[0].truth[name] <= estimate.high
