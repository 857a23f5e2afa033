"""Drives from which nothing can be identified."""

import dataclasses
from contextlib import nullcontext
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from simulated_drives import VEHICLE, commands_of_pair, driven, driven_pair

from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.poses import PlanarTrajectory
from parameter_identification.drives.simulated import SensorNoise
from parameter_identification.estimation.checks import (
    check_drives,
    check_motion,
    check_reference,
    check_signs,
    same_drives,
)
from tricycle_core.errors import IdentificationError
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate


@pytest.fixture(scope="module")
def pair():
    return driven_pair()


def with_reference(drive, vehicle):
    motion = simulate(vehicle, drive.commands)
    reference = PlanarTrajectory(motion.time, motion.x[0], motion.y[0], motion.yaw[0])
    return dataclasses.replace(drive, reference=reference)


def test_the_same_drive_does_not_count_twice(pair):
    check_drives(pair, VEHICLE)
    with pytest.raises(IdentificationError, match="circle and again are the same drive"):
        check_drives([pair[0], dataclasses.replace(pair[0], name="again")], VEHICLE)
    with pytest.raises(IdentificationError, match="circle is given twice"):
        check_drives([pair[0], pair[0]], VEHICLE)
    position = pair[0].signals[Sensor.POSITION]
    shorter = dataclasses.replace(position, time=position.time[:-9], values=position.values[:-9])
    signals = pair[0].signals | {Sensor.POSITION: shorter}
    cut = dataclasses.replace(pair[0], name="cut", signals=signals)
    with pytest.raises(IdentificationError, match="circle and cut are the same drive"):
        check_drives([pair[0], cut], VEHICLE)


@pytest.mark.parametrize("rounding", [0.01, 0.02])
def test_drives_of_one_maneuver_are_not_the_same_because_positions_are_rounded(rounding):
    ways = [
        driven(commands_of_pair()["circle"], noise=0.002, seed=i).signals[Sensor.POSITION].values
        for i in range(3)
    ]
    ways = [rounding * np.round(way / rounding) for way in ways]
    assert same_drives(ways) == {}
    assert same_drives([*ways, ways[1][20:-20]]) == {3: 1}


def test_each_drive_is_compared_with_those_that_count():
    rng = np.random.default_rng(0)
    way = np.vstack([np.zeros(2), rng.normal(size=(40, 2))])
    other = np.vstack([np.zeros(2), rng.normal(size=(40, 2))])  # of the same start
    assert same_drives([way, other, way[:-5], other[10:], way[:25]]) == {2: 0, 3: 1, 4: 0}
    assert same_drives([way[:25], way[10:], way[20:]]) == {1: 0}
    assert same_drives([way, other]) == {}
    assert same_drives([way]) == same_drives([]) == {}


def test_too_little_motion_is_refused(pair):
    still = Commands([0.0, 20.0], [0.0, 0.0], [0.01, 0.01])
    with pytest.raises(IdentificationError, match="too little motion"):
        check_motion(driven(still))
    moment = {s: signal.between(0.0, 0.5) for s, signal in pair[0].signals.items()}
    with pytest.raises(IdentificationError, match="11 positions are too few"):
        check_motion(dataclasses.replace(pair[0], signals=moment))
    assert Sensor.POSITION in moment


@pytest.mark.parametrize(
    ("sensor", "turned", "message"),
    [
        (Sensor.HEADING, -1.0, "heading has the opposite sign .* positive to the left"),
        (Sensor.YAW_RATE, -1.0, "yaw rate has the opposite sign .* positive to the left"),
        (Sensor.LATERAL_ACCELERATION, -0.9, "lateral acceleration has the opposite sign"),
        (Sensor.WHEEL_SPEED, -1.1, "wheel speed has the opposite sign .* positive forward"),
        (Sensor.YAW_RATE, 180.0 / np.pi, "yaw rate is 5. times what the commands .* in rad/s"),
        (Sensor.WHEEL_SPEED, 0.1, "wheel speed is 0.1 times"),
        (Sensor.YAW_RATE, 0.0, "yaw rate is 0 times what the commands give"),
        (Sensor.WHEEL_SPEED, 0.0, "wheel speed is 0 times .*, leave out its topic"),
        (Sensor.YAW_RATE, 0.3, ""),
        (Sensor.LATERAL_ACCELERATION, 2.0, ""),
    ],
)
def test_a_sensor_whose_axis_points_the_other_way_is_refused(sensor, turned, message):
    drive = driven(commands_of_pair()["lane"], others=[(sensor, SensorNoise(1e-3))])
    check_signs([drive], VEHICLE)
    other = with_values(drive, sensor, turned)
    if message:
        with pytest.raises(IdentificationError, match=message):
            check_signs([other], VEHICLE)
    else:
        check_signs([other], VEHICLE)


@pytest.mark.parametrize(
    ("factor", "message"),
    [
        (-1.0, "steering angle has the opposite sign .* to the left, in rad"),
        (180.0 / np.pi, "steering angle is 57 times"),
        (0.5, ""),
    ],
)
def test_a_steering_angle_of_the_other_sign_or_unit_is_refused(factor, message):
    drive = driven(commands_of_pair()["lane"], steering_step=0.002)
    told = dataclasses.replace(drive.steering_angle, values=factor * drive.steering_angle.values)
    with pytest.raises(IdentificationError, match=message) if message else nullcontext():
        check_signs([dataclasses.replace(drive, steering_angle=told)], VEHICLE)


