"""The steer PLC's set-point, faults and limits, on both backends (conftest.py)."""

import math

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plc_bench import ENABLE, STANDSTILL, STEER, Fault, Op, Result, State

from tricycle_bridge.protocol import messages as m
from tricycle_sim.plc import SteerMeasurement


def test_the_steering_starts_at_the_measured_angle(make_bench):
    bench = make_bench(STEER)
    bench.tick(angle=0.3)
    bench.hello()
    bench.set_up()
    for _ in range(5):
        bench.command(0.0, limit=1.0)
        bench.tick()
    bench.control(Op.ARM)
    bench.tick()
    assert bench.output.servo_on
    assert bench.output.setpoint == pytest.approx(0.3 - 0.01)


def test_enable_zero_stops_the_steering_without_a_fault_and_it_holds_for_ten_seconds(steer):
    steer.drive(10, 0.2)
    held = steer.output.setpoint
    for _ in range(1000):
        steer.command(0.0, flags=0)
        steer.tick()
        assert steer.plc.state is State.STOPPING
        assert steer.state.flags & m.StateFlag.HOLDING
        assert steer.output.setpoint == held
        assert steer.output.servo_on
    steer.tick()
    assert (steer.state.state, steer.state.faults, steer.output.servo_on) == (State.SAFE, 0, False)
    assert not steer.state.flags & m.StateFlag.HOLDING


def leave_by_disarm(steer):
    assert steer.control(Op.DISARM) is Result.OK


def leave_by_hello(steer):
    steer.hello(session=9)


def leave_by_emergency_stop(steer):
    steer.control(Op.ESTOP)


def leave_by_fault(steer):
    steer.command()
    steer.tick(adc=0)
    steer.tick(adc=None)


LEAVE = {
    State.SAFE: leave_by_disarm,
    State.ESTOP: leave_by_emergency_stop,
    State.FAULT: leave_by_fault,
}


def held_at(make_bench, leave):
    steer = make_bench(STEER).booted().armed()
    steer.drive(30, 0.3)
    leave(steer)
    steer.tick(angle=0.1)  # as if something pushed it
    assert steer.output.servo_on
    assert (steer.state.setpoint, steer.state.servo) == (3000, 1691)
    assert steer.state.flags & m.StateFlag.HOLDING
    return steer


@pytest.mark.parametrize("leave", [*LEAVE.values(), leave_by_hello])
def test_it_holds_until_the_host_says_standstill(make_bench, leave):
    steer = held_at(make_bench, leave)
    state = steer.state.state
    for flags in (0, ENABLE):
        steer.command(-0.2, flags=flags)
        steer.tick(20)
        assert (steer.state.setpoint, steer.output.servo_on) == (3000, True)
    steer.command(flags=STANDSTILL)
    steer.tick()
    assert (steer.state.state, steer.output.servo_on, steer.state.servo) == (state, False, 0)
    assert not steer.state.flags & m.StateFlag.HOLDING
    assert steer.state.setpoint == 1000  # the measured angle


@pytest.mark.parametrize("leave", LEAVE.values())
def test_it_holds_no_longer_than_ten_seconds(make_bench, leave):
    steer = make_bench(STEER).booted().armed()
    steer.drive(30, 0.3)
    since = steer.now
    leave(steer)
    while steer.tick().servo:
        assert steer.now - since < 11_000_000
    assert steer.now - since == pytest.approx(10_000_000, abs=30_000)


def test_the_ten_seconds_begin_where_it_leaves_armed(steer):
    steer.drive(1, flags=0)
    steer.tick(500)
    assert steer.state.state == State.STOPPING
    leave_by_disarm(steer)
    steer.tick(499)
    assert steer.output.servo_on
    steer.tick(2)
    assert not steer.output.servo_on


def test_standstill_means_nothing_while_it_is_armed(steer):
    steer.drive(20, 0.2, flags=ENABLE | STANDSTILL)
    assert steer.state.state == State.ARMED
    assert steer.state.servo > 1500
    steer.drive(1, 0.2, flags=STANDSTILL)  # this one disarms, the next one lets go
    assert (steer.state.state, steer.output.servo_on) == (State.STOPPING, True)
    steer.drive(1, 0.2, flags=STANDSTILL)
    assert (steer.state.state, steer.output.servo_on) == (State.SAFE, False)


