"""The drive PLC's set-point, gear, brake, faults and limits, on both backends (conftest.py)."""

import itertools
import math

import numpy as np
import pytest
from plc_bench import (
    DRIVE,
    ENABLE,
    HALL_SENSORS,
    MASS,
    Fault,
    Op,
    Result,
    SpeedController,
    State,
    Wheel,
)

from tricycle_bridge.protocol import messages as m
from tricycle_bridge.protocol.boards import HALL_PULSE, TYRE_RADIUS


def test_the_drive_arms_only_at_commanded_speed_zero(make_bench):
    bench = make_bench(DRIVE).booted()
    bench.drive(5, 0.5)
    assert bench.control(Op.ARM) is Result.PRECONDITIONS


@pytest.mark.parametrize(
    ("speed", "result"),
    [
        (0.099, Result.OK),
        (-0.099, Result.OK),
        (0.1, Result.PRECONDITIONS),
        (-0.1, Result.PRECONDITIONS),
    ],
)
def test_a_vehicle_that_rolls_is_not_armed(make_bench, speed, result):
    bench = make_bench(DRIVE).booted()
    for _ in range(5):
        bench.command()
        bench.tick(speed=speed)
    assert bench.control(Op.ARM) is result
    bench.tick()
    if result is not Result.OK:
        assert (bench.state.state, bench.output.brake) == (State.SAFE, 1.0)


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


def moving(make_bench, speed, *, gear=1):
    """Armed and at its set-point."""
    bench = make_bench(DRIVE).booted().armed()
    bench.drive(round(abs(speed) * 50) + 2, abs(speed), gear=gear)
    assert bench.output.setpoint == pytest.approx(speed)
    return bench


@pytest.mark.parametrize("sign", [1, -1])
def test_the_overspeed_is_exact_both_ways(make_bench, sign):
    drive = moving(make_bench, sign, gear=1 if sign == 1 else 2)
    drive.command(1.0, flags=0)
    for speed, state in ((5.28, State.STOPPING), (5.281, State.FAULT)):
        assert drive.tick(speed=sign * speed).state == state
    assert drive.state.faults == Fault.OVERSPEED


def test_the_overspeed_is_that_of_the_vehicle_s_largest_speed(make_bench):
    drive = make_bench(DRIVE).booted(max_speed=2000).armed()
    drive.drive(30, 0.5)
    drive.command(0.5, flags=0)
    for speed, state in ((2.48, State.STOPPING), (2.481, State.FAULT)):
        assert drive.tick(speed=speed).state == state


@pytest.mark.parametrize("gear", [1, 2])
def test_an_armed_drive_may_not_gain_while_its_motor_brakes(make_bench, gear):
    sign = 1 if gear == 1 else -1
    drive = moving(make_bench, sign * 1.0, gear=gear)
    drive.drive(250, 1.0, gear=gear)
    for speed, torque, state in (
        *((1.0 + 0.005 * tick, 1.0, State.ARMED) for tick in range(60)),  # as downhill on 5 %
        (1.3, 1.0, State.ARMED),  # pushed so far: the ceiling is 1.2 m/s
        (1.42, -1.0, State.ARMED),
        (1.421, -1.0, State.FAULT),
    ):
        drive.command(1.0, gear=gear)
        # pulses that fit: whether they do is not the question here
        drive.distance += sign * speed * 0.01
        pulses = math.floor(drive.distance / HALL_PULSE)
        assert (
            drive.tick(speed=sign * speed, torque=sign * torque, hall_count=pulses).state == state
        )
    assert drive.state.faults == Fault.OVERSPEED


def test_an_armed_drive_that_slows_down_less_than_its_set_point_is_no_fault(make_bench):
    drive = make_bench(DRIVE).booted().armed()
    vehicle = Slope(drive, slope=0.3, mass=95.0)
    vehicle.run(6.0, 2.0)
    state = vehicle.run(2.0, 0.5)
    assert (state.state, state.setpoint) == (State.ARMED, 500)
    assert vehicle.speed > 1.5
    vehicle.slope = 0.9  # steeper than the motor holds
    state = vehicle.run(3.0, 0.5)
    assert (state.state, state.faults) == (State.FAULT, Fault.OVERSPEED)
    assert vehicle.fastest < 2.3


