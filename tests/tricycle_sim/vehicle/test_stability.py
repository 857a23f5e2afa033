"""Vehicles that are too stiff for the steps are refused by name of the cause."""

import dataclasses

import numpy as np
import pytest

from tricycle_core.errors import VehicleError
from tricycle_sim.commands import Commands
from tricycle_sim.setpoints import command_rows, slew
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate
from tricycle_sim.vehicle.layout import STATE
from tricycle_sim.vehicle.live import LiveVehicle
from tricycle_sim.vehicle.stability import check_step, fastest_mode

VEHICLE = load_vehicle()


def test_the_fastest_mode_is_that_of_the_prototype():
    rate, _ = fastest_mode(VEHICLE)
    assert rate == pytest.approx(112.0, abs=1.0)


def test_a_short_motor_lag_is_its_own_mode():
    rate, state = fastest_mode(VEHICLE.replace(motor_lag=0.002, speed_gain_proportional=1e-3))
    assert rate == pytest.approx(500.0, rel=1e-3)
    assert state == STATE.torque


@pytest.mark.parametrize(
    ("values", "cause"),
    [
        ({"motor_lag": 0.001}, "change motor_lag"),
        ({"vertical_stiffness": 1e7}, "change vertical_stiffness"),
        ({"lateral_relaxation_length": 0.001}, "change lateral_relaxation_length"),
        ({"slip_stiffness": 1e6}, "slip_stiffness"),
        ({"front_wheel_inertia": 1e-5}, "the wheels' inertia"),
    ],
)
def test_vehicles_that_are_too_stiff_are_refused(values, cause):
    vehicle = VEHICLE.replace(**values)
    with pytest.raises(VehicleError, match=r"steps of 10 ms allow 250: change ") as error:
        simulate(vehicle, Commands([0.0, 1.0], [0.0, 0.0], [1.0, 1.0]))
    assert cause in str(error.value)
    with pytest.raises(VehicleError, match="steps of 5 ms allow 500"):
        LiveVehicle(vehicle)


def test_wheels_that_turn_beyond_a_right_angle_are_refused_whatever_made_the_vehicle():
    vehicle = VEHICLE.replace(steering_limit=1.2, steering_scale=2.0)
    with pytest.raises(VehicleError, match="needs a rising angle below 90 deg"):
        simulate(vehicle, Commands([0.0, 1.0], [0.0, 0.0], [1.0, 1.0]))
    with pytest.raises(VehicleError, match="needs a rising angle below 90 deg"):
        LiveVehicle(vehicle)


def test_samples_that_are_stiffer_than_the_vehicle_stay_bounded():
    stiff = {"slip_stiffness": (1500.0, 9000.0), "longitudinal_relaxation_length": (0.02, 0.2)}
    vehicle = dataclasses.replace(VEHICLE, unknown=stiff)
    commands = Commands([0.0, 6.0], [0.1, 0.1], [2.0, 2.0])
    points = np.array([[3000.0, 0.1], [9000.0, 0.02], [9000.0, 0.2]])
    trajectory = simulate(vehicle, commands, points)
    friction = trajectory.feasibility.friction.value
    assert friction == pytest.approx(friction[0], rel=0.01)
    np.testing.assert_allclose(trajectory.vx[1], trajectory.vx[2], atol=5e-3)


def test_samples_whose_lateral_slip_relaxes_within_a_step_stay_bounded():
    stiff = {"cornering_stiffness": (500.0, 4000.0), "lateral_relaxation_length": (0.003, 0.2)}
    vehicle = dataclasses.replace(VEHICLE, unknown=stiff)
    time = np.arange(0.0, 6.0, 0.1)
    commands = Commands(time, 0.4 * np.sin(3.0 * time), np.full(60, 2.0))
    points = np.array([[1000.0, 0.02], [1000.0, 0.003], [4000.0, 0.02], [4000.0, 0.003]])
    trajectory = simulate(vehicle, commands, points)
    np.testing.assert_allclose(trajectory.yaw[1::2], trajectory.yaw[::2], atol=5e-3)


def test_tall_samples_do_not_swing_on_their_tyres_at_the_steps_rate():
    stiff = {"cornering_stiffness": (500.0, 40000.0), "lateral_relaxation_length": (0.003, 0.2)}
    tall = VEHICLE.replace(com_height=0.7, roll_inertia=6.0, rollover_angle=1.2)
    vehicle, time = dataclasses.replace(tall, unknown=stiff), np.arange(0.0, 6.0, 0.1)
    commands = Commands(time, 0.1 * np.sin(3.0 * time), np.full(60, 1.5))
    trajectory = simulate(vehicle, commands, [[4000.0, 0.003]])
    # by a lateral force at each contact; with such a length 2.5 rad per step of 10 ms
    moved = (
        3.0 / tall.mass
        + (2.0 * tall.com_to_front_axle**2 + tall.com_to_rear_axle**2) / tall.yaw_inertia
        + 3.0 * tall.com_height**2 / tall.roll_inertia
    )
    live = LiveVehicle(vehicle, parameters=[4000.0, 4000.0 * moved / 250.0**2], substeps=8)
    steering = speed = 0.0
    rates = [0.0]
    for row in command_rows(commands):
        steering = slew(steering, commands.steering_motor_angle[row], vehicle.steering_slew)
        speed = slew(speed, commands.speed[row], vehicle.acceleration)
        rates.append(live.step(steering=steering, speed=speed).roll_rate)
    assert np.std(trajectory.roll_rate) == pytest.approx(np.std(rates), rel=0.1)


def test_vehicles_just_within_the_limit_stay_bounded():
    vehicle = VEHICLE.replace(motor_lag=0.0045)
    check_step(vehicle, 0.01)
    time = np.arange(0.0, 10.0, 0.1)
    commands = Commands(time, 0.3 * np.sign(np.sin(time)), 1.5 + np.sign(np.sin(2.0 * time)))
    trajectory = simulate(vehicle, commands)
    assert np.abs(trajectory.vx).max() < 4.0
    assert np.all(np.isfinite(trajectory.x))
