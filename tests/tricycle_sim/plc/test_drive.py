"""The drive PLC's set-point, gear, brake, faults and limits, on both backends (conftest.py)."""

import pytest
from plc_bench import DRIVE, ENABLE, Fault, Op, Result, State

from tricycle_bridge.protocol import messages as m


def test_the_drive_arms_only_at_commanded_speed_zero(make_bench):
    bench = make_bench(DRIVE).booted()
    bench.drive(5, 0.5)
    assert bench.control(Op.ARM) is Result.PRECONDITIONS


def test_stopping_ramps_the_drive_to_rest_then_brakes(drive):
    drive.drive(300, 2.0)
    assert drive.output.setpoint == 2.0
    speeds = []
    while drive.plc.state in (State.ARMED, State.STOPPING):
        drive.drive(1, 2.0, flags=0)
        speeds.append(drive.output.setpoint)
    assert speeds[0] == pytest.approx(2.0 - 0.02)
    assert len(speeds) == pytest.approx(100, abs=2)
    assert (drive.output.motor_on, drive.output.brake) == (False, 1.0)
    assert drive.state.faults == 0


def test_a_blocked_wheel_is_a_stall_and_a_fast_one_an_overspeed(drive, make_bench):
    while drive.plc.state is State.ARMED:
        drive.command(1.0)
        drive.tick(speed=0.0)
    assert drive.state.faults == Fault.STALL
    fast = make_bench(DRIVE).booted().armed()
    fast.command(1.0)
    fast.tick(speed=5.5)
    assert (fast.state.state, fast.state.faults) == (State.FAULT, Fault.OVERSPEED)


def test_drive_commands_are_limited_never_wrapped(drive):
    drive.drive(300, 32.767, limit=65.0)
    assert drive.output.setpoint == pytest.approx(4.8)
    drive.command(0.0)
    drive.send(m.DriveCommand(ENABLE, 1, -30000, 0, 255, 0, m.echo_of(drive.now)))
    drive.tick()
    assert drive.output.brake == 1.0
    drive.drive(300, 0.0)
    assert drive.output.setpoint == 0.0
    for speed, limit, flag in ((32.0, 1.0, True), (0.5, 65.0, True), (0.5, 1.0, False)):
        drive.drive(1, speed, limit=limit)
        assert bool(drive.state.flags & m.StateFlag.LIMITED) is flag


def test_the_gear_changes_only_at_rest(drive):
    drive.drive(100, 1.0, limit=1.0, gear=1)
    assert drive.output.setpoint == pytest.approx(1.0)
    seen = []
    for _ in range(300):
        drive.drive(1, 0.5, limit=1.0, gear=2)
        seen.append((drive.state.gear, drive.output.setpoint))
    assert all(setpoint >= 0 for gear, setpoint in seen if gear == 1)
    assert all(setpoint <= 0 for gear, setpoint in seen if gear == 2)
    assert seen[-1] == (2, -0.5)
