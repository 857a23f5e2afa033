"""Simulated sensors against the noise and the pose that were asked for."""

import numpy as np
import pytest
from simulated_drives import TRUTH, VEHICLE, commands_of_pair, driven

from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from tricycle_core.errors import IdentificationError
from tricycle_sim.vehicle.batch import simulate


def test_noise_has_the_deviation_and_correlation_asked_for():
    noise = SensorNoise(white=0.3, drift=2.0, drift_time=0.5, rate=20.0)
    values = noise.draw(200_000, np.random.default_rng(0))
    assert values.std() == pytest.approx(np.hypot(0.3, 2.0), rel=0.02)
    lag = 5  # a quarter of a second
    covariance = np.mean(values[lag:] * values[:-lag])
    assert covariance == pytest.approx(2.0**2 * np.exp(-0.25 / 0.5), rel=0.05)


def test_sensors_see_the_motion_from_the_pose():
    commands = commands_of_pair()["circle"]
    trajectory = simulate(VEHICLE, commands, TRUTH[None])
    exact = {sensor: SensorNoise(0.0, rate=100.0) for sensor in Sensor}
    drive = measure(
        SensedMotion.of(trajectory), commands, exact,
        rng=np.random.default_rng(0), standstill=0.5, pose=(1.0, 2.0, np.pi / 2),
    )  # fmt: skip
    during = drive.signals[Sensor.POSITION].time >= -1e-9
    position = drive.signals[Sensor.POSITION].values
    np.testing.assert_allclose(position[~during], [[1.0, 2.0]] * 50, atol=1e-12)
    np.testing.assert_allclose(position[during, 0], 1.0 - trajectory.y[0], atol=1e-9)
    np.testing.assert_allclose(position[during, 1], 2.0 + trajectory.x[0], atol=1e-9)
    heading = drive.signals[Sensor.HEADING].values[during, 0]
    np.testing.assert_allclose(heading, np.pi / 2 + trajectory.yaw[0], atol=1e-9)


def test_the_same_seed_gives_the_same_drive():
    a, b = (driven(commands_of_pair()["lane"], seed=3) for _ in range(2))
    np.testing.assert_array_equal(
        a.signals[Sensor.POSITION].values, b.signals[Sensor.POSITION].values
    )


def test_noise_must_be_one():
    with pytest.raises(IdentificationError, match="needs white"):
        SensorNoise(-0.1)
