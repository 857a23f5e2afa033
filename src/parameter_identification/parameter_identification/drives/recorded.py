"""A recorded drive: the poses measured, the reference, and the event that ties them in time.

Everything comes from one bag. Times are seconds since the start event, the tick at which row 0 of
the commands was played.
"""

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajectory_recorder.bag.reader import BagReader
from trajectory_recorder.bag.topics import decode
from tricycle_core.errors import JudgeError
from tricycle_core.joints import JOINTS
from tricycle_core.quantities import FloatArray

DURATION_TOLERANCE = 0.05  # s between the reference's end and the driver's
COMMANDS_TOLERANCE = 1e-6  # rad and rad/s between a set-point planned and played
QUATERNION_TOLERANCE = 0.01  # of the squared length of an orientation from 1
COMMANDS_FRACTION = 0.9  # of the set-points that must be those planned: some may be lost


@dataclass(frozen=True)
class Datum:
    """Geodetic origin of local east-north coordinates, WGS84."""

    latitude: float  # deg
    longitude: float  # deg
    altitude: float = 0.0  # m above the ellipsoid

    def __post_init__(self) -> None:
        if not (abs(self.latitude) <= 90 and abs(self.longitude) <= 180):
            raise JudgeError(
                f"datum {self.latitude}, {self.longitude}: latitude is -90 to 90 degrees, "
                "longitude -180 to 180"
            )


@dataclass(frozen=True)
class Topics:
    """Where a bag keeps what a judgement needs; foreign bags may use other names.

    Attributes
    ----------
    pose : Odometry, PoseStamped, TransformStamped, TFMessage or NavSatFix
    child_frame : of the transform to take from TFMessage
    datum : origin for NavSatFix
    reference, state, commands, played : what planner and driver publish
    """

    pose: str = "odom"
    reference: str = "maneuver/reference"
    state: str = "maneuver/state"
    commands: str = "maneuver/commands"
    played: str = "joint_commands"
    child_frame: str = "base_link"
    datum: Datum | None = None


@dataclass(frozen=True)
class Path2D:
    """Planar poses over time.

    Attributes
    ----------
    time : (t,) strictly increasing, s since the start event
    x, y : (t,) m
    heading : (t,) rad, left positive, continuous; NaN where the sensor has none
    """

    time: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray

    def part(self, selected: NDArray[np.bool_]) -> "Path2D":
        """Poses where ``selected`` (t,) is true."""
        return Path2D(*(v[selected] for v in (self.time, self.x, self.y, self.heading)))


@dataclass(frozen=True)
class Drive:
    """One driven maneuver.

    Attributes
    ----------
    bag : where it was recorded
    plan_id : of the maneuver driven
    start : time of the start event, ns of the clock that stamps the poses
    poses : measured, in the frame of the sensor; with what was recorded before and after
    reference : nominal trajectory, starting at the origin with heading 0
    commands : JointTrajectory of the plan driven; None if there is none in the bag
    complete : False where the bag was cut off
    metadata : what the recorder noted
    """

    bag: Path
    plan_id: str
    start: int
    poses: Path2D
    reference: Path2D
    commands: Any
    complete: bool
    metadata: Mapping[str, str] = field(default_factory=dict)

    @property
    def duration(self) -> float:
        """Duration of the reference, s."""
        return float(self.reference.time[-1])


def read_drive(bag: Path, *, topics: Topics | None = None) -> Drive:
    """Read the drive that a bag holds.

    Parameters
    ----------
    bag : rosbag2 directory, ``.mcap`` or ``.db3`` file
    topics : names of the topics where they differ from the suite's

    Raises
    ------
    BagError
        If the bag cannot be read.
    JudgeError
        If it holds no reference or several, no start event or several, an aborted maneuver, the
        drive of another maneuver than its reference, no poses, poses that are not numbers, or
        stamps that jump back.
    """
    topics = topics or Topics()
    with BagReader(bag) as reader:
        return _Collector(reader, topics).drive()


