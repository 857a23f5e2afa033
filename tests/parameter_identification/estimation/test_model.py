"""Predictions of a drive and their derivatives."""

import dataclasses

import numpy as np
import pytest
from simulated_drives import NAMES, TRUTH, VEHICLE, commands_of_pair, driven, shares

from parameter_identification.drives.following import curvature_per_angle
from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.simulated import SensorNoise
from parameter_identification.estimation.model import DriveModel
from tricycle_core.timing import TICK

ERROR = "error of the followed steering"
EXACT = {sensor: SensorNoise(0.0, rate=47.0) for sensor in Sensor}  # between ticks


@pytest.fixture(scope="module")
def drive():
    pose = (3.0, -2.0, 2.5)
    return driven(commands_of_pair()["lane"], noise=0.0, others=EXACT.items(), pose=pose)


@pytest.fixture(scope="module", params=[0.0, 1e-3])
def model(drive, request):
    """Of the set-points of the steering as they were, and of some that were made from angles."""
    return DriveModel(VEHICLE, dataclasses.replace(drive, turn_std=request.param))


def start_of(model):
    """Nuisances, in standard deviations, of the true start."""
    exact = {"start x": 3.0, "start y": -2.0, "start heading": 2.5, "pose filter": 0.15}
    return np.array([(exact.get(n.name, 0.0) - n.mean) / n.std for n in model.nuisances])


def test_with_the_truth_nothing_is_left(model):
    for p in model.predict(shares(TRUTH), start_of(model)):
        np.testing.assert_allclose(p.residual, 0.0, atol=1e-9)


def test_derivatives_by_the_filter_of_the_poses_are_those_of_the_prediction(drive):
    filtered = DriveModel(VEHICLE, dataclasses.replace(drive, pose_filter=0.15))
    test_derivatives_are_those_of_the_prediction(filtered)


def test_derivatives_are_those_of_the_prediction(model):
    k, z, b = len(NAMES), shares(TRUTH), start_of(model)
    variables = np.concatenate([z, b])
    before = model.predict(z, b)
    for i in range(len(variables)):
        step = 1e-4 if i < k else 1e-3
        ends = [variables + sign * step * np.eye(len(variables))[i] for sign in (-1, 1)]
        low, high = (model.predict(v[:k], v[k:]) for v in ends)
        for p, lower, upper in zip(before, low, high, strict=True):
            slope = (upper.residual - lower.residual) / (2 * step)
            smooth = np.abs(p.time / TICK % 1.0 - 0.5) < 0.4  # linear between ticks
            tolerance = 0.02 * np.abs(slope).max() + 1e-6
            np.testing.assert_allclose(p.jacobian[smooth, :, i], slope[smooth], atol=tolerance)


def test_an_error_of_the_steering_moves_the_body_by_way_of_its_tyres():
    commands = commands_of_pair()["lane"]
    believed = driven(commands, noise=0.0, others=EXACT.items())
    model = DriveModel(VEHICLE, dataclasses.replace(believed, turn_std=1e-3))
    errors = [n for n in model.nuisances if n.name.startswith(ERROR)]
    at = np.linspace(0.0, model.motion.time[-1], len(errors))
    wanted = np.where(np.abs(at - 0.4 * at[-1]) < 0.4, 2.0, 0.0)  # standard deviations
    off = errors[0].std * np.interp(commands.time, at, wanted)
    steered = dataclasses.replace(
        commands, steering_motor_angle=commands.steering_motor_angle + off
    )
    seen = driven(steered, noise=0.0, others=EXACT.items())
    model = DriveModel(VEHICLE, dataclasses.replace(believed, signals=seen.signals, turn_std=1e-3))
    rows = np.array([(0.0 - n.mean) / n.std for n in model.nuisances])
    without = model.predict(shares(TRUTH), rows)
    rows[[i for i, n in enumerate(model.nuisances) if n.name.startswith(ERROR)]] = wanted
    for p, before in zip(model.predict(shares(TRUTH), rows), without, strict=True):
        assert np.abs(p.residual).max() < 0.05 * np.abs(before.residual).max(), p.sensor


def test_the_misfit_prefers_the_truth(model):
    white = dict.fromkeys(Sensor, 0.01)
    others = np.random.default_rng(1).uniform(size=(20, len(NAMES)))
    misfits = model.misfits(np.vstack([shares(TRUTH), others]), white)
    assert np.argmin(misfits) == 0
    assert misfits[0] < 0.01 * misfits[1:].min()


def test_set_points_of_smoothed_angles_err_whatever_the_speed_is(drive):
    def knots(drive):
        return [n for n in DriveModel(VEHICLE, drive).nuisances if n.name.startswith(ERROR)]

    assert not knots(drive)
    uncertain = dataclasses.replace(drive, turn_std=1e-3)
    own = knots(uncertain)
    std = 1e-3 / curvature_per_angle(VEHICLE)  # of the motor's angle
    assert [n.std for n in own] == pytest.approx([std] * len(own))
    assert len(own) == pytest.approx(drive.commands.duration / 0.25, abs=2)
    position = drive.signals[Sensor.POSITION]  # and at rest, before the start
    earlier = dataclasses.replace(position, time=position.time - 1.0)
    before = dataclasses.replace(uncertain, signals={Sensor.POSITION: earlier})
    assert len(knots(before)) == len(own)
