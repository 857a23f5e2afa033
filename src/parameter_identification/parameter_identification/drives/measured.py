"""What identification needs of a drive: the commands, and what the sensors said of the motion.

A bag makes one (`read_measured_drive`), and so does a simulation (`measure`), so that the estimator
cannot tell them apart. Times are seconds since the start event, at which row 0 of the commands was
played; samples before it, at standstill, are welcome: they tell the start pose and a gyro's bias.
Letters of shapes: `m` samples of a signal, `t` points of a motion.
"""

import contextlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

import numpy as np

from parameter_identification.drives.recorded import Path2D, Topics, read_drive
from trajectory_recorder.bag.reader import BagReader
from trajectory_recorder.bag.topics import decode
from tricycle_core.errors import CommandsError, IdentificationError, JudgeError
from tricycle_core.joints import REAR_WHEEL_JOINT, STEERING_JOINT
from tricycle_core.quantities import FloatArray
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import UNKNOWN_PARAMETERS, Vehicle
from tricycle_sim.vehicle.batch import Trajectory

STANDSTILL = 1.0  # s before the start event that are used


class Sensor(Enum):
    """What measures: each has a noise of its own."""

    POSITION = "position"  # x and y of base_link in odom, m
    HEADING = "heading"  # rad, left positive
    YAW_RATE = "yaw rate"  # rad/s, base_link
    WHEEL_SPEED = "wheel speed"  # rad/s, rear wheel relative to the body

    @property
    def unit(self) -> str:
        """Unit of its values."""
        return {"position": "m", "heading": "rad"}.get(self.value, "rad/s")

    @property
    def channels(self) -> tuple[str, ...]:
        """Name of each column of its values."""
        return ("x", "y") if self is Sensor.POSITION else (self.value,)


# of stamps; the PLCs measure anywhere between two ticks of 10 ms, of which the bridge knows one
STAMP_JITTER = {Sensor.YAW_RATE: 0.0, Sensor.WHEEL_SPEED: 0.005}


@dataclass(frozen=True, eq=False)
class Signal:
    """Samples of a sensor.

    Attributes
    ----------
    time : (m,) s since the start event, strictly increasing
    values : (m, c) one column per channel; headings are continuous
    jitter : standard deviation of the stamps, s: noise where the values change quickly
    """

    time: FloatArray
    values: FloatArray
    jitter: float = 0.0

    def __post_init__(self) -> None:
        if self.values.shape[:1] != self.time.shape or self.values.ndim != 2:
            raise IdentificationError(
                f"signal: values of shape {self.values.shape} at {len(self.time)} times"
            )
        if not (np.isfinite(self.time).all() and np.isfinite(self.values).all()):
            raise IdentificationError("signal: times and values must be finite")
        if np.any(np.diff(self.time) <= 0):
            raise IdentificationError("signal: times must increase")

    def between(self, start: float, end: float) -> "Signal":
        """Samples from `start` to `end`, s, both included."""
        inside = (self.time >= start) & (self.time <= end)
        return Signal(self.time[inside], self.values[inside], self.jitter)


@dataclass(frozen=True)
class StartPose:
    """What is known of the pose at the start event besides the signals: by default nothing.

    Attributes
    ----------
    x, y, heading : m, m, rad in the frame of the positions; None: seen from the signals
    position_std, heading_std : standard deviations per axis, m and rad
    """

    x: float | None = None
    y: float | None = None
    heading: float | None = None
    position_std: float = 1.0
    heading_std: float = 0.5

    def __post_init__(self) -> None:
        if not (self.position_std > 0 and self.heading_std > 0):
            raise IdentificationError("start pose: standard deviations must be positive")


