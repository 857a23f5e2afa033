"""Effects: their table, their derivatives, and that they are found."""

import dataclasses

import numpy as np
import pytest
from simulated_drives import NAMES, TRUTH, VEHICLE, commands_of_pair, driven, shares

from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.simulated import SensorNoise
from parameter_identification.estimation.model import DriveModel
from parameter_identification.identification import identify
from tricycle_core.errors import VehicleError
from tricycle_sim.commands import Commands
from tricycle_sim.effects import EFFECTS, effects_of, extend, named_effects
from tricycle_sim.vehicle.batch import simulate

ZERO = np.radians(1.5)  # of the steering
EXACT = {sensor: SensorNoise(0.0, rate=20.0) for sensor in Sensor}


def off_centre(**others):
    """Return the pair of drives of a vehicle whose steering is off by ZERO."""
    vehicle = VEHICLE.replace(steering_offset=ZERO)
    return [
        driven(c, seed=i, name=name, vehicle=vehicle, **others)
        for i, (name, c) in enumerate(commands_of_pair().items())
    ]


def test_a_plan_that_names_a_deviation_is_refused():
    assert named_effects("all", planned=True) == EFFECTS
    assert named_effects("steering-zero", planned=True) == ("steering-zero",)
    with pytest.raises(VehicleError, match="speed-deviation: plans count no deviations"):
        named_effects("steering-zero,speed-deviation", planned=True)


def test_a_wrong_name_is_refused_with_the_right_one():
    with pytest.raises(VehicleError, match=r"'steering-zer' is not an effect; did you mean st"):
        effects_of(VEHICLE, ["steering-zer"])


def test_what_is_to_be_identified_is_no_effect():
    unknown = {**VEHICLE.unknown, "steering_offset": (-0.1, 0.1)}
    vehicle = dataclasses.replace(VEHICLE, unknown=unknown)
    names = {e.name for e in effects_of(vehicle, EFFECTS)}
    assert len(names) == len(EFFECTS) - 1
    assert "steering zero" not in names


def test_effects_keep_constants_possible():
    for e in effects_of(VEHICLE, EFFECTS):
        vehicle = extend(VEHICLE, e.parts)
        for value in (e.low, e.high):
            if np.isfinite(value):
                vehicle.replace(
                    **{n: vehicle.values[n] + c * value for n, c in e.constants.items()}
                )


def test_a_share_of_a_constant_that_is_0_is_no_effect():
    proportional = VEHICLE.replace(speed_gain_integral=0.0)
    assert effects_of(proportional, ()) == ()
    (found,) = effects_of(proportional, ("speed-loop",))
    assert dict(found.constants) == {"speed_gain_proportional": VEHICLE.speed_gain_proportional}
    (both,) = effects_of(VEHICLE, ("speed-loop",))
    assert (found.low, found.high) == (both.low, both.high)


def test_laws_with_more_constants_move_alike_without_the_effects():
    parts = {p: law for e in effects_of(VEHICLE, EFFECTS) for p, law in e.parts.items()}
    assert parts == {"servo": "geared", "tyre": "softened"}
    commands = commands_of_pair()["lane"]
    own, extended = (simulate(v, commands, TRUTH[None]) for v in (VEHICLE, extend(VEHICLE, parts)))
    np.testing.assert_allclose(extended.x, own.x, atol=1e-6)
    np.testing.assert_allclose(extended.yaw, own.yaw, atol=1e-6)


def test_a_vehicle_with_such_laws_needs_no_others():
    geared = dataclasses.replace(VEHICLE, parts={"servo": "geared", "front.tyre": "fiala"})
    found = {e.name: e for e in effects_of(geared, EFFECTS)}
    assert not found["steering play"].parts
    assert "tyre saturation" not in found  # not all its tyres are linear


def slopes(model, z, b):
    """Signal, derivative by each effect, and the same by central differences of the prediction."""
    before = model.predict(z, b)
    for i, n in enumerate(model.nuisances):
        if n.effect is not None:
            step = 2.0 * n.effect.step
            low, high = (model.predict(z, b + s * np.eye(len(b))[i]) for s in (-step, step))
            for p, lower, upper in zip(before, low, high, strict=True):
                slope = (upper.residual - lower.residual) / (2.0 * step)
                yield n.name, p.sensor, p.jacobian[:, :, len(z) + i], slope


@pytest.mark.slow
def test_derivatives_are_those_of_the_prediction():
    drive = driven(commands_of_pair()["lane"], noise=0.0, others=EXACT.items(), steering_step=0.01)
    smooth = [name for name in EFFECTS if name != "steering-play"]
    model = DriveModel(VEHICLE, drive, effects_of(VEHICLE, smooth))
    b = 0.1 * np.random.default_rng(0).standard_normal(len(model.nuisances))
    b = np.maximum(b, [n.low / n.std + 0.5 for n in model.nuisances])
    for name, _, found, slope in slopes(model, shares(TRUTH), b):
        tolerance = (0.1 if name.endswith("dead time") else 0.03) * np.abs(slope).max() + 1e-6
        np.testing.assert_allclose(found, slope, atol=tolerance, err_msg=name)


@pytest.mark.slow
def test_derivatives_by_the_play_are_about_those_of_the_prediction():
    drive = driven(commands_of_pair()["lane"], noise=0.0, others=EXACT.items())
    model = DriveModel(VEHICLE, drive, effects_of(VEHICLE, ["steering-play"]))
    b = np.where([n.name == "steering play" for n in model.nuisances], 1.0, 0.0)
    for _, sensor, found, slope in slopes(model, shares(TRUTH), b):
        if sensor in (Sensor.POSITION, Sensor.HEADING):  # rates jump where the gear turns round
            assert np.linalg.norm(found - slope) < 0.2 * np.linalg.norm(slope)


