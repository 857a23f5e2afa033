"""Reading of a drive, or of a drive back to a start, in one pass over its bag.

The start event, which the driver's state tells of, ties poses, reference, commands and sensors in
time. A bag that holds no drive, several, or one that was not driven as planned is refused with the
reason.
"""

from bisect import bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import isnan, nan
from pathlib import Path
from typing import Any

import numpy as np

from parameter_identification.drives.poses import PlanarTrajectory, PoseCollector, planar, stamp_of
from parameter_identification.drives.recorded import (
    IMPORTED_FROM,
    ImuSamples,
    JointStates,
    RecordedDrive,
    SteeredLeadIn,
    TopicNames,
)
from parameter_identification.drives.samples import Samples, measures_nothing
from trajectory_recorder.bag.reader import NOT_WHOLE, BagReader
from trajectory_recorder.bag.topics import deserialize
from tricycle_core.diagnostics import values_of
from tricycle_core.errors import JudgeError
from tricycle_core.joint_trajectory import rows_of
from tricycle_core.joints import JOINTS, REAR_WHEEL_JOINT, SPIN_JOINT, STEERING_JOINT
from tricycle_core.maneuver_state import ManeuverState, PlaybackState
from tricycle_core.readiness import Readiness

DURATION_TOLERANCE = 0.05  # s between the reference's end and the driver's
COMMANDS_TOLERANCE = 1e-6  # rad and rad/s between a set-point planned and played
PATH = "nav_msgs/msg/Path"
IMU, JOINT_STATE = "sensor_msgs/msg/Imu", "sensor_msgs/msg/JointState"
STATUS, DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticStatus", "diagnostic_msgs/msg/DiagnosticArray"
NOT_ARMED = "tricycle_bridge: vehicle", "not armed"  # a diagnosis: its name, how its message begins
COMMANDS_FRACTION = 0.9  # of the set-points that must be those planned: some may be lost


def read_drive(
    bag: Path | str, *, topics: TopicNames | None = None, sensors: bool = True
) -> RecordedDrive:
    """Read the drive that a bag holds.

    Parameters
    ----------
    bag : Path or str
        rosbag2 directory, ``.mcap`` or ``.db3`` file.
    topics : TopicNames, optional
        Names of the topics, where they differ from the suite's.
    sensors : bool
        Whether to read joint states and yaw rates too; judging alone does not need them.

    Raises
    ------
    BagError
        If the bag cannot be read.
    JudgeError
        If it holds no reference or several, no start event or several, an aborted maneuver, a
        vehicle that was not armed, the drive of another maneuver than its reference, no poses,
        poses that are not numbers, or stamps that jump back.
    """
    with BagReader(bag) as reader:
        return _Collector(reader, topics or TopicNames(), sensors=sensors).drive()


def read_way_back(bag: Path, *, topics: TopicNames | None = None) -> PlanarTrajectory | None:
    """Read the poses of a vehicle that drives back to a start by itself; None without any.

    Parameters
    ----------
    bag : Path
        Bag of a way back alone, or of a drive that begins after one.
    topics : TopicNames, optional
        Names of the topics, where they differ from the suite's.

    Raises
    ------
    BagError
        If the bag cannot be read.
    JudgeError
        If what it holds of states or poses is none.
    """
    with BagReader(bag) as reader:
        return _Collector(reader, topics or TopicNames(), sensors=False).way_back()


@dataclass(frozen=True)
class _StartEvent:
    time: int  # ns, by the clock that stamps the poses
    plan_id: str
    duration: float  # s
    recorded: int  # ns, when the message of the start was recorded
    ended: int  # ns, when that of the end was
    early: float | None  # s since the start, of an end before that of the commands
    whole: bool  # the end was recorded, too
    commander: str  # frame id of the driver's set-points; empty: not told


