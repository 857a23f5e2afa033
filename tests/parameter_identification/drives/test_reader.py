"""Drives out of bags: read once, with all that judging and identifying need."""

import shutil
from pathlib import Path

import driven_bags
import numpy as np
import pytest
from driven_bags import (
    START,
    TYPES,
    VEHICLE,
    Scene,
    SimulatedBag,
    header,
    imu,
    pose_stamped,
    sideways,
    status,
    velocities,
)

from parameter_identification.drives.measured_from_bag import measured_drive, read_measured_drive
from parameter_identification.drives.reader import read_drive
from parameter_identification.drives.recorded import TopicNames
from parameter_identification.judging.judgement import judge, judge_drive
from trajectory_recorder.bag.conversion import convert
from tricycle_core.errors import JudgeError


@pytest.mark.slow
def test_after_one_pass_a_drive_is_judged_and_identified_without_its_bag(tmp_path: Path) -> None:
    bag = SimulatedBag().write(tmp_path / "bag")
    judgement, measured = judge(bag), read_measured_drive(bag, VEHICLE)
    drive = read_drive(bag)
    shutil.rmtree(bag)
    assert judge_drive(drive).te == judgement.te
    again = measured_drive(drive, VEHICLE)
    assert again.signals.keys() == measured.signals.keys()
    for sensor, signal in again.signals.items():
        np.testing.assert_array_equal(signal.values, measured.signals[sensor].values)


def test_sensors_are_timed_from_the_start_event(tmp_path: Path) -> None:
    drive = read_drive(SimulatedBag().write(tmp_path / "bag"))
    assert drive.start == START
    assert drive.joint_states is not None
    assert drive.imu is not None
    assert drive.joint_states.time[0] == pytest.approx(-1.5)
    angle = drive.joint_states.steering_motor_angle
    assert angle[0] == 0.0
    assert np.nanmax(angle) > 0.5  # the circle's
    assert drive.joint_states.wheel_rate[-1] == pytest.approx(1.0 / VEHICLE.tyre_radius, abs=0.1)
    assert drive.imu.yaw_rate[-1] == pytest.approx(1.0 / 3.0, abs=0.1)


@pytest.mark.slow
def test_sensors_are_left_out_where_they_are_not_wanted_or_not_there(tmp_path: Path) -> None:
    bag = SimulatedBag(without=("/imu",)).write(tmp_path / "bag")
    drive = read_drive(bag, sensors=False)
    assert drive.joint_states is None
    assert read_drive(bag).imu is None
    asked = TopicNames(joint_states="arm/joint_states")
    named = "holds no sensor_msgs/msg/JointState in arm/joint_states; it holds: /joint_states"
    with pytest.raises(JudgeError, match=named):
        read_drive(bag, topics=asked)


@pytest.mark.slow
def test_a_drive_that_was_ended_early_ends_there_and_is_not_judged(tmp_path: Path) -> None:
    bag = SimulatedBag(ended_early=6.0).write(tmp_path / "bag")
    drive = read_drive(bag)
    assert drive.ended_early == 6.0
    assert drive.duration == pytest.approx(6.0, abs=0.1)
    measured = measured_drive(drive, VEHICLE)
    whole = SimulatedBag().commands()
    assert measured.commands.duration == 6.0
    np.testing.assert_allclose(
        measured.commands.speed[:-1], whole.speed[: len(measured.commands.speed) - 1]
    )
    assert all(signal.time[-1] <= 6.0 for signal in measured.signals.values())
    with pytest.raises(JudgeError, match=r"ended early, after 6\.00 s"):
        judge_drive(drive)


def test_a_bag_without_the_end_of_its_drive_is_not_whole(tmp_path: Path) -> None:
    def cut(messages):
        messages["/maneuver/state"] = messages["/maneuver/state"][:-1]

    assert read_drive(Scene().write(tmp_path / "bag")).complete
    assert not read_drive(Scene(edit=cut).write(tmp_path / "cut")).complete


