"""Servo, motor and brake: what they give, and where they end."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.actuators import (
    DIRECT_TORQUE,
    FRICTION_BRAKE,
    HUB_MOTOR,
    SECOND_ORDER,
    THROTTLE_CURVE,
    direct_torque,
    friction_brake,
    hub_motor,
    throttle_curve,
)
from tricycle_sim.vehicle.batch import simulate
from tricycle_sim.vehicle.kernel import functions_for
from tricycle_sim.vehicle.kinematics import steered_wheels
from tricycle_sim.vehicle.layout import LANES
from tricycle_sim.vehicle.parts import servo_at_rest, steering_constants

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


@pytest.mark.parametrize(("frequency", "damping"), [(40.0, 2.0), (2e5, 1.5), (3e3, 50.0)])
def test_a_servo_with_much_damping_has_two_real_modes_however_fast(frequency, damping):
    values = {"servo_natural_frequency": frequency, "servo_damping_ratio": damping}
    v = SimpleNamespace(**{**VEHICLE.values, **values})
    modes = np.roots([1.0, 2.0 * damping * frequency, frequency**2])
    vectors = np.array([[1.0, 1.0], modes])
    exact = vectors @ np.diag(np.exp(0.01 * modes)) @ np.linalg.inv(vectors)
    found = [formula(v, 0.01) for formula in list(SECOND_ORDER.values())[:4]]
    assert found == pytest.approx(exact.ravel().tolist(), rel=1e-6, abs=1e-12)


def test_a_fast_servo_with_much_damping_steers_a_vehicle():
    vehicle = VEHICLE.replace(servo_natural_frequency=500.0, servo_damping_ratio=2.0)
    trajectory = simulate(vehicle, Commands([0.0, 0.5], [0.2, 0.2], [0.0, 0.0]))
    assert trajectory.steering_motor_angle[0, -1] == pytest.approx(0.2, rel=1e-6)
    assert steered_wheels(vehicle, 0.2) == steered_wheels(VEHICLE, 0.2)


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


@pytest.mark.parametrize("law", [
    (hub_motor, HUB_MOTOR, {}), (direct_torque, DIRECT_TORQUE, {"setpoint_torque": 12.0}),
])  # fmt: skip
@pytest.mark.parametrize("speed_mode", [0.0, 1.0])
@pytest.mark.parametrize("demand", [-40.0, -3.0, 0.0, 3.0, 40.0])
@pytest.mark.parametrize("spin", [-20.0, -5.0, 0.0, 0.1, 7.0])
def test_backwards_a_motor_is_the_mirror_image_of_itself(law, speed_mode, demand, spin):
    function, formulas, own = law
    values = SimpleNamespace(**{**VEHICLE.values, **own, "speed_scale": 1.0})
    constants = np.repeat([float(formula(values)) for formula in formulas.values()], LANES)
    ahead = function(constants, 0, spin, 4.0, 0.7, speed_mode, demand)
    back = function(constants, 0, -spin, -4.0, -0.7, speed_mode, -demand)
    assert np.array(back) == pytest.approx(-np.array(ahead), abs=1e-12)


def test_a_stop_backwards_regenerates_no_more_than_one_ahead():
    most = VEHICLE.regenerative_torque
    _, _, excess = motor(spin=-5.0, speed_mode=1.0, demand=0.0)
    assert excess == pytest.approx(VEHICLE.speed_gain_proportional * 5.0 - most)


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


def driven_servo(setpoints, half_steps=2, *, at_once=True, **constants):
    """Motor angles at the ticks, and the left wheel's angles and rates, of a geared servo."""
    vehicle = dataclasses.replace(VEHICLE, parts={"servo": "geared"}).replace(**constants)
    functions, ticks = functions_for(vehicle), len(setpoints)
    servo, of_steering = servo_at_rest(vehicle), steering_constants(vehicle, 0.01 / half_steps)
    table, angles = np.empty((half_steps * ticks + 1, 8)), np.empty((2, ticks + 1))
    for first in range(0, ticks, ticks if at_once else 1):
        part = setpoints[first : first + (ticks if at_once else 1)]
        rows = table[half_steps * first :][: half_steps * len(part) + 1]
        own = angles[:, first : first + len(part) + 1]
        both = np.empty(own.shape)
        functions.steer(servo, part, of_steering, half_steps, rows, both)
        own[:] = both
    at_ticks = table[::half_steps]
    wheel = np.arctan2(-at_ticks[:, 0] / math.cos(vehicle.caster_angle), at_ticks[:, 1])
    return (
        angles[0],
        wheel,
        at_ticks[:, 3],
        lambda motor: functions.wheel_angles(motor, of_steering),
    )


