"""Contents of the bag of a drive: measured poses, the reference, the commands, and sensor signals.

Times are seconds since the start event, the tick at which row 0 of the commands was played.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from parameter_identification.drives.poses import Datum, PlanarTrajectory
from parameter_identification.drives.samples import Samples
from tricycle_core.frames import BASE_LINK
from tricycle_core.quantities import FloatArray
from tricycle_core.readiness import TOPIC as READINESS
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands

IMPORTED_FROM = "imported_from"  # in the record of an imported bag: the name of its table


@dataclass(frozen=True)
class TopicNames:
    """Names of the topics that make a drive; bags of other systems may use other names.

    Attributes
    ----------
    pose : str
        Odometry, PoseStamped, TransformStamped, TFMessage or NavSatFix.
    reference, state, commands, lead_in, played : str
        Topics of planner and maneuver driver.
    readiness, diagnostics : str
        Topics of the bridge: whether the vehicle was armed.
    imu, joint_states : str
        Sensors that only an identification needs.
    child_frame : str
        Frame of the poses and transforms to take.
    datum : Datum, optional
        Origin for NavSatFix.
    """

    pose: str = "odom"
    reference: str = "maneuver/reference"
    state: str = "maneuver/state"
    commands: str = "maneuver/commands"
    lead_in: str = "maneuver/lead_in"
    played: str = "joint_commands"
    readiness: str = READINESS
    diagnostics: str = "diagnostics"
    imu: str = "imu"
    joint_states: str = "joint_states"
    child_frame: str = BASE_LINK
    datum: Datum | None = None


@dataclass(frozen=True, eq=False)
class JointStates:
    """Joint states as the PLCs measured them, in the order of recording.

    Attributes
    ----------
    time : ndarray of float, shape (t,)
        Stamps since the start event [s].
    steering_motor_angle : ndarray of float, shape (t,)
        Left positive [rad]; NaN where a message has none.
    wheel_rate : ndarray of float, shape (t,)
        Rate of the rear wheel [rad/s]; NaN where a message has none.
    motor_torque : ndarray of float, shape (t,)
        At the driven wheels [N m]: their effort; NaN where a message has none.
    """

    time: FloatArray
    steering_motor_angle: FloatArray
    wheel_rate: FloatArray
    motor_torque: FloatArray


@dataclass(frozen=True, eq=False)
class ImuSamples:
    """Samples of the IMU, in the order of recording.

    Attributes
    ----------
    time : ndarray of float, shape (t,)
        Stamps since the start event [s].
    yaw_rate : ndarray of float, shape (t,)
        Left positive [rad/s]; NaN where the message says that there is none.
    lateral_acceleration : ndarray of float, shape (t,)
        To the left [m/s^2]; NaN where the message says that there is none.
    """

    time: FloatArray
    yaw_rate: FloatArray
    lateral_acceleration: FloatArray


@dataclass(frozen=True, eq=False)
class SteeredLeadIn:
    """The steering while the driver kept the vehicle on a line, in place of that of the commands.

    Attributes
    ----------
    end : float
        Time since the start event from which the commands hold [s].
    time : ndarray of float, shape (r,)
        Times of the set-points since the start event [s].
    steering_motor_angle : ndarray of float, shape (r,)
        Left positive [rad].
    """

    end: float
    time: FloatArray
    steering_motor_angle: FloatArray

    def in_place(self, commands: Commands) -> Commands:
        """Return commands with this steering.

        Parameters
        ----------
        commands : Commands
            Commands of the plan.
        """
        ticks = np.arange(round(self.end / TICK))
        later = commands.time[commands.time > (len(ticks) + 0.5) * TICK]
        time = np.concatenate([TICK * np.append(ticks, len(ticks)), later])
        rows = np.searchsorted(commands.time, time + 0.1 * TICK, side="right") - 1
        angle = commands.steering_motor_angle[rows]
        if len(self.time):
            newest = np.searchsorted(np.round(self.time / TICK), ticks, side="right") - 1
            led = self.steering_motor_angle[newest]
            angle[: len(ticks)] = np.where(newest >= 0, led, angle[: len(ticks)])
        return Commands(time, angle, commands.speed[rows])


@dataclass(frozen=True, eq=False)
class RecordedDrive:
    """One driven maneuver as a bag holds it: what is judged and identified from.

    Attributes
    ----------
    bag : Path
        Path of the bag.
    plan_id : str
        Identifier of the plan that was driven.
    start : int
        Stamp of the start event [ns], by the clock that stamps the poses.
    recorded : int
        Time at which the start event was recorded [ns since 1970], by the recorder's clock.
    poses : PlanarTrajectory
        Measured, in the frame of the sensor; with what was recorded before and after the drive.
    reference : PlanarTrajectory
        Nominal trajectory, starting at the origin with heading 0.
    commands : JointTrajectory message or None
        Commands of the plan that was driven; None where the bag has none.
    complete : bool
        False where the bag was cut off, lacks a file or messages, or does not hold the end.
    metadata : mapping of str to str
        Notes of the recorder.
    joint_states, imu : JointStates, ImuSamples, optional
        None where the bag has none, or they were not read.
    wheel_rates : mapping of str to Samples
        Rates of single wheels [rad/s] over the time since the start event [s], by name of the
        wheel: that of its joint is `<name>_wheel_spin_joint`.
    topics : TopicNames
        Names by which it was read.
    ended_early : float, optional
        Time at which the driver ended the maneuver, because no more of it was needed [s]; the
        reference ends then, the commands go on. None: it was driven to its end.
    lead_in : SteeredLeadIn, optional
        Steering by the driver, closed loop, before the commands; None: there was none.
    """

    bag: Path
    plan_id: str
    start: int
    recorded: int
    poses: PlanarTrajectory
    reference: PlanarTrajectory
    commands: Any
    complete: bool
    metadata: Mapping[str, str] = field(default_factory=dict)
    joint_states: JointStates | None = None
    imu: ImuSamples | None = None
    wheel_rates: Mapping[str, Samples] = field(default_factory=dict)
    topics: TopicNames = field(default_factory=TopicNames)
    ended_early: float | None = None
    lead_in: SteeredLeadIn | None = None

    @property
    def driven(self) -> PlanarTrajectory:
        """Poses from the start event to the end of the reference."""
        time = self.poses.time
        return self.poses.part((time >= 0.0) & (time <= self.duration))

    @property
    def duration(self) -> float:
        """Duration of the reference [s]."""
        return float(self.reference.time[-1])
