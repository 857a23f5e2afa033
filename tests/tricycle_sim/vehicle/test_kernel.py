"""The equations against an independent derivation, and what any correct vehicle shows."""

import importlib.util
import itertools
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from tricycle_sim.vehicle import kernel as dynamics
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.steering import (
    motor_angle_for,
    road_angle,
    run_servo,
    steering_constants,
    wheel_angles,
)

VEHICLE = load_vehicle()


def load(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


ORACLE = load(Path(__file__).with_name("lagrange_oracle.py"))
CHECKS = load(Path(__file__).parents[3] / "benchmarks" / "vehicle_checks.py")


def numbers(count, low, high):
    return st.lists(st.floats(low, high), min_size=count, max_size=count).map(np.array)


@st.composite
def parameters(draw):
    point = [draw(st.floats(low, high)) for low, high in VEHICLE.unknown.values()]
    return dict(zip(VEHICLE.unknown, point, strict=True))


@st.composite
def situations(draw):
    """Coordinates and rates of the oracle, steering and drive, over what a vehicle can meet."""
    tilt = draw(st.sampled_from([0.003, 0.1, 0.5]))
    position = [*draw(numbers(2, -50.0, 50.0)), VEHICLE.com_height + draw(st.floats(-0.02, 0.05))]
    angles = [draw(st.floats(-math.pi, math.pi)), *draw(numbers(2, -tilt, tilt))]
    velocity = [*draw(numbers(2, -5.0, 5.0)), draw(st.floats(-1.0, 1.0))]
    return SimpleNamespace(
        q=np.array([*position, *angles, 0.0, 0.0, 0.0]),
        dq=np.array([*velocity, *draw(numbers(3, -2.0, 2.0)), *draw(numbers(3, -16.0, 16.0))]),
        kappa=draw(numbers(3, -1.0, 1.0)),
        alpha=draw(numbers(3, -1.0, 1.0)),
        torque=draw(st.floats(-15.0, 35.0)),
        integrator=draw(st.floats(-2.0, 2.0)),
        motor_angle=draw(st.floats(-0.785, 0.785)),
        motor_rate=draw(st.floats(-3.0, 3.0)),
        speed=draw(st.none() | st.floats(-4.8, 4.8)),
        demand=draw(st.floats(-40.0, 40.0)),
        brake=draw(st.floats(0.0, 1.0)),
    )


def kernel_slopes(vehicle, s):
    """Slopes and loads by the kernel, for a situation in the oracle's coordinates."""
    table, servo = np.empty((1, 8)), np.array([s.motor_angle, s.motor_rate])
    constants = steering_constants(vehicle, 0.005)
    run_servo(servo, np.empty(0), constants, 0, table, np.empty((2, 1)))
    axles = np.array([table[0, :3], table[0, 4:7], [0.0, 1.0, 0.0]])
    yaw, pitch, roll = s.q[3:6]
    cy, sy, cp, sp, cr, sr = (f(a) for a in (yaw, pitch, roll) for f in (math.cos, math.sin))
    rotation = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    dyaw, dpitch, droll = s.dq[3:6]
    omega = np.array(
        [droll - dyaw * sp, dpitch * cr + dyaw * cp * sr, dyaw * cp * cr - dpitch * sr]
    )
    groups = dynamics.pack(vehicle, vehicle.nominal_point()[np.newaxis], (0.0, 0.0, 0.0))
    rows = groups.reshape(dynamics.ROWS, dynamics.LANES)
    rows[dynamics.X : dynamics.Z + 1] = s.q[:3, np.newaxis]
    quaternion = dynamics.attitude_quaternion(roll, pitch, yaw)
    rows[dynamics.Q0 : dynamics.Q3 + 1] = np.reshape(quaternion, (4, 1))
    rows[dynamics.U : dynamics.W + 1] = (rotation.T @ s.dq[:3])[:, np.newaxis]
    rows[dynamics.P : dynamics.R + 1] = omega[:, np.newaxis]
    spins = s.dq[6:] + axles @ omega
    rows[dynamics.SPIN_LEFT : dynamics.SPIN_REAR + 1] = spins[:, np.newaxis]
    rows[dynamics.KAPPA_LEFT : dynamics.KAPPA_REAR + 1] = s.kappa[:, np.newaxis]
    rows[dynamics.ALPHA_LEFT : dynamics.ALPHA_REAR + 1] = s.alpha[:, np.newaxis]
    rows[dynamics.TORQUE], rows[dynamics.INTEGRATOR] = s.torque, s.integrator
    speed_mode = s.speed is not None
    drive = np.array([[speed_mode, s.speed if speed_mode else s.demand, s.brake]])
    nothing = (dynamics.NO_ROWS, dynamics.NO_OUTPUT)
    dynamics.advance(groups, table, np.zeros(1), drive, 1, 0, *nothing)
    slopes = rows[dynamics.SLOPE : dynamics.SLOPE + dynamics.STATES, 0]
    return slopes, rows[dynamics.LOAD : dynamics.LOAD + 3, 0]


@settings(max_examples=100)
@given(situations(), parameters(), st.sampled_from([0.0, 0.7]), st.sampled_from([0.0, 0.4]))
def test_derivatives_agree_with_lagrange(situation, values, load_sensitivity, air_drag):
    vehicle = VEHICLE.replace(**values, load_sensitivity=load_sensitivity, air_drag=air_drag)
    s = situation
    angles = ORACLE.linkage(vehicle, s.motor_angle)
    rates = ORACLE.linkage_slopes(vehicle, s.motor_angle) * s.motor_rate
    truth = ORACLE.derivative(vehicle, s, (angles, rates), (s.speed, s.demand, s.brake))
    slopes, loads = kernel_slopes(vehicle, s)
    expected = {
        dynamics.X: s.dq[:3],
        dynamics.U: truth.velocity,
        dynamics.P: truth.rate,
        dynamics.SPIN_LEFT: truth.spin,
        dynamics.KAPPA_LEFT: truth.kappa,
        dynamics.ALPHA_LEFT: truth.alpha,
        dynamics.TORQUE: [truth.torque, truth.integrator],
    }
    for row, values in expected.items():
        assert slopes[row : row + len(values)] == pytest.approx(values, rel=1e-9, abs=1e-9)
    assert loads == pytest.approx(truth.loads, rel=1e-9, abs=1e-9)


@given(st.floats(-0.785, 0.785))
def test_linkage_agrees_with_the_oracle(motor_angle):
    constants = steering_constants(VEHICLE, 0.005)
    left, right, left_slope, right_slope = wheel_angles(motor_angle, constants)
    assert (left, right) == pytest.approx(tuple(ORACLE.linkage(VEHICLE, motor_angle)), abs=1e-14)
    slopes = ORACLE.linkage_slopes(VEHICLE, motor_angle)
    assert (left_slope, right_slope) == pytest.approx(tuple(slopes), abs=1e-9)


def test_ratio_of_the_wheel_angles_falls_from_0_8_to_0_6():
    constants = steering_constants(VEHICLE, 0.005)
    left, right, _, _ = wheel_angles(0.7854, constants)
    assert right / left == pytest.approx(0.6, abs=0.001)
    left, right, _, _ = wheel_angles(0.1, constants)
    assert right / left == pytest.approx(0.78, abs=0.01)


@given(st.floats(-0.5, 0.5))
def test_motor_angle_is_the_inverse_of_the_road_angle(angle):
    constants = steering_constants(VEHICLE, 0.005)
    assert road_angle(motor_angle_for(angle, constants), constants) == pytest.approx(
        angle, abs=1e-12
    )


def test_servo_is_exact_whatever_the_step():
    setpoints = 0.3 * np.sin(np.arange(100) * 0.05)
    ends = []
    for half_steps in (2, 16):
        servo = np.zeros(2)
        constants = steering_constants(VEHICLE, 0.01 / half_steps)
        table = np.empty((half_steps * 100 + 1, 8))
        run_servo(servo, setpoints, constants, half_steps, table, np.empty((2, 101)))
        ends.append(servo)
    assert ends[0] == pytest.approx(ends[1], abs=1e-13)


@pytest.mark.parametrize("damping", [0.3, 0.9, 1.0, 1.5])
def test_servo_follows_its_differential_equation(damping):
    vehicle = VEHICLE.replace(servo_damping_ratio=damping)
    servo, table, angles = np.array([0.1, -0.5]), np.empty((21, 8)), np.empty((2, 11))
    constants = steering_constants(vehicle, 0.005)
    run_servo(servo, np.full(10, 0.3), constants, 2, table, angles)
    system = [[0.0, 1.0], [-(25.0**2), -50.0 * damping]]
    exact = expm(0.1 * np.array(system)) @ [0.1 - 0.3, -0.5] + [0.3, 0.0]
    assert servo == pytest.approx(exact, rel=1e-12)


def test_servo_without_pulse_holds_its_angle():
    servo, table = np.array([0.2, 1.0]), np.empty((21, 8))
    constants = steering_constants(VEHICLE, 0.005)
    run_servo(servo, np.full(10, math.nan), constants, 2, table, np.empty((2, 11)))
    assert servo.tolist() == [0.2, 0.0]
    assert not table[:, [3, 7]].any()


def test_static_loads_are_those_of_the_moment_balance():
    assert CHECKS.static_loads(VEHICLE) == pytest.approx([120.72, 115.37, 237.73], abs=0.2)


@pytest.mark.parametrize("speed", [0.95, 2.93])
@pytest.mark.parametrize("stiffness", [500.0, 1500.0])
def test_steady_yaw_rate_is_that_of_the_linear_bicycle(speed, stiffness):
    model, bicycle = CHECKS.steady_yaw_rate(VEHICLE, speed, stiffness)
    assert model == pytest.approx(bicycle, rel=0.005)


def test_mirrored_steering_mirrors_the_trajectory():
    assert CHECKS.mirror_error(VEHICLE) < 1e-12


def test_rotated_start_rotates_the_trajectory():
    assert CHECKS.rotation_error(VEHICLE) < 1e-10


def test_coast_down_follows_the_closed_form():
    model, closed = CHECKS.coast_down(VEHICLE)
    assert model == pytest.approx(closed, rel=0.005)


@pytest.mark.parametrize(
    ("side", "prototype", "rigid_value"), [(1.0, 3.27, 3.165), (-1.0, 3.12, 3.025)]
)
def test_inner_wheel_lifts_at_the_expected_lateral_acceleration(side, prototype, rigid_value):
    model, rigid = CHECKS.wheel_lift(VEHICLE, side)
    assert rigid == pytest.approx(rigid_value, abs=0.001)
    assert model == pytest.approx(prototype, rel=0.01)


@pytest.mark.parametrize("degrees", [5.0, 15.0])
def test_slow_turns_have_the_kinematic_radius(degrees):
    model, kinematic = CHECKS.kinematic_radius(VEHICLE, degrees)
    assert model == pytest.approx(kinematic, rel=0.02)


def test_energy_never_rises_without_drive():
    assert CHECKS.largest_energy_rise(VEHICLE) < 0.0


@pytest.mark.slow
def test_trajectory_agrees_with_the_oracle_to_the_order_of_rk4():
    errors = CHECKS.integration_errors(VEHICLE)
    assert errors[10.0] < 5e-7
    steps = list(errors.values())
    for coarse, fine in itertools.pairwise(steps):
        assert 14.0 < coarse / fine < 19.0