class _Collector:
    """Gathers from one pass over a bag what `RecordedDrive` needs."""

    def __init__(self, reader: BagReader, topics: TopicNames, *, sensors: bool) -> None:
        self.bag = reader.path
        self.reader = reader
        self.topics = topics
        without = "publish a plan before recording"
        if table := reader.metadata.get(IMPORTED_FROM):
            without = (
                f"{table} has no standstill before a drive; identify from the table (--columns)"
            )
        self.reference = self._name(topics.reference, without)
        self.state = self._name(topics.state, "the drive's start event is recorded there")
        self.pose = self._name(topics.pose, "name the topic of the poses")
        self.commands = self._beside(topics.commands) or self._name(topics.commands)
        self.lead_in = self._beside(topics.lead_in, PATH)
        self.played = self._beside(topics.played) or self._name(topics.played)
        self.readiness = self._beside(topics.readiness, STATUS)
        self.diagnostics = self._beside(topics.diagnostics, DIAGNOSTICS)
        self.imu = self._sensor(topics.imu, IMU) if sensors else ""
        self.joint_states = self._sensor(topics.joint_states, JOINT_STATE) if sensors else ""

    def drive(self) -> RecordedDrive:
        poses = self._pose_collector()
        latched: dict[str, dict[bytes, Any]] = {
            name: {} for name in (self.reference, self.commands, self.lead_in)
        }
        every: dict[str, list[Any]] = {
            name: [] for name in (self.played, self.imu, self.joint_states)
        }
        timed: dict[str, list[tuple[int, Any]]] = {
            name: [] for name in (self.state, self.readiness, self.diagnostics)
        }
        wanted = ({self.pose} | latched.keys() | every.keys() | timed.keys()) - {""}
        for name, recorded, data, _ in self.reader.messages(wanted):
            if name in latched and data in latched[name]:  # repeated at the beginning of each file
                continue
            message = self._message(name, data)
            if name == self.pose:
                poses.add(message)
            elif name in timed:
                timed[name].append((recorded, message))
            elif name in latched:
                latched[name][data] = message
            else:
                every[name].append(message)
        event = self._start_event(timed[self.state])
        self._check_armed(event, timed[self.readiness], timed[self.diagnostics])
        start, plan_id = event.time, event.plan_id
        commands = self._commands(latched[self.commands].values(), plan_id)
        reference = self._reference(latched[self.reference].values(), commands)
        if not abs(event.duration - reference.time[-1]) <= DURATION_TOLERANCE:
            raise JudgeError(
                f"{self.bag}: the driven maneuver lasts {event.duration:.2f} s, its reference "
                f"{reference.time[-1]:.2f} s: the reference of another maneuver"
            )
        played = [  # those of others were refused
            setpoint
            for setpoint in every[self.played]
            if event.commander in ("", setpoint.header.frame_id)
        ]
        lead_in = self._led(latched[self.lead_in].values(), commands, played, start)
        if commands is not None:
            open_loop = 0.0 if lead_in is None else lead_in.end
            self._check_commands(commands, played, event, open_loop)
        if event.early is not None:
            reference = reference.part(reference.time <= event.early)
        return RecordedDrive(
            bag=self.bag,
            plan_id=plan_id,
            start=start,
            recorded=event.recorded,
            poses=poses.since(start),
            reference=reference,
            commands=commands,
            complete=self.reader.complete and event.whole,
            metadata=self.reader.metadata,
            joint_states=_joint_states(every[self.joint_states], start),
            imu=_imu_samples(every[self.imu], start),
            wheel_rates=_wheel_rates(every[self.joint_states], start),
            topics=self.topics,
            ended_early=event.early,
            lead_in=lead_in,
        )

    def way_back(self) -> PlanarTrajectory | None:
        poses, returning, found = self._pose_collector(), False, False
        for name, _, data, _ in self.reader.messages({self.pose, self.state}):
            message = self._message(name, data)
            if name == self.state:
                returning = self._state(message).state is PlaybackState.RETURNING
            elif returning:
                poses.add(message)
                found = True
        return poses.since(0) if found else None

    def _pose_collector(self) -> PoseCollector:
        kind, topics = self.reader.topics[self.pose].type, self.topics
        return PoseCollector(self.bag, self.pose, kind, topics.child_frame, topics.datum)

    def _message(self, topic: str, data: bytes) -> Any:
        return deserialize(self.reader.topics[topic].type, data)

    def _state(self, message: Any) -> ManeuverState:
        try:
            return ManeuverState.from_values(values_of(message))
        except ValueError as error:
            raise JudgeError(
                f"{self.bag}: {self.state}: {error}; want start_time and duration in seconds"
            ) from error

    def _name(self, name: str, why: str = "", type_name: str = "") -> str:
        """Topic of the bag with this name in any namespace; "" if there is none and no ``why``."""
        found = [
            known
            for known, topic in self.reader.topics.items()
            if (known == name or known.endswith("/" + name)) and type_name in ("", topic.type)
        ]
        if len(found) > 1:
            raise JudgeError(f"{self.bag} holds {' and '.join(sorted(found))}: name the one to use")
        if not found and why:
            raise JudgeError(f"{self.bag} holds no topic {name}: {why}")
        return found[0] if found else ""

    def _sensor(self, name: str, type_name: str) -> str:
        """As `_name`, but of several the one in the namespace of the driver's state."""
        found = self._beside(name, type_name) or self._name(name, type_name=type_name)
        if not found and name not in (TopicNames.imu, TopicNames.joint_states):  # asked for
            alike = [known for known, t in self.reader.topics.items() if t.type == type_name]
            there = ", ".join(sorted(alike)) or "none"
            raise JudgeError(f"{self.bag} holds no {type_name} in {name}; it holds: {there}")
        return found

    def _beside(self, name: str, type_name: str = "") -> str:
        """Topic of this name and type in the namespace of the driver's state; "" if none."""
        usual = TopicNames.state
        own = (self.state.removesuffix(usual) if self.state.endswith(usual) else "/") + name
        topic = self.reader.topics.get(own)
        return own if topic and type_name in ("", topic.type) else ""

    def _commands(self, messages: Iterable[Any], plan_id: str) -> Any:
        """Newest commands of the plan driven; of any plan where they carry no id."""
        newest = list(messages)[::-1]
        own = (message for message in newest if message.header.frame_id == plan_id)
        return next(own, newest[0] if newest else None)

    def _led(
        self, messages: Iterable[Any], commands: Any, played: Iterable[Any], start: int
    ) -> SteeredLeadIn | None:
        """The lead-in with the stamp of the commands, as it was steered; None without one."""
        own = _stamped_alike(messages, commands)
        if not own or not own[-1].poses:
            return None
        end = stamp_of(own[-1].poses[-1]) * 1e-9
        rows = [
            (elapsed, angle)
            for setpoint in played
            if 0.0 <= (elapsed := (stamp_of(setpoint) - start) * 1e-9) < end
            for name, angle in zip(setpoint.name, setpoint.position, strict=False)
            if name == STEERING_JOINT
        ]
        time, angle = np.array(sorted(rows), dtype=np.float64).reshape(-1, 2).T
        return SteeredLeadIn(end, time, angle)

    def _reference(self, messages: Iterable[Any], commands: Any) -> PlanarTrajectory:
        """The reference with the stamp of the commands; the only one where none has it."""
        every = list(messages)
        paths = {}
        for message in _stamped_alike(every, commands) or every:
            rows = [(stamp_of(pose) * 1e-9, *planar(pose.pose)) for pose in message.poses]
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
        return PlanarTrajectory(path[:, 0], path[:, 1], path[:, 2], np.unwrap(path[:, 3]))

    def _start_event(self, messages: Iterable[tuple[int, Any]]) -> _StartEvent:
        """The start event; raises if the bag holds none or several."""
        states = [(at, self._state(message)) for at, message in messages]
        running = [(at, s) for at, s in states if s.state is PlaybackState.RUNNING]
        starts = {s.start_time for _, s in running}
        if not starts:
            why = "nothing was driven"
            if any(state.state is PlaybackState.RETURNING for _, state in states):
                why = "it holds a way back to the start only, the drive did not follow"
            elif not self.reader.complete:
                why = f"the bag is {NOT_WHOLE}"
            raise JudgeError(f"{self.bag}: {self.state} holds no start event: {why}")
        if len(starts) > 1:
            raise JudgeError(
                f"{self.bag}: {len(starts)} maneuvers were started: record every maneuver in a "
                "bag of its own"
            )
        (start,) = starts
        recorded, event = running[0]
        if start is None or not event.duration > 0:
            raise JudgeError(f"{self.bag}: {self.state}: want start_time and duration in seconds")
        ended = early = None
        for at, state in states[states.index(running[-1]) :]:
            if state.state is PlaybackState.ABORTED:
                raise JudgeError(f"{self.bag}: the maneuver was aborted: {state.reason}")
            if state.state is PlaybackState.RETURNING:  # which may be aborted too
                break
            if state.state is PlaybackState.DONE:
                ended = at
                if state.reason and state.elapsed < event.duration:
                    early = state.elapsed
                break
        whole = ended is not None
        if ended is None:
            ended = recorded + round(event.duration * 1e9)
        own = event.plan_id, event.duration
        return _StartEvent(start, *own, recorded, ended, early, whole, event.commander)

    def _check_armed(
        self,
        event: _StartEvent,
        readiness: Iterable[tuple[int, Any]],
        diagnostics: Iterable[tuple[int, Any]],
    ) -> None:
        """Raise if the vehicle said during the drive that it was not armed."""
        said = sorted(_readiness(readiness), key=lambda entry: entry[0])
        at_start = [entry for entry in said if entry[0] <= event.recorded][-1:]
        later = [entry for entry in said if event.recorded < entry[0] <= event.ended]
        # bags of before vehicle/state have only the diagnostics, of once a second
        diagnosed = (e for e in _diagnosed(diagnostics) if event.recorded <= e[0] <= event.ended)
        for at, state in at_start + later or diagnosed:
            if not state.armed:
                after = (at - event.recorded) * 1e-9
                when = f"{after:.2f} s after the start" if after > 0.0 else "at the start"
                raise JudgeError(
                    f"{self.bag}: the maneuver was not driven: the vehicle was not armed {when} "
                    f"({state.reason or 'no reason is given'})"
                )

    def _check_commands(
        self, planned: Any, played: Iterable[Any], event: _StartEvent, open_loop: float
    ) -> None:
        """Raise if what was played from a time on is not what the bag holds as the plan."""
        try:
            pairs = list(_planned_and_played(planned, played, event.time, open_loop, event.early))
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


