"""Predictions: in closed form where the simulator is linear, and what the vehicle's looks like."""

import numpy as np
import pytest

from excitation_planner import Box, TrajectoryNoise
from excitation_planner.maneuver import Circle
from excitation_planner.planning.prediction import (
    PERIOD,
    STANDSTILL,
    ReplayedTrajectories,
    predicted_covariance,
)
from excitation_planner.planning.replay import nominal_run
from tricycle_core.errors import DesignError, InfeasibleManeuver
from tricycle_sim.vehicle import load_vehicle

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


def test_vehicles_that_roll_over_are_left_out_but_not_all_of_them():
    def rolls_over(x, P):
        Y = drives_p(x, P)
        Y[P[:, 0] > x[0]] = np.nan
        return Y

    noise, alone = TrajectoryNoise(std=0.1), (np.array([1.0]),)
    some = predicted_covariance((rolls_over,), alone, UNKNOWN, noise, seed=0)
    assert some[0, 0] == pytest.approx(1.0 / (np.sum((2.0 * TIME) ** 2) / 0.1**2 + 12.0), rel=1e-6)
    with pytest.raises(DesignError, match="every vehicle drawn rolled over"):
        predicted_covariance((rolls_over,), (np.array([-1.0]),), UNKNOWN, noise, seed=0)


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
