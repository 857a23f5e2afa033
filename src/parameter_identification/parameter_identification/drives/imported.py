"""A recording of another system as a bag, with the topics that the suite's own recorder has.

Where the vehicle stands before it drives, the moment when it starts is the start event, and the
reference is what the nominal vehicle does with the recorded commands: such a bag can be judged and,
where the set-points of the speed were recorded and the map of the steering is known, identified
from as a drive of a plan.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from parameter_identification.drives.measured import MeasuredDrive, Sensor
from parameter_identification.drives.measured_from_bag import (
    FROM_POSES,
    FROM_TURNS,
    GIVEN,
    POSE_FILTER,
    SPEED_SOURCE,
    STEERING_SOURCE,
    TURN_STD,
)
from parameter_identification.drives.motion import motion_of
from parameter_identification.drives.recorded import IMPORTED_FROM
from parameter_identification.drives.samples import Samples
from parameter_identification.drives.table import WHEELS, EstimatedMap, Recording, SteeringMap
from parameter_identification.drives.windows import MEASURED, recorded_commands
from trajectory_recorder.bag.topics import OfferedQos, Topic, jazzy
from trajectory_recorder.bag.writer import BagWriter, whole_or_none
from tricycle_core.errors import IdentificationError
from tricycle_core.frames import BASE_LINK, ODOM
from tricycle_core.joints import JOINTS, REAR_WHEEL_JOINT, SPIN_JOINT, STEERING_JOINT
from tricycle_core.maneuver_state import ManeuverState, PlaybackState
from tricycle_core.quantities import FloatArray
from tricycle_core.rotations import about_vertical
from tricycle_core.stamps import SECOND, split_seconds
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import simulate

STANDING = 0.02  # m/s
AT_REST = 0.6  # s: half before the start event, for the judge, half until the vehicle moves
LAST = 2.0**31 - 1.0  # s, of the stamp of a message
STATE_EVERY = 0.5  # s, as the maneuver driver repeats its state
LATCHED = (OfferedQos(durability="transient_local", depth=1),)
KINDS = {
    "/odom": "nav_msgs/msg/Odometry",
    "/imu": "sensor_msgs/msg/Imu",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/maneuver/reference": "nav_msgs/msg/Path",
    "/maneuver/commands": "trajectory_msgs/msg/JointTrajectory",
    "/maneuver/state": "diagnostic_msgs/msg/DiagnosticStatus",
}
Row = tuple[int, str, Any]  # stamp [ns], topic, message


def recording_of(drive: MeasuredDrive) -> Recording:
    """Return a measured drive as a recording, e.g. to write a simulated one as a bag.

    Parameters
    ----------
    drive : MeasuredDrive
        Drive with positions, and with headings at the same times if any; it begins at a standstill.
    """
    position, commands = drive.signals[Sensor.POSITION], drive.commands
    first = float(position.time[0])
    heading = drive.signals.get(Sensor.HEADING)
    time = np.append(0.0, commands.time - first)
    more = {"speed_command": Samples(time, np.append(0.0, commands.speed))}
    for name, sensor in MEASURED.items():
        if sensor in drive.signals:
            signal = drive.signals[sensor]
            more[name] = Samples(signal.time - first, signal.values[:, 0])
    if (wheels := drive.signals.get(Sensor.WHEEL_SPEEDS)) is not None:
        for wheel, values in zip(wheels.wheels, wheels.values.T, strict=True):
            more[f"{WHEELS}.{wheel}"] = Samples(wheels.time - first, values)
    return Recording(
        name=drive.name,
        start=0.0,
        time=position.time - first,
        x=position.values[:, 0],
        y=position.values[:, 1],
        yaw=None if heading is None else heading.values[:, 0],
        steering=Samples(time, np.append(0.0, commands.steering_motor_angle)),
        more=more,
    )


def write_bag(
    recording: Recording, vehicle: Vehicle, steering: SteeringMap, output: Path
) -> float | None:
    """Write a recording as a bag (MCAP); return the time of its start event [s].

    Parameters
    ----------
    recording : Recording
        From `read_recording`.
    vehicle : Vehicle
        Vehicle that drove; its nominal values give the reference.
    steering : SteeringMap
        From the recording's steering to the angle of the steering motor.
    output : Path
        Directory to create.

    Returns
    -------
    float or None
        None where the vehicle does not stand for 0.6 s before it drives: the bag has no start event
        then, no commands and no reference.

    Raises
    ------
    BagError
        If the output exists.
    CommandsError
        If the commands are beyond what the model takes.
    IdentificationError
        If the vehicle has no wheel of a name, a time is none of a bag, or what was recorded of a
        drive with a start event contradicts the poses, has a gap, or is beyond what the model
        takes.
    """
    metadata = {IMPORTED_FROM: recording.name}
    if "speed_command" not in recording.more:
        metadata[SPEED_SOURCE] = FROM_POSES
    metadata[STEERING_SOURCE] = FROM_TURNS if isinstance(steering, EstimatedMap) else GIVEN
    if recording.pose_filter > 0.0:
        metadata[POSE_FILTER] = repr(recording.pose_filter)
    rows = list(_sensed(recording, vehicle, steering))
    start = _start(recording)
    if start is not None:
        commands, turn_std = recorded_commands(recording, vehicle, steering, start)
        rows += _driven(recording, vehicle, commands, start)
        if turn_std > 0.0:
            metadata[TURN_STD] = repr(float(turn_std))
    rows.sort(key=lambda row: row[0])
    names = [name for name in KINDS if any(row[1] == name for row in rows)]
    with whole_or_none(BagWriter(output, metadata=metadata)) as bag:
        ids = {
            name: bag.add_topic(
                Topic.of_type(name, KINDS[name], qos=LATCHED if "maneuver" in name else ())
            )
            for name in names
        }
        for stamp, name, message in rows:
            bag.write(ids[name], stamp, bytes(jazzy().serialize_cdr(message, KINDS[name])))
    return start


def _start(recording: Recording) -> float | None:
    """Time shortly before the vehicle leaves its first standstill [s]; None without one."""
    motion = motion_of(recording)
    speed = np.abs(motion.speed)
    first = int(np.argmax(speed > 0.1))
    standing = np.flatnonzero(speed[:first] < STANDING)
    if not len(standing) or motion.time[standing[-1]] - motion.time[0] < AT_REST:
        return None
    return float(motion.time[standing[-1]]) - 0.5 * AT_REST


def _sensed(recording: Recording, vehicle: Vehicle, steering: SteeringMap) -> Iterator[Row]:
    yaw = [None] * len(recording.time) if recording.yaw is None else recording.yaw
    for time, x, y, heading in zip(recording.time, recording.x, recording.y, yaw, strict=True):
        stamp = _stamp(recording, time)
        yield stamp, "/odom", _odometry(stamp, x, y, heading)
    more = recording.more
    ahead, left = more.get("acceleration_x"), more.get("acceleration_y")
    if ahead is not None and left is not None:  # one message holds both
        known = left.time[ahead.known(left.time)]
        ahead = Samples(known, ahead.at(known))
    for stamp, *values in _rows(recording, [more.get("yaw_rate"), ahead, left]):
        yield stamp, "/imu", _imu(stamp, *values)
    angle = None
    if recording.steering_measured:
        measured = recording.steering
        angle = Samples(measured.time, steering.angle(measured.values))
    driving = [angle, more.get("wheel_speed"), more.get("motor_torque")]
    for stamp, *row in _rows(recording, driving):
        joints = {
            STEERING_JOINT: (row[0], math.nan, math.nan),
            REAR_WHEEL_JOINT: (math.nan, row[1], row[2]),
        }
        yield stamp, "/joint_states", _joint_state(stamp, joints)
    wheels = recording.wheel_speeds(vehicle)
    for stamp, *speeds in _rows(recording, list(wheels.values())):
        joints = {
            f"{w}{SPIN_JOINT}": (math.nan, speed, math.nan)
            for w, speed in zip(wheels, speeds, strict=True)
        }
        yield stamp, "/joint_states", _joint_state(stamp, joints)


def _rows(
    recording: Recording, columns: Sequence[Samples | None]
) -> Iterator[tuple[int, *tuple[float, ...]]]:
    """Stamps, and the samples of columns then; NaN of those that have none."""
    rows: dict[int, list[float]] = {}
    for number, samples in enumerate(columns):
        if samples is not None:
            for time, value in zip(samples.time, samples.values, strict=True):
                row = rows.setdefault(_stamp(recording, time), [math.nan] * len(columns))
                row[number] = float(value)
    for stamp, row in rows.items():
        yield stamp, *row


def _driven(
    recording: Recording, vehicle: Vehicle, commands: Commands, start: float
) -> Iterator[Row]:
    """Commands, reference and start event."""
    nominal = simulate(vehicle, commands, vehicle.nominal_point()[np.newaxis], threads=1)
    first, at = _stamp(recording, recording.time[0]), _stamp(recording, start)
    poses = [
        _message("geometry_msgs/msg/PoseStamped", header=_header(round(t * 1e9)), pose=_pose(*p))
        for t, *p in zip(nominal.time, nominal.x[0], nominal.y[0], nominal.yaw[0], strict=True)
    ]
    yield (
        first,
        "/maneuver/reference",
        _message("nav_msgs/msg/Path", header=_header(first), poses=poses),
    )
    yield first, "/maneuver/commands", _trajectory(first, commands, vehicle.driven_radius)
    states = dict.fromkeys(np.arange(0.0, commands.duration, STATE_EVERY), PlaybackState.RUNNING)
    states[commands.duration] = PlaybackState.DONE
    for elapsed, state in states.items():
        values = ManeuverState(state, "imported", at, elapsed, commands.duration).values()
        pair = "diagnostic_msgs/msg/KeyValue"
        yield (
            at + round(elapsed * 1e9),
            "/maneuver/state",
            _message(
                "diagnostic_msgs/msg/DiagnosticStatus",
                level=0,
                name="tricycle import: maneuver",
                message=state.value,
                hardware_id="",
                values=[_message(pair, key=key, value=value) for key, value in values.items()],
            ),
        )


def _stamp(recording: Recording, time: float) -> int:
    start = max(recording.start, -recording.earliest)  # no stamp is below 0
    if start + time >= LAST:
        raise IdentificationError(
            f"{recording.name}: time {start + time:.10g} s: a bag's end in 2038, at {LAST:.0f} s; "
            "give the unit of the column in the mapping, as time: {column: t, unit: ms}"
        )
    return round(start * 1e9) + round(time * 1e9)


def _message(kind: str, /, **entries: Any) -> Any:
    return jazzy().types[kind](**entries)


def _header(stamp: int, frame: str = ODOM) -> Any:
    time = _message("builtin_interfaces/msg/Time", sec=stamp // SECOND, nanosec=stamp % SECOND)
    return _message("std_msgs/msg/Header", stamp=time, frame_id=frame)


def _vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    return _message("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z))


def _pose(x: float, y: float, heading: float | None) -> Any:
    """Pose; the quaternion is zero, which is none, where there is no heading."""
    z, w = (0.0, 0.0) if heading is None else about_vertical(float(heading))
    return _message(
        "geometry_msgs/msg/Pose",
        position=_message("geometry_msgs/msg/Point", x=float(x), y=float(y), z=0.0),
        orientation=_message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=z, w=w),
    )


def _odometry(stamp: int, x: float, y: float, heading: float | None) -> Any:
    nothing: FloatArray = np.zeros(36)
    twist = _message("geometry_msgs/msg/Twist", linear=_vector(), angular=_vector())
    pose = _pose(x, y, heading)
    return _message(
        KINDS["/odom"],
        header=_header(stamp),
        child_frame_id=BASE_LINK,
        pose=_message("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=nothing),
        twist=_message("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=nothing),
    )


def _joint_state(stamp: int, joints: Mapping[str, tuple[float, ...]]) -> Any:
    """Position, velocity and effort by joint."""
    position, velocity, effort = (np.array(values) for values in zip(*joints.values(), strict=True))
    return _message(
        KINDS["/joint_states"],
        header=_header(stamp),
        name=list(joints),
        position=position,
        velocity=velocity,
        effort=effort,
    )


def _imu(stamp: int, rate: float, ahead: float, left: float) -> Any:
    unknown = np.array([-1.0, *[0.0] * 8])  # the message's way to say that there is none
    turning, there = math.isfinite(rate), math.isfinite(ahead) or math.isfinite(left)
    return _message(
        KINDS["/imu"],
        header=_header(stamp, BASE_LINK),
        orientation=_message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=unknown,
        angular_velocity=_vector(z=rate if turning else 0.0),
        angular_velocity_covariance=np.zeros(9) if turning else unknown,
        linear_acceleration=_vector(ahead, left) if there else _vector(),
        linear_acceleration_covariance=np.zeros(9) if there else unknown,
    )


def _trajectory(stamp: int, commands: Commands, radius: float) -> Any:
    points = []
    for time, angle, speed in zip(
        commands.time, commands.steering_motor_angle, commands.speed, strict=True
    ):
        sec, nanosec = split_seconds(float(time))
        points.append(
            _message(
                "trajectory_msgs/msg/JointTrajectoryPoint",
                positions=np.array([angle, 0.0]),
                velocities=np.array([0.0, speed / radius]),
                accelerations=np.zeros(0),
                effort=np.zeros(0),
                time_from_start=_message(
                    "builtin_interfaces/msg/Duration", sec=sec, nanosec=nanosec
                ),
            )
        )
    return _message(
        KINDS["/maneuver/commands"],
        header=_header(stamp, "imported"),
        joint_names=list(JOINTS),
        points=points,
    )
