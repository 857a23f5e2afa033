"""Judged bags against drives whose error is known."""

import argparse
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from driven_bags import DATUM, START, TYPES, Scene, header, sideways, stamp, status
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from parameter_identification.drives.reader import read_drive
from parameter_identification.judging.judgement import Anchor, TopicNames, judge
from trajectory_recorder.bag.topics import jazzy
from tricycle_cli.commands.judge import add_arguments
from tricycle_core.errors import BagError, JudgeError
from tricycle_core.readiness import Readiness


def test_te_of_a_known_deviation(tmp_path: Path) -> None:
    j = judge(Scene(deviation=sideways(0.2)).write(tmp_path / "bag"))
    assert j.te == pytest.approx(0.04 * 3 / 8, rel=1e-4)
    assert j.rms == pytest.approx(math.sqrt(j.te))
    assert j.max == pytest.approx(0.2, rel=1e-4)
    assert (j.rms_x, j.rms_y) == pytest.approx((0, j.rms), abs=1e-4)
    assert math.hypot(j.rms_along, j.rms_cross) == pytest.approx(j.rms)
    assert j.te_corrected == pytest.approx(j.te, rel=1e-6)
    assert (len(j.series.time), j.duration) == (10_000, 8.0)
    assert (j.anchor_pose.x, j.anchor_pose.y, j.anchor_pose.heading) == pytest.approx((3, -2, 2.5))
    assert j.te_by_anchor[Anchor.START] == pytest.approx(j.te, rel=1e-3)
    assert j.te_by_anchor[Anchor.FIT] < j.te
    assert j.plan_id == "p1"
    assert j.rms_heading < 1e-4


def test_along_cross_and_heading_are_those_of_the_reference_frame(tmp_path: Path) -> None:
    scene = Scene()
    ahead = Scene(
        deviation=lambda t: 0.1 * np.stack(
            [np.cos(scene.reference(t)[2]), np.sin(scene.reference(t)[2])]
        ) * (t > 0)
    )  # fmt: skip
    j = judge(ahead.write(tmp_path / "bag"))
    np.testing.assert_allclose(j.series.along[50:-20], 0.1, atol=1e-4)
    np.testing.assert_allclose(j.series.cross[50:-20], 0, atol=1e-4)


def test_a_lag_is_estimated_and_not_applied(tmp_path: Path) -> None:
    j = judge(Scene(lag=0.05, noise=0.002).write(tmp_path / "bag"))
    assert j.time_offset == pytest.approx(0.05, abs=5 * j.time_offset_deviation)
    assert 1e-5 < j.time_offset_deviation < 0.005
    assert j.te > 0.002  # 5 cm behind


@pytest.mark.slow
def test_the_lags_uncertainty_holds_over_seeds(tmp_path: Path) -> None:
    scores = []
    for seed in range(10):
        j = judge(Scene(lag=0.02, noise=0.01, seed=seed).write(tmp_path / f"{seed}"))
        scores.append((j.time_offset - 0.02) / j.time_offset_deviation)
    assert 0.6 < np.std(scores) < 1.5
    assert abs(np.mean(scores)) < 0.8


@pytest.mark.slow
def test_noise_is_found_and_taken_off(tmp_path: Path) -> None:
    true = 0.05**2 * 3 / 8
    found = [
        judge(
            Scene(deviation=sideways(0.05), noise=0.01, heading_noise=0.005, seed=seed).write(
                tmp_path / f"{seed}"
            )
        )
        for seed in range(8)
    ]
    assert np.mean([j.noise for j in found]) == pytest.approx(0.01, rel=0.05)
    raw = np.array([j.te for j in found])
    corrected = np.array([j.te_corrected for j in found])
    deviation = np.mean([j.te_deviation for j in found])
    assert np.mean(raw) > true + 1e-4  # 2 σ² · 2/3
    assert np.mean(corrected) == pytest.approx(true, abs=3 * deviation / math.sqrt(8))
    assert 0.4 < np.std(corrected) / deviation < 2.0


