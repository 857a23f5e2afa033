"""The equations of every structure and law against the independent derivation."""

import math
from types import SimpleNamespace

import lagrange_oracle
import numpy as np
import pytest
import structures

from tricycle_core.rotations import attitude_quaternion
from tricycle_core.timing import TICK
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
)
from tricycle_sim.vehicle.live import LiveVehicle
from tricycle_sim.vehicle.parts import servo_at_rest, steering_constants

EVERY = {**structures.STRUCTURES, **structures.WITHOUT_SPEED_LOOP}
SLOPE_WITH_WIND = {
    "road_grade": 0.1, "road_bank": -0.3, "air_drag": 0.4, "load_sensitivity": 0.6,
}  # fmt: skip


def situation(vehicle, rng):
    """Coordinates and rates of the oracle, steering and drive, over what a vehicle can meet."""
    n = len(vehicle.wheels)
    tilt = rng.choice([0.003, 0.1, 0.4])
    height = vehicle.com_height + rng.uniform(-0.02, 0.03)
    angles = [rng.uniform(-math.pi, math.pi), *rng.uniform(-tilt, tilt, 2)]
    speed_mode = rng.uniform() < 0.6
    return SimpleNamespace(
        q=np.array([*rng.uniform(-50.0, 50.0, 2), height, *angles, *np.zeros(n)]),
        dq=np.concatenate(
            [
                rng.uniform(-4.0, 4.0, 2),
                rng.uniform(-1.0, 1.0, 1),
                rng.uniform(-2.0, 2.0, 3),
                rng.uniform(-16.0, 16.0, n),
            ]
        ),
        kappa=rng.uniform(-0.3, 0.3, n) * rng.choice([0.1, 1.0]),
        alpha=rng.uniform(-0.3, 0.3, n) * rng.choice([0.1, 1.0]),
        torque=rng.uniform(-15.0, 35.0),
        integrator=rng.uniform(-2.0, 2.0),
        motor_angle=rng.uniform(-0.7, 0.7),
        motor_rate=rng.uniform(-3.0, 3.0),
        speed=rng.uniform(-4.8, 4.8) if speed_mode else None,
        demand=rng.uniform(-40.0, 40.0),
        brake=rng.uniform(0.0, 1.0),
    )


def axles(described, angles):
    """Direction of each wheel's axle in the body frame, turned about its king-pin."""
    tilts = [wheel.caster for wheel in described.wheels]
    return np.array(
        [
            (-math.cos(c) * math.sin(d), math.cos(d), -math.sin(c) * math.sin(d))
            for c, d in zip(tilts, angles, strict=True)
        ]
    )


def rotation(s):
    """Of body to world, and the angular rate in the body frame."""
    yaw, pitch, roll = s.q[3:6]
    cy, sy, cp, sp, cr, sr = (f(a) for a in (yaw, pitch, roll) for f in (math.cos, math.sin))
    matrix = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    dyaw, dpitch, droll = s.dq[3:6]
    rate = [droll - dyaw * sp, dpitch * cr + dyaw * cp * sr, dyaw * cp * cr - dpitch * sr]
    return matrix, np.array(rate)


