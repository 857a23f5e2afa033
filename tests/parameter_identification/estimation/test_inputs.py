"""Steering and wheels that move as measured, behind actuators of another kind than the file's."""

import dataclasses
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from simulated_drives import NAMES, TRUTH, VEHICLE, commands_of_pair, driven, shares

from parameter_identification.drives.measured import Input, Sensor, Signal, StartPose
from parameter_identification.drives.samples import Samples
from parameter_identification.drives.simulated import SensorNoise
from parameter_identification.estimation.inputs import (
    LOADING,
    Inputs,
    measured_inputs,
    servo_misfit,
    speed_misfits,
)
from parameter_identification.estimation.model import DriveModel
from parameter_identification.estimation.prior import box_prior
from parameter_identification.estimation.shares import first_fit, share_of
from parameter_identification.identification import identify
from tricycle_core.errors import IdentificationError
from tricycle_sim.effects import EFFECTS, effects_of

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
    assert measured_inputs([drive], VEHICLE, Inputs.EITHER) == set()


def test_a_noisy_angle_is_no_other_servo():
    drive = driven(commands_of_pair()["lane"], steering_step=1e-6)
    told = drive.steering_angle
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(told.time))
    noisy = dataclasses.replace(told, values=told.values + noise)
    assert servo_misfit(drive.commands, noisy, VEHICLE) < 1.2


@pytest.mark.slow
def test_a_servo_of_another_kind_is_told_where_all_drives_tell_the_angle(worlds):
    drives = drives_in(worlds, "servo of another kind")
    assert measured_inputs(drives, VEHICLE, Inputs.EITHER) == {Input.STEERING}
    assert measured_inputs(drives, VEHICLE, Inputs.COMMANDS) == set()
    circle, lane = drives  # in which it shows
    told = lane.steering_angle
    kept = (told.time < 3.0) | (told.time > 3.25)
    gap = dataclasses.replace(lane, steering_angle=Samples(told.time[kept], told.values[kept]))
    for some in ([dataclasses.replace(circle, steering_angle=None), lane], [circle, gap]):
        with pytest.raises(IdentificationError, match="does not tell the steering angle through"):
            measured_inputs(some, VEHICLE, Inputs.EITHER)
        assert measured_inputs(some, VEHICLE, Inputs.COMMANDS) == set()
    untold = dataclasses.replace(lane, steering_angle=None)
    assert measured_inputs([drives[0], untold], VEHICLE, Inputs.MEASURED) == {Input.SPEED}
    poses = {Sensor.POSITION: untold.signals[Sensor.POSITION]}
    blind = dataclasses.replace(untold, signals=poses)
    with pytest.raises(IdentificationError, match="not all drives tell throughout"):
        measured_inputs([drives[0], blind], VEHICLE, Inputs.MEASURED)


@pytest.mark.slow
def test_a_speed_loop_of_another_kind_is_told_by_the_wheels(worlds):
    alike, other = (drives_in(worlds, name) for name in ("nothing", "speed loop of another kind"))
    assert max(speed_misfits(alike, VEHICLE, LOADING)) < 1.5
    assert measured_inputs(alike, VEHICLE, Inputs.EITHER) == set()
    assert measured_inputs(other, VEHICLE, Inputs.EITHER) == {Input.SPEED}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 6])
def test_a_lag_is_not_taken_for_tyres_far_from_the_file(worlds, seed):
    drives = worlds.drives_in(
        "speed loop lags by 60 ms", worlds.draw(seed), seed, worlds.commands_of_pair()
    )
    assert measured_inputs(drives, VEHICLE, Inputs.EITHER) == {Input.SPEED}


def test_tyres_that_change_between_drives_are_no_other_speed_loop():
    drives = [
        driven(
            commands_of_pair()["circle"],
            truth=np.append(stiffness * TRUTH[:1], TRUTH[1:]),
            others={Sensor.WHEEL_SPEED: SensorNoise(0.001)},
        )
        for stiffness in (0.8, 1.2)
    ]
    assert measured_inputs(drives, VEHICLE, Inputs.EITHER) == {Input.SPEED}
    assert measured_inputs(drives, VEHICLE, Inputs.EITHER, changing=True) == set()


@pytest.mark.parametrize(
    "changes", [{"speed_gain_proportional": 10.0, "speed_gain_integral": 10.0}, {"mass": 53.0}]
)
def test_a_slow_speed_loop_and_a_heavy_vehicle_are_of_the_files_kind(changes):
    drive = driven(
        commands_of_pair()["lane"],
        vehicle=VEHICLE.replace(**changes),
        others={Sensor.WHEEL_SPEED: SensorNoise(0.003)},
    )
    assert max(speed_misfits([drive], VEHICLE, LOADING)) < 1.5


def test_wheels_that_are_not_heard_throughout_are_no_input():
    drive = driven(commands_of_pair()["lane"], others={Sensor.WHEEL_SPEED: SensorNoise(0.003)})
    wheels = drive.signals[Sensor.WHEEL_SPEED]
    heard = (wheels.time < 3.0) | (wheels.time > 3.3)
    signals = {
        **drive.signals,
        Sensor.WHEEL_SPEED: Signal(wheels.time[heard], wheels.values[heard]),
    }
    assert drive.measured_throughout == {Input.SPEED}
    assert dataclasses.replace(drive, signals=signals).measured_throughout == set()