@pytest.mark.slow
def test_steering_zero_and_sensor_are_found_with_the_parameters():
    drives = off_centre()
    found = identify(drives, VEHICLE, effects=("steering-zero", "sensor-left"))
    (steering,) = (e for e in found.effects if e.name == "steering zero")
    assert steering.estimate == pytest.approx(ZERO, abs=4 * steering.standard_deviation)
    assert steering.standard_deviation < 0.002
    assert str(steering).startswith("steering zero: +1.")
    stiffness = found.parameters["cornering_stiffness"]
    assert stiffness.low <= TRUTH[0] <= stiffness.high
    assert stiffness.high - stiffness.low < 150.0
    assert found.white
    assert not identify(drives, VEHICLE).white


@pytest.mark.slow
def test_play_and_saturation_are_found_with_the_parameters():
    play = np.radians(0.6)
    values = {"servo_backlash": play, "tyre_saturation": 1.2}
    worn = dataclasses.replace(VEHICLE, parts={"servo": "geared", "tyre": "softened"})
    drives = [
        driven(c, seed=i, name=name, vehicle=worn.replace(**values))
        for i, (name, c) in enumerate(commands_of_pair().items())
    ]
    found = identify(drives, VEHICLE, effects=("steering-play", "tyre-saturation"))
    effects = {e.name: e for e in found.effects}
    expected = {"steering play": play, "tyre saturation": 1.2}
    for name, value in expected.items():
        e = effects[name]
        assert e.estimate == pytest.approx(value, abs=4 * e.standard_deviation)
        assert e.standard_deviation < 0.3 * value
    stiffness = found.parameters["cornering_stiffness"]
    assert stiffness.identifiable
    assert stiffness.low <= TRUTH[0] <= stiffness.high


@pytest.mark.slow
def test_a_drive_that_answers_late_is_found_with_the_parameters():
    late = 0.06  # s
    drives = []
    for i, (name, c) in enumerate(commands_of_pair().items()):
        rows = round(late / c.time[1])
        speed = np.concatenate([np.zeros(rows), c.speed[:-rows]])
        delayed = driven(Commands(c.time, c.steering_motor_angle, speed), seed=i, name=name)
        drives.append(dataclasses.replace(delayed, commands=c))
    found = identify(drives, VEHICLE, effects=("drive-dead-time",))
    (delay,) = found.effects
    assert delay.estimate == pytest.approx(late, abs=4 * delay.standard_deviation)
    assert delay.standard_deviation < 0.01
    for name, true in zip(NAMES, TRUTH, strict=True):
        assert found.parameters[name].low <= true <= found.parameters[name].high


@pytest.mark.slow
def test_weighed_effects_act_where_they_do_and_cost_less_than_all():
    drives = off_centre(others={Sensor.YAW_RATE: SensorNoise(0.002, rate=100.0)}.items())
    weighed, all_act = (
        identify(drives, VEHICLE, effects=EFFECTS, weighed=w) for w in (True, False)
    )
    acts = {e.name: e.acts for e in weighed.effects}
    assert acts["steering zero"] > 0.99
    assert acts["load sensitivity"] < 0.5
    for name, true in zip(NAMES, TRUTH, strict=True):
        narrow, wide = weighed.parameters[name], all_act.parameters[name]
        assert narrow.low <= true <= narrow.high
        assert narrow.high - narrow.low < 1.02 * (wide.high - wide.low)
    assert weighed.deviations == all_act.deviations == ()
    assert weighed.parameters["camber_stiffness"].identifiable
    assert not all_act.parameters["camber_stiffness"].identifiable
    assert ", acts with 100%" in str(next(e for e in weighed.effects if e.name == "steering zero"))


@pytest.mark.slow
def test_it_is_told_that_the_vehicle_moves_as_no_effect_can():
    sliding = dataclasses.replace(VEHICLE, parts={"tyre": "fiala"})
    gyro = {Sensor.YAW_RATE: SensorNoise(0.002, rate=100.0)}.items()
    drives = [
        driven(c, seed=i, name=name, vehicle=sliding, others=gyro)
        for i, (name, c) in enumerate(commands_of_pair().items())
    ]
    found = identify(drives, VEHICLE, effects=("speed-deviation", "turn-deviation"))
    assert found.white  # the deviations have taken it up
    assert found.deviations


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "size", "constants"),
    [
        ("wheel-radius", 0.01, {"tyre_radius": 1.01 * VEHICLE.tyre_radius, "speed_scale": 1.01}),
        ("relaxation-length", -0.5, {"lateral_relaxation_length": 0.1}),
    ],
)
def test_other_tyres_are_told_and_the_parameters_hold(effect, size, constants):
    other = VEHICLE.replace(**constants)
    sensors = {Sensor.YAW_RATE: SensorNoise(0.005), Sensor.WHEEL_SPEED: SensorNoise(0.003)}
    drives = [
        driven(commands, seed=i, name=name, vehicle=other, others=sensors.items())
        for i, (name, commands) in enumerate(commands_of_pair().items())
    ]
    found = identify(drives, VEHICLE, effects=[effect])
    (told,) = found.effects
    assert told.estimate == pytest.approx(size, abs=3.0 * told.standard_deviation)
    for (name, e), truth in zip(found.parameters.items(), TRUTH, strict=True):
        assert abs(e.estimate - truth) < 3.0 * e.standard_deviation, name
