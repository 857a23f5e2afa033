"""Identification against vehicles whose parameters are known."""

import dataclasses
import json

import numpy as np
import pytest
from simulated_drives import (
    HIGH,
    LOW,
    NAMES,
    TRUTH,
    VEHICLE,
    commands_of_pair,
    driven,
    driven_pair,
    planned,
    shares,
)

from excitation_planner.maneuver import Circle, DoubleLaneChange
from parameter_identification.drives.measured import Sensor, Signal, StartPose
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from parameter_identification.estimation import levenberg_marquardt
from parameter_identification.identification import identify
from parameter_identification.identification_file import document_of
from tricycle_core.errors import ExcitationError, IdentificationError
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle.batch import simulate


@pytest.fixture(scope="module")
def commands():
    return commands_of_pair()


@pytest.fixture(scope="module")
def pair():
    return driven_pair()


@pytest.mark.slow
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


@pytest.mark.slow
def test_intervals_hold_the_truth_and_agree_with_the_linear_ones(pair):
    told = []
    found = identify(
        pair, VEHICLE, profiles=True, progress=lambda done, total: told.append((done, total))
    )
    assert told == sorted(told)
    assert told[-1][0] == told[-1][1]
    assert len(told) > 10
    assert found.white
    for name, truth in zip(NAMES, TRUTH, strict=True):
        e = found.parameters[name]
        deviation = (e.estimate - truth) / e.standard_deviation
        assert abs(deviation) < 3.5
        assert e.low <= e.estimate <= e.high
        width = e.high - e.low
        assert width == pytest.approx(e.linear[1] - e.linear[0], rel=0.25)


@pytest.mark.parametrize("weighed", [False, True])
def test_of_a_search_that_is_given_up_nothing_is_shown(pair, monkeypatch, weighed):
    monkeypatch.setattr(levenberg_marquardt, "MAX_STEPS", 0)
    effects = ["wheel-radius"] if weighed else []
    found = identify(pair, VEHICLE, effects=effects, weighed=weighed, profiles=True)
    assert not found.converged
    assert not any(found.identifiable.values())
    for name, e in found.parameters.items():
        assert (e.low, e.high) == VEHICLE.unknown[name]
        assert e.profile is None
    assert document_of(found).to_json()["converged"] is False


@pytest.mark.slow
def test_what_a_drive_does_not_show_keeps_its_range_and_is_named(pair):
    found = identify(pair[:1], VEHICLE, profiles=True)
    aligning = found.parameters["self_aligning_stiffness"]
    assert not aligning.identifiable
    assert (aligning.low, aligning.high) == VEHICLE.unknown["self_aligning_stiffness"]
    assert any("self_aligning_stiffness" in c.weights for c in found.hidden)


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_gyro_narrows_the_intervals(commands):
    gyro = {Sensor.YAW_RATE: SensorNoise(0.005, rate=100.0)}
    without, found = (
        identify([driven(commands["circle"], others=others, standstill=1.0)], VEHICLE)
        for others in ((), gyro.items())
    )
    assert np.all(
        found.standard_deviations[[0, 1, 3]] < 0.75 * without.standard_deviations[[0, 1, 3]]
    )


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_model_that_lacks_an_effect_leaves_residuals_that_are_not_white(commands):
    loaded = VEHICLE.replace(load_sensitivity=1.0)
    drives = [driven(c, vehicle=loaded, seed=i) for i, c in enumerate(commands.values())]
    assert not identify(drives, VEHICLE).white


@pytest.mark.slow
def test_a_steering_that_is_two_degrees_off_leaves_residuals_that_are_not_white(commands):
    drives = []
    for i, c in enumerate(commands.values()):
        angle = np.clip(c.steering_motor_angle + np.radians(2.0), -0.785, 0.785)
        motion = SensedMotion.of(simulate(VEHICLE, Commands(c.time, angle, c.speed), TRUTH[None]))
        rng = np.random.default_rng(i)
        drives.append(measure(motion, c, {Sensor.POSITION: SensorNoise(0.01)}, rng=rng))
    assert not identify(drives, VEHICLE).white


