"""Vehicles of every structure: the kernel against the independent derivation, and what they do."""

import importlib.util
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tricycle_core.rotations import attitude_quaternion
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle, Wheel, load_vehicle
from tricycle_sim.vehicle.batch import simulate
from tricycle_sim.vehicle.groups import equilibrium, pack
from tricycle_sim.vehicle.kernel import NO_OUTPUT, NO_ROWS, functions_for
from tricycle_sim.vehicle.layout import (
    EVALUATED,
    LANES,
    SLOPE,
    STATE,
    WHEEL_EVALUATED,
    WHEEL_STATES,
    of_wheels,
    states_of,
)
from tricycle_sim.vehicle.live import LiveVehicle
from tricycle_sim.vehicle.parts import steering_constants, structure_of


def load(name):
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


ORACLE = load("lagrange_oracle")
STRUCTURES = load("structures").STRUCTURES
PAPER = load_vehicle()
OF_THE_TADPOLE = {"com_to_front_axle", "com_to_rear_axle", "left_wheel_y", "right_wheel_y"} | {
    "rear_wheel_y", "front_wheel_inertia", "rear_wheel_inertia", "steering_ratio_straight",
    "steering_ratio_full", "steering_ratio_smoothing",
}  # fmt: skip


def made(name, unknown=None, **constants):
    """The vehicle of a structure of `structures.py`."""
    structure = STRUCTURES[name]
    shared = {n: value for n, value in PAPER.values.items() if n not in OF_THE_TADPOLE}
    return Vehicle(
        name=name,
        wheels=tuple(Wheel(**wheel) for wheel in structure["wheels"]),
        parts=structure["parts"],
        values=shared | structure["constants"] | constants,
        unknown=unknown or {},
    )


def slopes_of(vehicle, s):
    """Slopes and loads by the kernel, for a state in the oracle's coordinates."""
    n, functions = len(vehicle.wheels), functions_for(vehicle)
    table, servo = np.empty((1, 8)), np.array([s.motor_angle, s.motor_rate])
    functions.steer(
        servo, np.empty(0), steering_constants(vehicle, 0.005), 0, table, np.empty((2, 1))
    )
    sides = structure_of(vehicle).sides[:n]
    axles = np.array(
        [[0.0, 1.0, 0.0] if side < 0 else table[0, 4 * side : 4 * side + 3] for side in sides]
    )
    yaw, pitch, roll = s.q[3:6]
    dyaw, dpitch, droll = s.dq[3:6]
    sp, cp, sr, cr = math.sin(pitch), math.cos(pitch), math.sin(roll), math.cos(roll)
    omega = np.array(
        [droll - dyaw * sp, dpitch * cr + dyaw * cp * sr, dyaw * cp * cr - dpitch * sr]
    )
    w, x, y, z = attitude = attitude_quaternion(roll, pitch, yaw)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    groups = pack(vehicle, vehicle.nominal_point()[np.newaxis], equilibrium(vehicle))
    rows = groups.reshape(-1, LANES)
    rows[STATE.x : STATE.z + 1, 0] = s.q[:3]
    rows[STATE.q0 : STATE.q3 + 1, 0] = attitude
    rows[STATE.u : STATE.w + 1, 0] = rotation.T @ s.dq[:3]
    rows[STATE.p : STATE.r + 1, 0] = omega
    rows[of_wheels(STATE.spin, WHEEL_STATES, n), 0] = s.dq[6:] + axles @ omega
    rows[of_wheels(STATE.kappa, WHEEL_STATES, n), 0] = s.kappa
    rows[of_wheels(STATE.alpha, WHEEL_STATES, n), 0] = s.alpha
    rows[STATE.torque, 0], rows[STATE.integrator, 0] = s.torque, s.integrator
    drive = np.array([[1.0, s.speed, s.brake]])
    functions.advance(groups, table, np.zeros(1), drive, 1, 0, NO_ROWS, NO_OUTPUT)
    slopes = rows[SLOPE : SLOPE + states_of(n), 0]
    return slopes, rows[of_wheels(EVALUATED.load, WHEEL_EVALUATED, n), 0]


