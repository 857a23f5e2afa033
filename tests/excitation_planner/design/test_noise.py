"""Noise of a measured trajectory error by simulation, and what is no noise."""

import math

import numpy as np
import pytest

from excitation_planner import MeasurementNoise, TrajectoryErrorNoise, TrajectoryNoise
from excitation_planner.design.noise import GYRO_BIAS_STD
from tricycle_core.errors import DesignError, PlanError


@pytest.mark.parametrize("points", [1, 200])
def test_noise_of_a_trajectory_error(points):
    """White noise on `points` positions, or one offset of them all, by simulation."""
    rng, std = np.random.default_rng(0), 0.05
    deviation = rng.normal(0, 0.3, size=(points, 2))
    te = np.mean(np.sum(deviation**2, axis=1))
    noise = rng.normal(0, std, size=(20_000, points, 2))
    measured = np.mean(np.sum((deviation + noise) ** 2, axis=2), axis=1)
    expected = TrajectoryErrorNoise(std, points=points)(np.array([te]))
    assert np.var(measured) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(("std", "points"), [(-0.1, 1), (math.nan, 1), (0.1, 0)])
def test_impossible_noise_of_a_trajectory_error_is_refused(std, points):
    with pytest.raises(DesignError, match="noise"):
        TrajectoryErrorNoise(std, points=points)


@pytest.mark.parametrize(
    "arguments", [{"std": 0.0}, {"std": (1.0, -1.0)}, {"drift_std": -1.0}, {"period": 0.0}]
)
def test_impossible_noise_of_a_trajectory_is_refused(arguments):
    with pytest.raises(DesignError, match="noise"):
        TrajectoryNoise(**arguments)


def test_a_gyro_is_one_more_channel():
    with_gyro = MeasurementNoise(noise_std=0.02, yaw_rate_std=0.003)
    assert str(with_gyro) == "position ± 20 mm at 20 Hz, gyro ± 3 mrad/s at 20 Hz"
    assert with_gyro.channels == ("x", "y", "yaw_rate")
    assert with_gyro.of_trajectory.std == (0.02, 0.02, 0.003)
    assert MeasurementNoise(noise_std=0.02).of_trajectory.std == (0.02, 0.02)
    assert with_gyro.of_trajectory_error == TrajectoryErrorNoise(0.02)


def test_a_wheel_is_one_more_channel_without_a_bias():
    wheel = MeasurementNoise(wheel_speed_std=0.003, wheel_rate=5.0)
    assert wheel.channels == ("x", "y", "drive_speed")
    assert wheel.of_trajectory.std == pytest.approx((0.01, 0.01, 0.006))
    assert wheel.of_trajectory.bias_std == (0.0,)
    both = MeasurementNoise(wheel_speed_std=0.003, yaw_rate_std=0.003)
    assert both.channels == ("x", "y", "yaw_rate", "drive_speed")
    assert both.of_trajectory.bias_std == (GYRO_BIAS_STD, 0.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"drift_std": -1.0}, "drift_std = -1 m must be from 0 to 10"),
        ({"yaw_rate_std": math.nan}, "yaw_rate_std = nan rad/s must be from 0 to 10"),
        ({"drift_time": 0.0}, "drift_time = 0 s must be above 0"),
    ],
)
def test_impossible_measurements_are_refused(arguments, message):
    with pytest.raises(PlanError, match=message):
        MeasurementNoise(**arguments)


def test_the_largest_deviation_of_the_message_is_taken():
    with pytest.raises(PlanError, match=r"noise_std = 10\.1 m must be from 0 to 10"):
        MeasurementNoise(noise_std=10.1)
    assert MeasurementNoise(noise_std=10.0).noise_std == 10.0


def test_failed_simulations_have_no_part_in_the_noise():
    noise = TrajectoryErrorNoise(0.1)
    assert noise(np.array([1.0, np.nan])) == noise(np.array([1.0]))


def test_a_heading_and_faster_sensors_tell_more():
    noise = MeasurementNoise(
        noise_std=0.02, heading_std=0.004, pose_rate=80.0, yaw_rate_std=0.006, gyro_rate=180.0
    )
    assert noise.channels == ("x", "y", "yaw", "yaw_rate")
    # four and nine times the samples of 20 Hz: half and a third of the deviation
    assert noise.of_trajectory.std == pytest.approx((0.01, 0.01, 0.002, 0.002))
    assert noise.of_trajectory.heading_channel == 2


@pytest.mark.parametrize(
    ("arguments", "shape", "message"),
    [
        ({"std": (0.1, 0.1, 0.1)}, (40, 2), "3 std does not fit 40 time points of 2 channels"),
        ({"bias_std": (0.1, 0.1)}, (40, 3), "2 bias_std, for those that are no pose, does not"),
        ({"start_position_std": 0.1}, (40, 1), "a start pose"),
        ({"heading_channel": 3}, (40, 3), "heading_channel = 3"),
        ({"delay_std": 0.1}, (1, 2), "delay_std"),
    ],
)
def test_noise_of_other_trajectories_is_named(arguments, shape, message):
    with pytest.raises(DesignError, match=message):
        TrajectoryNoise(**arguments).check_channels(*shape)


def test_noise_of_as_many_channels_fits():
    TrajectoryNoise(std=(0.1, 0.1, 0.2, 0.3), heading_channel=2, bias_std=(0.1,)).check_channels(
        40, 4
    )
