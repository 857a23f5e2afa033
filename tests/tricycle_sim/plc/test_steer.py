"""The steer PLC's set-point, faults and limits, on both backends (conftest.py)."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plc_bench import ENABLE, STEER, Fault, Op, State

from tricycle_bridge.protocol import messages as m
from tricycle_sim.plc import SteerMeasurement


def test_the_steering_starts_at_the_measured_angle(make_bench):
    bench = make_bench(STEER)
    bench.tick(angle=0.3)
    bench.hello()
    for _ in range(5):
        bench.command(0.0, limit=1.0)
        bench.tick()
    bench.control(Op.ARM)
    bench.tick()
    assert bench.output.servo_on
    assert bench.output.setpoint == pytest.approx(0.3 - 0.01)


def test_enable_zero_stops_the_steering_for_a_second_without_a_fault(steer):
    steer.drive(10, 0.2)
    held = steer.output.setpoint
    for _ in range(100):
        steer.command(0.0, flags=0)
        steer.tick()
        assert steer.plc.state is State.STOPPING
        assert steer.output.setpoint == held
        assert steer.output.servo_on
    steer.tick(2)
    assert (steer.state.state, steer.state.faults, steer.output.servo_on) == (State.SAFE, 0, False)


def test_a_broken_potentiometer_is_a_latched_fault(steer):
    steer.command()
    steer.tick(adc=4)
    assert (steer.state.state, steer.state.faults) == (State.FAULT, Fault.SENSOR)
    steer.drive(5)
    assert steer.state.state == State.FAULT


def test_a_blocked_steering_is_a_tracking_fault_after_a_second(steer):
    ticks = 0
    while steer.plc.state is State.ARMED:
        steer.command(0.5)
        steer.tick(angle=0.0)
        ticks += 1
    assert steer.state.faults == Fault.TRACKING
    assert ticks == pytest.approx(100 + 5, abs=2)  # 0.15 rad at 3 rad/s take 5 ticks


def test_commands_outside_the_limits_are_limited_and_reported_while_it_lasts(steer):
    steer.drive(100, 3.0, limit=60.0)
    assert steer.output.setpoint == pytest.approx(0.7854)
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
        assert abs(bench.output.setpoint) <= 0.7854
        last = bench.output.setpoint
        bench.measurement = SteerMeasurement(last)