class _Collector:
    """Gathers from one pass over a bag what `Drive` needs."""

    def __init__(self, reader: BagReader, topics: Topics) -> None:
        self.bag = reader.path
        self.reader = reader
        self.topics = topics
        self.reference = self._name(topics.reference, "publish a plan before recording")
        self.state = self._name(topics.state, "the drive's start event is recorded there")
        self.pose = self._name(topics.pose, "name the topic of the poses")
        self.commands = self._name(topics.commands)
        self.played = self._name(topics.played)

    def drive(self) -> Drive:
        wanted = {self.reference, self.state, self.pose, self.commands, self.played} - {""}
        poses = _Poses(self.bag, self.pose, self.reader.topics[self.pose].type, self.topics)
        latched: dict[str, dict[bytes, Any]] = {self.reference: {}, self.commands: {}}
        states: list[dict[str, str]] = []
        played: list[tuple[int, Any]] = []
        for topic, _, data in self.reader.messages(wanted):
            type_name = self.reader.topics[topic].type
            if topic == self.pose:
                poses.add(decode(type_name, data))
            elif topic in latched:
                if data not in latched[topic]:  # repeated at the beginning of each file
                    latched[topic][data] = decode(type_name, data)
            elif topic == self.state:
                states.append({v.key: v.value for v in decode(type_name, data).values})
            else:
                message = decode(type_name, data)
                played.append((_stamp(message), message))
        start, plan_id, duration = self._start_event(states)
        commands = self._commands(latched[self.commands].values(), plan_id)
        reference = self._reference(latched[self.reference].values(), commands)
        if not abs(duration - reference.time[-1]) <= DURATION_TOLERANCE:
            raise JudgeError(
                f"{self.bag}: the driven maneuver lasts {duration:.2f} s, its reference "
                f"{reference.time[-1]:.2f} s: the reference of another maneuver"
            )
        if commands is not None:
            self._check_commands(commands, played, start)
        return Drive(
            bag=self.bag,
            plan_id=plan_id,
            start=start,
            poses=poses.since(start),
            reference=reference,
            commands=commands,
            complete=self.reader.complete,
            metadata=self.reader.metadata,
        )

    def _name(self, name: str, why: str = "") -> str:
        """Topic of the bag with this name in any namespace; "" if there is none and no ``why``."""
        found = [
            known for known in self.reader.topics if known == name or known.endswith("/" + name)
        ]
        if len(found) > 1:
            raise JudgeError(f"{self.bag} holds {' and '.join(sorted(found))}: name the one to use")
        if not found and why:
            raise JudgeError(f"{self.bag} holds no topic {name}: {why}")
        return found[0] if found else ""

    def _commands(self, messages: Iterable[Any], plan_id: str) -> Any:
        """Newest commands of the plan driven; of any plan where they carry no id."""
        newest = list(messages)[::-1]
        own = (message for message in newest if message.header.frame_id == plan_id)
        return next(own, newest[0] if newest else None)

    def _reference(self, messages: Iterable[Any], commands: Any) -> Path2D:
        """The reference published with the commands; the only one where stamps do not tell."""
        every = list(messages)
        own = [m for m in every if commands is not None and _stamp(m) == _stamp(commands)]
        paths = {}
        for message in own or every:
            rows = [(_stamp(pose) * 1e-9, *_planar(pose.pose)) for pose in message.poses]
            paths[np.array(rows).tobytes()] = np.array(rows).reshape(-1, 4)
        if not paths:
            raise JudgeError(f"{self.bag}: {self.reference} is empty: no reference to judge by")
        if len(paths) > 1:
            raise JudgeError(
                f"{self.bag}: {self.reference} holds {len(paths)} different references: "
                "record every maneuver in a bag of its own"
            )
        (path,) = paths.values()
        if len(path) < 2 or np.any(np.diff(path[:, 0]) <= 0) or not np.isfinite(path).all():
            raise JudgeError(
                f"{self.bag}: {self.reference} is no trajectory: want two poses or more, finite, "
                "with unit quaternions and increasing stamps"
            )
        if path[0, 0] != 0:
            raise JudgeError(
                f"{self.bag}: {self.reference} starts at {path[0, 0]:.3f} s: its stamps must count "
                "from the start of the maneuver, 0 s"
            )
        return Path2D(path[:, 0], path[:, 1], path[:, 2], np.unwrap(path[:, 3]))

    def _start_event(self, states: list[dict[str, str]]) -> tuple[int, str, float]:
        """Time of the start event, ns; id and duration, s, of the plan driven."""
        running = {s.get("start_time", ""): s for s in states if s.get("state") == "running"}
        if not running:
            raise JudgeError(f"{self.bag}: {self.state} holds no start event: nothing was driven")
        if len(running) > 1:
            raise JudgeError(
                f"{self.bag}: {len(running)} maneuvers were started: record every maneuver in a "
                "bag of its own"
            )
        ((start_time, event),) = running.items()
        try:
            start = _nanoseconds(start_time)
            duration = float(event["duration"])
        except (ValueError, KeyError) as error:
            raise JudgeError(
                f"{self.bag}: {self.state}: want start_time and duration in seconds"
            ) from error
        for state in states[states.index(event) :]:
            if state.get("state") == "aborted":
                raise JudgeError(f"{self.bag}: the maneuver was aborted: {state.get('reason', '')}")
        return start, event.get("plan_id", ""), duration

    def _check_commands(self, planned: Any, played: list[tuple[int, Any]], start: int) -> None:
        """Raise if what was played is not what the bag says was planned."""
        try:
            pairs = list(_planned_and_played(planned, played, start))
        except (LookupError, ValueError) as error:
            raise JudgeError(
                f"{self.bag}: {self.commands} and {self.played}: want position and velocity of "
                f"{' and '.join(JOINTS)} in every message"
            ) from error
        if not pairs:
            return
        a = np.array(pairs)
        same = np.all(np.abs(a[:, :2] - a[:, 2:]) < COMMANDS_TOLERANCE, axis=1)
        if np.mean(same) < COMMANDS_FRACTION:
            raise JudgeError(
                f"{self.bag}: {np.mean(~same):.0%} of the set-points on {self.played} are not "
                f"those of {self.commands}: the drive of another maneuver"
            )


