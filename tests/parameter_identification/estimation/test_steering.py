"""A steering that moves as measured, where its servo is of another kind than the file's."""

import dataclasses
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from simulated_drives import NAMES, TRUTH, VEHICLE, commands_of_pair, driven, shares

from parameter_identification.drives.measured import Sensor, StartPose
from parameter_identification.drives.simulated import SensorNoise
from parameter_identification.estimation.model import DriveModel
from parameter_identification.estimation.steering import servo_misfit, servo_of_another_kind
from parameter_identification.identification import Steering, identify
from tricycle_core.errors import IdentificationError
from tricycle_sim.effects import EFFECTS

STEP = 1.0 / 435  # rad, of the board's ADC
SENSORS = {Sensor.YAW_RATE: SensorNoise(0.005)}


@pytest.fixture(scope="module")
def worlds():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(Path(__file__).parents[3] / "benchmarks"))
        yield import_module("worlds")


def drives_in(worlds, name):
    return worlds.drives_in(name, TRUTH, 0, list(commands_of_pair().values()))


@pytest.mark.parametrize(
    ("changes", "limit"),
    [
        ({}, 1.2),
        ({"servo_natural_frequency": 0.5 * VEHICLE.servo_natural_frequency}, 1.2),
        ({"steering_offset": 0.03}, 1.2),
    ],
)
def test_a_servo_of_the_files_kind_has_the_angle(changes, limit):
    drive = driven(
        commands_of_pair()["lane"], vehicle=VEHICLE.replace(**changes), steering_step=STEP
    )
    assert servo_misfit(drive.commands, drive.steering_angle, VEHICLE) < limit
    assert not servo_of_another_kind([drive], VEHICLE)


def test_a_noisy_angle_is_no_other_servo():
    drive = driven(commands_of_pair()["lane"], steering_step=1e-6)
    told = drive.steering_angle
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(told.time))
    noisy = dataclasses.replace(told, values=told.values + noise)
    assert servo_misfit(drive.commands, noisy, VEHICLE) < 1.2


def test_a_servo_of_another_kind_is_told_where_all_drives_tell_the_angle(worlds):
    drives = drives_in(worlds, "servo of another kind")
    assert servo_of_another_kind(drives, VEHICLE)
    untold = dataclasses.replace(drives[1], steering_angle=None)
    assert not servo_of_another_kind([drives[0], untold], VEHICLE)
    with pytest.raises(IdentificationError, match="lane: no steering angle is told throughout"):
        identify([drives[0], untold], VEHICLE, steering=Steering.MEASURED)


def test_the_steering_goes_where_it_was_measured():
    start = StartPose(0.0, 0.0, 0.0)
    drive = driven(commands_of_pair()["lane"], noise=0.0, steering_step=1e-6, start=start)
    off = dataclasses.replace(drive.steering_angle, values=drive.steering_angle.values + 0.02)
    drive = dataclasses.replace(drive, steering_angle=off)
    model = DriveModel(VEHICLE, drive, measured_steering=True)
    own = DriveModel(VEHICLE.replace(steering_offset=0.02), drive)
    found, expected = (
        m.predict(shares(TRUTH), np.zeros(len(m.nuisances)))[0].values for m in (model, own)
    )
    np.testing.assert_allclose(found[40:], expected[40:], atol=0.06)
    assert np.abs(expected - drive.signals[Sensor.POSITION].values).max() > 0.5


def test_derivatives_by_what_is_unknown_of_the_angle():
    drive = driven(commands_of_pair()["lane"], noise=0.0, others=SENSORS, steering_step=STEP)
    model = DriveModel(VEHICLE, drive, measured_steering=True)
    z, b = shares(TRUTH), np.zeros(len(model.nuisances))
    before = model.predict(z, b)
    names = [n.name for n in model.nuisances]
    assert sum("measured steering" in name for name in names) == 3
    for i, name in enumerate(names):
        if "measured steering" in name:
            low, high = (model.predict(z, b + s * np.eye(len(b))[i]) for s in (-0.2, 0.2))
            for p, lower, upper in zip(before, low, high, strict=True):
                slope = (upper.residual - lower.residual) / 0.4
                found = p.jacobian[:, :, len(z) + i]
                np.testing.assert_allclose(
                    found, slope, atol=0.03 * np.abs(slope).max() + 1e-6, err_msg=name
                )


@pytest.mark.slow
def test_intervals_hold_behind_a_servo_of_another_kind_and_are_narrower(worlds):
    drives = drives_in(worlds, "servo of another kind")
    found, by_commands = (
        identify(drives, VEHICLE, effects=EFFECTS, weighed=True, steering=steering)
        for steering in (Steering.EITHER, Steering.COMMANDS)
    )
    assert found.measured_steering
    assert not any(e.name.startswith("servo") for e in found.effects)
    for name in ("cornering_stiffness", "yaw_inertia"):
        e, other = (f.parameters[name] for f in (found, by_commands))
        assert e.low <= TRUTH[NAMES.index(name)] <= e.high
        assert e.high - e.low < other.high - other.low
