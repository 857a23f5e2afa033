"""Replays: any legal command is survived, what it asked of the vehicle is reported."""

import dataclasses
import math
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import CommandedBatch, simulate
from tricycle_sim.vehicle.planar import simulate_planar

VEHICLE = load_vehicle()


def sample(n, seed=0):
    low, high = np.array(list(VEHICLE.unknown.values())).T
    return np.random.default_rng(seed).uniform(low, high, (n, len(low)))


def slalom(duration=6.0, speed=2.0):
    time = np.arange(0.0, duration + 0.01, 0.02)
    return Commands(time, 0.2 * np.sin(2.0 * time), np.minimum(0.9 * time, speed))


def test_starts_at_rest_at_the_origin_and_stays_there_without_commands():
    trajectory = simulate(VEHICLE, Commands([0.0, 5.0], [0.0, 0.0], [0.0, 0.0]))
    assert trajectory.time.shape == (501,)
    assert trajectory.time[-1] == pytest.approx(5.0)
    columns = trajectory.columns()
    assert list(columns)[:4] == ["time", "x", "y", "z"]
    for name in ("x", "y", "yaw", "vx", "vy", "yaw_rate"):
        assert columns[name].shape == (1, 501)
        assert columns[name][0, 0] == pytest.approx(0.0, abs=1e-15)
        assert np.abs(columns[name]).max() < 1e-4
    assert np.ptp(columns["z"]) < 1e-6


def test_drives_at_the_commanded_speed_with_rolling_wheels():
    trajectory = simulate(VEHICLE, Commands([0.0, 8.0], [0.0, 0.0], [2.0, 2.0]))
    assert trajectory.vx[0, -1] == pytest.approx(2.0, rel=0.02)  # the loaded radius is smaller
    assert trajectory.wheel_speed_rear[0, -1] == pytest.approx(2.0 / VEHICLE.tyre_radius, rel=1e-3)
    assert trajectory.x[0, -1] == pytest.approx(2.0 * 8.0 - 2.0, rel=0.03)  # 1 m/s^2 up to 2 m/s
    assert trajectory.load_rear[0, 100] > trajectory.load_rear[0, -1] + 5.0  # squats
    assert trajectory.pitch[0, 100] < trajectory.pitch[0, -1]  # nose up


def test_left_is_positive_and_loads_the_outer_wheel():
    trajectory = simulate(VEHICLE, Commands([0.0, 8.0], [0.2, 0.2], [1.5, 1.5]))
    assert trajectory.yaw[0, -1] > 1.0
    assert trajectory.y[0, -1] > 0.5
    assert trajectory.load_right[0, -1] > trajectory.load_right[0, 0] + 2.0
    assert trajectory.load_left[0, -1] < trajectory.load_left[0, 0] - 2.0
    assert trajectory.steering_motor_angle[0, -1] == pytest.approx(0.2)


def test_yaw_is_continuous_over_turns():
    trajectory = simulate(VEHICLE, Commands([0.0, 40.0], [0.5, 0.5], [1.0, 1.0]))
    assert trajectory.yaw[0, -1] > 2.5 * math.pi
    assert np.abs(np.diff(trajectory.yaw)).max() < 0.1


def test_a_sample_does_not_depend_on_its_companions_or_on_threads():
    parameters, commands = sample(21), slalom()
    together = simulate(VEHICLE, commands, parameters, threads=2)
    for index in (0, 7, 8, 20):
        alone = simulate(VEHICLE, commands, parameters[index : index + 1], threads=1)
        for name, column in alone.columns().items():
            if name != "time":
                assert np.array_equal(column[0], getattr(together, name)[index]), name
    least = together.feasibility.least_load["left"]
    assert np.array_equal(least.value, together.load_left.min(axis=1))
    assert np.array_equal(least.time, together.time[together.load_left.argmin(axis=1)])
    assert np.array_equal(least.x, together.x[np.arange(21), together.load_left.argmin(axis=1)])