def test_a_stale_standstill_does_not_let_go(steer):
    steer.drive(20, 0.2)
    leave_by_disarm(steer)
    steer.command(flags=STANDSTILL, echo=m.echo_of(steer.now - 200_000))
    steer.tick()
    assert steer.output.servo_on


def test_it_arms_while_it_holds_and_starts_at_the_measured_angle(make_bench):
    steer = held_at(make_bench, leave_by_disarm)
    for _ in range(5):
        steer.command(0.1)
        steer.tick()
    assert steer.control(Op.ARM) is Result.OK
    steer.command(0.1)
    steer.tick()
    assert (steer.state.state, steer.state.setpoint) == (State.ARMED, 1000)
    assert not steer.state.flags & m.StateFlag.HOLDING


def test_a_reset_lets_go(make_bench):
    steer = held_at(make_bench, leave_by_disarm)
    steer.plc.reset()
    steer.tick()
    assert not steer.output.servo_on


def test_a_servo_that_is_off_has_no_pulse_and_the_measured_angle_as_set_point(bench_of_steer):
    state = bench_of_steer.tick(angle=-0.31)
    assert (state.servo, state.setpoint, state.angle) == (0, -3100, -3100)
    assert bench_of_steer.output.setpoint == pytest.approx(-0.31)


@pytest.fixture
def bench_of_steer(make_bench):
    return make_bench(STEER).booted()


@pytest.mark.parametrize("sign", [1, -1])
def test_a_state_frame_has_the_set_point_and_its_pulse(steer, sign):
    for _ in range(250):
        steer.drive(1, 0.7461 * sign, limit=0.371)
        setpoint = steer.output.setpoint
        assert abs(steer.state.setpoint - setpoint * 1e4) <= 0.5 + 1e-6
        # the firmware rounds to 1/16 us first
        assert abs(steer.state.servo - (1500 + 500 * setpoint / 0.7854)) <= 0.5 + 1 / 32
    assert (steer.state.setpoint, steer.state.servo) == (7461 * sign, 1500 + 475 * sign)


@pytest.mark.parametrize(
    ("adc", "state"), [(5, State.ARMED), (1018, State.ARMED), (4, State.FAULT), (1019, State.FAULT)]
)
def test_the_range_of_the_potentiometer_is_exact(steer, adc, state):
    steer.command()
    steer.tick(adc=adc)
    assert steer.state.state == state


def test_a_broken_potentiometer_is_a_latched_fault(steer):
    steer.command()
    steer.tick(adc=4)
    assert (steer.state.state, steer.state.faults) == (State.FAULT, Fault.SENSOR)
    steer.drive(5)
    assert steer.state.state == State.FAULT


def test_with_a_broken_potentiometer_it_is_not_armed(make_bench):
    steer = make_bench(STEER).booted()
    for counts, result in ((4, Result.PRECONDITIONS), (1019, Result.PRECONDITIONS), (5, Result.OK)):
        for _ in range(6):
            steer.command()
            steer.tick(adc=counts)
        assert steer.control(Op.ARM) == result
    steer.tick(angle=-1.2)  # as the sensor may say it
    assert steer.state.servo >= 1000


def test_a_blocked_steering_is_a_tracking_fault_after_a_second(steer):
    ticks = 0
    while steer.plc.state is State.ARMED:
        steer.command(0.5)
        steer.tick(angle=0.0)
        ticks += 1
    assert steer.state.faults == Fault.TRACKING
    assert ticks == pytest.approx(100 + 5, abs=2)  # 0.15 rad at 3 rad/s take 5 ticks


@pytest.mark.parametrize("measured", [0.0, 0.3, -0.3])
@pytest.mark.parametrize(
    ("error", "trips"), [(0.1501, True), (-0.1501, True), (0.1499, False), (-0.1499, False)]
)
def test_the_tracking_error_has_a_limit_on_both_sides(make_bench, measured, error, trips):
    steer = armed_at(make_bench, measured)
    for _ in range(7):  # until the set-point is there
        steer.command(measured + error)
        steer.tick()
    for _ in range(95):
        steer.command(measured + error)
        assert steer.tick().state == State.ARMED
    for _ in range(10):
        steer.command(measured + error)
        steer.tick()
    assert steer.state.state == (State.FAULT if trips else State.ARMED)


