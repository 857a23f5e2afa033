"""Judged bags against drives whose error is known."""

import argparse
import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from parameter_identification.drives.recorded import read_drive
from parameter_identification.judging.export import ExportFormat, export, plot
from parameter_identification.judging.judgement import Anchor, Datum, TopicNames, judge
from trajectory_recorder.bag.topics import OfferedQos, Topic, jazzy
from trajectory_recorder.bag.writer import BagWriter
from tricycle_cli.commands.judge import add_parser
from tricycle_core.errors import BagError, JudgeError

Array = NDArray[np.float64]
TYPES = jazzy().types
LATCHED = (OfferedQos(durability="transient_local", depth=1),)
START = 1_700_000_000_123_456_789  # ns


def stamp(ns: int) -> Any:
    return TYPES["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)


def header(ns: int, frame: str = "odom") -> Any:
    return TYPES["std_msgs/msg/Header"](stamp=stamp(ns), frame_id=frame)


def pose(x: float, y: float, heading: float) -> Any:
    return TYPES["geometry_msgs/msg/Pose"](
        position=TYPES["geometry_msgs/msg/Point"](x=x, y=y, z=0.3),
        orientation=TYPES["geometry_msgs/msg/Quaternion"](
            x=0.0, y=0.0, z=math.sin(heading / 2), w=math.cos(heading / 2)
        ),
    )


def vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    return TYPES["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)


def pose_stamped(ns: int, x: float, y: float, heading: float) -> Any:
    return TYPES["geometry_msgs/msg/PoseStamped"](header=header(ns), pose=pose(x, y, heading))


def odometry(ns: int, x: float, y: float, heading: float) -> Any:
    twist = TYPES["geometry_msgs/msg/Twist"](linear=vector(), angular=vector())
    return TYPES["nav_msgs/msg/Odometry"](
        header=header(ns),
        child_frame_id="base_link",
        pose=TYPES["geometry_msgs/msg/PoseWithCovariance"](
            pose=pose(x, y, heading), covariance=np.zeros(36)
        ),
        twist=TYPES["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36)),
    )


def transform(ns: int, x: float, y: float, heading: float) -> Any:
    return TYPES["geometry_msgs/msg/TransformStamped"](
        header=header(ns),
        child_frame_id="base_link",
        transform=TYPES["geometry_msgs/msg/Transform"](
            translation=vector(x, y), rotation=pose(x, y, heading).orientation
        ),
    )


def tf(ns: int, x: float, y: float, heading: float) -> Any:
    other = transform(ns, -y, x, 0.0)
    other.child_frame_id = "lidar"
    return TYPES["tf2_msgs/msg/TFMessage"](transforms=[other, transform(ns, x, y, heading)])


DATUM = Datum(46.5, 6.6, 400.0)


def fix(ns: int, x: float, y: float, heading: float) -> Any:
    """Inverse of the tangent plane by its metric at the datum: good to 1e-4 of 10 m."""
    a, e2, phi = 6_378_137.0, 6.694_379_990_14e-3, math.radians(DATUM.latitude)
    w = math.sqrt(1 - e2 * math.sin(phi) ** 2)
    meridian, normal = a * (1 - e2) / w**3, a / w
    return TYPES["sensor_msgs/msg/NavSatFix"](
        header=header(ns),
        status=TYPES["sensor_msgs/msg/NavSatStatus"](status=0, service=1),
        latitude=DATUM.latitude + math.degrees(y / (meridian + DATUM.altitude)),
        longitude=DATUM.longitude + math.degrees(x / ((normal + DATUM.altitude) * math.cos(phi))),
        altitude=DATUM.altitude,
        position_covariance=np.zeros(9),
        position_covariance_type=0,
    )


MAKERS: dict[str, tuple[str, Callable[..., Any]]] = {
    "odometry": ("nav_msgs/msg/Odometry", odometry),
    "pose": ("geometry_msgs/msg/PoseStamped", pose_stamped),
    "transform": ("geometry_msgs/msg/TransformStamped", transform),
    "tf": ("tf2_msgs/msg/TFMessage", tf),
    "fix": ("sensor_msgs/msg/NavSatFix", fix),
}


def status(state: str, start: str, **values: str) -> Any:
    values = {"state": state, "plan_id": "p1", "start_time": start, "duration": "8.0", **values}
    return TYPES["diagnostic_msgs/msg/DiagnosticStatus"](
        level=0,
        name="maneuver_driver: maneuver",
        message=state,
        hardware_id="",
        values=[TYPES["diagnostic_msgs/msg/KeyValue"](key=k, value=v) for k, v in values.items()],
    )


@dataclass
class Scene:
    """A straight run-in of 2 s, then a circle of 2 m at 1 m/s; what deviates is said here."""

    deviation: Callable[[Array], Array] = lambda t: np.zeros((2, len(t)))  # in reference frame
    lag: float = 0.0  # s
    noise: float = 0.0  # m
    heading_noise: float = 0.0  # rad
    anchor: tuple[float, float, float] = (3.0, -2.0, 2.5)
    rate: float = 100.0  # Hz
    before: float = 1.5  # s recorded
    after: float = 1.5
    duration: float = 8.0
    seed: int = 0
    poses: str = "odometry"
    topics: dict[str, str] = field(default_factory=dict)  # other names
    edit: Callable[[dict[str, list[Any]]], None] = lambda messages: None  # what is wrong

    def reference(self, t: Array) -> Array:
        """x, y, heading (3, t) of a start at rest: 1 m/s² for 1 s, then 1 m/s."""
        t = np.clip(t, 0, self.duration)
        s = np.where(t < 1, t**2 / 2, t - 0.5)
        arc = np.maximum(s - 1.5, 0)
        straight = np.minimum(s, 1.5)
        return np.stack([straight + 2 * np.sin(arc / 2), 2 * (1 - np.cos(arc / 2)), arc / 2])

    def messages(self) -> dict[str, list[Any]]:
        """Topic -> [(receive stamp, message)]."""
        t = np.arange(0, self.duration + 1e-9, 0.01)
        poses = [
            pose_stamped(round(ti * 1e9), *p) for ti, p in zip(t, self.reference(t).T, strict=True)
        ]
        path = TYPES["nav_msgs/msg/Path"](header=header(0), poses=poses)
        rng = np.random.default_rng(self.seed)
        t = np.arange(-self.before, self.duration + self.after, 1 / self.rate) + 0.001234
        x, y, heading = self.reference(t - self.lag)
        x, y = np.stack([x, y]) + self.deviation(np.clip(t, 0, self.duration))
        x0, y0, a = self.anchor
        measured = np.stack(
            [x0 + np.cos(a) * x - np.sin(a) * y, y0 + np.sin(a) * x + np.cos(a) * y]
        )
        measured += rng.normal(0, self.noise, measured.shape) if self.noise else 0
        heading = heading + a + rng.normal(0, 1, len(t)) * self.heading_noise
        stamps = START + np.round(t * 1e9).astype(np.int64)
        make = MAKERS[self.poses][1]
        first, at = int(stamps[0]) - 10**7, f"{START // 10**9}.{START % 10**9:09d}"
        end = START + round(self.duration * 1e9)
        length = {"duration": f"{self.duration:.3f}"}
        messages = {
            "/maneuver/reference": [(first, path)],
            "/maneuver/state": [
                (first, status("waiting", "", **length)),
                (START + 10**6, status("running", at, **length)),
                (START + 10**9, status("running", at, elapsed="1.0", **length)),
                (end, status("done", at, **length)),
            ],
            "/odom": [
                (int(s) + 10**6, make(int(s), float(px), float(py), float(h)))
                for s, px, py, h in zip(stamps, *measured, heading, strict=True)
            ],
        }
        self.edit(messages)
        return messages

    def types(self) -> dict[str, str]:
        return {
            "/maneuver/reference": "nav_msgs/msg/Path",
            "/maneuver/state": "diagnostic_msgs/msg/DiagnosticStatus",
            "/maneuver/commands": "trajectory_msgs/msg/JointTrajectory",
            "/joint_commands": "sensor_msgs/msg/JointState",
            "/odom": MAKERS[self.poses][0],
        }

    def write(self, path: Path, **options: Any) -> Path:
        messages, types = self.messages(), self.types()
        rows = [(s, name, m) for name, found in messages.items() for s, m in found]
        rows.sort(key=lambda row: row[0])
        with BagWriter(path, **options) as bag:
            ids = {
                name: bag.add_topic(
                    Topic.of_type(
                        self.topics.get(name, name),
                        types[name],
                        qos=LATCHED if "man" in name else (),
                    )
                )
                for name in messages
            }
            for i, (s, name, message) in enumerate(rows):
                bag.write(ids[name], s, bytes(jazzy().serialize_cdr(message, types[name])))
                if i % 100 == 0:
                    bag.flush()
        return path


def sideways(distance: float) -> Callable[[Array], Array]:
    """Deviation in y that grows as sin² over the eight seconds: mean square 3/8 d²."""
    return lambda t: np.stack([0 * t, distance * np.sin(np.pi * t / 16) ** 2])


def test_te_of_a_known_deviation(tmp_path: Path) -> None:
    j = judge(Scene(deviation=sideways(0.2)).write(tmp_path / "bag"))
    assert j.te == pytest.approx(0.04 * 3 / 8, rel=1e-4)
    assert j.rms == pytest.approx(math.sqrt(j.te))
    assert j.max == pytest.approx(0.2, rel=1e-4)
    assert (j.rms_x, j.rms_y) == pytest.approx((0, j.rms), abs=1e-4)
    assert math.hypot(j.rms_along, j.rms_cross) == pytest.approx(j.rms)
    assert j.te_corrected == pytest.approx(j.te, rel=1e-6)
    assert (j.points, j.duration, j.matched_fraction) == (10_000, 8.0, 1.0)
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


def test_the_lags_uncertainty_holds_over_seeds(tmp_path: Path) -> None:
    scores = []
    for seed in range(10):
        j = judge(Scene(lag=0.02, noise=0.01, seed=seed).write(tmp_path / f"{seed}"))
        scores.append((j.time_offset - 0.02) / j.time_offset_deviation)
    assert 0.6 < np.std(scores) < 1.5
    assert abs(np.mean(scores)) < 0.8


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


def test_a_bag_in_parts_and_in_a_namespace(tmp_path: Path) -> None:
    scene = Scene(deviation=sideways(0.2))
    scene.topics = {name: "/second" + name for name in scene.types()}
    bag = scene.write(tmp_path / "bag", split_duration=2.0)
    assert len(list(bag.glob("*.mcap"))) > 4
    assert judge(bag).te == pytest.approx(0.04 * 3 / 8, rel=1e-4)


def test_tum_export_agrees_with_evo(tmp_path: Path) -> None:
    evo_io = pytest.importorskip("evo.tools.file_interface")
    from evo.core.metrics import APE, PoseRelation

    j = judge(Scene(deviation=sideways(0.2), noise=0.01).write(tmp_path / "bag"))
    measured, reference = export([j], tmp_path / "out", ExportFormat.TUM)
    ape = APE(PoseRelation.translation_part)
    ape.process_data(
        (evo_io.read_tum_trajectory_file(reference), evo_io.read_tum_trajectory_file(measured))
    )
    statistics = ape.get_all_statistics()
    assert statistics["rmse"] == pytest.approx(j.rms, abs=1e-9)
    assert statistics["max"] == pytest.approx(j.max, abs=1e-9)


def test_csv_and_figure(tmp_path: Path) -> None:
    j = judge(Scene(deviation=sideways(0.2)).write(tmp_path / "bag"))
    (path,) = export([j], tmp_path, ExportFormat.CSV)
    table = np.genfromtxt(path, delimiter=",", names=True)
    assert np.mean(table["along"] ** 2 + table["cross"] ** 2) == pytest.approx(j.te, rel=1e-12)
    again = export([j, j], tmp_path / "again", ExportFormat.CSV)
    assert [path.name for path in again] == ["bag.csv", "bag_2.csv"]
    plot([j, j], tmp_path / "figures" / "figure.png")
    assert (tmp_path / "figures" / "figure.png").read_bytes().startswith(b"\x89PNG")


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


def test_a_child_frame_that_is_not_there_is_told_with_those_that_are(tmp_path: Path) -> None:
    bag = Scene(poses="tf").write(tmp_path / "bag")
    with pytest.raises(JudgeError, match="no transform to wheel; it holds those to base_link, lid"):
        judge(bag, topics=TopicNames(child_frame="wheel"))


def test_a_truncated_bag_fails_with_the_fraction_matched(tmp_path: Path) -> None:
    bag = Scene(deviation=sideways(0.2)).write(tmp_path / "bag", chunk_size=2000) / "bag_0.mcap"
    content = bag.read_bytes()
    bag.write_bytes(content[: len(content) // 2])
    with pytest.raises(JudgeError, match=r"poses match \d\d\.\d% of the reference's 8.00 s"):
        judge(bag)
    bag.write_bytes(content[:20])
    with pytest.raises(BagError, match="empty bag"):
        judge(bag)


def test_east_north_of_one_degree_at_the_equator() -> None:
    from parameter_identification.drives.poses import east_north

    east, north = east_north(0.0, 1.0, 0.0, Datum(0.0, 0.0))
    assert east == pytest.approx(6_378_137 * math.sin(math.radians(1)), rel=1e-12)
    assert north == 0.0
    # a short arc of the meridian at 45°: radius of curvature a(1-e²)/(1-e²/2)^1.5
    _, north = east_north(45.001, 0.0, 0.0, Datum(45.0, 0.0))
    radius = 6_378_137 * (1 - 6.694_379_990_14e-3) / (1 - 6.694_379_990_14e-3 / 2) ** 1.5
    assert north == pytest.approx(radius * math.radians(0.001), rel=1e-6)
    with pytest.raises(JudgeError, match="latitude is -90 to 90"):
        Datum(91.0, 0.0)


def test_the_command_compares_bags_and_prints_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parser = argparse.ArgumentParser()
    add_parser(parser.add_subparsers())
    bags = [
        str(Scene(deviation=sideways(d), noise=0.01).write(tmp_path / name))
        for name, d in (("good", 0.05), ("bad", 0.2))
    ]
    arguments = ["--plot", str(tmp_path / "f.png"), "--export", "csv", "--output", str(tmp_path)]
    args = parser.parse_args(["judge", *bags, *arguments])
    assert args.run(args) == 0
    table = capsys.readouterr().out
    assert "good" in table
    assert "TE at anchor fit / m²" in table
    assert {"f.png", "good.csv", "bad.csv"} <= {path.name for path in tmp_path.iterdir()}

    args = parser.parse_args(["judge", bags[0], "--json"])
    args.run(args)
    one = json.loads(capsys.readouterr().out)
    assert {"te", "rms", "max", "points", "duration", "matched_fraction"} <= one.keys()
    args = parser.parse_args(["judge", *bags, "--json"])
    args.run(args)
    two = json.loads(capsys.readouterr().out)["bags"]
    assert two[0] == one
    assert two[1]["te"] > two[0]["te"]

    args = parser.parse_args(["judge", bags[0], str(tmp_path / "absent"), "--json"])
    assert args.run(args) == 2
    output, errors = capsys.readouterr()
    assert json.loads(output)["bags"] == [one]
    assert "absent: no such bag" in errors