def _planned_and_played(
    planned: Any, played: list[tuple[int, Any]], start: int
) -> Iterator[tuple[float, float, float, float]]:
    """Angle and wheel speed planned, then those played, of each set-point during the drive."""
    times = [_duration(point.time_from_start) for point in planned.points]
    steer, wheel = (planned.joint_names.index(name) for name in JOINTS)
    rows = [(point.positions[steer], point.velocities[wheel]) for point in planned.points]
    for stamp, setpoint in played:
        elapsed = (stamp - start) * 1e-9
        if 0 <= elapsed < times[-1]:
            row = bisect_right(times, elapsed + 1e-6) - 1
            steer, wheel = (setpoint.name.index(name) for name in JOINTS)
            yield *rows[row], setpoint.position[steer], setpoint.velocity[wheel]


class _Poses:
    """Poses of a topic, whatever its type."""

    def __init__(self, bag: Path, topic: str, type_name: str, topics: Topics) -> None:
        self.where = f"{bag}: {topic}"
        readers: dict[str, Callable[[Any], Iterable[tuple[int, float, float, float]]]] = {
            "nav_msgs/msg/Odometry": lambda m: [(_stamp(m), *_planar(m.pose.pose))],
            "geometry_msgs/msg/PoseStamped": lambda m: [(_stamp(m), *_planar(m.pose))],
            "geometry_msgs/msg/TransformStamped": lambda m: [(_stamp(m), *_planar(m.transform))],
            "tf2_msgs/msg/TFMessage": self._of_child_frame,
            "sensor_msgs/msg/NavSatFix": lambda m: [(_stamp(m), *self._fix(m), math.nan)],
        }
        if type_name not in readers:
            raise JudgeError(
                f"{self.where} is {type_name}: poses are read from {', '.join(sorted(readers))}"
            )
        self._read = readers[type_name]
        self._rows: list[tuple[int, float, float, float]] = []
        self._child_frame = topics.child_frame
        self._other_frames: set[str] = set()
        self._datum = topics.datum
        if type_name.endswith("NavSatFix") and self._datum is None:
            raise JudgeError(f"{self.where} is NavSatFix: give the datum of the local coordinates")

    def add(self, message: Any) -> None:
        self._rows += self._read(message)

    def since(self, start: int) -> Path2D:
        """All poses, timed from the start event."""
        if not self._rows and self._other_frames:
            raise JudgeError(
                f"{self.where} holds no transform to {self._child_frame}; it holds those to "
                f"{', '.join(sorted(self._other_frames))}"
            )
        if not self._rows:
            raise JudgeError(f"{self.where} holds no poses")
        stamps = np.array([row[0] for row in self._rows], dtype=np.int64)
        if not stamps.any():
            raise JudgeError(f"{self.where}: all stamps are 0: the poses have no time")
        back = np.flatnonzero(np.diff(stamps) < 0)
        if len(back):
            at = back[0]
            raise JudgeError(
                f"{self.where}: the clock jumps back by "
                f"{(stamps[at] - stamps[at + 1]) * 1e-9:.3f} s "
                f"at {(stamps[at] - start) * 1e-9:.3f} s"
            )
        new = np.concatenate([[True], np.diff(stamps) > 0])  # a pose sent twice counts once
        values = np.array([row[1:] for row in self._rows])[new]
        time = (stamps[new] - start) * 1e-9
        wrong = ~np.isfinite(values[:, :2]).all(axis=1)
        if not np.isnan(values[:, 2]).all():  # a sensor has headings, or it has none
            wrong |= np.isnan(values[:, 2])
        if wrong.any():
            raise JudgeError(
                f"{self.where}: the pose at {time[wrong][0]:.3f} s is not a number, or its "
                "orientation no unit quaternion "
                f"({np.count_nonzero(wrong)} of {len(time)} poses)"
            )
        return Path2D(time, values[:, 0], values[:, 1], np.unwrap(values[:, 2]))

    def _of_child_frame(self, message: Any) -> Iterator[tuple[int, float, float, float]]:
        for transform in message.transforms:
            child_frame = transform.child_frame_id.lstrip("/")
            if child_frame == self._child_frame:
                yield _stamp(transform), *_planar(transform.transform)
            else:
                self._other_frames.add(child_frame)

    def _fix(self, message: Any) -> tuple[float, float]:
        assert self._datum is not None
        return east_north(message.latitude, message.longitude, message.altitude, self._datum)