def armed_at(make_bench, angle, **kwargs):
    bench = make_bench(STEER, **kwargs)
    bench.tick(angle=angle)
    bench.hello()
    bench.set_up()
    for _ in range(5):
        bench.command(angle)
        bench.tick()
    assert bench.control(Op.ARM) is Result.OK
    return bench


def test_the_tracking_error_at_the_limit_is_none(steer):
    for error in (0.15, -0.15):
        for _ in range(200):
            steer.command(error)
            steer.tick()
        assert steer.state.setpoint == round(error * 1e4)
        assert steer.state.state == State.ARMED


def test_the_second_of_a_tracking_fault_begins_anew_after_a_break(make_bench):
    steer = armed_at(make_bench, 0.0, start_us=5_000_000)
    for _ in range(3):
        for k in range(101):  # off from the first, so 1 s has passed at the last
            assert steer.plc.state is State.ARMED
            steer.command()
            steer.tick(angle=0.2 if k < 100 else 0.0)
    for _ in range(101):
        assert steer.plc.state is State.ARMED
        steer.command()
        steer.tick(angle=-0.2)
    assert steer.state.faults == Fault.TRACKING


def test_a_tracking_error_of_an_earlier_arming_is_forgotten(steer):
    for _ in range(50):
        steer.command()
        steer.tick(angle=0.2)
    assert steer.control(Op.DISARM) is Result.OK
    for _ in range(100):
        steer.command(0.2)
        steer.tick(angle=0.2)
    assert steer.control(Op.ARM) is Result.OK
    steer.command(0.2)
    steer.tick(angle=0.0)
    assert steer.state.state == State.ARMED


@pytest.mark.parametrize(
    ("angle", "rate", "limited"),
    [
        (0.7461, 3.0, False),
        (0.7462, 3.0, True),
        (0.7461, 3.001, True),
        (-0.7461, 0.0, False),
        (-0.7462, 0.0, True),
    ],
)
def test_a_command_at_the_limits_is_not_limited(steer, angle, rate, limited):
    steer.drive(100, angle, limit=rate)
    assert bool(steer.state.flags & m.StateFlag.LIMITED) is limited
    assert steer.output.setpoint == pytest.approx(math.copysign(0.7461, angle))


def test_limits_are_what_the_plc_enforces(bench_of_steer):
    (limits,) = bench_of_steer.send(m.LimitsRequest())
    assert limits == m.SteerLimits(7461, 3000, 0, 0, 200, 150, 7854, 435)


def test_commands_outside_the_limits_are_limited_and_reported_while_it_lasts(steer):
    steer.drive(100, 3.0, limit=60.0)
    assert steer.output.setpoint == pytest.approx(0.7461)
    assert steer.state.faults == Fault.LIMIT
    assert steer.state.flags & m.StateFlag.LIMITED
    steer.drive(1, 0.5)
    assert steer.state.faults == 0
    for angle, rate, flag in ((3.0, 1.0, True), (0.5, 60.0, True), (0.5, 1.0, False)):
        steer.drive(1, angle, limit=rate)
        assert bool(steer.state.flags & m.StateFlag.LIMITED) is flag


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.tuples(st.integers(-32768, 32767), st.integers(0, 65535)), min_size=1, max_size=30)
)
def test_the_steering_setpoint_is_never_faster_nor_further_than_its_limits(make_bench, commands):
    bench = make_bench(STEER).booted().armed()
    last = bench.tick().setpoint * 1e-4
    for angle, rate in commands:
        bench.send(m.SteerCommand(ENABLE, 0, angle, rate, m.echo_of(bench.now)))
        bench.tick()
        allowed = min(rate * 1e-3 or 3.0, 3.0) * 0.01
        assert abs(bench.output.setpoint - last) <= allowed + 1e-12
        assert abs(bench.output.setpoint) <= 0.7461 + 1e-12
        last = bench.output.setpoint
        bench.measurement = SteerMeasurement(last)
