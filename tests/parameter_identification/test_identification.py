"""Identification against vehicles whose parameters are known."""

import dataclasses
import json
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from excitation_planner.maneuver import Circle, DoubleLaneChange
from excitation_planner.planning.replay import nominal_run
from parameter_identification.drives.measured import MeasuredDrive, Sensor, Signal, StartPose
from parameter_identification.drives.poses import PlanarTrajectory
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from parameter_identification.estimation.problem import Loss
from parameter_identification.identification import GaussianPrior, identify
from parameter_identification.identification_file import document_of
from parameter_identification.identified_vehicle import identified_vehicle
from tricycle_core.errors import IdentificationError
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate

VEHICLE = load_vehicle()
LOW, HIGH = np.array(list(VEHICLE.unknown.values())).T
TRUTH = LOW + (HIGH - LOW) * np.array([0.3, 0.7, 0.5, 0.4, 0.6, 0.5])
NAMES = tuple(VEHICLE.unknown)


def planned(family, *x):
    return nominal_run(VEHICLE, family, np.array(x)).commands


@pytest.fixture(scope="module")
def commands():
    return {
        "circle": planned(Circle(duration=12.0), 2.5, 0.9),
        "lane": planned(DoubleLaneChange(), 2.0, 2.0),
    }


def driven(commands, *, noise=0.01, seed=0, truth=TRUTH, vehicle=VEHICLE, others=(), **options):
    motion = SensedMotion.of(simulate(vehicle, commands, truth[None]))
    sensors = {Sensor.POSITION: SensorNoise(noise), **dict(others)}
    return measure(motion, commands, sensors, rng=np.random.default_rng(seed), **options)


@pytest.fixture(scope="module")
def pair(commands):
    return [driven(c, seed=i, name=name) for i, (name, c) in enumerate(commands.items())]


def shares(values):
    return (values - LOW) / (HIGH - LOW)


def test_without_noise_the_truth_comes_back(commands):
    drives = [
        driven(c, noise=1e-6, pose=(3.0, -2.0, 2.5), standstill=1.0) for c in commands.values()
    ]
    found = identify(drives, VEHICLE)
    shown = [i for i, name in enumerate(NAMES) if found.identifiable[name]]
    assert {"cornering_stiffness", "camber_stiffness", "yaw_inertia"} <= {NAMES[i] for i in shown}
    deviations = np.abs(found.estimates - TRUTH) / found.standard_deviations
    assert deviations[shown].max() < 4
    assert np.abs(shares(found.estimates) - shares(TRUTH))[[0, 1, 3]].max() < 1e-4
    start = found.drives[0].nuisances
    assert start["start x"].estimate == pytest.approx(3.0, abs=1e-4)
    assert start["start heading"].estimate == pytest.approx(2.5, abs=1e-4)


def test_intervals_hold_the_truth_and_agree_with_the_linear_ones(pair):
    found = identify(pair, VEHICLE, profiles=True)
    assert found.white
    for name, truth in zip(NAMES, TRUTH, strict=True):
        e = found.parameters[name]
        deviation = (e.estimate - truth) / e.standard_deviation
        assert abs(deviation) < 3.5
        assert e.low <= e.estimate <= e.high
        width = e.high - e.low
        assert width == pytest.approx(e.linear[1] - e.linear[0], rel=0.25)


def test_what_a_drive_does_not_show_keeps_its_range_and_is_named(pair):
    found = identify(pair[:1], VEHICLE, profiles=True)
    aligning = found.parameters["self_aligning_stiffness"]
    assert not aligning.identifiable
    assert (aligning.low, aligning.high) == VEHICLE.unknown["self_aligning_stiffness"]
    assert any("self_aligning_stiffness" in c.weights for c in found.hidden)


def test_delays_bias_and_rolling_start_are_found(commands):
    truth = TRUTH
    motion = simulate(VEHICLE, commands["lane"], truth[None], speed=0.03)
    drive = measure(
        SensedMotion.of(motion),
        commands["lane"],
        {
            Sensor.POSITION: SensorNoise(0.003, rate=100.0),
            Sensor.YAW_RATE: SensorNoise(0.002, rate=100.0),
        },
        rng=np.random.default_rng(5),
    )
    signals = dict(drive.signals)
    gyro, position = signals[Sensor.YAW_RATE], signals[Sensor.POSITION]
    signals[Sensor.YAW_RATE] = Signal(gyro.time, gyro.values + 0.01)
    signals[Sensor.POSITION] = Signal(position.time + 0.02, position.values)
    found = identify([dataclasses.replace(drive, signals=signals)], VEHICLE)
    nuisances = found.drives[0].nuisances
    for name, expected in {"pose delay": 0.02, "gyro bias": 0.01, "start speed": 0.03}.items():
        found = nuisances[name]
        assert abs(found.estimate - expected) < 4 * found.standard_deviation
        assert found.standard_deviation < 0.35 * expected


