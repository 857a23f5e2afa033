"""Drives of bags as an identification needs them; see `drives.measured`."""

import contextlib
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from excitation_planner.design.noise import STANDSTILL
from parameter_identification.drives.measured import (
    MIN_SAMPLES,
    STAMP_JITTER,
    STEERING_LATE,
    MeasuredDrive,
    Sensor,
    Signal,
    of_wheels,
    resolved,
    usable,
)
from parameter_identification.drives.names import name_of
from parameter_identification.drives.reader import read_drive
from parameter_identification.drives.recorded import IMPORTED_FROM, RecordedDrive, TopicNames
from parameter_identification.drives.samples import Samples, measures_nothing
from tricycle_core.errors import CommandsError, IdentificationError, JudgeError
from tricycle_core.joint_trajectory import rows_of
from tricycle_core.quantities import FloatArray
from tricycle_core.stamps import SECOND
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle

VEHICLE_HASH = "vehicle_hash"  # in the record of a bag of `tricycle drive`
# in the record of an imported bag
SPEED_SOURCE, FROM_POSES = "speed_set_points_from", "poses"
STEERING_SOURCE, FROM_TURNS, GIVEN = "steering_map_from", "turns", "mapping"
TURN_STD = "steering_curvature_std"  # 1/m, of set-points that were made from measured angles
POSE_FILTER = "pose_filter_time_constant"  # s


def read_measured_drive(
    bag: Path | str, vehicle: Vehicle, *, topics: TopicNames | None = None
) -> MeasuredDrive:
    """Read a drive from a bag; `measured_drive` takes one that was read already.

    Parameters
    ----------
    bag : Path or str
        rosbag2 directory, ``.mcap`` or ``.db3`` file.
    vehicle : Vehicle
        Vehicle that drove; its tyre radius turns wheel rates into speeds.
    topics : TopicNames, optional
        Names of the topics, where they differ from the suite's.

    Raises
    ------
    BagError
        If the bag cannot be read.
    JudgeError
        If it holds no single maneuver with reference, start event and poses.
    IdentificationError
        If it holds no commands.
    """
    return measured_drive(read_drive(bag, topics=topics), vehicle)


def measured_drive(drive: RecordedDrive, vehicle: Vehicle) -> MeasuredDrive:
    """Return the commands and signals of a recorded drive, as an identification needs them.

    Parameters
    ----------
    drive : RecordedDrive
        From `read_drive` with its sensors.
    vehicle : Vehicle
        Vehicle that drove; its tyre radius turns wheel rates into speeds.

    Raises
    ------
    JudgeError
        If a sensor's value is infinite. NaN means not measured, and is skipped.
    IdentificationError
        If it holds no commands, or they were made from its poses, or may have been.
    """
    if made := _made_from_poses(drive.metadata):
        raise IdentificationError(
            f"{drive.bag}: {made}, for the nominal vehicle, and would be taken for knowledge of "
            "the one that drove; identify from the table: `tricycle identify TABLE --columns "
            "MAPPING`"
        )
    if IMPORTED_FROM in drive.metadata and STEERING_SOURCE not in drive.metadata:
        raise IdentificationError(
            f"{drive.bag}: imported by an earlier version, which did not note how uncertain the "
            "steering is: import the table again"
        )
    if drive.commands is None:
        raise IdentificationError(
            f"{drive.bag} holds no topic {drive.topics.commands}: without commands there is no "
            "model of the drive"
        )
    commands = commands_of(drive.commands, vehicle, str(drive.bag))
    if drive.lead_in is not None:
        commands = drive.lead_in.in_place(commands)
    if drive.ended_early is not None:
        commands = commands.until(drive.ended_early)
    late = STEERING_LATE if IMPORTED_FROM in drive.metadata else 0.0
    end = commands.duration
    signals = _signals(drive, vehicle, end - late)
    return MeasuredDrive(
        name=name_of(drive.bag),
        commands=commands,
        signals=usable(signals, vehicle),
        reference=drive.reference,
        truth=_truth(drive.metadata),
        complete=drive.complete,
        began=drive.recorded / SECOND,
        steering_angle=_steering_angle(drive, end),
        turn_std=_told(drive, TURN_STD),
        steering_late=late,
        pose_filter=_told(drive, POSE_FILTER),
        vehicle_hash=drive.metadata.get(VEHICLE_HASH, ""),
        unheard=tuple(sensor for sensor, s in signals.items() if len(s.time) < MIN_SAMPLES),
    )


