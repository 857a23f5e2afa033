"""Recordings of other systems as bags: what was measured comes out as it went in."""

import dataclasses

import numpy as np
import pytest
from simulated_drives import VEHICLE, commands_of_pair, driven

from parameter_identification.drives.imported import recording_of, write_bag
from parameter_identification.drives.measured import STEERING_LATE, Input, Sensor
from parameter_identification.drives.measured_from_bag import measured_drive, read_measured_drive
from parameter_identification.drives.reader import read_drive
from parameter_identification.drives.samples import Samples
from parameter_identification.drives.simulated import SensorNoise
from parameter_identification.drives.table import EstimatedMap, SteeringMap
from trajectory_recorder.bag.reader import BagReader
from trajectory_recorder.bag.topics import jazzy
from tricycle_core.errors import IdentificationError, JudgeError
from tricycle_core.stamps import SECOND

pytestmark = pytest.mark.slow  # every test writes a whole drive
ALL = {sensor: SensorNoise(1e-3, rate=50.0) for sensor in Sensor}


@pytest.fixture(scope="module")
def drive():
    return driven(commands_of_pair()["lane"], noise=0.01, others=ALL.items(), standstill=1.0)


def test_a_bag_holds_every_sensor_of_the_recording(drive, tmp_path):
    start = write_bag(recording_of(drive), VEHICLE, SteeringMap(), tmp_path / "bag")
    again = read_measured_drive(tmp_path / "bag", VEHICLE)
    assert again.signals.keys() == drive.signals.keys() == set(Sensor)
    # that of the driven wheel is the motor's
    assert again.signals[Sensor.WHEEL_SPEEDS].wheels == ("left", "right")
    # another system logged it: the commands go on where the steering may have been late
    assert again.steering_late == STEERING_LATE
    last = max(signal.time[-1] for signal in again.signals.values())
    assert last <= again.commands.duration - STEERING_LATE
    begin = float(drive.signals[Sensor.POSITION].time[0]) + start
    for sensor, signal in again.signals.items():
        at = np.searchsorted(drive.signals[sensor].time - begin, signal.time - 1e-6)
        values = drive.signals[sensor].values[at, : signal.values.shape[1]]
        np.testing.assert_allclose(signal.values, values, atol=1e-9)


def test_a_bag_of_an_earlier_version_is_judged_only(drive, tmp_path):
    """It does not hold what its steering was made from."""
    write_bag(recording_of(drive), VEHICLE, SteeringMap(), tmp_path / "bag")
    earlier = read_drive(tmp_path / "bag")
    metadata = {k: v for k, v in earlier.metadata.items() if k != "steering_map_from"}
    earlier = dataclasses.replace(earlier, metadata=metadata)
    with pytest.raises(
        IdentificationError, match=r"an earlier version, .*: import the table again"
    ):
        measured_drive(earlier, VEHICLE)


def test_what_was_not_measured_is_not_in_the_bag(drive, tmp_path):
    few = {s: drive.signals[s] for s in (Sensor.POSITION, Sensor.YAW_RATE, Sensor.WHEEL_SPEED)}
    recording = recording_of(dataclasses.replace(drive, signals=few))
    write_bag(recording, VEHICLE, SteeringMap(), tmp_path / "bag")
    assert read_measured_drive(tmp_path / "bag", VEHICLE).signals.keys() == few.keys()


def test_sensors_that_come_without_their_companions_are_in_the_bag(drive, tmp_path):
    alone = (Sensor.POSITION, Sensor.LATERAL_ACCELERATION, Sensor.MOTOR_TORQUE)
    recording = recording_of(
        dataclasses.replace(drive, signals={s: drive.signals[s] for s in alone})
    )
    write_bag(recording, VEHICLE, SteeringMap(), tmp_path / "bag")
    assert read_measured_drive(tmp_path / "bag", VEHICLE).signals.keys() == {*alone}


def test_a_wheel_that_the_vehicle_lacks_is_refused(drive, tmp_path):
    recording = recording_of(drive)
    more = {**recording.more, "wheel_speeds.rera": recording.more["wheel_speeds.rear"]}
    with pytest.raises(IdentificationError, match="'rera' is not an entry; did you mean rear"):
        write_bag(
            dataclasses.replace(recording, more=more), VEHICLE, SteeringMap(), tmp_path / "bag"
        )
    assert not (tmp_path / "bag").exists()


def test_speeds_made_from_the_poses_are_not_identified_from(drive, tmp_path):
    recording = recording_of(drive)
    del recording.more["speed_command"]
    assert write_bag(recording, VEHICLE, SteeringMap(), tmp_path / "bag") is not None
    with pytest.raises(IdentificationError, match="identify from the table"):
        read_measured_drive(tmp_path / "bag", VEHICLE)


def test_a_map_estimated_from_the_poses_is_not_identified_from(drive, tmp_path):
    steering = EstimatedMap(gain=1.0, offset=0.01)
    assert write_bag(recording_of(drive), VEHICLE, steering, tmp_path / "bag") is not None
    assert read_drive(tmp_path / "bag").commands is not None  # it can be judged
    with pytest.raises(IdentificationError, match=r"from the turns.*; identify from the table"):
        read_measured_drive(tmp_path / "bag", VEHICLE)