@pytest.mark.slow
def test_planar_blocks_are_the_trajectories():
    parameters, commands = sample(43), slalom()
    full = simulate(VEHICLE, commands, parameters)
    seen, lock = np.zeros(43, dtype=int), threading.Lock()
    reports = []

    def compare(first, block):
        last = first + len(block.x)
        with lock:
            seen[first:last] += 1
        assert np.array_equal(block.x, full.x[first:last])
        assert np.array_equal(block.y, full.y[first:last])
        assert np.array_equal(block.time, full.time)
        cosine, sine = np.cos(full.yaw[first:last]), np.sin(full.yaw[first:last])
        vx, vy = full.vx[first:last], full.vy[first:last]
        assert block.vx_world == pytest.approx(cosine * vx - sine * vy, abs=0.01)
        assert block.vy_world == pytest.approx(sine * vx + cosine * vy, abs=0.01)
        step = np.diff(block.x) / 0.01  # trapezoid of the velocity is the difference of positions
        mean = 0.5 * (block.vx_world[:, 1:] + block.vx_world[:, :-1])
        assert step == pytest.approx(mean, abs=1e-3)
        assert block.feasibility.feasible.shape == (last - first,)

    simulate_planar(
        VEHICLE, commands, parameters, compare, progress=lambda *done: reports.append(done)
    )
    assert seen.tolist() == [1] * 43
    assert reports[-1] == (43, 43)
    assert reports == sorted(reports)


def test_an_error_in_a_reduction_reaches_the_caller():
    def fail(first, block):
        raise ArithmeticError("no")

    with pytest.raises(ArithmeticError, match="no"):
        simulate_planar(VEHICLE, slalom(1.0), sample(20), fail)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        (np.zeros((3, 5)), r"shape \(3, 5\) instead of \(n, 6\)"),
        (np.zeros((0, 6)), r"shape \(0, 6\)"),
        (np.full((1, 6), np.nan), "row 1: cornering_stiffness is not finite"),
    ],
)
def test_bad_parameters_are_named(parameters, message):
    with pytest.raises(ValueError, match=message):
        simulate(VEHICLE, slalom(1.0), parameters)


def assert_sound(trajectory):
    """No NaN, no blow-up: the vehicle stays a vehicle on the road, or is reported rolled over."""
    for column in trajectory.columns().values():
        assert np.all(np.isfinite(column))
    assert np.abs(trajectory.vx).max() < 8.0
    assert np.abs(trajectory.vy).max() < 8.0
    for rate in (trajectory.roll_rate, trajectory.pitch_rate, trajectory.yaw_rate):
        assert np.abs(rate).max() < 20.0
    upright = ~trajectory.feasibility.rolled_over.happened
    assert np.abs(trajectory.roll[upright]).max(initial=0.0) < 0.79
    assert trajectory.z.min() > 0.0
    assert trajectory.z.max() < 1.0


@pytest.mark.slow
@settings(max_examples=60)
@given(
    rows=st.lists(
        st.tuples(
            st.sampled_from([0.02, 0.1, 0.5, 2.0]),
            st.floats(-0.7854, 0.7854),
            st.floats(-4.8, 4.8) | st.sampled_from([0.0, 4.8, -4.8]),
        ),
        min_size=2,
        max_size=12,
    ),
    seed=st.integers(0, 100),
)
def test_any_legal_commands_are_survived(rows, seed):
    steps, angles, speeds = np.array(rows).T
    time = np.concatenate([[0.0], np.cumsum(steps[:-1])])
    assert_sound(simulate(VEHICLE, Commands(time, angles, speeds), sample(8, seed)))


@pytest.mark.parametrize(
    ("angles", "speeds"),
    [
        ([0.0, 0.7854, -0.7854, 0.0], [0.0, 0.0, 0.0, 0.0]),  # steering at standstill
        ([0.3, 0.3, 0.3, 0.3], [-2.0, -2.0, -2.0, 0.0]),  # reversing
        ([0.0, 0.0, 0.0, 0.0], [3.0, 0.0, 0.0, 0.0]),  # braking to zero
        ([0.1, -0.1, 0.1, 0.0], [2.0, -2.0, 2.0, 0.0]),  # to and fro
        ([0.0, 0.6, 0.6, 0.0], [4.0, 4.0, 4.0, 0.0]),  # lifts a wheel
    ],
)
def test_awkward_drives_are_survived(angles, speeds):
    commands = Commands([0.0, 5.0, 10.0, 15.0], angles, speeds)
    assert_sound(simulate(VEHICLE, commands, sample(8)))


def test_brakes_to_a_standstill_and_stays():
    commands = Commands([0.0, 4.0, 14.0], [0.0, 0.0, 0.0], [2.0, 0.0, 0.0])
    trajectory = simulate(VEHICLE, commands)
    assert abs(trajectory.vx[0, -1]) < 1e-3
    assert np.ptp(trajectory.x[0, -100:]) < 1e-3