@pytest.mark.parametrize("poses", ["pose", "transform", "tf"])
@pytest.mark.parametrize("plugin", StoragePlugin)
def test_foreign_bags(tmp_path: Path, poses: str, plugin: StoragePlugin) -> None:
    scene = Scene(deviation=sideways(0.2), poses=poses, rate=50)
    types = scene.types()
    names = {"/odom": "/mocap/tricycle"}
    with RosbagsWriter(tmp_path / "bag", version=9, storage_plugin=plugin) as bag:
        for name, messages in scene.messages().items():
            topic = bag.add_connection(names.get(name, name), types[name], typestore=jazzy())
            for ns, message in messages:
                bag.write(topic, ns, jazzy().serialize_cdr(message, types[name]))
    j = judge(tmp_path / "bag", topics=TopicNames(pose="/mocap/tricycle"))
    assert j.te == pytest.approx(0.04 * 3 / 8, rel=1e-3)


@pytest.mark.slow
def test_satellite_fixes_need_datum_and_a_fitted_anchor(tmp_path: Path) -> None:
    bag = Scene(deviation=sideways(0.2), poses="fix").write(tmp_path / "bag")
    with pytest.raises(JudgeError, match="give the datum"):
        judge(bag)
    with pytest.raises(JudgeError, match=r"no heading .* 'fit'"):
        judge(bag, topics=TopicNames(datum=DATUM))
    exact = judge(Scene(deviation=sideways(0.2)).write(tmp_path / "exact"), anchor=Anchor.FIT)
    j = judge(bag, topics=TopicNames(datum=DATUM), anchor=Anchor.FIT)
    assert j.te == pytest.approx(exact.te, rel=1e-2)
    assert math.isnan(j.rms_heading)

    def lose_some(messages: dict[str, list[Any]]) -> None:
        for _, message in messages["/odom"][::50]:
            message.status.status, message.latitude, message.longitude = -1, 0.0, 0.0

    lost = Scene(deviation=sideways(0.2), poses="fix", edit=lose_some).write(tmp_path / "lost")
    found = judge(lost, topics=TopicNames(datum=DATUM), anchor=Anchor.FIT)
    assert found.te == pytest.approx(j.te, rel=1e-3)


def test_a_datum_is_refused_where_it_has_no_effect(tmp_path: Path) -> None:
    bag = Scene().write(tmp_path / "bag")
    message = r"/odom is nav_msgs/msg/Odometry: a datum is only for NavSatFix: leave it out"
    with pytest.raises(JudgeError, match=message):
        judge(bag, topics=TopicNames(datum=DATUM))


def test_of_two_vehicles_the_one_whose_state_is_named_is_judged(tmp_path: Path) -> None:
    one, other = Scene(deviation=sideways(0.2)), Scene(deviation=sideways(0.4))
    both = Scene()
    messages, types = {}, {}
    for namespace, scene in (("/a", one), ("/b", other)):
        for name, rows in scene.messages().items():
            messages[namespace + name], types[namespace + name] = rows, scene.types()[name]
    both.messages, both.types = lambda: messages, lambda: types
    bag = both.write(tmp_path / "bag")
    with pytest.raises(JudgeError, match="name the one to use"):
        judge(bag)
    names = {"pose": "/b/odom", "reference": "/b/maneuver/reference", "state": "/b/maneuver/state"}
    assert judge(bag, topics=TopicNames(**names)).te == pytest.approx(0.16 * 3 / 8, rel=1e-3)


def test_a_bag_in_parts_and_in_a_namespace(tmp_path: Path) -> None:
    scene = Scene(deviation=sideways(0.2))
    scene.topics = {name: "/second" + name for name in scene.types()}
    bag = scene.write(tmp_path / "bag", split_duration=2.0)
    assert len(list(bag.glob("*.mcap"))) > 4
    assert judge(bag).te == pytest.approx(0.04 * 3 / 8, rel=1e-4)


def remove(topic: str, low: float, high: float) -> Callable[[dict[str, list[Any]]], None]:
    """Lose the messages between two times since the start event."""

    def edit(messages: dict[str, list[Any]]) -> None:
        messages[topic] = [
            (s, m) for s, m in messages[topic] if not low <= (s - START) * 1e-9 < high
        ]

    return edit


def jump(messages: dict[str, list[Any]]) -> None:
    for _, m in messages["/odom"][500:]:
        m.header.stamp = stamp(m.header.stamp.sec * 10**9 + m.header.stamp.nanosec - 2 * 10**9)