@pytest.mark.parametrize(
    ("cut", "why"), [(0, "nothing was driven$"), (200, "the bag is not whole: it was cut off")]
)
def test_without_a_start_event_a_bag_that_is_not_whole_is_said_to_be(tmp_path, cut, why):
    bag = Scene(edit=lambda messages: messages["/maneuver/state"].clear()).write(tmp_path / "bag")
    (file,) = bag.glob("*.mcap")
    content = file.read_bytes()
    file.write_bytes(content[: len(content) - cut])
    with pytest.raises(JudgeError, match=f"holds no start event: {why}"):
        read_drive(bag)


def test_a_bag_of_a_way_back_without_its_drive_is_said_to_be_one(tmp_path):
    def only_return(messages):
        (at, _), *_ = messages["/maneuver/state"]
        messages["/maneuver/state"] = [(at, status("returning", ""))]

    bag = Scene(edit=only_return).write(tmp_path / "bag")
    with pytest.raises(JudgeError, match="no start event: it holds a way back to the start only"):
        read_drive(bag)


def test_a_way_back_after_the_drive_may_be_aborted(tmp_path: Path) -> None:
    def go_back(messages):
        end, _ = messages["/maneuver/state"][-1]
        messages["/maneuver/state"] += [
            (end + 10**8, status("returning", "")),
            (end + 2 * 10**8, status("aborted", "", reason="stopped by the operator")),
        ]

    assert read_drive(Scene(edit=go_back).write(tmp_path / "bag")).complete


def test_a_second_imu_in_another_namespace_is_left_alone(tmp_path: Path) -> None:
    ours, other = (imu(START + 10**9, rate) for rate in (0.1, 0.7))
    scene = Scene(deviation=sideways(0.1))
    scene.more = {
        "/imu": ("sensor_msgs/msg/Imu", [(START + 10**9, ours)]),
        "/camera/imu": ("sensor_msgs/msg/Imu", [(START + 10**9, other)]),
    }
    drive = read_drive(scene.write(tmp_path / "bag"))
    assert drive.imu is not None
    assert drive.imu.yaw_rate.tolist() == [0.1]
    scene.more["/arm/imu"] = scene.more.pop("/imu")
    with pytest.raises(JudgeError, match="/arm/imu and /camera/imu: name the one to use"):
        read_drive(scene.write(tmp_path / "two"))


def test_wheels_may_come_in_messages_of_their_own_and_a_gyro_may_say_that_it_is_none(
    tmp_path: Path,
) -> None:
    times = [START + 10**7 * i for i in range(4)]
    rates = [("left", 1.0), ("right", 4.0), ("left", 3.0), ("right", 8.0)]
    states = [
        (time, velocities(time, {f"{wheel}_wheel_spin_joint": rate}))
        for time, (wheel, rate) in zip(times, rates, strict=True)
    ]
    none = imu(START, 0.0)
    none.angular_velocity_covariance[0] = -1.0
    scene = Scene(deviation=sideways(0.1))
    scene.more = {
        "/joint_states": ("sensor_msgs/msg/JointState", states),
        "/imu": ("sensor_msgs/msg/Imu", [(START, none)]),
    }
    drive = read_drive(scene.write(tmp_path / "bag"))
    left, right = drive.wheel_rates["left"], drive.wheel_rates["right"]
    np.testing.assert_allclose([left.time, left.values], [[0.0, 0.02], [1.0, 3.0]])
    np.testing.assert_allclose([right.time, right.values], [[0.01, 0.03], [4.0, 8.0]])
    assert drive.imu is not None
    assert np.isnan(drive.imu.yaw_rate).all()