def test_the_wheels_turn_as_measured(worlds):
    drive = drives_in(worlds, "speed loop of another kind")[1]
    start = dataclasses.replace(drive, start=StartPose(0.0, 0.0, 0.0))
    model = DriveModel(VEHICLE, start, measured=[Input.SPEED])
    assert Sensor.WHEEL_SPEED not in model.drive.signals
    by_commands = DriveModel(VEHICLE, start)
    off, off_by_commands = (
        np.abs(m.predict(shares(TRUTH), np.zeros(len(m.nuisances)))[0].residual).max()
        for m in (model, by_commands)
    )
    assert off < 0.1  # noise of 1 cm, and what two steps of the wheel's sensor make
    assert off_by_commands > 1.0


@pytest.mark.parametrize("name", ["nothing", "speed loop of another kind"])
def test_the_wheels_turn_as_fast_as_measured(worlds, name, monkeypatch):
    monkeypatch.setattr(worlds, "rounded", lambda drive: drive)
    for drive in drives_in(worlds, name):
        model = DriveModel(VEHICLE, drive, measured=[Input.SPEED]).motion
        turned = model.unaffected(shares(TRUTH)[np.newaxis]).wheel_speed[0]
        wheels = drive.signals[Sensor.WHEEL_SPEED]
        off = np.interp(wheels.time, model.time, turned) - wheels.values[:, 0]
        off *= VEHICLE.driven_radius
        assert np.abs(off).max() < 0.006
        assert np.abs(np.cumsum(off)).max() * 0.05 < 0.0004


@pytest.mark.slow
def test_the_steering_goes_where_it_was_measured():
    start = StartPose(0.0, 0.0, 0.0)
    drive = driven(commands_of_pair()["lane"], noise=0.0, steering_step=1e-6, start=start)
    off = dataclasses.replace(drive.steering_angle, values=drive.steering_angle.values + 0.02)
    drive = dataclasses.replace(drive, steering_angle=off)
    model = DriveModel(VEHICLE, drive, measured=[Input.STEERING])
    own = DriveModel(VEHICLE.replace(steering_offset=0.02), drive)
    found, expected = (
        m.predict(shares(TRUTH), np.zeros(len(m.nuisances)))[0].values for m in (model, own)
    )
    np.testing.assert_allclose(found[40:], expected[40:], atol=0.06)
    assert np.abs(expected - drive.signals[Sensor.POSITION].values).max() > 0.5


@pytest.mark.slow
def test_derivatives_by_what_is_unknown_of_the_angle():
    drive = driven(commands_of_pair()["lane"], noise=0.0, others=SENSORS, steering_step=STEP)
    model = DriveModel(VEHICLE, drive, measured=[Input.STEERING])
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
        identify(drives, VEHICLE, effects=EFFECTS, weighed=True, inputs=inputs)
        for inputs in (Inputs.EITHER, Inputs.COMMANDS)
    )
    assert found.measured == {Input.STEERING}
    assert not any(e.name.startswith("servo") for e in found.effects)
    for name in ("cornering_stiffness", "yaw_inertia"):
        e, other = (f.parameters[name] for f in (found, by_commands))
        assert e.low <= TRUTH[NAMES.index(name)] <= e.high
        assert e.high - e.low < other.high - other.low


@pytest.mark.slow
def test_intervals_hold_behind_a_speed_loop_of_another_kind(worlds):
    found = identify(
        drives_in(worlds, "speed loop of another kind"), VEHICLE, effects=EFFECTS, weighed=True
    )
    assert found.measured == {Input.SPEED}
    assert not {"speed loop", "drive dead time"} & {e.name for e in found.effects}
    for name in ("cornering_stiffness", "yaw_inertia"):
        e = found.parameters[name]
        assert e.low <= TRUTH[NAMES.index(name)] <= e.high
        assert e.identifiable


@pytest.mark.slow
def test_drives_one_by_one_turn_their_wheels_as_measured_too(worlds):
    drives = drives_in(worlds, "speed loop of another kind")
    effects = effects_of(VEHICLE, ["speed-loop", "wheel-radius"])
    prior = box_prior(VEHICLE, None)
    setting, at = first_fit(drives, VEHICLE, effects, prior, 0)
    assert setting.measured == {Input.SPEED}
    shares_found = [share_of(setting, drive, at) for drive in drives]
    names = [*VEHICLE.unknown, *(e.name for e in setting.shared)]
    idle, acting = names.index("speed loop"), names.index("wheel radius")
    for share in shares_found:
        assert not share.information[idle].any()
        assert share.information[acting, acting] > 1.0
    silent = {s: v for s, v in drives[0].signals.items() if s is not Sensor.WHEEL_SPEED}
    with pytest.raises(IdentificationError, match="circle: does not tell throughout the speed"):
        share_of(setting, dataclasses.replace(drives[0], signals=silent), at)