def kernel_slopes(vehicle, s, axles_now):
    """Slopes and loads by the kernel, for a situation in the oracle's coordinates."""
    functions, n = functions_for(vehicle), len(vehicle.wheels)
    table, servo = np.empty((1, 8)), servo_at_rest(vehicle)
    servo[:2] = s.motor_angle, s.motor_rate
    if len(servo) > 2:  # the play is taken up
        servo[0] += math.copysign(0.5 * vehicle.servo_backlash, s.motor_rate)
        servo[2] = s.motor_angle - math.copysign(1.0, s.motor_rate)
    constants = steering_constants(vehicle, 0.005)
    functions.steer(servo, np.empty(0), constants, 0, table, np.empty((2, 1)))
    matrix, omega = rotation(s)
    groups = pack(vehicle, np.empty((1, 0)), equilibrium(vehicle))
    rows = groups.reshape(-1, LANES)

    def of_each(first):
        return of_wheels(first, WHEEL_STATES, n)

    def put(where, values):
        rows[where] = np.reshape(values, (-1, 1))

    yaw, pitch, roll = s.q[3:6]
    put(slice(STATE.x, STATE.z + 1), s.q[:3])
    put(slice(STATE.q0, STATE.q3 + 1), attitude_quaternion(roll, pitch, yaw))
    put(slice(STATE.u, STATE.w + 1), matrix.T @ s.dq[:3])
    put(slice(STATE.p, STATE.r + 1), omega)
    put(of_each(STATE.spin), s.dq[6:] + axles_now @ omega)
    put(of_each(STATE.kappa), s.kappa)
    put(of_each(STATE.alpha), s.alpha)
    rows[STATE.torque], rows[STATE.integrator] = s.torque, s.integrator
    speed_mode = s.speed is not None
    drive = np.array([[speed_mode, s.speed if speed_mode else s.demand, s.brake]])
    functions.advance(groups, table, np.zeros(1), drive, 1, 0, NO_ROWS, 1, NO_OUTPUT)
    slopes = rows[SLOPE:, 0]
    return SimpleNamespace(
        position=slopes[STATE.x : STATE.z + 1],
        velocity=slopes[STATE.u : STATE.w + 1],
        rate=slopes[STATE.p : STATE.r + 1],
        spin=slopes[of_each(STATE.spin)],
        kappa=slopes[of_each(STATE.kappa)],
        alpha=slopes[of_each(STATE.alpha)],
        torque=slopes[STATE.torque],
        integrator=slopes[STATE.integrator],
        loads=rows[of_wheels(EVALUATED.load, WHEEL_EVALUATED, n), 0],
    )


@pytest.mark.slow  # each structure is compiled
@pytest.mark.parametrize("road", [{}, SLOPE_WITH_WIND])
@pytest.mark.parametrize("name", EVERY)
def test_derivatives_agree_with_lagrange(name, road):
    vehicle = structures.vehicle_of(EVERY[name], **road)
    described = lagrange_oracle.describe(vehicle)
    for seed in range(40):
        s = situation(vehicle, np.random.default_rng(seed))
        angles, angle_slopes = described.steering(s.motor_angle)
        steering = (angles, angle_slopes * s.motor_rate)
        truth = lagrange_oracle.derivative(described, s, steering, (s.speed, s.demand, s.brake))
        truth.position = s.dq[:3]
        found = kernel_slopes(vehicle, s, axles(described, angles))
        for what, value in vars(found).items():
            expected = pytest.approx(getattr(truth, what), rel=1e-9, abs=1e-9)
            assert value == expected, f"{what}, seed {seed}"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["delta", "car"])
def test_a_drive_agrees_with_the_oracle(name):
    """From rest into a turn and out of it; with servo, steering and speed loop."""
    at_once = {"steering_slew": 1e3, "acceleration": 1e3}
    vehicle = structures.vehicle_of(structures.STRUCTURES[name], **at_once)
    ticks = 80
    steering = np.repeat([0.2, -0.1], ticks // 2)
    speed = np.repeat([0.6, 0.8], ticks // 2)
    pose = equilibrium(vehicle).pose
    exact = lagrange_oracle.simulate(
        lagrange_oracle.describe(vehicle), pose, steering, speed, TICK, rtol=1e-8
    )
    # steps of 10 ms lose 7e-6 m where set-points jump
    live = LiveVehicle(vehicle, substeps=8)
    for angle, setpoint in zip(steering, speed, strict=True):
        found = live.step(steering=angle, speed=setpoint)
    for column, place in (("x", 0), ("y", 1), ("yaw", 3)):
        assert getattr(found, column) == pytest.approx(exact[-1, place], abs=2e-6)