@pytest.mark.parametrize("gear", [1, 2])
def test_a_vehicle_whose_motor_does_not_hold_it_is_stopped(make_bench, gear):
    drive = make_bench(DRIVE).booted().armed()
    sign = 1 if gear == 1 else -1
    vehicle = Slope(drive, slope=0.45 * sign, mass=60.0)
    vehicle.controller.torque = lambda output, speed, *, reverse: 0.0  # its wire is broken
    state = vehicle.run(6.0, 0.5, gear=gear)
    assert (state.state, drive.output.brake) == (State.FAULT, 1.0)
    assert vehicle.fastest < 0.9


@pytest.mark.parametrize("slope", [0.2, 0.45])
def test_a_motor_that_dies_as_the_set_point_is_reached_gains_less_than_half_a_metre_per_second(
    drive, slope
):
    vehicle = Slope(drive, slope=slope, mass=42.0)
    assert vehicle.run(2.3, 4.8).state == State.ARMED  # it arrives with 2 m/s^2
    vehicle.controller.torque = lambda output, speed, *, reverse: 0.0  # its wire breaks
    state = vehicle.run(10.0, 4.8)
    assert (state.state, drive.output.brake) == (State.FAULT, 1.0)
    assert vehicle.fastest < 5.3


@pytest.mark.parametrize("gear", [1, 2])
def test_a_set_point_that_rises_to_meet_a_vehicle_above_it_is_no_fault(drive, gear):
    vehicle = Slope(drive, slope=0.45 if gear == 1 else -0.45)
    for target in (4.8, 0.0, 4.8):
        state = vehicle.run(5.0, target, gear=gear)
        assert (state.state, state.faults) == (State.ARMED, 0)


# ---- the hall sensor's lines ----


@pytest.mark.parametrize("line", ["hall_line", "direction_line"])
@pytest.mark.parametrize(
    ("volts", "whole"),
    [
        (0.0, False),
        (0.49, False),
        (0.51, True),
        (1.49, True),
        (1.51, False),
        (2.5, False),
        (3.49, False),
        (3.51, True),
        (4.49, True),
        (4.51, False),
        (5.0, False),
    ],
)
def test_a_line_outside_of_its_bands_for_three_ticks_is_a_fault(make_bench, line, volts, whole):
    drive = make_bench(DRIVE).booted()
    drive.tick(2, **{line: volts})
    assert drive.state.faults == 0
    drive.tick(1, **{line: 1.0})
    drive.tick(2, **{line: volts})
    assert drive.state.faults == 0
    drive.tick()
    assert (drive.state.state, drive.state.faults) == (
        State.SAFE,
        0 if whole else Fault.HALL_LINE,
    )


@pytest.mark.parametrize("gear", [1, 2])
@pytest.mark.parametrize(("speed", "begins"), [(0.4, 0.4), (1.1, 1.0), (-0.1, 0.0)])
def test_a_stop_begins_at_the_speed_of_a_vehicle_that_was_slower(make_bench, gear, speed, begins):
    sign = 1 if gear == 1 else -1
    drive = moving(make_bench, sign * 1.0, gear=gear)
    for now in np.linspace(1.0, speed, 100):
        drive.command(1.0, gear=gear)
        drive.roll(1, sign * now)
    drive.command(1.0, gear=gear, flags=0)
    drive.roll(1, sign * speed)
    assert drive.state.state == State.STOPPING
    assert drive.output.setpoint == pytest.approx(sign * max(begins - 0.02, 0.0))


def test_the_brake_joins_a_stop_whose_ramp_is_over(make_bench):
    drive = moving(make_bench, 0.1)
    drive.command(0.1, flags=0)
    drive.roll(4, 0.1)
    assert (drive.state.state, drive.output.brake) == (State.STOPPING, 0.0)
    drive.roll(20, 0.1)
    assert (drive.state.state, drive.output.brake) == (State.STOPPING, pytest.approx(1.0))


def test_an_overspeed_is_found_while_stopping_too(make_bench):
    drive = moving(make_bench, 1.0)
    drive.command(1.0, flags=0)
    drive.tick()
    assert drive.state.state == State.STOPPING
    drive.tick(speed=5.3)
    assert (drive.state.state, drive.state.faults) == (State.FAULT, Fault.OVERSPEED)
    assert (drive.output.motor_on, drive.output.brake) == (False, 1.0)


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
    assert state.brake == (min(brake, 200) if speed > 0 and gear else 200)  # held at rest
    assert state.gear == (gear if gear < 3 else 0)