def east_north(
    latitude: float, longitude: float, altitude: float, datum: Datum
) -> tuple[float, float]:
    """Position east and north of a datum, m, in its tangent plane (WGS84).

    One degree of longitude at the equator is 111 319.5 m less what the tangent plane leaves.
    """
    point = _earth_centred(latitude, longitude, altitude)
    origin = _earth_centred(datum.latitude, datum.longitude, datum.altitude)
    dx, dy, dz = (a - b for a, b in zip(point, origin, strict=True))
    phi, lam = math.radians(datum.latitude), math.radians(datum.longitude)
    east = -math.sin(lam) * dx + math.cos(lam) * dy
    north = -math.sin(phi) * (math.cos(lam) * dx + math.sin(lam) * dy) + math.cos(phi) * dz
    return east, north


def _earth_centred(latitude: float, longitude: float, altitude: float) -> tuple[float, ...]:
    a, e2 = 6_378_137.0, 6.694_379_990_14e-3  # WGS84: semi-major axis in m, eccentricity squared
    phi, lam = math.radians(latitude), math.radians(longitude)
    normal = a / math.sqrt(1 - e2 * math.sin(phi) ** 2)
    return (
        (normal + altitude) * math.cos(phi) * math.cos(lam),
        (normal + altitude) * math.cos(phi) * math.sin(lam),
        (normal * (1 - e2) + altitude) * math.sin(phi),
    )


def _stamp(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _duration(duration: Any) -> float:
    return float(duration.sec) + float(duration.nanosec) * 1e-9


def _planar(pose: Any) -> tuple[float, float, float]:
    """Position and heading of a Pose or a Transform; NaN where its quaternion is none."""
    position, q = (
        (pose.position, pose.orientation)
        if hasattr(pose, "position")
        else (pose.translation, pose.rotation)
    )
    if not abs(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z - 1) < QUATERNION_TOLERANCE:
        return position.x, position.y, math.nan
    heading = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))
    return position.x, position.y, heading


def _nanoseconds(seconds: str) -> int:
    """``"12.000000001"`` -> 12000000001, exactly."""
    whole, _, fraction = seconds.partition(".")
    nanoseconds = int(whole) * 10**9 + int(fraction.ljust(9, "0")[:9] or 0)
    if not 0 <= nanoseconds < 2**63:
        raise ValueError(f"{seconds} s is no time")
    return nanoseconds