@pytest.mark.slow
def test_a_wrong_start_heading_does_not_hide_the_right_basin():
    truth = LOW + (HIGH - LOW) * np.array([0.98, 0.729, 0.927, 0.968, 0.015, 0.864])
    start = StartPose(0.0, 0.0, 0.0, 0.02, np.radians(1.0))
    to_the_stop = VEHICLE.replace(steering_margin=0.0)  # with which this drive was found
    maneuvers = (
        planned(Circle(), 2.0, 0.785, vehicle=to_the_stop),
        planned(DoubleLaneChange(), 8.0, 0.0),
    )
    drives = [
        driven(c, truth=truth, seed=i, standstill=1.0, pose=(-0.009, -0.015, 0.004), start=start)
        for i, c in enumerate(maneuvers)
    ]
    found = identify(drives, VEHICLE)
    assert found.white
    assert np.abs(shares(found.estimates) - shares(truth))[[0, 1, 3]].max() < 0.1


@pytest.mark.slow
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
    robust = identify(spoilt, VEHICLE, loss="robust")
    assert robust.outliers >= 14
    assert robust.standard_deviations[0] < 0.5 * plain.standard_deviations[0]
    assert abs(robust.estimates[0] - TRUTH[0]) < 3.5 * robust.standard_deviations[0]


@pytest.mark.slow
def test_a_held_out_drive_is_predicted_to_the_noise(pair):
    found = identify(pair[1:], VEHICLE, held_out=pair[:1])
    (held,) = found.held_out
    assert held.name == "circle"
    assert held.rms_estimated < 0.5 * held.rms_nominal
    assert held.noise == pytest.approx(np.sqrt(2) * 0.01, rel=0.1)
    assert held.rms_estimated < 3 * held.noise


GENTLE, DEMANDING = (planned(Circle(duration=d), *x) for d, *x in ((8, 4.0, 0.6), (14, 2.5, 0.9)))


def predicted(vehicles, effects=(), offset=0.0):
    """Predictions of a demanding drive of random vehicles, each known from a gentle one."""
    rng, found = np.random.default_rng(5), []
    for number in range(vehicles):
        truth = LOW + (HIGH - LOW) * rng.uniform(0.0, 1.0, len(LOW))
        vehicle = VEHICLE.replace(steering_offset=offset)
        drives = [
            driven(c, seed=10 * number + i, truth=truth, vehicle=vehicle, name=str(i))
            for i, c in enumerate((GENTLE, DEMANDING))
        ]
        one = identify(drives[:1], VEHICLE, held_out=drives[1:], starts=1, effects=effects)
        found += one.held_out
    ratios = [held.rms_estimated / held.expected for held in found]
    return np.mean([held.inside for held in found]), np.sqrt(np.mean(np.square(ratios)))


@pytest.mark.slow
def test_the_band_of_a_held_out_drive_holds_the_share_of_its_level():
    inside, ratio = predicted(20)
    assert inside == pytest.approx(0.95, abs=0.02)
    assert ratio == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_the_band_does_not_hold_what_the_vehicle_file_lacks_unless_it_is_an_effect():
    inside, ratio = predicted(5, offset=0.012)
    assert inside < 0.9
    assert ratio > 1.3
    inside, _ = predicted(5, offset=0.035)  # the ranges are contradicted, and the band is wide
    assert inside > 0.8
    inside, ratio = predicted(5, offset=0.035, effects=("steering-zero",))
    assert inside > 0.9
    assert ratio < 1.2
    inside, _ = predicted(5, offset=0.035, effects=("turn-deviation",))  # it stays along a drive
    assert inside > 0.9


@pytest.mark.slow
def test_the_band_counts_how_far_drives_are_from_where_the_others_predict_them():
    sharper = planned(Circle(duration=14), 2.2, 1.0)

    def last(offset):
        vehicle = VEHICLE.replace(steering_offset=offset)
        *drives, held = (
            driven(c, seed=i, truth=TRUTH, vehicle=vehicle, name=str(i))
            for i, c in enumerate((GENTLE, GENTLE, DEMANDING, sharper))
        )
        return identify(drives, VEHICLE, held_out=[held], starts=1)

    assert last(0.0).missed == 0.0
    wrong = last(0.012)
    (held,) = wrong.held_out
    assert wrong.missed > held.noise
    assert held.inside > 0.9