def test_reversing_mirrors_driving_ahead_on_the_straight():
    ahead = simulate(VEHICLE, Commands([0.0, 6.0], [0.0, 0.0], [1.0, 1.0]))
    back = simulate(VEHICLE, Commands([0.0, 6.0], [0.0, 0.0], [-1.0, -1.0]))
    assert back.x[0, -1] == pytest.approx(-ahead.x[0, -1], rel=0.01)
    assert back.wheel_speed_rear[0, -1] == pytest.approx(-1.0 / VEHICLE.tyre_radius, rel=1e-3)


def test_feasible_drives_say_so():
    feasibility = simulate(VEHICLE, slalom()).feasibility
    assert feasibility.feasible.tolist() == [True]
    assert feasibility.reasons(0) == ()
    assert 0.0 < feasibility.friction.value[0] < 1.0
    assert np.isnan(feasibility.rolled_over.time[0])


def test_saturated_steering_is_reported_with_time_and_place():
    commands = Commands([0.0, 3.0, 5.0], [0.0, 0.5, 0.5], [1.0, 1.0, 1.0])
    feasibility = simulate(VEHICLE, commands).feasibility
    assert feasibility.steering_saturated.time[0] == pytest.approx(3.0)
    assert feasibility.steering_saturated.x[0] == pytest.approx(2.4, abs=0.2)
    assert feasibility.steering_saturated.value[0] == pytest.approx(0.48)
    assert not feasibility.feasible[0]
    assert feasibility.reasons(0)[0].startswith(
        "steering asked to turn faster than steering_slew, 2 rad/s, at 3.00 s, x = 2."
    )


def test_commands_beyond_the_end_stop_saturate_the_steering_there():
    vehicle, time = VEHICLE.replace(steering_limit=0.3), np.arange(0.0, 3.0, 0.01)
    angles = np.clip(0.2 * (time - 1.0), 0.0, 0.35)  # meets the stop at 2.5 s
    trajectory = simulate(vehicle, Commands(time, -angles, np.minimum(time, 1.0)))
    assert trajectory.steering_motor_angle.min() == -0.3
    saturated = trajectory.feasibility.steering_saturated
    assert saturated.time[0] == pytest.approx(2.51)
    assert saturated.value[0] == pytest.approx(0.002)
    assert trajectory.feasibility.reasons(0)[0].startswith(
        "steering asked to turn beyond steering_limit, 0.3 rad, at 2.51 s"
    )
    up_to_it = Commands(time, np.minimum(angles, 0.3), np.minimum(time, 1.0))
    assert simulate(vehicle, up_to_it).feasibility.feasible[0]


def test_saturated_motor_is_reported():
    vehicle = VEHICLE.replace(motor_power=30.0)
    feasibility = simulate(vehicle, Commands([0.0, 5.0], [0.0, 0.0], [3.0, 3.0])).feasibility
    assert feasibility.motor_saturated.happened[0]
    assert feasibility.motor_saturated.value[0] > 0.0
    assert feasibility.feasible[0]


def test_lifted_wheel_is_reported_with_time_and_place():
    time = np.arange(0.0, 25.0, 0.02)
    commands = Commands(time, np.clip(0.05 * (time - 6.0), 0.0, 0.7), np.minimum(time, 3.4))
    trajectory = simulate(VEHICLE, commands)
    feasibility = trajectory.feasibility
    assert feasibility.wheel_lifted[0]
    lift = feasibility.least_load["left"]
    tick = round(lift.time[0] * 100)
    assert trajectory.load_left[0, tick] == 0.0
    assert trajectory.load_left[0, :tick].min() > 0.0
    assert lift.x[0] == trajectory.x[0, tick]
    assert any(reason.startswith("left wheel lifted at") for reason in feasibility.reasons(0))


def test_roll_over_is_detected_and_the_vehicle_left_where_it_is():
    time = np.arange(0.0, 12.0, 0.02)
    high = VEHICLE.replace(com_height=0.9, friction_coefficient=1.0)
    steering = np.clip(0.8 * (time - 6.0), 0.0, 0.6)
    trajectory = simulate(high, Commands(time, steering, np.minimum(time, 4.0)))
    rolled = trajectory.feasibility.rolled_over
    assert rolled.happened[0]
    tick = round(rolled.time[0] * 100)
    assert tick < len(trajectory.time) - 100
    for name in ("x", "y", "z", "roll", "pitch", "yaw"):
        assert np.ptp(getattr(trajectory, name)[0, tick:]) == 0.0
    assert np.abs(trajectory.roll[0, tick]) > 0.75
    assert not np.any(trajectory.vx[0, tick:])
    assert trajectory.feasibility.reasons(0)[-1].startswith("rolled over at")
    assert np.all(np.isfinite(trajectory.x))


