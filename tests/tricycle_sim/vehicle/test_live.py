"""The live vehicle is the batch's vehicle, driven tick by tick."""

import dataclasses
import math

import numpy as np
import pytest

from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.setpoints import command_rows, slew
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate
from tricycle_sim.vehicle.groups import equilibrium, pack
from tricycle_sim.vehicle.kernel import functions_for, position
from tricycle_sim.vehicle.live import LiveVehicle
from tricycle_sim.vehicle.parts import steering_constants

VEHICLE = load_vehicle()
TIME = np.arange(0.0, 8.01, 0.02)
COMMANDS = Commands(TIME, 0.25 * np.sin(1.5 * TIME), np.minimum(0.9 * TIME, 2.0))


def drive(vehicle, commands, **options):
    """Drive a live vehicle through commands as the PLCs would; returns its states."""
    live, states = LiveVehicle(vehicle, **options), []
    states.append(live.state)
    steering = speed = 0.0
    for row in command_rows(commands):
        steering = slew(steering, commands.steering_motor_angle[row], vehicle.steering_slew)
        speed = slew(speed, commands.speed[row], vehicle.acceleration)
        states.append(live.step(steering=steering, speed=speed))
    return states, live


def test_live_path_equals_the_batch_bit_for_bit():
    point = VEHICLE.nominal_point() * 1.1
    states, live = drive(VEHICLE, COMMANDS, parameters=point, substeps=1)
    batch = simulate(VEHICLE, COMMANDS, [point, point * 0.9])
    for name in ("time", "x", "y", "z", "vx", "vy", "vz", "roll_rate", "pitch_rate", "yaw_rate"):
        column = batch.time if name == "time" else getattr(batch, name)[0]
        assert [getattr(state, name) for state in states] == column.tolist(), name
    assert [s.steering_motor_angle for s in states] == batch.steering_motor_angle[0].tolist()
    loads = np.array([state.loads for state in states]).T
    assert np.array_equal(loads, [batch.load_left[0], batch.load_right[0], batch.load_rear[0]])
    spins = np.array([state.wheel_speeds for state in states]).T
    batch_spins = [
        batch.wheel_speed_left[0],
        batch.wheel_speed_right[0],
        batch.wheel_speed_rear[0],
    ]
    assert spins == pytest.approx(np.array(batch_spins), abs=1e-12)
    assert live.feasibility.friction.value[0] == batch.feasibility.friction.value[0]
    assert live.feasibility.friction.time[0] == batch.feasibility.friction.time[0]


def test_a_stiff_sample_lives_as_it_does_in_the_batch():
    ranges = {"slip_stiffness": (1500.0, 9000.0), "longitudinal_relaxation_length": (0.02, 0.2)}
    vehicle, point = dataclasses.replace(VEHICLE, unknown=ranges), [9000.0, 0.02]
    batch = simulate(vehicle, COMMANDS, [point])
    states, live = drive(vehicle, COMMANDS, parameters=point, substeps=1)
    assert [state.x for state in states] == batch.x[0].tolist()
    assert live.feasibility.friction.value[0] == batch.feasibility.friction.value[0] < 1.0
    finer, _ = drive(vehicle, COMMANDS, parameters=point)
    assert finer[-1].x == pytest.approx(states[-1].x, abs=1e-3)


@pytest.mark.parametrize(
    ("vehicle", "parameters"),
    [
        (VEHICLE.replace(road_bank=0.05, road_grade=-0.03), {}),
        (VEHICLE, {"gravity": 9.7, "road_bank": 0.05}),
    ],
    ids=["of the file", "unknown"],
)
def test_an_accelerometer_and_the_motor_tell_in_a_batch_what_they_do_live(vehicle, parameters):
    unknown = {name: (0.9 * value, 1.1 * value) for name, value in parameters.items()}
    nominal = {name: 1.05 * value for name, value in parameters.items()}
    across = dataclasses.replace(vehicle, values={**vehicle.values, **nominal}, unknown=unknown)
    point = np.array([parameters[name] for name in across.unknown])
    states, _ = drive(across, COMMANDS, substeps=1, parameters=point)
    batch = simulate(across, COMMANDS, point[np.newaxis])
    sideways = [state.specific_force[1] for state in states]
    assert np.ptp(sideways) > 1.0
    assert batch.lateral_acceleration[0] == pytest.approx(np.array(sideways), abs=1e-9)
    assert [state.motor_torque for state in states] == batch.motor_torque[0].tolist()


def test_two_substeps_change_the_path_by_less_than_a_micrometre():
    states, _ = drive(VEHICLE, COMMANDS)
    batch = simulate(VEHICLE, COMMANDS)
    deviation = math.hypot(states[-1].x - batch.x[0, -1], states[-1].y - batch.y[0, -1])
    assert 0.0 < deviation < 1e-6