@pytest.mark.slow
def test_two_drives_one_after_the_other_tell_what_both_tell_together(pair):
    both = identify(pair, VEHICLE)
    first = identify(pair[:1], VEHICLE)
    second = identify(pair[1:], VEHICLE, prior=first.posterior())
    difference = (second.estimates - both.estimates) / both.standard_deviations
    assert np.abs(difference).max() < 1.0
    np.testing.assert_allclose(second.standard_deviations, both.standard_deviations, rtol=0.3)
    assert second.identifiable == both.identifiable


@pytest.mark.slow
def test_what_is_not_asked_for_is_in_the_intervals_unless_it_is_held(pair):
    asked = ["camber_stiffness", "cornering_stiffness"]
    held = identify(pair, VEHICLE, parameters=asked, hold_others=True, profiles=True)
    counted = identify(pair, VEHICLE, parameters=asked, profiles=True)
    everything = identify(pair, VEHICLE, profiles=True)
    for found in (held, counted):
        assert found.names == ("cornering_stiffness", "camber_stiffness")
        assert found.covariance.shape == (2, 2)
    for name in counted.names:  # the yaw inertia of the drives is not that of the file
        truth, e = TRUTH[NAMES.index(name)], counted.parameters[name]
        assert e.low < truth < e.high
        assert not held.parameters[name].low < truth < held.parameters[name].high
        assert (e.low, e.high) == (
            everything.parameters[name].low,
            everything.parameters[name].high,
        )
    assert held.fixed["yaw_inertia"] == VEHICLE.yaw_inertia
    assert not held.others
    assert counted.others["yaw_inertia"].estimate == everything.parameters["yaw_inertia"].estimate
    written = document_of(counted).to_json()
    assert list(written["parameters"]) == list(counted.names)
    assert "yaw_inertia" in written["others"]


@pytest.mark.slow
def test_the_same_drives_give_the_same_numbers(pair):
    a, b = (document_of(identify(pair, VEHICLE, seed=1)).to_json() for _ in range(2))
    del a["seconds"], b["seconds"]
    assert json.dumps(a, allow_nan=False) == json.dumps(b, allow_nan=False)


# ---- bad input ----


@pytest.mark.slow
def test_three_seconds_leave_the_ranges_as_they_were(commands):
    drive = driven(commands["circle"], noise=0.01)
    short = {s: signal.between(0.0, 3.0) for s, signal in drive.signals.items()}
    found = identify([dataclasses.replace(drive, signals=short)], VEHICLE, profiles=True)
    assert not any(found.identifiable.values())
    for e in found.parameters.values():
        assert e.high - e.low > 0.8 * (e.range[1] - e.range[0])


def test_what_the_model_lacks_is_shown_where_the_vehicle_was():
    time = np.arange(0.0, 16.0, 0.1)
    straight = driven(Commands(time, 0.0 * time, np.minimum(1.0, 0.5 * time)), pose=(1.0, 2.0, 2.0))
    position = straight.signals[Sensor.POSITION]
    pushed = np.where(position.time[:, None] > 8.0, 0.3, 0.0)  # to the left of the way
    moved = Signal(position.time, position.values + pushed * [-np.sin(2.0), np.cos(2.0)])
    drive = dataclasses.replace(straight, signals={Sensor.POSITION: moved})
    (fit,) = identify([drive], VEHICLE).drives
    lack = fit.lack
    assert lack.time.tolist() == [k + 0.5 for k in range(16)]
    left, ahead = (lack.values[f"{side} of the model / m"] for side in ("left", "ahead"))
    assert left[9] - left[6] > 0.2
    assert np.abs(ahead).max() < 0.02
    assert lack.speed[-3:] == pytest.approx(1.0, abs=0.02)
    assert lack.standard_deviations["left of the model / m"][3] > 0.0


