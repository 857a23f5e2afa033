"""Both PLCs on two backends: the emulation in Python and the firmware's own C logic."""

import pytest
from plc_bench import DRIVE, STEER, Bench, State

from tricycle_sim.plc import DrivePlc, SteerPlc
from tricycle_sim.plc.firmware import FirmwareDrivePlc, FirmwareSteerPlc


@pytest.fixture(params=["emulated", "firmware"])
def make_plc(request):
    """Makes the PLC of a board on one of the backends."""
    if request.param == "emulated":
        return lambda board, **kwargs: {STEER: SteerPlc, DRIVE: DrivePlc}[board](**kwargs)
    build = request.getfixturevalue("firmware_libraries")
    classes = {STEER: FirmwareSteerPlc, DRIVE: FirmwareDrivePlc}
    return lambda board, **kwargs: classes[board](build / f"lib{board.name.lower()}.so", **kwargs)


@pytest.fixture
def make_bench(make_plc):
    """Makes a bench with the PLC of a board, as it is before its first tick."""

    def make(board, *, start_us=0, **kwargs):
        return Bench(make_plc(board, **kwargs), start_us=start_us)

    return make


@pytest.fixture(params=[STEER, DRIVE], ids=["steer", "drive"])
def bench(request, make_bench):
    return make_bench(request.param).booted()


@pytest.fixture
def armed(bench):
    bench.armed().drive(1)
    assert bench.state.state == State.ARMED
    return bench


@pytest.fixture
def steer(make_bench):
    return make_bench(STEER).booted().armed()


@pytest.fixture
def drive(make_bench):
    return make_bench(DRIVE).booted().armed()
