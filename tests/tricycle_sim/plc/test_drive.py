"""The drive PLC's set-point, gear, brake, faults and limits, on both backends (conftest.py)."""

import dataclasses

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


def moving(make_bench, speed, *, gear=1):
    """Armed and at its set-point."""
    bench = make_bench(DRIVE).booted().armed()
    bench.drive(round(abs(speed) * 50) + 2, abs(speed), gear=gear)
    assert bench.output.setpoint == pytest.approx(speed)
    return bench


@pytest.mark.parametrize("sign", [1, -1])
def test_the_overspeed_is_exact_both_ways(drive, sign):
    for speed, state in ((5.28, State.ARMED), (5.281, State.FAULT)):
        drive.command()
        assert drive.tick(speed=sign * speed).state == state


@pytest.mark.parametrize(
    ("speed", "stalls"), [(0.3, False), (0.301, True), (-0.3, False), (-0.301, True)]
)
def test_a_wheel_at_rest_stalls_after_two_seconds_of_power(make_bench, speed, stalls):
    drive = moving(make_bench, speed, gear=1 if speed > 0 else 2)
    gear = drive.state.gear
    for _ in range(200):
        drive.command(abs(speed), gear=gear)
        assert drive.tick(speed=0.019).state == State.ARMED
    drive.command(abs(speed), gear=gear)
    assert drive.tick().state == (State.FAULT if stalls else State.ARMED)


@pytest.mark.parametrize("speed", [0.02, -0.02])
def test_a_wheel_that_just_moves_is_no_stall(make_bench, speed):
    drive = moving(make_bench, 1.0)
    for _ in range(250):
        drive.command(1.0)
        assert drive.tick(speed=speed).state == State.ARMED


def test_the_two_seconds_of_a_stall_begin_anew_after_a_break(make_bench):
    drive = moving(make_bench, 1.0)
    for k in range(450):
        drive.command(1.0)
        assert drive.tick(speed=0.5 if k % 150 == 0 else 0.0).state == State.ARMED


@pytest.mark.parametrize(
    ("speed", "rests"), [(0.02, False), (0.019, True), (-0.019, True), (-0.02, False)]
)
def test_stopping_ends_where_the_wheel_is_at_rest(make_bench, speed, rests):
    drive = moving(make_bench, 0.1)
    drive.command(0.1, flags=0)
    assert drive.tick(4, speed=speed).state == State.STOPPING  # the set-point is not 0 yet
    assert drive.tick(3).state == (State.SAFE if rests else State.STOPPING)
    assert drive.output.setpoint == 0.0
    assert drive.tick().setpoint == 0


@pytest.mark.parametrize(("gear", "direction"), [(1, 1), (2, -1), (0, 0)])
def test_a_gear_acts_in_the_first_tick_after_arming(drive, gear, direction):
    drive.command(1.0, gear=gear)
    state = drive.tick(torque=17.5)
    assert (state.gear, state.setpoint) == (gear, 20 * direction)
    assert drive.output.setpoint == pytest.approx(0.02 * direction)
    assert drive.output.motor_on is (gear != 0)
    assert state.pwm == (500 if gear else 0)


@pytest.mark.parametrize(
    ("speed", "changes"), [(0.02, False), (-0.02, False), (0.019, True), (-0.019, True)]
)
def test_a_gear_changes_where_the_wheel_is_at_rest(drive, speed, changes):
    drive.drive(1, 0.0, gear=1)
    drive.command(1.0, gear=2)
    state = drive.tick(speed=speed)
    assert state.gear == (2 if changes else 1)
    assert state.setpoint == (-20 if changes else 0)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_state_frame_has_the_set_point(drive, sign):
    for _ in range(200):
        drive.drive(1, 4.0, limit=0.377, gear=1 if sign > 0 else 2)
        assert abs(drive.state.setpoint - drive.output.setpoint * 1e3) <= 0.5 + 1e-6
    assert drive.state.setpoint == sign * 754


@pytest.mark.parametrize("state", [State.SAFE, State.ESTOP])
def test_a_board_that_is_not_armed_puts_nothing_out(make_bench, state):
    drive = moving(make_bench, 1.0)
    drive.control(Op.DISARM if state is State.SAFE else Op.ESTOP)
    frame = drive.tick(torque=17.5)
    assert frame.state == state
    assert (frame.setpoint, frame.pwm, frame.gear, frame.brake) == (0, 0, 0, 200)
    assert (drive.output.setpoint, drive.output.brake) == (0.0, 1.0)


@pytest.mark.parametrize(
    ("speed", "accel", "gear", "brake", "limited"),
    [
        (4800, 2000, 2, 200, False),
        (4801, 2000, 1, 0, True),
        (0, 2001, 1, 0, True),
        (0, 0, 3, 0, True),
        (0, 0, 1, 201, True),
        (-1, 0, 1, 0, True),
        (0, 0, 0, 0, False),
    ],
)
def test_a_command_at_the_limits_is_not_limited(drive, speed, accel, gear, brake, limited):
    command = m.DriveCommand(ENABLE, gear, speed, accel, brake, 0, m.echo_of(drive.now))
    drive.send(command)
    state = drive.tick()
    assert bool(state.flags & m.StateFlag.LIMITED) is limited
    assert state.faults == (Fault.LIMIT if limited else 0)
    assert state.brake == min(brake, 200)
    assert state.gear == (gear if gear < 3 else 0)
    drive.control(Op.DISARM)
    drive.send(dataclasses.replace(command, echo=m.echo_of(drive.now)))
    assert not drive.tick().flags & m.StateFlag.LIMITED


def test_the_brake_stays_as_last_commanded_while_stopping(make_bench):
    drive = moving(make_bench, 1.0)
    drive.drive(1, 1.0, brake=0.25)
    drive.drive(1, 1.0, brake=0.75, flags=0)
    assert drive.state.state == State.STOPPING
    assert drive.output.brake == 0.25
    assert drive.state.brake == 50


def test_limits_are_what_the_plc_enforces(drive):
    (limits,) = drive.send(m.LimitsRequest())
    assert limits == m.DriveLimits(0, 4800, 2000, 200, 150, 15253, 0, 0)


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