def with_values(drive, sensor, factor):
    signal = dataclasses.replace(
        drive.signals[sensor], values=factor * drive.signals[sensor].values
    )
    return dataclasses.replace(drive, signals={**drive.signals, sensor: signal})


def test_every_drive_is_looked_at_by_itself_but_windows_together():
    gyro = [(Sensor.YAW_RATE, SensorNoise(1e-3))]
    circle, lane = (driven(c, others=gyro, name=n) for n, c in commands_of_pair().items())
    with pytest.raises(IdentificationError, match="lane: the yaw rate has the opposite"):
        check_signs([circle, with_values(lane, Sensor.YAW_RATE, -1.0)], VEHICLE)
    turns = Commands(5.0 * np.arange(5), 0.5 * np.array([1, -1, 1, -1, 1]), np.full(5, 0.9))
    whole = driven(turns, others=gyro)
    windows = [
        dataclasses.replace(
            whole, signals={s: v.between(t - 2.0, t + 2.0) for s, v in whole.signals.items()}
        )
        for t in (5.0, 10.0, 15.0)
    ]
    one_odd = [with_values(windows[0], Sensor.YAW_RATE, -1.0), *windows[1:]]
    check_signs(one_odd, VEHICLE)
    with pytest.raises(IdentificationError, match="yaw rate has the opposite"):
        check_signs([with_values(w, Sensor.YAW_RATE, -1.0) for w in windows], VEHICLE)


@pytest.mark.parametrize("zero", [-0.06, 0.06])
def test_a_drive_almost_straight_on_may_turn_the_other_way(zero):
    ahead = Commands([0.0, 30.0], [0.03, 0.03], [1.5, 1.5])
    vehicle = VEHICLE.replace(steering_offset=zero)
    sensors = [(s, SensorNoise(1e-3)) for s in (Sensor.HEADING, Sensor.YAW_RATE)]
    check_signs([driven(ahead, vehicle=vehicle, others=sensors)], VEHICLE)


def test_a_gyro_that_is_0_straight_on_is_let_through():
    ahead = Commands([0.0, 30.0], [0.0, 0.0], [1.5, 1.5])
    drive = driven(ahead, others=[(Sensor.YAW_RATE, SensorNoise(1e-3))])
    check_signs([with_values(drive, Sensor.YAW_RATE, 0.0)], VEHICLE)


@pytest.mark.parametrize(
    ("turned", "message"),
    [
        (lambda values: values, None),
        (lambda values: values[:, ::-1] * [1.0, -1.0], None),  # turned by 90 degrees
        (lambda values: values[:, ::-1], "positions are the mirror image of what"),  # north, east
        (lambda values: values * [1.0, -1.0], "positions are the mirror image of what"),
        (lambda values: 3.28 * values, r"positions are 3\.3 times what"),
        (lambda values: 100.0 * values, "positions are 99 times what"),
    ],
)
def test_positions_in_a_frame_or_unit_of_another_kind_are_refused(turned, message):
    drive = driven(commands_of_pair()["circle"], pose=(3.0, -2.0, 2.5))
    signal = drive.signals[Sensor.POSITION]
    signals = {Sensor.POSITION: dataclasses.replace(signal, values=turned(signal.values))}
    with nullcontext() if message is None else pytest.raises(IdentificationError, match=message):
        check_signs([dataclasses.replace(drive, signals=signals)], VEHICLE)


def test_signs_are_right_backwards_too():
    back = Commands([0.0, 5.0, 10.0, 15.0], [0.5, -0.5, 0.5, 0.5], [-0.7, -0.7, -0.7, -0.2])
    sensors = [(s, SensorNoise(1e-3)) for s in (Sensor.HEADING, Sensor.YAW_RATE)]
    drive = driven(back, others=[*sensors, (Sensor.WHEEL_SPEED, SensorNoise(1e-3))])
    check_signs([drive], VEHICLE)
    with pytest.raises(IdentificationError, match="wheel speed has the opposite sign"):
        check_signs([with_values(drive, Sensor.WHEEL_SPEED, -1.0)], VEHICLE)


@pytest.mark.slow
def test_a_drive_planned_for_another_vehicle_is_refused(pair):
    cargo = load_vehicle(Path(str(resources.files("tricycle_sim") / "cargo_tadpole.yaml")))
    with pytest.raises(IdentificationError, match="another vehicle"):
        check_drives([with_reference(pair[0], cargo)], VEHICLE)
    check_drives([with_reference(pair[0], cargo)], VEHICLE, other_vehicle=True)


@pytest.mark.slow
def test_a_drive_planned_with_other_nominal_values_is_taken(pair):
    planned_with = VEHICLE.replace(cornering_stiffness=800.0, camber_stiffness=60.0)
    check_reference(with_reference(pair[0], planned_with), VEHICLE)


@pytest.mark.slow
def test_a_vehicle_file_that_is_better_known_than_the_plan_was_is_taken(pair):
    narrow = dataclasses.replace(
        VEHICLE.replace(cornering_stiffness=800.0),
        unknown={**VEHICLE.unknown, "cornering_stiffness": (760.0, 840.0)},
    )
    check_reference(with_reference(pair[0], VEHICLE), narrow)
