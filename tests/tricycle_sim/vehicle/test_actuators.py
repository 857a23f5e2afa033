"""Servo, motor and brake: what they give, and where they end."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.actuators import FRICTION_BRAKE, HUB_MOTOR, friction_brake, hub_motor
from tricycle_sim.vehicle.kernel import functions_for
from tricycle_sim.vehicle.layout import LANES
from tricycle_sim.vehicle.parts import steering_constants

VEHICLE = load_vehicle()
FUNCTIONS = functions_for(VEHICLE)


def test_servo_is_exact_whatever_the_step():
    setpoints = 0.3 * np.sin(np.arange(100) * 0.05)
    ends = []
    for half_steps in (2, 16):
        servo = np.zeros(2)
        constants = steering_constants(VEHICLE, 0.01 / half_steps)
        table = np.empty((half_steps * 100 + 1, 8))
        FUNCTIONS.steer(servo, setpoints, constants, half_steps, table, np.empty((2, 101)))
        ends.append(servo)
    assert ends[0] == pytest.approx(ends[1], abs=1e-13)


@pytest.mark.parametrize("damping", [0.3, 0.9, 1.0, 1.5])
def test_servo_follows_its_differential_equation(damping):
    vehicle = VEHICLE.replace(servo_damping_ratio=damping)
    servo, table, angles = np.array([0.1, -0.5]), np.empty((21, 8)), np.empty((2, 11))
    constants = steering_constants(vehicle, 0.005)
    FUNCTIONS.steer(servo, np.full(10, 0.3), constants, 2, table, angles)
    system = [[0.0, 1.0], [-(25.0**2), -50.0 * damping]]
    exact = expm(0.1 * np.array(system)) @ [0.1 - 0.3, -0.5] + [0.3, 0.0]
    assert servo == pytest.approx(exact, rel=1e-12)


def test_servo_without_pulse_holds_its_angle():
    servo, table = np.array([0.2, 1.0]), np.empty((21, 8))
    constants = steering_constants(VEHICLE, 0.005)
    FUNCTIONS.steer(servo, np.full(10, math.nan), constants, 2, table, np.empty((2, 11)))
    assert servo.tolist() == [0.2, 0.0]
    assert not table[:, [3, 7]].any()


def test_the_servo_stops_at_the_limit():
    servo, angles = np.zeros(2), np.empty((2, 101))
    constants = steering_constants(VEHICLE.replace(servo_damping_ratio=0.3), 0.005)
    FUNCTIONS.steer(servo, np.full(100, 0.7854), constants, 2, np.empty((201, 8)), angles)
    assert angles[0].max() == VEHICLE.steering_limit


def constants_of(formulas):
    """Constants of one vehicle, as they stand in a group."""
    return np.repeat([formula(VEHICLE.of("rear")) for formula in formulas.values()], LANES)


def motor(spin=0.0, torque=0.0, integrator=0.0, speed_mode=0.0, demand=0.0):
    return hub_motor(constants_of(HUB_MOTOR), 0, spin, torque, integrator, speed_mode, demand)


def test_torque_mode_gives_what_is_demanded_after_a_lag():
    slope, integrator_slope, excess = motor(torque=4.0, demand=10.0)
    assert slope == pytest.approx(6.0 / VEHICLE.motor_lag)
    assert (integrator_slope, excess) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("spin", "most"),
    [(0.0, 35.0), (10.0, 25.0), (15.0, 4.5), (15.5, 0.0)],
)
def test_torque_is_limited_by_current_power_and_no_load_speed(spin, most):
    for sign in (-1.0, 1.0):  # reverse gear mirrors everything; it needs a negative speed
        _, _, excess = motor(spin=sign * spin, speed_mode=1.0, demand=sign * 100.0)
        wanted = VEHICLE.speed_gain_proportional * sign * (100.0 / VEHICLE.tyre_radius - spin)
        assert excess == pytest.approx(wanted - sign * most)


def test_regenerative_braking_is_limited():
    _, _, excess = motor(spin=5.0, demand=-40.0)
    assert excess == pytest.approx(-40.0 + VEHICLE.regenerative_torque)


def test_a_torque_backwards_is_limited_as_one_forwards_is_unless_it_brakes():
    for spin, most in ((0.0, 35.0), (-10.0, 25.0), (0.1, VEHICLE.regenerative_torque)):
        _, _, excess = motor(spin=spin, demand=-40.0)
        assert excess == pytest.approx(-40.0 + most)


def test_the_integrator_unwinds_while_the_motor_saturates():
    _, free, _ = motor(speed_mode=1.0, demand=0.1)
    assert free == pytest.approx(0.1 / VEHICLE.tyre_radius)
    _, saturated, excess = motor(speed_mode=1.0, demand=4.0)
    assert excess > 0.0
    assert saturated < 4.0 / VEHICLE.tyre_radius


def test_the_brake_acts_against_the_spin():
    constants = constants_of(FRICTION_BRAKE)
    assert friction_brake(constants, 0, 100.0, 1.0, 0.0) == 25.0
    assert friction_brake(constants, 0, -100.0, 0.5, 0.0) == -12.5
    assert friction_brake(constants, 0, 0.0, 1.0, 0.0) == 0.0


@pytest.mark.parametrize(("others", "taken"), [(10.0, 10.0), (-24.0, -24.0), (30.0, 25.0)])
def test_the_brake_holds_a_wheel_at_rest_up_to_its_torque(others, taken):
    assert friction_brake(constants_of(FRICTION_BRAKE), 0, 0.0, 1.0, others) == taken
