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

from tricycle_core.rotations import attitude_quaternion
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.groups import equilibrium, pack
from tricycle_sim.vehicle.kernel import (
    NO_OUTPUT,
    NO_ROWS,
    compiled_for,
    functions_for,
    position,
    yaw,
)
from tricycle_sim.vehicle.layout import (
    EVALUATED,
    LANES,
    SLOPE,
    STATE,
    STATES,
    WHEEL_EVALUATED,
    WHEEL_STATES,
    of_wheels,
)
from tricycle_sim.vehicle.parts import steering_constants

VEHICLE = load_vehicle()
FUNCTIONS = functions_for(VEHICLE)


def load(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


ORACLE = load(Path(__file__).with_name("lagrange_oracle.py"))
CHECKS = load(Path(__file__).parents[3] / "benchmarks" / "vehicle_checks.py")


def _asks():
    """Stand for what calls the functions of a structure."""


def test_a_structure_is_compiled_once_however_it_is_asked_for():
    asks = compiled_for(VEHICLE, _asks)
    again = getattr(asks, "py_func", asks).__globals__  # without a compiler it is itself
    assert again["advance"] is FUNCTIONS.advance
    assert again["steer"] is FUNCTIONS.steer
    assert functions_for(VEHICLE, own_commands=False) is FUNCTIONS


def numbers(count, low, high):
    # products of numbers near the smallest ones are zero in one of both formulas
    number = st.floats(low, high).map(lambda v: v if abs(v) > 1e-12 else 0.0)
    return st.lists(number, min_size=count, max_size=count).map(np.array)


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
    FUNCTIONS.steer(servo, np.empty(0), constants, 0, table, np.empty((2, 1)))
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
    groups = pack(vehicle, vehicle.nominal_point()[np.newaxis], equilibrium(VEHICLE))
    rows = groups.reshape(-1, LANES)
    rows[STATE.x : STATE.z + 1] = s.q[:3, np.newaxis]
    quaternion = attitude_quaternion(roll, pitch, yaw)
    rows[STATE.q0 : STATE.q3 + 1] = np.reshape(quaternion, (4, 1))
    rows[STATE.u : STATE.w + 1] = (rotation.T @ s.dq[:3])[:, np.newaxis]
    rows[STATE.p : STATE.r + 1] = omega[:, np.newaxis]
    spins = s.dq[6:] + axles @ omega
    rows[of_wheels(STATE.spin, WHEEL_STATES, 3)] = spins[:, np.newaxis]
    rows[of_wheels(STATE.kappa, WHEEL_STATES, 3)] = s.kappa[:, np.newaxis]
    rows[of_wheels(STATE.alpha, WHEEL_STATES, 3)] = s.alpha[:, np.newaxis]
    rows[STATE.torque], rows[STATE.integrator] = s.torque, s.integrator
    speed_mode = s.speed is not None
    drive = np.array([[speed_mode, s.speed if speed_mode else s.demand, s.brake]])
    FUNCTIONS.advance(groups, table, np.zeros(1), drive, 1, 0, NO_ROWS, 1, NO_OUTPUT)
    slopes = rows[SLOPE : SLOPE + STATES, 0]
    return slopes, rows[of_wheels(EVALUATED.load, WHEEL_EVALUATED, 3), 0]


@pytest.mark.slow
@settings(max_examples=100)
@given(
    situations(),
    parameters(),
    st.sampled_from([0.0, 0.7]),
    st.sampled_from([0.0, 0.4]),
    st.sampled_from([(0.0, 0.0), (0.1, -0.3)]),
)
def test_derivatives_agree_with_lagrange(situation, values, load_sensitivity, air_drag, road):
    grade, bank = road
    vehicle = VEHICLE.replace(
        **values,
        load_sensitivity=load_sensitivity,
        air_drag=air_drag,
        road_grade=grade,
        road_bank=bank,
    )
    s = situation
    described = ORACLE.describe(vehicle)
    angles, angle_slopes = described.steering(s.motor_angle)
    steering = (angles, angle_slopes * s.motor_rate)
    truth = ORACLE.derivative(described, s, steering, (s.speed, s.demand, s.brake))
    slopes, loads = kernel_slopes(vehicle, s)
    expected = {
        STATE.x: s.dq[:3],
        STATE.u: truth.velocity,
        STATE.p: truth.rate,
        STATE.torque: [truth.torque, truth.integrator],
        STATE.spin: np.ravel(np.transpose([truth.spin, truth.kappa, truth.alpha])),
    }
    for row, values in expected.items():
        assert slopes[row : row + len(values)] == pytest.approx(values, rel=1e-9, abs=1e-9)
    assert loads == pytest.approx(truth.loads, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("speed", "side"), [(2.0, 1.0), (0.0, 0.0), (-2.0, -1.0)])
def test_the_aligning_moment_is_against_the_slip_forwards_and_with_it_backwards(speed, side):
    """The force acts where the contact is left: behind its middle, or in front of it."""
    spins = np.full(3, speed / VEHICLE.tyre_radius)
    situation = SimpleNamespace(
        q=np.array([0.0, 0.0, VEHICLE.com_height - 0.003, *np.zeros(6)]),
        dq=np.array([speed, *np.zeros(5), *spins]),
        kappa=np.zeros(3),
        alpha=np.full(3, 0.01),
        torque=0.0,
        integrator=0.0,
        motor_angle=0.0,
        motor_rate=0.0,
        speed=speed,
        demand=0.0,
        brake=0.0,
    )
    turned = [
        kernel_slopes(VEHICLE.replace(self_aligning_stiffness=stiffness), situation)[0][STATE.r]
        for stiffness in (0.3, 0.0)
    ]
    moment = VEHICLE.yaw_inertia * (turned[0] - turned[1])
    assert moment == pytest.approx(-side * 3 * 0.3 * 0.01, rel=1e-2, abs=1e-9)


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


def test_getters_for_compiled_callers():
    vehicle = VEHICLE.replace()
    groups = pack(vehicle, vehicle.nominal_point()[np.newaxis], equilibrium(vehicle))
    rows = groups.reshape(-1, LANES)
    rows[STATE.x, 0], rows[STATE.y, 0] = 3.0, -4.0
    rows[STATE.q0 : STATE.q3 + 1, 0] = attitude_quaternion(0.1, -0.2, 2.5)
    assert position(groups) == (3.0, -4.0)
    assert yaw(groups) == pytest.approx(2.5)