@pytest.mark.slow  # derives the equations and compiles each structure
@pytest.mark.parametrize("name", STRUCTURES)
def test_derivatives_agree_with_lagrange(name):
    vehicle, rng = made(name, air_drag=0.4, load_sensitivity=0.6, road_grade=0.1), None
    described = ORACLE.describe(vehicle)
    rng = np.random.default_rng(2)
    n = len(vehicle.wheels)
    for _ in range(40):
        s = SimpleNamespace(
            q=np.array([*rng.uniform(-9.0, 9.0, 2), vehicle.com_height + rng.uniform(-0.02, 0.02),
                        *rng.uniform(-1.0, 1.0, 1), *rng.uniform(-0.1, 0.1, 2), *np.zeros(n)]),
            dq=np.array([*rng.uniform(-4.0, 4.0, 2), *rng.uniform(-1.0, 1.0, 4),
                         *rng.uniform(-12.0, 12.0, n)]),
            kappa=rng.uniform(-0.5, 0.5, n),
            alpha=rng.uniform(-0.5, 0.5, n),
            torque=rng.uniform(-15.0, 35.0),
            integrator=rng.uniform(-2.0, 2.0),
            motor_angle=rng.uniform(-0.7, 0.7),
            motor_rate=rng.uniform(-3.0, 3.0),
            speed=rng.uniform(-4.0, 4.0),
            brake=rng.uniform(0.0, 1.0),
        )  # fmt: skip
        angles, slopes = described.steering(s.motor_angle)
        steering = (angles, slopes * s.motor_rate)
        truth = ORACLE.derivative(described, s, steering, (s.speed, 0.0, s.brake))
        found, loads = slopes_of(vehicle, s)
        assert loads == pytest.approx(truth.loads, rel=1e-9, abs=1e-9)
        expected = {
            STATE.x: s.dq[:3],
            STATE.u: truth.velocity,
            STATE.p: truth.rate,
            STATE.torque: [truth.torque, truth.integrator],
            STATE.spin: np.ravel(np.transpose([truth.spin, truth.kappa, truth.alpha])),
        }
        for row, values in expected.items():
            assert found[row : row + len(values)] == pytest.approx(values, rel=1e-9, abs=1e-9)


@pytest.mark.slow  # compiles each structure
@pytest.mark.parametrize("name", STRUCTURES)
def test_a_vehicle_stands_drives_and_turns(name):
    vehicle = made(name)
    time = np.arange(0.0, 6.01, 0.02)
    trajectory = simulate(vehicle, Commands(time, 0.2 * (time > 3.0), np.minimum(time, 1.5)))
    at_rest = [load[0, 0] for load in trajectory.load.values()]
    assert at_rest == pytest.approx(vehicle.static_loads(), abs=2.0)
    assert list(trajectory.load) == [wheel.name for wheel in vehicle.wheels]
    assert trajectory.drive_speed[0, -1] * vehicle.driven_radius == pytest.approx(1.5, rel=0.02)
    assert trajectory.yaw_rate[0, -1] > 0.1  # to the left, also with the rear wheels
    state = LiveVehicle(vehicle).step(speed=0.5)
    assert len(state.wheel_speeds) == len(vehicle.wheels)


@pytest.mark.slow  # compiles
def test_every_constant_can_be_unknown_and_moves_each_sample_alone():
    unknown = {
        "front.cornering_stiffness": (800.0, 2000.0),
        "steering_offset": (-0.05, 0.05),
        "com_height": (0.3, 0.5),
        "rear.tyre_radius": (0.34, 0.37),
        "servo_natural_frequency": (10.0, 40.0),
        "caster_angle": (0.0, 0.3),
    }
    nominal = {"front.cornering_stiffness": 1000.0, "servo_natural_frequency": 25.0}
    vehicle = made("car", unknown, com_height=0.45, steering_offset=0.0, **nominal)
    assert [*vehicle.unknown] == [*unknown]
    time = np.arange(0.0, 3.01, 0.02)
    commands = Commands(time, 0.3 * np.sin(2.0 * time), np.minimum(time, 1.5))
    low, high = np.array([*unknown.values()]).T
    points = low + (high - low) * np.random.default_rng(3).random((9, len(low)))
    together = simulate(vehicle, commands, points)
    for sample in (0, 8):
        alone = vehicle.replace(**dict(zip(unknown, points[sample].tolist(), strict=True)))
        expected = simulate(alone, commands).columns()
        for name, column in together.columns().items():
            found = column if name == "time" else column[sample]
            assert found == pytest.approx(np.ravel(expected[name]), abs=1e-5), name
    live = LiveVehicle(vehicle, parameters=points[0])
    for _ in range(200):
        state = live.step(steering=0.0, speed=1.0)
    assert np.sign(state.yaw_rate) == np.sign(points[0, 1])  # of the offset