def test_the_brake_stays_as_last_commanded_while_stopping(make_bench):
    drive = moving(make_bench, 1.0)
    drive.drive(1, 1.0, brake=0.25)
    drive.drive(1, 1.0, brake=0.75, flags=0)
    assert drive.state.state == State.STOPPING
    assert drive.output.brake == 0.25
    assert drive.state.brake == 50


def test_stopping_brakes_ever_harder_where_the_wheel_is_faster_than_its_set_point(make_bench):
    drive = moving(make_bench, 1.0)
    drive.command(1.0, flags=0)
    drive.roll(10, 0.99)
    assert (drive.state.setpoint, drive.state.brake) == (800, 0)
    brakes = [drive.roll(1, 0.99).brake for _ in range(25)]
    assert brakes == [min(10 * k, 200) for k in range(1, 26)]
    assert drive.output.motor_on
    drive.tick(10, speed=0.1)
    assert (drive.state.state, drive.state.brake) == (State.STOPPING, 200)  # it never falls
    drive.tick(50, speed=0.0)
    assert drive.state.state == State.SAFE


def test_stopping_brakes_only_as_long_as_it_is_too_fast(make_bench):
    drive = moving(make_bench, 1.0)
    drive.drive(1, 1.0, flags=0)
    speed = drive.output.setpoint + 0.25
    assert drive.roll(1, speed).brake == 10
    for _ in range(20):
        drive.roll(1, drive.output.setpoint + 0.1)
        assert drive.state.brake == 10


def test_stopping_gives_up_after_eight_seconds(make_bench):
    drive = moving(make_bench, 1.0)
    drive.command(1.0, flags=0)
    ticks = 0
    while drive.roll(1, 1.0).state == State.STOPPING:
        ticks += 1
    assert ticks == 800
    assert (drive.state.state, drive.state.faults) == (State.FAULT, Fault.STOP_TIMEOUT)
    assert (drive.output.motor_on, drive.output.brake) == (False, 1.0)


# ---- at rest ----


def test_an_armed_vehicle_at_rest_is_held_by_its_brake(drive):
    drive.drive(3, 0.0)
    assert (drive.output.motor_on, drive.output.brake, drive.state.gear) == (False, 1.0, 1)
    assert drive.state.flags & m.StateFlag.HOLDING
    drive.drive(1, 0.5)
    assert (drive.output.motor_on, drive.output.brake) == (True, 0.0)
    assert not drive.state.flags & m.StateFlag.HOLDING
    drive.drive(1, 0.0)
    assert drive.state.setpoint == 0
    while drive.state.speed >= 20:
        assert drive.output.brake == 0.0
        drive.drive(1, 0.0)
    drive.drive(1, 0.0)
    assert (drive.output.motor_on, drive.output.brake) == (False, 1.0)


def test_a_held_wheel_that_slips_stays_held_until_the_target_is_not_zero(drive):
    drive.drive(3, 0.0)
    for _ in range(20):
        drive.command(0.0)
        drive.tick(speed=-0.06)
    assert (drive.output.motor_on, drive.output.brake) == (False, 1.0)
    drive.command(0.2)
    drive.tick()
    assert (drive.output.motor_on, drive.output.brake) == (True, 0.0)


def test_a_rolling_wheel_in_neutral_is_held_when_it_rests(drive):
    drive.command(0.0, gear=0)
    drive.tick(speed=0.05)
    assert (drive.output.motor_on, drive.output.brake) == (False, 0.0)
    drive.command(0.0, gear=0)
    drive.tick(speed=0.019)
    assert (drive.output.motor_on, drive.output.brake) == (False, 1.0)


# ---- does the wheel turn as it should? ----


class Slope(Wheel):
    """A wheel behind a drive PLC and a speed controller."""

    def __init__(self, bench, **kwargs):
        super().__init__(**kwargs)
        self.bench = bench
        self.controller = SpeedController()

    def run(self, seconds, value, *, gear=1, flags=ENABLE, brake=0.0, limit=0.0):
        """Ticks until the drive PLC neither drives nor stops; its state then."""
        torque = self.bench.measurement.torque
        for _ in range(round(100 * seconds)):
            self.bench.command(value, gear=gear, flags=flags, brake=brake, limit=limit)
            state = self.bench.tick(speed=self.sensed_speed, hall_count=self.count, torque=torque)
            if state.state not in (State.ARMED, State.STOPPING):
                break
            reverse = state.gear == m.Gear.REVERSE
            torque = self.controller.torque(self.bench.output, self.sensed_speed, reverse=reverse)
            self.move(0.01, torque, self.bench.output.brake)
        return state