def test_drives_of_one_name_are_told_apart(pair):
    named = [dataclasses.replace(drive, name="bag") for drive in pair]
    found = identify(named, VEHICLE, parameters=["cornering_stiffness"], starts=1, hold_others=True)
    nuisances = document_of(found).nuisances
    assert list(nuisances) == ["bag", "bag (2)"]
    first, second = (drive.nuisances for drive in found.drives)
    assert nuisances == {"bag": first, "bag (2)": second}
    assert {test.drive for test in found.whiteness} == {"bag", "bag (2)"}


def test_names_of_parameters_are_checked(pair):
    with pytest.raises(IdentificationError, match="not an unknown parameter"):
        identify(pair, VEHICLE, parameters=["mass"])
    with pytest.raises(IdentificationError, match="no drive"):
        identify([], VEHICLE)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"level": 95}, "level = 95: must be between 0 and 1"),
        ({"level": 0.0}, "level = 0: must be between 0 and 1"),
        ({"starts": 0}, "starts = 0: must be 1 or more"),
        (
            {"effects": "steering-zero"},
            r"effects: a list of names is needed, as \['steering-zero'\]",
        ),
        ({"inputs": "measurd"}, "unknown inputs 'measurd'; one of: 'commands', 'measured'"),
        ({"loss": "robst"}, "unknown loss 'robst'; one of: 'squared', 'robust'"),
    ],
)
def test_arguments_are_checked(pair, options, message):
    with pytest.raises(ExcitationError, match=message):
        identify(pair, VEHICLE, **options)


def test_drives_are_lists(pair):
    with pytest.raises(IdentificationError, match="drives: a list of drives"):
        identify(pair[0], VEHICLE)
    with pytest.raises(IdentificationError, match="held_out: a list of drives"):
        identify(pair[:1], VEHICLE, held_out=pair[1])


def test_the_friction_that_was_used_is_that_of_the_fitted_vehicle(commands, pair):
    found = identify(pair, VEHICLE, starts=1)
    parameters = np.array([[e.estimate for e in found.parameters.values()]])
    used = [
        simulate(VEHICLE, c, parameters).feasibility.friction.value[0] for c in commands.values()
    ]
    assert found.friction_used == pytest.approx(max(used), rel=1e-6)


@pytest.mark.slow
def test_a_range_that_does_not_hold_the_truth_leaves_an_interval_at_its_end(pair):
    at = NAMES.index("yaw_inertia")
    least = 1.02 * TRUTH[at]
    vehicle = dataclasses.replace(
        VEHICLE, unknown={**VEHICLE.unknown, "yaw_inertia": (least, 1.5 * least)}
    )
    effects = ("steering-zero", "wheel-radius")
    found = identify(pair, vehicle, effects=effects, weighed=True, starts=1)
    e = found.parameters["yaw_inertia"]
    assert e.estimate == pytest.approx(least)
    assert e.low == pytest.approx(least)
    assert e.high > e.low


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"profiles": True}, {"weighed": True}])
def test_what_the_drives_pull_far_beyond_its_range_is_not_shown(pair, options):
    stiffness = (1.2 * TRUTH[0], 2.0 * TRUTH[0])  # it holds the nominal value
    vehicle = dataclasses.replace(
        VEHICLE, unknown={**VEHICLE.unknown, "cornering_stiffness": stiffness}
    )
    found = identify(pair, vehicle, effects=("steering-zero",), starts=1, **options)
    e = found.parameters["cornering_stiffness"]
    assert e.estimate == pytest.approx(stiffness[0])
    assert (e.low, e.high) == pytest.approx(stiffness)
    assert not any(found.identifiable.values())  # the drives miss each other: all are doubted
    assert found.missed > 0.0
    assert any("cornering_stiffness" in combination.weights for combination in found.hidden)
    assert found.posterior().covariance[0, 0] ** 0.5 > 0.25 * (stiffness[1] - stiffness[0])