@dataclass(frozen=True, eq=False)
class MeasuredDrive:
    """One drive.

    Attributes
    ----------
    name : for messages and figures
    commands : what was played from the start event on
    signals : by sensor; a position is needed, the others are welcome
    start : what is known of the start pose
    reference : the plan's nominal trajectory, where there is one: tells a bag of another vehicle
    truth : true values of the unknown parameters, where the drive was simulated and says them
    complete : False where the recording was cut off
    """

    name: str
    commands: Commands
    signals: Mapping[Sensor, Signal]
    start: StartPose = field(default_factory=StartPose)
    reference: Path2D | None = None
    truth: Mapping[str, float] = field(default_factory=dict)
    complete: bool = True

    def __post_init__(self) -> None:
        if Sensor.POSITION not in self.signals:
            raise IdentificationError(f"{self.name}: no positions: nothing to identify from")
        for sensor, signal in self.signals.items():
            if signal.values.shape[1] != len(sensor.channels):
                raise IdentificationError(
                    f"{self.name}: {sensor.value}: needs {len(sensor.channels)} columns"
                )


@dataclass(frozen=True)
class SensorNoise:
    """Noise of a synthetic sensor.

    Attributes
    ----------
    white : standard deviation of the white part, in the sensor's unit
    drift, drift_time : standard deviation and correlation time (s) of an exponentially correlated
        part
    rate : Hz
    """

    white: float
    drift: float = 0.0
    drift_time: float = 5.0
    rate: float = 20.0

    def __post_init__(self) -> None:
        if not (self.white >= 0 and self.drift >= 0 and self.drift_time > 0 and self.rate > 0):
            raise IdentificationError(
                f"noise: {self}: needs white, drift >= 0 and drift_time, rate > 0"
            )

    def draw(self, m: int, rng: np.random.Generator) -> FloatArray:
        """Noise (m,) of samples at `rate`."""
        noise = self.white * rng.standard_normal(m)
        if self.drift > 0:
            a = math.exp(-1.0 / (self.rate * self.drift_time))
            kicks = self.drift * rng.standard_normal(m)
            drift = np.empty(m)
            drift[0] = kicks[0]
            for k in range(1, m):
                drift[k] = a * drift[k - 1] + math.sqrt(1.0 - a * a) * kicks[k]
            noise += drift
        return noise


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of one vehicle, as sensors see it; arrays (t,), SI, from the start event on."""

    time: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    yaw_rate: FloatArray
    wheel_speed: FloatArray

    @classmethod
    def of(cls, trajectory: Trajectory, sample: int = 0) -> "Motion":
        """One sample of a simulated trajectory."""
        t = trajectory
        return cls(
            t.time,
            *(v[sample] for v in (t.x, t.y, t.yaw, t.yaw_rate, t.wheel_speed_rear)),
        )


def measure(
    motion: Motion,
    commands: Commands,
    noise: Mapping[Sensor, SensorNoise],
    *,
    rng: np.random.Generator,
    name: str = "simulated",
    standstill: float = 0.0,
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
    start: StartPose | None = None,
    truth: Mapping[str, float] | None = None,
) -> MeasuredDrive:
    """Measure a motion with sensors of given noise.

    Parameters
    ----------
    motion : what the vehicle did
    commands : what it was told
    noise : of the sensors there are
    rng : of the noise
    standstill : s before the start event at which the sensors begin
    pose : of the start in the frame of the positions, m, m, rad
    start : what is told of the start pose
    truth : parameters of the motion, for `MeasuredDrive.truth`
    """
    x0, y0, psi0 = pose
    c, s = math.cos(psi0), math.sin(psi0)
    columns = {
        Sensor.POSITION: (x0 + c * motion.x - s * motion.y, y0 + s * motion.x + c * motion.y),
        Sensor.HEADING: (psi0 + motion.heading,),
        Sensor.YAW_RATE: (motion.yaw_rate,),
        Sensor.WHEEL_SPEED: (motion.wheel_speed,),
    }
    signals = {}
    for sensor, model in noise.items():
        before = math.floor(standstill * model.rate)
        count = math.floor(motion.time[-1] * model.rate + 1e-9)
        time = np.arange(-before, count + 1) / model.rate
        exact = [np.interp(time, motion.time, column) for column in columns[sensor]]
        values = [v + model.draw(len(time), rng) for v in exact]
        signals[sensor] = Signal(time, np.column_stack(values))
    return MeasuredDrive(name, commands, signals, start or StartPose(), truth=dict(truth or {}))


@dataclass(frozen=True)
class SignalTopics:
    """Where a bag keeps what identification needs besides what the judge needs."""

    judged: Topics = field(default_factory=Topics)
    imu: str = "imu"
    joints: str = "joint_states"


def read_measured_drive(
    bag: Path, vehicle: Vehicle, *, topics: SignalTopics | None = None
) -> MeasuredDrive:
    """Take a drive out of a bag.

    Parameters
    ----------
    bag : rosbag2 directory, ``.mcap`` or ``.db3`` file
    vehicle : its tyre radius turns the wheel's speeds into set-points
    topics : names where they differ from the suite's

    Raises
    ------
    BagError
        If the bag cannot be read.
    JudgeError
        If it holds no single maneuver with reference, start event and poses.
    IdentificationError
        If it holds no commands.
    """
    topics = topics or SignalTopics()
    drive = read_drive(bag, topics=topics.judged)
    if drive.commands is None:
        raise IdentificationError(
            f"{bag} holds no topic {topics.judged.commands}: without commands there is no model "
            "of the drive"
        )
    commands = _commands(drive.commands, vehicle, bag)
    rows: dict[Sensor, list[tuple[int, float]]] = {Sensor.YAW_RATE: [], Sensor.WHEEL_SPEED: []}
    with BagReader(bag) as reader:
        wanted = {
            known: name
            for name in (topics.imu, topics.joints)
            for known in reader.topics
            if known == name or known.endswith("/" + name)
        }
        for topic, _, data in reader.messages(set(wanted)):
            message = decode(reader.topics[topic].type, data)
            stamp = message.header.stamp
            nanoseconds = int(stamp.sec) * 10**9 + int(stamp.nanosec) - drive.start
            if wanted[topic] == topics.imu:
                rows[Sensor.YAW_RATE].append((nanoseconds, message.angular_velocity.z))
            elif REAR_WHEEL_JOINT in message.name:
                speed = message.velocity[message.name.index(REAR_WHEEL_JOINT)]
                rows[Sensor.WHEEL_SPEED].append((nanoseconds, speed))
    poses = drive.poses
    signals = {Sensor.POSITION: Signal(poses.time, np.column_stack([poses.x, poses.y]))}
    if np.isfinite(poses.heading).all():
        signals[Sensor.HEADING] = Signal(poses.time, poses.heading[:, None])
    for sensor, samples in rows.items():
        if samples:
            signals[sensor] = _signal(np.array(samples, dtype=np.float64), bag, sensor)
    end = commands.duration
    return MeasuredDrive(
        name=drive.bag.stem,
        commands=commands,
        signals={sensor: signal.between(-STANDSTILL, end) for sensor, signal in signals.items()},
        reference=drive.reference,
        truth=_truth(drive.metadata),
        complete=drive.complete,
    )


def _truth(metadata: Mapping[str, str]) -> dict[str, float]:
    """True values that a simulation left in the bag's record as ``true_<parameter>``."""
    truth = {}
    for name in UNKNOWN_PARAMETERS:
        with contextlib.suppress(KeyError, ValueError):
            truth[name] = float(metadata[f"true_{name}"])
    return truth


def _signal(samples: FloatArray, bag: Path, sensor: Sensor) -> Signal:
    """Signal of (m, 2) stamps in ns since the start event and values, in the order of time."""
    time, first = np.unique(samples[:, 0] * 1e-9, return_index=True)
    values = samples[first, 1]
    wrong = ~np.isfinite(values)
    if wrong.any():
        raise JudgeError(f"{bag}: {sensor.value} at {time[wrong][0]:.3f} s is not a number")
    return Signal(time, values[:, None], STAMP_JITTER[sensor])


def _commands(message: object, vehicle: Vehicle, bag: Path) -> Commands:
    points = message.points  # type: ignore[attr-defined]
    names = list(message.joint_names)  # type: ignore[attr-defined]
    try:
        steer, wheel = names.index(STEERING_JOINT), names.index(REAR_WHEEL_JOINT)
        return Commands(
            [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in points],
            [p.positions[steer] for p in points],
            [p.velocities[wheel] * vehicle.tyre_radius for p in points],
        )
    except (ValueError, IndexError, CommandsError) as error:
        raise IdentificationError(f"{bag}: commands: {error}") from error