@pytest.fixture
def weighed(make_bench):
    """Armed, with the vehicle's mass known by 10 %."""
    return make_bench(DRIVE).booted(mass_low=round(9 * MASS), mass_high=round(11 * MASS)).armed()


@pytest.mark.parametrize("slope", [-0.5, 0.5])
@pytest.mark.parametrize("value", [0.25, 1.0, 4.8])
@pytest.mark.parametrize(
    ("sensor", "gear"),
    [
        ("no pulses", 1),
        ("no pulses", 2),
        ("direction reads forward", 2),
        ("direction reads backward", 1),
    ],
)
def test_a_stuck_hall_sensor_is_found(weighed, sensor, gear, value, slope):
    vehicle = Slope(weighed, sensed=HALL_SENSORS[sensor], slope=slope)
    state = vehicle.run(6.0, value, gear=gear)
    assert (state.state, state.faults) == (State.FAULT, Fault.PULSES)
    assert (weighed.output.motor_on, weighed.output.brake) == (False, 1.0)
    assert vehicle.fastest < 1.4


@pytest.mark.parametrize("value", [0.25, 1.0, 3.0])
def test_a_sensor_that_sticks_on_the_way_is_found(weighed, value):
    vehicle = Slope(weighed)
    assert vehicle.run(4.0, value).state == State.ARMED
    at = vehicle.travel
    vehicle.sensed = lambda travel: min(travel, at)
    state = vehicle.run(6.0, value)
    assert (state.state, state.faults) == (State.FAULT, Fault.PULSES)
    assert vehicle.fastest < value + 0.7


@pytest.mark.parametrize(
    ("gear", "value", "slope", "mass"),
    [(1, 0.25, -0.5, 95.0), (1, 2.0, 0.5, 42.0), (2, 1.0, 0.0, 60.0), (2, 0.25, 0.5, 95.0)],
)
def test_a_healthy_wheel_is_no_fault(drive, gear, value, slope, mass):
    vehicle = Slope(drive, slope=slope, mass=mass)
    for target in (value, 0.0, value):
        state = vehicle.run(2.5, target, gear=gear)
        assert (state.state, state.faults) == (State.ARMED, 0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gear", "mass", "slope"),
    [
        (gear, mass, slope)
        for gear, mass, slope in itertools.product(
            [1, 2], [42.0, 88.0, 95.0], [-0.5, -0.35, 0.0, 0.35, 0.5]
        )
        # more braking than the motor has, or close to it: the test below. 88 kg at the tread, with
        # 30 kg of load and the wheels' inertia, of which 78 kg weigh, have 0.43 m/s^2 on 5 %, of
        # which the tyres' rolling resistance takes 0.09
        if mass * (slope if gear == 1 else -slope) * TYRE_RADIUS < 14.0
    ],
)
@pytest.mark.parametrize("value", [0.25, 0.6, 1.0, 2.0, 4.0])
def test_no_healthy_wheel_is_a_fault(drive, gear, value, slope, mass):
    vehicle = Slope(drive, slope=slope, mass=mass)
    for target in (value, 0.0, value):
        state = vehicle.run(5.0, target, gear=gear)
        assert (state.state, state.faults) == (State.ARMED, 0)


@pytest.mark.parametrize("gear", [1, 2])
@pytest.mark.parametrize("mass", [95.0, 110.0])
def test_a_load_that_the_motor_does_not_hold_downhill_is_stopped(drive, gear, mass):
    vehicle = Slope(drive, slope=0.5 if gear == 1 else -0.5, mass=mass)
    state = vehicle.run(20.0, 0.6, gear=gear)
    assert (state.state, state.faults) == (State.FAULT, Fault.OVERSPEED)
    assert vehicle.fastest < 1.1


def test_a_blocked_wheel_is_found_while_stopping_too(make_bench):
    drive = make_bench(DRIVE).booted().armed()
    vehicle = Slope(drive)
    vehicle.run(5.0, 4.0)
    at = vehicle.travel
    vehicle.sensed = lambda travel: 2 * at - travel  # backwards from now on
    state = vehicle.run(0.5, 4.0, flags=0)
    assert (state.state, state.faults) == (State.FAULT, Fault.PULSES)