def test_steering_and_rear_wheel_may_come_in_messages_of_their_own(tmp_path: Path) -> None:
    states = []
    for i in range(200):
        at = START + 10**7 * i
        states.append((at, velocities(at, {"steering_motor_joint": 0.0}, [1e-3 * i])))
        states.append((at + 10**6, velocities(at + 10**6, {"rear_wheel_joint": 3.0})))
    scene = Scene(deviation=sideways(0.1))
    scene.more = {"/joint_states": ("sensor_msgs/msg/JointState", states)}
    joints = read_drive(scene.write(tmp_path / "bag")).joint_states
    assert joints is not None
    angle, rate = joints.steering_motor_angle, joints.wheel_rate
    np.testing.assert_allclose(angle[~np.isnan(angle)], 1e-3 * np.arange(200))
    np.testing.assert_allclose(joints.time[~np.isnan(angle)], 0.01 * np.arange(200))
    np.testing.assert_array_equal(rate[~np.isnan(rate)], np.full(200, 3.0))


def test_an_accelerometer_that_tells_zeros_only_is_none(tmp_path: Path) -> None:
    scene = Scene(deviation=sideways(0.1))
    samples = [(START + 10**7 * i, imu(START + 10**7 * i, 0.1)) for i in range(20)]
    scene.more = {"/imu": ("sensor_msgs/msg/Imu", samples)}
    drive = read_drive(scene.write(tmp_path / "bag"))
    assert drive.imu is not None
    assert np.isnan(drive.imu.lateral_acceleration).all()
    assert (drive.imu.yaw_rate == 0.1).all()


def test_set_points_of_others_than_the_driver_do_not_count(tmp_path: Path) -> None:
    """The bridge refused them; those of the driver may be recorded in another order."""
    joints, first = ["steering_motor_joint", "rear_wheel_joint"], START - 10**9
    nothing = np.zeros(0)

    def played(tick: int, sender: str, angle: float) -> tuple[int, object]:
        stamp = START + tick * 10**7
        angles = nothing if tick == 50 else np.array([angle, 0.0])  # one tells the speed alone
        values = angles, np.array([0.0, 3.0]), nothing
        return stamp, TYPES["sensor_msgs/msg/JointState"](header(stamp, sender), joints, *values)

    def edit(messages: dict[str, list]) -> None:
        point = TYPES["trajectory_msgs/msg/JointTrajectoryPoint"]
        after = TYPES["builtin_interfaces/msg/Duration"]
        points = [
            point(np.zeros(2), np.array([0.0, 3.0]), nothing, nothing, after(sec=t, nanosec=0))
            for t in (0, 8)
        ]
        kind = TYPES["trajectory_msgs/msg/JointTrajectory"]
        messages["/maneuver/commands"] = [(first, kind(header(first, "p1"), joints, points))]
        ticks = [1, 0, *range(2, 800)]
        messages["/joint_commands"] = [
            played(tick, sender, angle)
            for tick in ticks
            for sender, angle in (("/maneuver_driver", 0.1 * (tick < 200)), ("/teleop", 0.5))
        ]
        for at, (recorded, message) in enumerate(messages["/maneuver/state"]):
            values = {pair.key: pair.value for pair in message.values}
            told = status(
                values.pop("state"),
                values.pop("start_time"),
                **values,
                commander="/maneuver_driver",
            )
            messages["/maneuver/state"][at] = (recorded, told)

    path = TYPES["nav_msgs/msg/Path"](header(first), [pose_stamped(2 * 10**9, 0.0, 0.0, 0.0)])
    more = {"/maneuver/lead_in": ("nav_msgs/msg/Path", [(first, path)])}
    drive = read_drive(Scene(edit=edit, more=more).write(tmp_path / "bag"))
    assert drive.lead_in is not None
    assert set(drive.lead_in.steering_motor_angle.tolist()) == {0.1}
    assert np.all(np.diff(drive.lead_in.time) > 0.0)


def test_the_second_drive_of_a_bag_can_be_cut_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = Scene().write(tmp_path / "first")
    monkeypatch.setattr(driven_bags, "START", START + 30 * 10**9)
    second = Scene().write(tmp_path / "second")
    convert([first, second], tmp_path / "both")
    with pytest.raises(JudgeError, match="2 maneuvers were started"):
        read_drive(tmp_path / "both")
    convert([tmp_path / "both"], tmp_path / "part", start=25.0)
    assert read_drive(tmp_path / "part").start == START + 30 * 10**9