def _made_from_poses(metadata: Mapping[str, str]) -> str:
    """What of the commands of an imported bag was made from its poses; empty: nothing."""
    if metadata.get(SPEED_SOURCE) == FROM_POSES:
        return "its table has no speed_command: the set-points were made from its poses"
    if metadata.get(STEERING_SOURCE) == FROM_TURNS:
        return "its mapping has no gain of the steering: it was estimated from the turns"
    return ""


def _told(drive: RecordedDrive, entry: str) -> float:
    """A number that the record of an imported bag holds; 0 where it holds none."""
    told = drive.metadata.get(entry, "0")
    with contextlib.suppress(ValueError):
        if 0.0 <= (number := float(told)) < math.inf:
            return number
    raise IdentificationError(f"{drive.bag}: {entry} = {told!r} must be a number from 0 on")


def _signals(drive: RecordedDrive, vehicle: Vehicle, end: float) -> dict[Sensor, Signal]:
    """Signals of all sensors that were recorded, from the standstill to an end [s]."""
    poses = drive.poses
    signals = {Sensor.POSITION: Signal(poses.time, np.column_stack([poses.x, poses.y]))}
    if np.isfinite(poses.heading).all():
        signals[Sensor.HEADING] = Signal(poses.time, poses.heading[:, None])
    optional: list[tuple[Sensor, FloatArray, FloatArray]] = []
    if (imu := drive.imu) is not None:
        optional += [
            (Sensor.YAW_RATE, imu.time, imu.yaw_rate),
            (Sensor.LATERAL_ACCELERATION, imu.time, imu.lateral_acceleration),
        ]
    if (joints := drive.joint_states) is not None:
        optional.append((Sensor.WHEEL_SPEED, joints.time, joints.wheel_rate))
        if not measures_nothing(joints.motor_torque):
            optional.append((Sensor.MOTOR_TORQUE, joints.time, joints.motor_torque))
    for sensor, time, values in optional:
        if (measured := ~np.isnan(values)).any():
            samples = _samples(drive.bag, sensor.value, time[measured], values[measured])
            signals[sensor] = Signal(samples.time, samples.values[:, None], STAMP_JITTER[sensor])
    wheels = {
        w.name: drive.wheel_rates[w.name] for w in vehicle.wheels if w.name in drive.wheel_rates
    }
    if wheels:
        signals[Sensor.WHEEL_SPEEDS] = of_wheels(wheels)
    signals = {sensor: signal.between(-STANDSTILL, end) for sensor, signal in signals.items()}
    if Sensor.WHEEL_SPEED in signals:  # before the start, it may have begun at any speed
        signals[Sensor.WHEEL_SPEED] = resolved(signals[Sensor.WHEEL_SPEED])
    return signals


def _steering_angle(drive: RecordedDrive, end: float) -> Samples | None:
    """Measured angle of the steering motor up to an end."""
    if (joints := drive.joint_states) is None:
        return None
    there = (joints.time >= 0.0) & (joints.time <= end) & ~np.isnan(joints.steering_motor_angle)
    time, angle = joints.time[there], joints.steering_motor_angle[there]
    return _samples(drive.bag, "steering angle", time, angle) if len(time) else None


def _samples(bag: Path, what: str, stamps: FloatArray, values: FloatArray) -> Samples:
    """Samples (m,) at stamps (m,) s in their order; a stamp counts once."""
    time, first = np.unique(stamps, return_index=True)
    values = values[first]
    if (wrong := ~np.isfinite(values)).any():
        raise JudgeError(f"{bag}: {what} at {time[wrong][0]:.3f} s is not a number")
    return Samples(time, values)


def _truth(metadata: Mapping[str, str]) -> dict[str, float]:
    """True values that a simulation left in the bag's record as ``true_<parameter>``."""
    truth = {}
    for key, value in metadata.items():
        if key.startswith("true_"):
            with contextlib.suppress(ValueError):
                truth[key.removeprefix("true_")] = float(value)
    return truth


def commands_of(message: Any, vehicle: Vehicle, where: str) -> Commands:
    """Return the commands that a message of `maneuver/commands` holds.

    Parameters
    ----------
    message : JointTrajectory message
        Message as rosbags or rclpy gives it.
    vehicle : Vehicle
        Vehicle to drive; its tyre radius turns wheel rates into speeds.
    where : str
        For messages.

    Raises
    ------
    IdentificationError
        If a joint or a value is missing, or the commands are none.
    """
    try:
        time, angle, rate = rows_of(message).T
        return Commands(time, angle, rate * vehicle.driven_radius)
    except (ValueError, IndexError, CommandsError) as error:
        raise IdentificationError(f"{where}: commands: {error}") from error