def test_a_bag_without_a_start_names_the_table_to_identify_from(drive, tmp_path):
    moving = driven(commands_of_pair()["lane"], noise=0.01, others=ALL.items())
    assert write_bag(recording_of(moving), VEHICLE, SteeringMap(), tmp_path / "bag") is None
    with pytest.raises(
        JudgeError, match=r"has no standstill before a drive; identify from the table"
    ):
        read_measured_drive(tmp_path / "bag", VEHICLE)


def test_a_filter_of_the_poses_is_noted_in_the_bag(drive, tmp_path):
    recording = dataclasses.replace(recording_of(drive), pose_filter=0.15)
    write_bag(recording, VEHICLE, SteeringMap(), tmp_path / "bag")
    assert read_measured_drive(tmp_path / "bag", VEHICLE).pose_filter == 0.15


def test_a_measured_steering_angle_is_in_the_bag(drive, tmp_path):
    recording = recording_of(drive)
    time = np.arange(0.0, recording.time[-1], 0.02)
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(time))
    angles = Samples(time, recording.steering.at(time) + noise)
    recording = dataclasses.replace(recording, steering=angles, steering_measured=True)
    steering = SteeringMap(gain=0.5)
    start = write_bag(recording, VEHICLE, steering, tmp_path / "bag")
    again = read_measured_drive(tmp_path / "bag", VEHICLE)
    assert Input.STEERING in again.measured_throughout
    assert 1e-5 < again.turn_std < 1e-2  # of what the smoothing leaves
    angle = again.steering_angle
    expected = steering.angle(recording.steering.at(angle.time + start))
    np.testing.assert_allclose(angle.values, expected, atol=1e-9)


def test_a_clock_that_begins_below_zero_begins_at_zero_in_the_bag(drive, tmp_path):
    recording = dataclasses.replace(recording_of(drive), start=-3.0)
    start = write_bag(recording, VEHICLE, SteeringMap(), tmp_path / "bag")
    assert read_drive(tmp_path / "bag").start == round(start * SECOND)


def test_times_that_no_message_can_hold_are_refused(drive, tmp_path):
    recording = dataclasses.replace(recording_of(drive), start=1.7e12)  # ms
    with pytest.raises(IdentificationError, match="give the unit of the column in the mapping"):
        write_bag(recording, VEHICLE, SteeringMap(), tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


def test_the_state_of_a_bag_comes_as_the_drivers(drive, tmp_path):
    write_bag(recording_of(drive), VEHICLE, SteeringMap(), tmp_path / "bag")
    with BagReader(tmp_path / "bag") as bag:
        stamps = [message.stamp for message in bag.messages(["/maneuver/state"])]
    assert np.diff(stamps).max() <= 0.5 * SECOND


@pytest.mark.parametrize("wrong", ["x and y swapped", "degrees"])
def test_what_contradicts_the_poses_is_refused(drive, tmp_path, wrong):
    recording = recording_of(drive)
    changed = {"yaw": np.degrees(recording.yaw)}
    if wrong != "degrees":
        changed = {"x": recording.y, "y": recording.x}
    recording = dataclasses.replace(recording, **changed)
    with pytest.raises(IdentificationError, match="are x and y swapped, is the unit of yaw"):
        write_bag(recording, VEHICLE, SteeringMap(), tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


def test_a_gap_of_the_steering_while_the_vehicle_moves_is_refused(drive, tmp_path):
    recording = recording_of(drive)
    time = recording.steering.time
    there = (time < 5.0) | (time > 7.0)
    steering = Samples(time[there], recording.steering.values[there])
    gap = dataclasses.replace(recording, steering=steering)
    with pytest.raises(IdentificationError, match=r"gap of the steering of more than .* at 4\.99"):
        write_bag(gap, VEHICLE, SteeringMap(), tmp_path / "bag")


def test_a_sensor_heard_before_the_first_pose_has_a_time(drive, tmp_path):
    recording = recording_of(drive)
    rate = recording.more["yaw_rate"]
    early = dataclasses.replace(rate, time=rate.time - rate.time[0] - 0.004)
    write_bag(
        dataclasses.replace(recording, more=recording.more | {"yaw_rate": early}),
        *(VEHICLE, SteeringMap(), tmp_path / "bag"),
    )
    with BagReader(tmp_path / "bag") as bag:
        assert bag.span[0] == 0


def test_an_acceleration_that_was_not_measured_is_no_number(drive, tmp_path):
    recording = recording_of(drive)
    time = recording.more["acceleration_y"].time
    ahead = Samples(time[:100], np.full(100, 1.23))
    write_bag(
        dataclasses.replace(recording, more=recording.more | {"acceleration_x": ahead}),
        *(VEHICLE, SteeringMap(), tmp_path / "bag"),
    )
    with BagReader(tmp_path / "bag") as bag:
        imu = [
            jazzy().deserialize_cdr(data, "sensor_msgs/msg/Imu")
            for _, _, data, _ in bag.messages({"/imu"})
        ]
    of_force = [m.linear_acceleration for m in imu if m.linear_acceleration_covariance[0] != -1.0]
    assert [a.x for a in of_force[:100]] == [1.23] * 100
    assert np.isnan([a.x for a in of_force[100:]]).all()
    assert np.isfinite([a.y for a in of_force]).all()