def nan(messages: dict[str, list[Any]]) -> None:
    messages["/odom"][600][1].pose.pose.position.x = math.nan


def no_orientation(messages: dict[str, list[Any]]) -> None:
    """As some drivers leave it: all zero."""
    for _, m in messages["/odom"]:
        m.pose.pose.orientation.z = m.pose.pose.orientation.w = 0.0


def one_without_orientation(messages: dict[str, list[Any]]) -> None:
    messages["/odom"][600][1].pose.pose.orientation.w = math.nan


def second_reference(messages: dict[str, list[Any]]) -> None:
    s, _ = messages["/maneuver/reference"][0]
    other = Scene(duration=8.5).messages()["/maneuver/reference"][0][1]
    messages["/maneuver/reference"].append((s + 1, other))


def second_plan(messages: dict[str, list[Any]]) -> None:
    """A planner that has published its own plan before, and publishes another during the drive."""
    second_reference(messages)
    ((s, driven), (_, other)) = messages["/maneuver/reference"]
    driven.header, other.header = header(START - 2), header(START - 9)
    messages["/maneuver/reference"] = [(s, other), (s, driven), (START + 10**9, other)]
    plans = commands(0.2, START - 2), commands(0.1, START - 9, "p2")
    messages["/maneuver/commands"] = [(s, plans[0]), (START + 10**9, plans[1])]


def empty_reference(messages: dict[str, list[Any]]) -> None:
    messages["/maneuver/reference"][0][1].poses.clear()


def other_reference(messages: dict[str, list[Any]]) -> None:
    messages["/maneuver/reference"] = Scene(duration=5.0).messages()["/maneuver/reference"]


def aborted(messages: dict[str, list[Any]]) -> None:
    s, m = messages["/maneuver/state"][-1]
    start = next(v.value for v in m.values if v.key == "start_time")
    messages["/maneuver/state"][-1] = (s, status("aborted", start, reason="3.2 m off the path"))


def vehicle_state(*said: tuple[float, bool]) -> dict[str, tuple[str, list[tuple[int, Any]]]]:
    """`vehicle/state` that says at these times after the start whether the vehicle is armed."""
    kind = "diagnostic_msgs/msg/DiagnosticStatus"
    rows = []
    for time, armed in said:
        message = status("", "")
        values = Readiness(armed, "" if armed else "hardware e-stop pressed").values()
        message.values = [
            TYPES["diagnostic_msgs/msg/KeyValue"](key=k, value=v) for k, v in values.items()
        ]
        rows.append((START + round(time * 1e9), message))
    return {"/vehicle/state": (kind, rows)}


def diagnostics(*said: tuple[float, str]) -> dict[str, tuple[str, list[tuple[int, Any]]]]:
    """`/diagnostics` of the bridge, with these messages about the vehicle."""
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    rows = []
    for time, text in said:
        entries = [status("", ""), status("", "")]
        entries[0].name, entries[0].message = "tricycle_bridge: steer PLC", "not armed"
        entries[1].name, entries[1].message = "tricycle_bridge: vehicle", text
        at = START + round(time * 1e9)
        rows.append((at, TYPES[kind](header=header(at), status=entries)))
    return {"/diagnostics": (kind, rows)}


def no_time(messages: dict[str, list[Any]]) -> None:
    s, _ = messages["/maneuver/state"][-1]
    messages["/maneuver/state"] = [(s, status("running", "9" * 30, duration="8"))]


def two_starts(messages: dict[str, list[Any]]) -> None:
    s, _ = messages["/maneuver/state"][-1]
    messages["/maneuver/state"].append((s + 1, status("running", "1700000100.000000000")))


def commands(angle: float, published: int = 0, plan_id: str = "p1") -> Any:
    none = np.zeros(0)
    points = [
        TYPES["trajectory_msgs/msg/JointTrajectoryPoint"](
            np.array([angle, 0.0]), np.array([0.0, 3.0]), none, none,
            TYPES["builtin_interfaces/msg/Duration"](sec=t, nanosec=0))
        for t in (0, 8)
    ]  # fmt: skip
    return TYPES["trajectory_msgs/msg/JointTrajectory"](
        header(published, plan_id), ["steering_motor_joint", "rear_wheel_joint"], points
    )