@pytest.mark.parametrize("delay", [0.0, 0.01, 0.0137, 0.3, 0.5])
@pytest.mark.parametrize("half_steps", [2, 4])
def test_a_delayed_servo_answers_as_one_without_delay_later(delay, half_steps):
    angles, *_ = driven_servo(np.full(80, 0.3), half_steps, servo_delay=delay)
    system = np.array([[0.0, 1.0], [-(25.0**2), -2.0 * VEHICLE.servo_damping_ratio * 25.0]])
    for tick, found in enumerate(angles):
        since = max(0.01 * tick - delay, 0.0)
        exact = 0.3 + (expm(since * system) @ [-0.3, 0.0])[0]
        assert found == pytest.approx(exact, abs=1e-12)


def test_a_geared_servo_without_delay_and_play_is_the_other_one():
    setpoints = 0.3 * np.sin(np.arange(100) * 0.05)
    setpoints[40:50] = math.nan
    servo, table = np.zeros(2), np.empty((201, 8))
    constants = steering_constants(VEHICLE, 0.005)
    plain = np.empty((2, 101))
    FUNCTIONS.steer(servo, setpoints, constants, 2, table, plain)
    angles, wheel, rates, _ = driven_servo(setpoints)
    assert angles == pytest.approx(plain[0], abs=1e-14)
    expected = np.arctan2(-table[::2, 0] / math.cos(VEHICLE.caster_angle), table[::2, 1])
    assert wheel == pytest.approx(expected, abs=1e-14)
    assert rates == pytest.approx(table[::2, 3], abs=1e-12)


def test_delay_and_play_are_kept_from_tick_to_tick():
    setpoints = 0.3 * np.sin(np.arange(150) * 0.08)
    constants = {"servo_delay": 0.123, "servo_backlash": 0.05}
    at_once = driven_servo(setpoints, **constants)
    by_ticks = driven_servo(setpoints, at_once=False, **constants)
    for a, b in zip(at_once[:3], by_ticks[:3], strict=True):
        assert a == pytest.approx(b, abs=1e-13)


def test_wheels_follow_the_motor_over_a_loop_as_wide_as_the_play():
    play = 0.08
    setpoints = np.interp(np.arange(600), [0, 150, 300, 450, 599], [0.0, 0.3, -0.3, 0.3, 0.3])
    motor, wheel, rates, of_motor = driven_servo(setpoints, servo_backlash=play)
    behind, expected = 0.0, []
    for angle in motor:
        behind = np.clip(behind, angle - 0.5 * play, angle + 0.5 * play)
        expected.append(of_motor(behind)[0])
    assert wheel == pytest.approx(expected, abs=1e-12)
    # up and down through the middle, the wheels stand a play apart
    down, up = (np.argmin(np.abs(motor[a:b])) + a for a, b in ((160, 300), (310, 450)))
    assert wheel[down] == pytest.approx(of_motor(motor[down] + 0.5 * play)[0], abs=1e-12)
    assert wheel[up] == pytest.approx(of_motor(motor[up] - 0.5 * play)[0], abs=1e-12)
    moved = np.abs(np.diff(wheel)) > 1e-9
    assert not rates[1:][~moved & (np.abs(np.diff(motor)) > 1e-9)].any()


def without_speed_loop(law, formulas, demand, spin=0.0, speed_mode=1.0, **own):
    values = SimpleNamespace(**{**VEHICLE.values, **own})
    constants = np.repeat([float(formula(values)) for formula in formulas.values()], LANES)
    slope, integrator_slope, excess = law(constants, 0, spin, 0.0, 0.0, speed_mode, demand)
    assert integrator_slope == 0.0
    return slope * VEHICLE.motor_lag, excess


@pytest.mark.parametrize(("setpoint", "spin", "granted"), [
    (1.0, 0.0, 12.0), (-1.0, 0.0, -12.0), (4.0, 0.0, 35.0), (4.0, 10.0, 25.0), (-4.0, 5.0, -15.0),
])  # fmt: skip
def test_a_direct_torque_is_in_proportion_to_the_setpoint_within_the_limits(
    setpoint, spin, granted
):
    torque, excess = without_speed_loop(
        direct_torque, DIRECT_TORQUE, setpoint, spin, setpoint_torque=12.0
    )
    assert torque == pytest.approx(granted)
    assert excess == pytest.approx(12.0 * setpoint - granted)


@pytest.mark.parametrize("setpoint", [0.0, 0.3, 1.0, 1.7, -2.2, 3.1, 4.0, 9.0, -9.0])
def test_a_throttle_gives_the_torque_of_its_table(setpoint):
    torques = {"throttle_torque_25": 0.0, "throttle_torque_50": 6.0, "throttle_torque_75": 18.0,
               "throttle_torque_100": 30.0}  # fmt: skip
    torque, _ = without_speed_loop(
        throttle_curve, THROTTLE_CURVE, setpoint, throttle_full_setpoint=4.0, **torques
    )
    table = np.interp(abs(setpoint) / 4.0, [0.0, 0.25, 0.5, 0.75, 1.0], [0.0, *torques.values()])
    assert torque == pytest.approx(math.copysign(table, setpoint))
    assert without_speed_loop(
        throttle_curve, THROTTLE_CURVE, 7.0, speed_mode=0.0, throttle_full_setpoint=4.0, **torques
    ) == pytest.approx((7.0, 0.0))
