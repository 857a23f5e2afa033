"""Predictions: in closed form where the simulator is linear, and what the vehicle's looks like."""

import numpy as np
import pytest

from excitation_planner import Box, TrajectoryNoise
from excitation_planner.design.prior import NuisanceParameters
from excitation_planner.maneuver import Circle
from excitation_planner.planning.prediction import (
    PERIOD,
    STANDSTILL,
    ReplayedTrajectories,
    planned_effects,
    predicted_covariance,
)
from excitation_planner.planning.replay import nominal_run
from tricycle_core.errors import DesignError, InfeasibleManeuver
from tricycle_core.timing import TICK
from tricycle_sim.effects import EFFECTS
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate as simulate_vehicle

VEHICLE = load_vehicle()
TIME = np.arange(50) * PERIOD
UNKNOWN = Box.of({"p": (0.0, 2.0), "q": (1.0, 2.0)})


def drives_p(x, P):
    return np.stack([x[0] * P[:, :1] * TIME, 0.0 * P[:, :1] * TIME], axis=-1)


def drives_q(x, P):
    return np.stack([0.0 * P[:, 1:] * TIME, x[0] * P[:, 1:] * TIME**2], axis=-1)


def test_drives_one_after_the_other_add_their_information():
    noise = TrajectoryNoise(std=0.1)
    covariance = predicted_covariance(
        (drives_p, drives_q), (np.array([3.0]), np.array([0.5])), UNKNOWN, noise, seed=0
    )
    # in ranges: p has a width of 2, q of 1; a uniform prior has information 12
    of_p = np.sum((3.0 * 2.0 * TIME) ** 2) / 0.1**2 + 12.0
    of_q = np.sum((0.5 * TIME**2) ** 2) / 0.1**2 + 12.0
    assert np.allclose(covariance, np.diag([1.0 / of_p, 1.0 / of_q]), rtol=1e-6, atol=1e-12)


def test_vehicles_that_roll_over_are_left_out_but_not_most_of_them():
    def rolls_over(x, P):
        Y = drives_p(x, P)
        Y[P[:, 0] > x[0]] = np.nan
        return Y

    noise, alone = TrajectoryNoise(std=0.1), (np.array([1.0]),)
    some = predicted_covariance((rolls_over,), alone, UNKNOWN, noise, seed=0)
    assert some[0, 0] == pytest.approx(1.0 / (np.sum((2.0 * TIME) ** 2) / 0.1**2 + 12.0), rel=1e-6)
    with pytest.raises(DesignError, match=r"48 of 48 vehicles drawn roll over"):
        predicted_covariance((rolls_over,), (np.array([-1.0]),), UNKNOWN, noise, seed=0)
    with pytest.raises(DesignError, match="of 48 vehicles drawn roll over"):
        predicted_covariance((rolls_over,), (np.array([0.5]),), UNKNOWN, noise, seed=0)


def test_trajectories_of_the_vehicle_begin_at_rest_and_end_where_it_ends():
    family, x = Circle(duration=3.0), np.array([3.0, 0.8])
    simulate = ReplayedTrajectories(VEHICLE, family, ("x", "y", "yaw_rate"))
    Y = simulate(x, VEHICLE.nominal_point()[None])
    rest = round(STANDSTILL / PERIOD)
    reference = nominal_run(VEHICLE, family, x).reference
    assert np.all(Y[0, :rest, :2] == 0.0)
    assert np.allclose(Y[0, rest:, 0], reference.x[:: round(PERIOD / 0.01)])
    assert np.ptp(Y[0, rest:, 2]) > 0.1
    with pytest.raises(InfeasibleManeuver):
        ReplayedTrajectories(VEHICLE, Circle())(np.array([2.0, 1.0]), Y[0, :1])


def test_what_is_beside_the_parameters_is_eliminated_as_in_least_squares():
    rng = np.random.default_rng(0)
    design = rng.standard_normal((2, 60, 2, 2 + 3))  # of two drives: two parameters, three beside
    drives = tuple(lambda x, P, J=J: np.einsum("tcj,nj->ntc", J, P) for J in design)
    noise = TrajectoryNoise(std=0.5)
    nuisances = NuisanceParameters(steps=(0.01, 0.01, 0.02), own=1)
    found = predicted_covariance(
        drives, (np.empty(0),) * 2, UNKNOWN, noise, seed=0, nuisances=nuisances
    )
    # one column per drive for the last, which each drive has its own of
    rows = design.reshape(2, -1, 5) / 0.5
    rows[:, :, 0] *= 2.0  # the width of p
    both = np.zeros((2, rows.shape[1], 6))
    both[:, :, :4] = rows[:, :, :4]
    both[0, :, 4], both[1, :, 5] = rows[0, :, 4], rows[1, :, 4]
    both = both.reshape(-1, 6)
    whole = np.linalg.inv(both.T @ both + np.diag([12.0, 12.0, 1.0, 1.0, 1.0, 1.0]))
    assert np.allclose(found, whole[:2, :2], rtol=1e-6)


def test_effects_move_the_vehicle_as_they_do_in_the_identification():
    effects = planned_effects(VEHICLE, EFFECTS)
    assert [e.per_drive for e in effects[-2:]] == [True, True]
    assert not any(e.process for e in effects)
    family, x, channels = Circle(duration=3.0), np.array([3.0, 0.8]), ("x", "y", "drive_speed")
    simulate = ReplayedTrajectories(VEHICLE, family, channels, effects=effects)
    of_file = VEHICLE.nominal_point()
    P = np.tile(np.append(of_file, np.zeros(len(effects))), (len(effects) + 1, 1))
    P[1:, len(of_file) :] += np.eye(len(effects))
    Y = simulate(x, P)
    alone = ReplayedTrajectories(VEHICLE, family, channels)(x, of_file[None])[0]
    np.testing.assert_allclose(Y[0], alone, atol=1e-6)
    moved = dict(zip((e.name for e in effects), Y[1:], strict=True))
    assert not any(
        np.array_equal(Y[0], other) for name, other in moved.items() if name != "sensor yaw"
    )
    np.testing.assert_allclose(
        moved["sensor forward"][0, :2], Y[0][0, :2] + [0.03, 0.0], atol=1e-12
    )
    off = VEHICLE.replace(steering_offset=0.02)  # one standard deviation
    motion = simulate_vehicle(off, nominal_run(VEHICLE, family, x).commands)
    rest, every = round(STANDSTILL / PERIOD), round(PERIOD / TICK)
    np.testing.assert_allclose(moved["steering zero"][rest:, 0], motion.x[0, ::every], atol=1e-6)
    np.testing.assert_allclose(moved["steering zero"][rest:, 1], motion.y[0, ::every], atol=1e-6)
    # 50 ms of dead time: a point of the trajectory later, but for what the steering does to it
    late = moved["drive dead time"][rest + 1 :, 2], Y[0][rest:-1, 2]
    np.testing.assert_allclose(*late, atol=0.01)
