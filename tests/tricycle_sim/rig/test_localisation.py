"""A localisation scatters about the true pose as its noise says."""

import numpy as np
import pytest

from tricycle_sim.rig.localisation import PoseNoise, measure_pose
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.live import LiveVehicle


def test_measured_poses_scatter_as_the_noise_says():
    state, rng = LiveVehicle(load_vehicle()).state, np.random.default_rng(0)
    poses = [measure_pose(state, PoseNoise(position=0.02, yaw=0.01), rng) for _ in range(4000)]
    assert np.std([pose.x for pose in poses]) == pytest.approx(0.02, rel=0.05)
    assert np.std([pose.yaw for pose in poses]) == pytest.approx(0.01, rel=0.05)
    assert np.mean([pose.y for pose in poses]) == pytest.approx(0.0, abs=0.002)