def other_commands(messages: dict[str, list[Any]]) -> None:
    names = ["steering_motor_joint", "rear_wheel_joint"]
    none = np.zeros(0)
    messages["/maneuver/commands"] = [(START - 10**9, commands(0.1))]
    messages["/joint_commands"] = [
        (START + t * 10**7, TYPES["sensor_msgs/msg/JointState"](
            header(START + t * 10**7), names, np.array([0.2, 0.0]), np.array([0.0, 3.0]), none))
        for t in range(800)
    ]  # fmt: skip


def commands_without_joints(messages: dict[str, list[Any]]) -> None:
    other_commands(messages)
    messages["/maneuver/commands"][0][1].joint_names = ["a", "b"]


BAD: dict[str, tuple[Scene, str]] = {
    "no reference": (Scene(edit=lambda m: m.pop("/maneuver/reference")), "no topic maneuver/refer"),
    "empty reference": (Scene(edit=empty_reference), "no trajectory: want two poses or more"),
    "two references": (Scene(edit=second_reference), "2 different references"),
    "no state": (Scene(edit=lambda m: m.pop("/maneuver/state")), "no topic maneuver/state"),
    "no start": (Scene(edit=remove("/maneuver/state", 0, 100)), "no start event"),
    "two starts": (Scene(edit=two_starts), "2 maneuvers were started"),
    "no time": (Scene(edit=no_time), "want start_time and duration in seconds"),
    "aborted": (Scene(edit=aborted), "was aborted: 3.2 m off the path"),
    "never armed": (
        Scene(more=vehicle_state((-1.4, False), *((t, False) for t in range(8)))),
        r"was not driven: the vehicle was not armed at the start \(hardware e-stop pressed\)",
    ),
    "disarmed before": (Scene(more=vehicle_state((-1.4, True), (-1, False))), "armed at the start"),
    "disarmed": (
        Scene(more=vehicle_state((-1.4, True), (3.5, False), (3.6, True))),
        r"was not driven: the vehicle was not armed 3\.50 s after the start \(hardware e-stop",
    ),
    "never armed, of old": (
        Scene(more=diagnostics((0.4, "not armed: waiting for the operator"))),
        r"was not armed 0\.40 s after the start \(waiting for the operator\)",
    ),
    "no poses": (Scene(edit=lambda m: m.pop("/odom")), "no topic odom"),
    "clock jumps back": (Scene(edit=jump), "clock jumps back by 1.990 s at 3.491 s"),
    "NaN": (Scene(edit=nan), r"pose at 4.501 s is not a number, .* \(1 of 1100 poses\)"),
    "no orientation": (Scene(edit=no_orientation), "no heading to anchor the reference by"),
    "one orientation": (Scene(edit=one_without_orientation), "at 4.501 s .* no unit quaternion"),
    "joints": (Scene(edit=commands_without_joints), "steering_motor_joint and rear_wheel_joint"),
    "another maneuver": (Scene(edit=other_reference), "8.00 s, its reference 5.00 s"),
    "other commands": (Scene(edit=other_commands), "the drive of another maneuver"),
    "a gap": (
        Scene(edit=remove("/odom", 3, 4)),
        r"poses match 87.4% of the reference's 8.00 s; there are none between 2.99 s and 4.00 s",
    ),
    "the end": (Scene(edit=remove("/odom", 6, 100)), r"match 74.9% .* 5.99 s and 8.00 s"),
    "no standstill": (Scene(before=0.1), "0.10 s of standstill .* 0.3 s are needed"),
    "rolling start": (
        Scene(edit=lambda m: [_shift(x) for x in m["/odom"]] and None),
        "moves at 0.20 m/s before the start event",
    ),
    "wrong type": (Scene(topics={"/maneuver/state": "/odom2"}), "no topic maneuver/state"),
}  # fmt: skip


def _shift(message: tuple[int, Any]) -> None:
    s, m = message
    m.pose.pose.position.x += 0.2 * (s - START) * 1e-9