@pytest.mark.slow
def test_tracking_tick_equals_the_batch_to_round_off():
    groups = pack(VEHICLE, VEHICLE.nominal_point()[np.newaxis], equilibrium(VEHICLE))
    servo, constants = np.zeros(2), steering_constants(VEHICLE, 0.5 * TICK)
    steering = speed = 0.0
    for row in command_rows(COMMANDS):
        steering = slew(steering, COMMANDS.steering_motor_angle[row], VEHICLE.steering_slew)
        speed = slew(speed, COMMANDS.speed[row], VEHICLE.acceleration)
        functions_for(VEHICLE).advance_tick(
            groups, servo, constants, steering, (1.0, speed, 0.0), 1
        )
    batch = simulate(VEHICLE, COMMANDS)
    assert position(groups) == pytest.approx((batch.x[0, -1], batch.y[0, -1]), abs=1e-12)


def test_instruments_agree_with_each_other():
    states, _ = drive(VEHICLE, COMMANDS)
    speeds = np.array([state.wheel_speeds[2] for state in states])
    turned = np.concatenate([[0.0], np.cumsum(0.5 * TICK * (speeds[1:] + speeds[:-1]))])
    assert [state.drive_angle for state in states] == pytest.approx(turned, abs=1e-9)
    for state in (states[0], states[400], states[-1]):
        assert np.linalg.norm(state.quaternion) == pytest.approx(1.0, abs=1e-9)
        assert sum(state.loads) == pytest.approx(VEHICLE.mass * 9.81, rel=0.05)
        assert state.specific_force[2] == pytest.approx(9.81, abs=0.5)
    force = states[50].specific_force[0]  # while accelerating at 0.9 m/s^2
    assert force == pytest.approx(0.9, abs=0.2)
    assert states[50].motor_power > 0.0
    assert states[50].motor_current == pytest.approx(states[50].motor_power / 48.0)


def test_rest_reads_gravity_and_nothing_else():
    state = LiveVehicle(VEHICLE).state
    assert state.loads == pytest.approx(VEHICLE.static_loads(), abs=0.2)
    assert np.linalg.norm(state.specific_force) == pytest.approx(9.81, abs=1e-3)
    zero = pytest.approx((0.0,) * 5, abs=1e-15)
    assert (state.x, state.y, state.yaw, state.vx, state.motor_torque) == zero


def test_rest_does_not_depend_on_what_the_memory_held(monkeypatch):
    expected = LiveVehicle(load_vehicle()).state
    monkeypatch.setattr(np, "empty", lambda shape, dtype=float: np.full(shape, math.nan, dtype))
    assert LiveVehicle(load_vehicle()).state == expected


def test_off_means_no_torque_and_a_held_steering_angle():
    _, live = drive(VEHICLE, COMMANDS)
    angle, speed = live.state.steering_motor_angle, live.state.vx
    for _ in range(100):
        state = live.step()
    assert state.steering_motor_angle == angle
    assert state.steering_motor_rate == 0.0
    assert abs(state.motor_torque) < 1e-9
    assert 0.5 * speed < state.vx < speed


def test_brake_stops_within_its_torque():
    _, live = drive(VEHICLE, COMMANDS)
    distance = live.state.x, live.state.y
    for _ in range(300):
        state = live.step(steering=0.0, brake=1.0)
    assert abs(state.vx) < 0.01
    # m v^2 / 2 over the brake's force
    expected = 0.5 * 48.3 * 2.0**2 / (25.0 / 0.335)
    assert math.dist((state.x, state.y), distance) == pytest.approx(expected, rel=0.2)


def test_torque_mode_pushes_as_it_should():
    live = LiveVehicle(VEHICLE)
    for _ in range(100):
        state = live.step(steering=0.0, torque=10.0)
    assert state.motor_torque == pytest.approx(10.0, abs=0.01)
    inertia = VEHICLE.mass + (2 * 0.3 + 0.5) / 0.335**2
    resistance = 0.009 * VEHICLE.mass * 9.81
    assert state.vx == pytest.approx((10.0 / 0.335 - resistance) / inertia, rel=0.1)
    state = live.step(torque=1000.0)
    for _ in range(50):
        state = live.step(torque=1000.0)
    assert state.motor_torque <= VEHICLE.motor_torque


def test_speed_controller_starts_anew_after_torque_mode():
    first, second = LiveVehicle(VEHICLE), LiveVehicle(VEHICLE)
    for _ in range(200):
        second.step(speed=0.0)
        first.step(torque=0.0)
    first.step(speed=0.5)
    second.step(speed=0.5)
    assert first.state.motor_torque == pytest.approx(second.state.motor_torque, rel=0.1)


def test_reverse_gear_is_a_negative_setpoint():
    live = LiveVehicle(VEHICLE)
    for tick in range(400):
        state = live.step(steering=0.0, speed=-min(0.01 * tick, 1.0))
    assert state.vx == pytest.approx(-1.0, rel=0.02)
    assert state.drive_angle < 0.0


def test_wrong_number_of_parameters():
    with pytest.raises(ValueError, match=r"shape \(2,\) instead of \(6,\)"):
        LiveVehicle(VEHICLE, parameters=[1.0, 2.0])