def test_a_gyro_narrows_the_intervals(commands):
    gyro = {Sensor.YAW_RATE: SensorNoise(0.005, rate=100.0)}
    without, found = (
        identify([driven(commands["circle"], others=others, standstill=1.0)], VEHICLE)
        for others in ((), gyro.items())
    )
    assert np.all(
        found.standard_deviations[[0, 1, 3]] < 0.75 * without.standard_deviations[[0, 1, 3]]
    )


def test_drift_widens_the_intervals_and_is_told(commands, pair):
    drift = [
        measure(
            SensedMotion.of(simulate(VEHICLE, c, TRUTH[None])),
            c,
            {Sensor.POSITION: SensorNoise(0.01, drift=0.01, drift_time=5.0)},
            rng=np.random.default_rng(i),
        )
        for i, c in enumerate(commands.values())
    ]
    white, found = identify(pair, VEHICLE), identify(drift, VEHICLE)
    assert not found.white
    assert found.noise[Sensor.POSITION].drift > 0.003
    assert found.standard_deviations[0] > 1.5 * white.standard_deviations[0]
    assert abs(found.estimates[0] - TRUTH[0]) < 3.5 * found.standard_deviations[0]


def test_a_model_that_lacks_an_effect_leaves_residuals_that_are_not_white(commands):
    loaded = VEHICLE.replace(load_sensitivity=1.0)
    drives = [driven(c, vehicle=loaded, seed=i) for i, c in enumerate(commands.values())]
    assert not identify(drives, VEHICLE).white


def test_a_steering_that_is_two_degrees_off_leaves_residuals_that_are_not_white(commands):
    drives = []
    for i, c in enumerate(commands.values()):
        angle = np.clip(c.steering_motor_angle + np.radians(2.0), -0.785, 0.785)
        motion = SensedMotion.of(simulate(VEHICLE, Commands(c.time, angle, c.speed), TRUTH[None]))
        rng = np.random.default_rng(i)
        drives.append(measure(motion, c, {Sensor.POSITION: SensorNoise(0.01)}, rng=rng))
    assert not identify(drives, VEHICLE).white


def test_a_wrong_start_heading_does_not_hide_the_right_basin():
    truth = LOW + (HIGH - LOW) * np.array([0.98, 0.729, 0.927, 0.968, 0.015, 0.864])
    start = StartPose(0.0, 0.0, 0.0, 0.02, np.radians(1.0))
    maneuvers = (planned(Circle(), 2.0, 0.785), planned(DoubleLaneChange(), 8.0, 0.0))
    drives = [
        driven(c, truth=truth, seed=i, standstill=1.0, pose=(-0.009, -0.015, 0.004), start=start)
        for i, c in enumerate(maneuvers)
    ]
    found = identify(drives, VEHICLE)
    assert found.white
    assert np.abs(shares(found.estimates) - shares(truth))[[0, 1, 3]].max() < 0.1


def test_outliers_are_counted_and_held_back_by_the_robust_loss(pair):
    rng = np.random.default_rng(3)
    spoilt = []
    for drive in pair:
        position = drive.signals[Sensor.POSITION]
        values = position.values.copy()
        at = rng.choice(len(values), 8, replace=False)
        values[at] += rng.choice([-1.0, 1.0], (8, 2))
        spoilt.append(
            dataclasses.replace(drive, signals={Sensor.POSITION: Signal(position.time, values)})
        )
    plain = identify(spoilt, VEHICLE)
    robust = identify(spoilt, VEHICLE, loss=Loss.ROBUST)
    assert robust.outliers >= 14
    assert robust.standard_deviations[0] < 0.5 * plain.standard_deviations[0]
    assert abs(robust.estimates[0] - TRUTH[0]) < 3.5 * robust.standard_deviations[0]


def test_a_held_out_drive_is_predicted_to_the_noise(pair):
    found = identify(pair[1:], VEHICLE, held_out=pair[:1])
    (held,) = found.held_out
    assert held.name == "circle"
    assert held.rms_estimated < 0.5 * held.rms_nominal
    assert held.noise == pytest.approx(np.sqrt(2) * 0.01, rel=0.1)
    assert held.rms_estimated < 3 * held.noise


def test_two_drives_one_after_the_other_tell_what_both_tell_together(pair):
    both = identify(pair, VEHICLE)
    first = identify(pair[:1], VEHICLE)
    second = identify(pair[1:], VEHICLE, prior=first.posterior())
    difference = (second.estimates - both.estimates) / both.standard_deviations
    assert np.abs(difference).max() < 1.0
    np.testing.assert_allclose(second.standard_deviations, both.standard_deviations, rtol=0.3)


