"""Replay: TE of the samples as it follows from their whole trajectories."""

import pickle

import numpy as np
import pytest

from excitation_planner.maneuver import Circle
from excitation_planner.maneuver.steering import SineSweep, StepSteer
from excitation_planner.planning import PlanRequest
from excitation_planner.planning.replay import (
    ReplayedTrajectoryError,
    nominal_commands,
    nominal_run,
    replayed_errors,
)
from excitation_planner.trajectory_error import POINTS, trajectory_error
from tricycle_core.errors import InfeasibleManeuver, PlanError
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate

VEHICLE = load_vehicle()
X = np.array([3.0, 0.8])


def samples(n, seed=0):
    low, high = np.array(list(VEHICLE.unknown.values())).T
    return low + (high - low) * np.random.default_rng(seed).random((n, len(low)))


@pytest.fixture(scope="module")
def run():
    return nominal_run(VEHICLE, Circle(), X)


def test_te_is_that_of_the_interpolated_trajectories(run):
    parameters = samples(11)
    motion = simulate(VEHICLE, run.commands, parameters)
    at = np.linspace(0.0, run.commands.duration, POINTS)
    reference = [np.interp(at, run.reference.time, v) for v in (run.reference.x, run.reference.y)]
    expected = [
        trajectory_error(np.interp(at, motion.time, x), np.interp(at, motion.time, y), *reference)
        for x, y in zip(motion.x, motion.y, strict=True)
    ]
    # linear interpolation of 10 ms steps is good to micrometres
    assert replayed_errors(VEHICLE, run, parameters) == pytest.approx(expected, rel=1e-4)


def test_the_nominal_vehicle_has_no_error(run):
    assert replayed_errors(VEHICLE, run, VEHICLE.nominal_point()[None])[0] < 1e-20


def test_the_reference_starts_at_the_origin(run):
    reference = run.reference
    start = [reference.time[0], reference.x[0], reference.y[0], reference.yaw[0]]
    assert start == pytest.approx([0.0] * 4, abs=1e-15)


def test_the_commands_alone_are_those_of_the_run(run):
    commands = nominal_commands(VEHICLE, Circle(), X)
    assert np.array_equal(commands.time, run.commands.time)
    assert np.array_equal(commands.speed, run.commands.speed)
    assert np.array_equal(commands.steering_motor_angle, run.commands.steering_motor_angle)


def test_the_simulator_is_picklable_and_repeatable():
    simulator = ReplayedTrajectoryError(VEHICLE, Circle())
    parameters = samples(3)
    first = simulator(X, parameters)
    assert np.array_equal(pickle.loads(pickle.dumps(simulator))(X, parameters), first)


def test_a_maneuver_that_cannot_be_driven_is_infeasible_with_its_reason():
    with pytest.raises(InfeasibleManeuver, match="steering saturates"):
        ReplayedTrajectoryError(VEHICLE, Circle())(np.array([2.0, 1.0]), samples(2))


def test_no_maneuver_is_planned_for_a_motor_without_a_speed_loop(without_speed_loop):
    with pytest.raises(PlanError, match=r"parts\.motor: direct_torque has no speed loop"):
        nominal_run(without_speed_loop, Circle(duration=3.0), np.array([2.0, 1.0]))
    with pytest.raises(PlanError, match=r"^[^\n]*: maneuvers are driven at a speed"):
        PlanRequest(without_speed_loop, Circle(), "yaw_inertia")


@pytest.mark.parametrize(
    ("family", "x"),
    [(Circle(), [0.0, 0.8]), (StepSteer(), [0.2, -1.0]), (SineSweep(duration=0.0), [0.2, 1.0])],
)
def test_what_is_no_maneuver_cannot_be_driven(family, x):
    with pytest.raises(InfeasibleManeuver):
        nominal_run(VEHICLE, family, np.array(x))