@pytest.mark.parametrize("gear", [1, 2])
@pytest.mark.parametrize(("value", "state"), [(0.15, State.FAULT), (0.09, State.ARMED)])
def test_two_and_a_half_seconds_without_a_pulse_are_a_fault_where_one_must_come(
    drive, gear, value, state
):
    for _ in range(210):
        drive.command(value, gear=gear)
        assert drive.tick().state == State.ARMED
    for _ in range(50):
        drive.command(value, gear=gear)
        drive.tick()
    assert drive.state.state == state


@pytest.mark.parametrize("value", [0.25, 1.0, 4.8])
@pytest.mark.parametrize("sensor", ["no pulses", "direction reads backward"])
def test_a_slight_brake_does_not_hide_a_stuck_hall_sensor(weighed, sensor, value):
    vehicle = Slope(weighed, sensed=HALL_SENSORS[sensor], slope=0.5)
    assert vehicle.run(6.0, value, brake=0.005).state == State.ARMED
    assert vehicle.fastest == 0.0
    state = vehicle.run(6.0, value)
    assert (state.state, state.faults) == (State.FAULT, Fault.PULSES)
    assert vehicle.fastest < 1.4


def test_a_slight_brake_at_speed_does_not_hide_a_sensor_that_sticks(weighed):
    vehicle = Slope(weighed)
    vehicle.run(4.0, 2.0)
    at, fastest = vehicle.travel, vehicle.fastest
    vehicle.sensed = lambda travel: min(travel, at)
    vehicle.run(3.0, 2.0, brake=0.005)
    assert vehicle.speed == 0.0
    assert vehicle.fastest == fastest


def test_a_motor_never_pushes_against_a_commanded_brake(drive):
    for brake in (0.005, 1.0):
        drive.command(1.0, brake=brake)
        state = drive.tick(10)
        assert (state.state, state.faults, state.setpoint) == (State.ARMED, 0, 0)
        assert (drive.output.motor_on, drive.output.brake) == (False, 1.0)  # held at rest
    drive.command(1.0)
    drive.tick()
    assert (drive.output.motor_on, drive.output.brake) == (True, 0.0)


@pytest.mark.parametrize("gear", [1, 2])
@pytest.mark.parametrize("slope", [-0.5, 0.0, 0.5])
@pytest.mark.parametrize(("brake", "ticks"), [(0.005, 1), (0.3, 30), (1.0, 600)])
@pytest.mark.parametrize("limit", [0.0, 0.05])
def test_a_brake_at_speed_stops_without_a_fault_and_lets_go_at_rest(
    drive, gear, slope, brake, ticks, limit
):
    vehicle = Slope(drive, slope=slope)
    assert vehicle.run(5.0, 2.0, gear=gear).state == State.ARMED
    fastest, brakes = vehicle.fastest, []
    for tick in range(600):
        acts = brake if tick < ticks else 0.0
        state = vehicle.run(0.01, 2.0, gear=gear, brake=acts, limit=limit)
        assert (state.state, state.faults) == (State.ARMED, 0)
        if drive.output.motor_on:
            break
        brakes.append(drive.output.brake)
    assert brakes == sorted(brakes)  # it does not fall before rest
    assert brakes[0] >= brake
    assert len(brakes) < 400 or ticks == 600
    assert vehicle.fastest < fastest + 0.15
    state = vehicle.run(5.0, 2.0, gear=gear)
    assert (state.state, state.faults) == (State.ARMED, 0)
    assert abs(vehicle.speed) > 1.7


def test_a_brake_that_is_commanded_goes_on_in_a_stop(drive):
    vehicle = Slope(drive)
    vehicle.run(5.0, 2.0)
    vehicle.run(0.1, 2.0, brake=0.4)
    state = vehicle.run(0.01, 2.0, flags=0)
    assert (state.state, state.brake) == (State.STOPPING, 80)
    assert vehicle.run(4.0, 2.0, flags=0).state == State.SAFE


def test_limits_are_what_the_plc_enforces(drive):
    (limits,) = drive.send(m.LimitsRequest())
    assert limits == m.DriveLimits(
        4800, 2000, 15253, 3350, 3500, 1500, 250, 400, 1000, 0, 0, 0, 0, 200, 150
    )


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
