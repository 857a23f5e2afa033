"""Steering inputs against their definitions, and as the nominal vehicle drives them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from excitation_planner.maneuver.family import ACCELERATION, SETTLING_TIME
from excitation_planner.maneuver.steering import SineSweep, StepSteer
from excitation_planner.planning.replay import nominal_run
from tricycle_bridge.protocol.units import ANGLE_UNIT, SPEED_UNIT
from tricycle_core.errors import InfeasibleManeuver
from tricycle_sim.vehicle import load_vehicle

VEHICLE = load_vehicle()


@given(angle=st.floats(0.05, 0.6), speed=st.floats(0.8, 2.5))
def test_step_steer_is_straight_then_as_steep_as_the_slew_then_constant(angle, speed):
    family = StepSteer()
    commands = family.drive(np.array([angle, speed]), VEHICLE)
    step = speed / ACCELERATION + SETTLING_TIME
    steering = commands.steering_motor_angle
    assert np.all(steering[commands.time < step] == 0.0)
    held = commands.time > step + angle / VEHICLE.steering_slew
    assert np.all(steering[held] == angle)
    rising = ~held & (commands.time > step)
    assert np.allclose(steering[rising], VEHICLE.steering_slew * (commands.time[rising] - step))
    assert np.all(commands.speed[commands.time > step] == speed)
    assert commands.duration == pytest.approx(step + family.duration, abs=0.02)


def test_sweep_crosses_zero_as_often_as_its_phase_says():
    family = SineSweep()
    commands = family.drive(np.array([0.1, 2.0]), VEHICLE)
    after = commands.time - (family.speed / ACCELERATION + SETTLING_TIME)
    steering = commands.steering_motor_angle[after > 0.0]
    # the mean of 0.2 and 2 Hz for 15 s are 16.5 periods, two crossings each
    assert np.count_nonzero(np.diff(np.sign(steering))) == pytest.approx(33, abs=1)
    assert np.abs(steering).max() == pytest.approx(0.1, rel=0.01)


@pytest.mark.parametrize("turn", [0.4, -0.4])
def test_a_sweep_about_a_turn_is_that_straight_ahead_and_a_ramp(turn):
    x = np.array([0.1, 1.0])
    straight, turned = (SineSweep(turn=angle).drive(x, VEHICLE) for angle in (0.0, turn))
    ramp = turned.steering_motor_angle - straight.steering_motor_angle
    step = SineSweep.speed / ACCELERATION + SETTLING_TIME
    reached = straight.time >= step + abs(turn) / (0.5 * VEHICLE.steering_slew)
    assert np.all(ramp[straight.time <= step] == 0.0)
    assert np.allclose(ramp[reached], turn)
    assert np.all(np.abs(np.diff(ramp)) <= 0.5 * VEHICLE.steering_slew * 0.02 + 1e-12)
    np.testing.assert_array_equal(turned.speed, straight.speed)


@pytest.mark.parametrize(
    ("family", "x"),
    [
        (StepSteer(), (0.3, 2.0)),
        (StepSteer(), (0.6, 0.8)),
        (SineSweep(), (0.1, 1.0)),
        (SineSweep(turn=0.4), (0.1, 1.0)),
    ],
)
def test_the_nominal_vehicle_drives_it_within_all_limits(family, x):
    run = nominal_run(VEHICLE, family, np.array(x, dtype=float))
    for values, unit in (
        (run.commands.steering_motor_angle, ANGLE_UNIT),
        (run.commands.speed, SPEED_UNIT),
    ):
        assert np.allclose(values / unit, np.round(values / unit), atol=1e-6)
    # the path is that of the rear axle: behind the reference by its distance
    assert run.path[0] == pytest.approx([-VEHICLE.com_to_rear_axle, 0.0], abs=1e-9)
    distance = np.hypot(*(run.path - np.column_stack([run.reference.x, run.reference.y])[::10]).T)
    assert np.allclose(distance, VEHICLE.com_to_rear_axle)


def test_a_sweep_faster_than_the_slew_is_infeasible():
    with pytest.raises(InfeasibleManeuver, match="faster than steering_slew, 2 rad/s, at "):
        nominal_run(VEHICLE, SineSweep(), np.array([0.4, 2.0]))


def test_steering_into_the_margin_before_the_end_stop_is_infeasible():
    family, x = StepSteer(), np.array([0.77, 0.6])
    with pytest.raises(InfeasibleManeuver) as error:
        nominal_run(VEHICLE, family, x)
    assert str(error.value) == (
        "the steering turns to 0.7700 rad at 2.00 s: it may turn to 0.7461 rad, "
        "5 % before its end stop"
    )
    nominal_run(VEHICLE, family, np.array([VEHICLE.steering_reach, 0.6]))
    nominal_run(VEHICLE.replace(steering_margin=0.0), family, x)


def test_a_slower_vehicle_steps_more_slowly():
    slow = VEHICLE.replace(steering_slew=0.5)
    run = nominal_run(slow, StepSteer(), np.array([0.3, 1.0]))
    assert np.abs(np.diff(run.commands.steering_motor_angle)).max() <= 0.5 * 0.02 + ANGLE_UNIT