@pytest.mark.parametrize(
    "told",
    [
        vehicle_state((-1.4, False), (-1.0, True), (2.0, True), (8.5, False)),
        diagnostics((-1, "not armed: no command stream"), (0.1, "armed"), (8.5, "not armed: over")),
        # what vehicle/state says counts, not the diagnostics
        vehicle_state((-1.0, True)) | diagnostics((1.0, "not armed: of another vehicle")),
        vehicle_state() | diagnostics((1.0, "armed")),
    ],
)
def test_a_vehicle_that_is_armed_during_the_drive_is_judged(
    tmp_path: Path, told: dict[str, tuple[str, list[tuple[int, Any]]]]
) -> None:
    assert judge(Scene(more=told).write(tmp_path / "bag")).te < 1e-9


@pytest.mark.slow
def test_of_several_plans_the_one_driven_is_judged(tmp_path: Path) -> None:
    alone = judge(Scene(deviation=sideways(0.2)).write(tmp_path / "alone"))
    scene = Scene(deviation=sideways(0.2), edit=second_plan)
    assert judge(scene.write(tmp_path / "bag")).te == alone.te
    driven = read_drive(tmp_path / "bag").commands
    assert (driven.header.frame_id, driven.points[0].positions[0]) == ("p1", 0.2)


@pytest.mark.parametrize(("scene", "reason"), BAD.values(), ids=BAD.keys())
def test_what_cannot_be_judged_is_told_in_one_line(
    tmp_path: Path, scene: Scene, reason: str
) -> None:
    bag = scene.write(tmp_path / "bag")
    with pytest.raises(JudgeError, match=reason) as error:
        judge(bag)
    assert "\n" not in str(error.value)
    assert str(bag) in str(error.value)


def test_types_that_hold_no_pose_are_named(tmp_path: Path) -> None:
    bag = Scene().write(tmp_path / "bag")
    with pytest.raises(JudgeError, match="is nav_msgs/msg/Path: poses are read from geometry_msgs"):
        judge(bag, topics=TopicNames(pose="/maneuver/reference"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("poses", "those"),
    [("tf", "base_link, lidar"), ("odometry", "base_link"), ("transform", "base_link")],
)
def test_a_child_frame_that_is_not_there_is_told_with_those_that_are(
    tmp_path: Path, poses: str, those: str
) -> None:
    bag = Scene(poses=poses).write(tmp_path / "bag")
    with pytest.raises(JudgeError, match=f"no poses of wheel; it holds those of {those}:"):
        judge(bag, topics=TopicNames(child_frame="wheel"))


def test_a_truncated_bag_fails_with_the_fraction_matched(tmp_path: Path) -> None:
    bag = Scene(deviation=sideways(0.2)).write(tmp_path / "bag", chunk_size=2000) / "bag_0.mcap"
    content = bag.read_bytes()
    bag.write_bytes(content[: len(content) // 2])
    with pytest.raises(JudgeError, match=r"poses match \d\d\.\d% of the .* 8.00 s.*was cut off"):
        judge(bag)
    bag.write_bytes(content[:20])
    with pytest.raises(BagError, match="empty bag"):
        judge(bag)


@pytest.mark.slow
def test_the_command_compares_bags_and_prints_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    bags = [
        str(Scene(deviation=sideways(d), noise=0.01).write(tmp_path / name))
        for name, d in (("good", 0.05), ("bad", 0.2))
    ]
    arguments = ["--plot", str(tmp_path / "f.png"), "--export", "csv", "--output", str(tmp_path)]
    args = parser.parse_args([*bags, *arguments])
    assert args.run(args) == 0
    table = capsys.readouterr().out
    assert "good" in table
    assert "TE at anchor fit / m²" in table
    assert {"f.png", "good.csv", "bad.csv"} <= {path.name for path in tmp_path.iterdir()}

    args = parser.parse_args([bags[0], "--json"])
    args.run(args)
    one = json.loads(capsys.readouterr().out)
    assert {"te", "rms", "max", "duration", "noise"} <= one.keys()
    args = parser.parse_args([*bags, "--json"])
    args.run(args)
    two = json.loads(capsys.readouterr().out)["bags"]
    assert two[0] == one
    assert two[1]["te"] > two[0]["te"]

    args = parser.parse_args([bags[0], str(tmp_path / "absent"), "--json"])
    assert args.run(args) == 2
    output, errors = capsys.readouterr()
    assert json.loads(output)["bags"] == [one]
    assert "absent: no such bag" in errors