def test_known_parameters_are_left_alone(pair):
    found = identify(pair, VEHICLE, parameters=["camber_stiffness", "cornering_stiffness"])
    assert found.names == ("cornering_stiffness", "camber_stiffness")
    assert found.fixed["yaw_inertia"] == VEHICLE.yaw_inertia
    assert found.covariance.shape == (2, 2)


def test_the_same_drives_give_the_same_numbers(pair):
    a, b = (document_of(identify(pair, VEHICLE, seed=1)).to_json() for _ in range(2))
    del a["seconds"], b["seconds"]
    assert json.dumps(a, allow_nan=False) == json.dumps(b, allow_nan=False)


def test_the_vehicle_file_holds_the_estimates_and_their_origin(pair, tmp_path):
    found = identify(pair, VEHICLE)
    path = tmp_path / "vehicle.yaml"
    path.write_text(identified_vehicle(found, None), encoding="utf-8")
    vehicle = load_vehicle(path)
    e = found.parameters["cornering_stiffness"]
    assert vehicle.cornering_stiffness == e.estimate
    low, high = vehicle.unknown["cornering_stiffness"]
    assert low < e.low < e.high < high
    assert "circle" in path.read_text(encoding="utf-8")
    unseen = "self_aligning_stiffness"
    assert vehicle.unknown[unseen] == VEHICLE.unknown[unseen]


# ---- bad input ----


def test_too_little_motion_is_told():
    still = Commands([0.0, 20.0], [0.0, 0.0], [0.01, 0.01])
    with pytest.raises(IdentificationError, match="too little motion"):
        identify([driven(still)], VEHICLE)


def test_three_seconds_leave_the_ranges_as_they_were(commands):
    drive = driven(commands["circle"], noise=0.01)
    short = {s: signal.between(0.0, 3.0) for s, signal in drive.signals.items()}
    found = identify([dataclasses.replace(drive, signals=short)], VEHICLE, profiles=True)
    assert not any(found.identifiable.values())
    for e in found.parameters.values():
        assert e.high - e.low > 0.8 * (e.range[1] - e.range[0])


def with_reference(drive, vehicle):
    motion = simulate(vehicle, drive.commands)
    reference = PlanarTrajectory(motion.time, motion.x[0], motion.y[0], motion.yaw[0])
    return dataclasses.replace(drive, reference=reference)


def test_a_drive_planned_for_another_vehicle_is_told(pair):
    cargo = load_vehicle(Path(str(resources.files("tricycle_sim") / "cargo_tricycle.yaml")))
    with pytest.raises(IdentificationError, match="another vehicle"):
        identify([with_reference(pair[0], cargo)], VEHICLE)


def test_a_drive_planned_with_other_nominal_values_is_taken(pair):
    planned_with = VEHICLE.replace(cornering_stiffness=800.0, camber_stiffness=60.0)
    drives = [with_reference(pair[0], planned_with)]
    assert identify(drives, VEHICLE).identifiable["cornering_stiffness"]


def test_a_vehicle_file_that_knows_more_than_the_plan_did_is_taken(pair):
    drive = with_reference(pair[0], VEHICLE)
    known = VEHICLE.replace(cornering_stiffness=800.0)
    narrow = dataclasses.replace(
        known, unknown={**VEHICLE.unknown, "cornering_stiffness": (760.0, 840.0)}
    )
    found = identify([drive], narrow)
    assert found.parameters["cornering_stiffness"].range == (760.0, 840.0)


def test_the_same_drive_does_not_count_twice(pair):
    with pytest.raises(IdentificationError, match="same drive"):
        identify([pair[0], pair[0]], VEHICLE)


def test_names_of_parameters_are_checked(pair):
    with pytest.raises(IdentificationError, match="not an unknown parameter"):
        identify(pair, VEHICLE, parameters=["mass"])
    with pytest.raises(IdentificationError, match="no drive"):
        identify([], VEHICLE)


def test_signals_are_checked():
    time = np.arange(3.0)
    with pytest.raises(IdentificationError, match="must increase"):
        Signal(time[::-1].copy(), np.zeros((3, 1)))
    with pytest.raises(IdentificationError, match="finite"):
        Signal(time, np.array([[0.0], [np.nan], [0.0]]))
    with pytest.raises(IdentificationError, match="no positions"):
        MeasuredDrive("a", Commands([0, 1], [0, 0], [0, 0]), {})


def test_a_prior_must_be_one():
    with pytest.raises(IdentificationError, match="positive definite"):
        GaussianPrior(("yaw_inertia",), np.array([50.0]), np.array([[0.0]]))