@pytest.mark.parametrize("delay", [None, 0.03])
@pytest.mark.parametrize("every", [2, 5, 7, 1000])
def test_recording_some_ticks_only_gives_those_of_all(every, delay):
    batch = CommandedBatch(VEHICLE, Commands([0.0, 1.0, 3.0], [0.2, 0.4, 0.4], [1.0, 1.5, 1.5]))
    points = np.tile(VEHICLE.nominal_point(), (9, 1)) * np.linspace(0.9, 1.1, 9)[:, np.newaxis]
    columns = ("x", "yaw", "yaw_rate", "drive_speed", "load_left")
    delays = None if delay is None else np.full(9, delay)
    whole, some = (batch.run(points, columns, steering_delay=delays, every=e) for e in (1, every))
    for name in columns:
        assert np.array_equal(some.columns[name], whole.columns[name][:, ::every])
    assert some.columns["x"].shape[1] == len(batch.time[::every])
    angles = some.steering_motor_angle, whole.steering_motor_angle[:, ::every]
    assert np.array_equal(*angles)
    assert np.array_equal(some.groups, whole.groups)


def test_a_servo_that_hears_later_by_whole_ticks_is_one_with_that_dead_time():
    geared = dataclasses.replace(VEHICLE, parts={"servo": "geared"})
    commands = Commands([0.0, 1.0, 3.0], [0.2, 0.3, 0.3], [1.0, 1.5, 1.5])
    point, columns = geared.nominal_point()[np.newaxis], ("x", "y", "yaw")
    batch = CommandedBatch(geared, commands)
    later = batch.run(point, columns, steering_delay=np.array([0.03]))
    own = CommandedBatch(geared.replace(servo_delay=0.03), commands).run(point, columns)
    for name in columns:
        assert later.columns[name] == pytest.approx(own.columns[name], abs=1e-12)
    # between ticks it changes as evenly
    delays = np.linspace(0.02, 0.04, 21)
    yaw = batch.run(np.repeat(point, 21, axis=0), columns, steering_delay=delays)
    slopes = np.diff(yaw.columns["yaw"][:, -1]) / np.diff(delays)
    assert slopes == pytest.approx(slopes.mean(), rel=0.05)


def test_an_angle_added_to_the_set_point_is_a_command_for_so_much_more():
    time = np.arange(0.0, 4.0, 0.01)
    more = 0.02 * np.sin(np.pi * time)
    own = [Commands(time, 0.1 + m, np.minimum(time, 1.0)) for m in (0.0 * time, more)]
    vehicle = VEHICLE.replace(steering_slew=100.0)
    batch, columns = CommandedBatch(vehicle, own[0]), ("x", "y", "yaw")
    points = np.repeat(vehicle.nominal_point()[np.newaxis], 2, axis=0)
    added = np.zeros((2, len(batch.time)))
    added[1] = np.interp(batch.time, time, more)
    both = batch.run(points, columns, steered=added)
    later = batch.run(points, columns, steered=added, steering_delay=np.full(2, 0.03))
    for lane, commands in enumerate(own):
        alone = CommandedBatch(vehicle, commands)
        expected = alone.run(points[:1], columns).columns
        delayed = alone.run(points[:1], columns, steering_delay=np.array([0.03])).columns
        for name in columns:
            assert both.columns[name][lane] == pytest.approx(expected[name][0], abs=1e-12)
            assert later.columns[name][lane] == pytest.approx(delayed[name][0], abs=1e-12)


def test_a_speed_added_to_the_set_point_is_a_command_for_so_much_more():
    time = np.arange(0.0, 4.0, 0.01)
    asked, more = 0.4 * np.minimum(time, 2.0), 0.3 * np.sin(0.5 * np.pi * time)
    commands, faster = (Commands(time, 0.0 * time + 0.1, v) for v in (asked, asked + more))
    batch, columns = CommandedBatch(VEHICLE, commands), ("x", "y", "drive_speed")
    added = np.zeros((2, len(batch.time)))
    added[1] = np.interp(batch.time, time, more)
    both = batch.run(
        np.repeat(VEHICLE.nominal_point()[np.newaxis], 2, axis=0), columns, faster=added
    )
    for lane, own in enumerate((commands, faster)):
        alone = CommandedBatch(VEHICLE, own).run(VEHICLE.nominal_point()[np.newaxis], columns)
        for name in columns:
            # commands are held for a tick, what is added is linear between ticks
            near = pytest.approx(alone.columns[name][0], abs=1e-2 if lane else 1e-12)
            assert both.columns[name][lane] == near