def _stamped_alike(messages: Iterable[Any], commands: Any) -> list[Any]:
    """Messages with the stamp of the commands; none where there are no commands."""
    return [m for m in messages if commands is not None and stamp_of(m) == stamp_of(commands)]


def _planned_and_played(
    planned: Any, played: Iterable[Any], start: int, begin: float, end: float | None
) -> Iterator[tuple[float, float, float, float]]:
    """Angle and wheel speed planned, then those played, of each set-point from begin to end."""
    times, *columns = rows_of(planned).T.tolist()
    rows = list(zip(*columns, strict=True))
    for setpoint in played:
        elapsed = (stamp_of(setpoint) - start) * 1e-9
        if setpoint.name and begin <= elapsed < (times[-1] if end is None else end):
            row = bisect_right(times, elapsed + 1e-6) - 1
            steer, wheel = (setpoint.name.index(name) for name in JOINTS)
            yield *rows[row], setpoint.position[steer], setpoint.velocity[wheel]


def _readiness(messages: Iterable[tuple[int, Any]]) -> Iterator[tuple[int, Readiness]]:
    """Readiness by each message of `vehicle/state`, with the message's time."""
    for at, message in messages:
        yield at, Readiness.from_values(values_of(message))


def _diagnosed(messages: Iterable[tuple[int, Any]]) -> Iterator[tuple[int, Readiness]]:
    """Readiness by each message of the bridge's diagnostics, with the message's time."""
    name, begin = NOT_ARMED
    for at, message in messages:
        for status in message.status:
            if status.name == name:
                reason = status.message.removeprefix(begin).removeprefix(": ")
                yield at, Readiness(not status.message.startswith(begin), reason)


def _joint_states(messages: Iterable[Any], start: int) -> JointStates | None:
    """Joint states with anything of either joint; None where no message has that."""
    rows = []
    for message in messages:
        names = list(message.name)
        angles, rates, efforts = (
            dict(zip(names, values, strict=False))
            for values in (message.position, message.velocity, message.effort)
        )
        if STEERING_JOINT in angles or REAR_WHEEL_JOINT in rates.keys() | efforts.keys():
            wheel = (values.get(REAR_WHEEL_JOINT, nan) for values in (rates, efforts))
            rows.append((stamp_of(message) - start, angles.get(STEERING_JOINT, nan), *wheel))
    if not rows:
        return None
    time, *columns = np.array(rows, dtype=np.float64).T
    return JointStates(time * 1e-9, *columns)


def _wheel_rates(messages: Iterable[Any], start: int) -> dict[str, Samples]:
    """Speeds of single wheels by their names: each in its own order of stamps, which count once."""
    rates: dict[str, dict[int, float]] = {}
    for message in messages:
        for name, rate in zip(message.name, message.velocity, strict=False):
            if name.endswith(SPIN_JOINT) and not isnan(rate):
                wheel = rates.setdefault(name.removesuffix(SPIN_JOINT), {})
                wheel.setdefault(stamp_of(message) - start, rate)
    rows = {name: np.array(sorted(wheel.items())) for name, wheel in rates.items()}
    return {name: Samples(row[:, 0] * 1e-9, row[:, 1]) for name, row in rows.items()}


def _imu_samples(messages: Iterable[Any], start: int) -> ImuSamples | None:
    rows = []
    for message in messages:
        # a covariance of -1: there is none (REP-145)
        turning = message.angular_velocity_covariance[0] != -1.0
        rate = message.angular_velocity.z if turning else nan
        there = message.linear_acceleration_covariance[0] != -1.0
        sideways = message.linear_acceleration.y if there else nan
        rows.append((stamp_of(message) - start, rate, sideways))
    if not rows:
        return None
    time, rate, acceleration = np.array(rows, dtype=np.float64).T
    if measures_nothing(acceleration):
        acceleration = np.full_like(acceleration, nan)
    return ImuSamples(time * 1e-9, rate, acceleration)
