"""Drives as an identification needs them: the commands, and the signals of the sensors.

A bag gives one (`drives.measured_from_bag`), and so does a simulation (`drives.simulated`), so that
the estimator cannot tell them apart. Times are seconds since the start event, at which row 0
of the commands was played; samples before it, at standstill, show the start pose and a gyro's bias.
Letters of shapes: `m` samples of a signal, `c` channels.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from parameter_identification.drives.poses import PlanarTrajectory
from parameter_identification.drives.samples import MAX_GAP, Samples, common_times
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle

STEERING_LATE = 0.08  # s by which another system may log the steering after it was there
MIN_SAMPLES = 10  # samples of a sensor in a drive, fewer tell nothing of its noise
LATEST_SPEED = 1.5  # s from rest to its first speed: a sensor of pulses does not tell slow ones


class Sensor(Enum):
    """Sensors whose signals are compared with the model; each has a noise of its own."""

    POSITION = "position"  # x and y of base_link in odom, m
    HEADING = "heading"  # rad, left positive
    YAW_RATE = "yaw rate"  # rad/s, base_link
    WHEEL_SPEED = "wheel speed"  # rad/s, driven wheels relative to the body
    WHEEL_SPEEDS = "wheel speeds"  # rad/s, single wheels relative to the body, a column each
    LATERAL_ACCELERATION = (
        "lateral acceleration"  # m/s^2, as an accelerometer reads it, to the left
    )
    MOTOR_TORQUE = "motor torque"  # N m, at the driven wheels

    @property
    def unit(self) -> str:
        """Unit of its values."""
        return _UNITS.get(self, "rad/s")


class Input(Enum):
    """Inputs that move a vehicle: as commanded or, where measured throughout, as measured."""

    STEERING = "steering"  # angle of its motor
    SPEED = "speed"  # of the driven wheels


_UNITS = {
    Sensor.POSITION: "m",
    Sensor.HEADING: "rad",
    Sensor.LATERAL_ACCELERATION: "m/s^2",
    Sensor.MOTOR_TORQUE: "N m",
}


# of stamps; the PLCs measure anywhere between two ticks of 10 ms, and stamp with one of them
STAMP_JITTER = {
    Sensor.YAW_RATE: 0.0,
    Sensor.LATERAL_ACCELERATION: 0.0,
    Sensor.WHEEL_SPEED: 0.005,
    Sensor.WHEEL_SPEEDS: 0.005,
    Sensor.MOTOR_TORQUE: 0.005,
}
PULSE_JITTER = 0.03  # s, of wheel speeds from pulses
CARRIED = 1.0  # s, such a speed is carried on by an acceleration that may be so old
DEAD_ZONE = 5.0  # median steps between low speeds, from which the first ones are not the wheel's
FIRST_STEPS = 3  # from standstill that are looked at
RESOLVED = 4.5  # of the slowest speed above the dead zone, from which pulses tell a speed


@dataclass(frozen=True, eq=False)
class Signal:
    """Samples of a sensor.

    Attributes
    ----------
    time : ndarray of float, shape (m,)
        Times since the start event [s], strictly increasing.
    values : ndarray of float, shape (m, c)
        One column per channel; headings are continuous.
    jitter : float
        Standard deviation of the stamps [s]; it is noise where the values change quickly.
    wheels : tuple of str
        Names of the wheels of which the columns are, in the vehicle file; of other sensors none.

    Raises
    ------
    IdentificationError
        If shapes differ, numbers are not finite, or times do not increase.
    """

    time: FloatArray
    values: FloatArray
    jitter: float = 0.0
    wheels: tuple[str, ...] = ()

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
        """Return the samples between two times, both included.

        Parameters
        ----------
        start, end : float
            Times since the start event [s].
        """
        inside = (self.time >= start) & (self.time <= end)
        return replace(self, time=self.time[inside], values=self.values[inside])

    @property
    def of_pulses(self) -> bool:
        """Whether it is a wheel speed from pulses."""
        return self.jitter >= PULSE_JITTER

    def stamp_errors(self, slopes: FloatArray) -> FloatArray:
        """Return the standard deviation (m,) of each sample's error by its stamp.

        Parameters
        ----------
        slopes : ndarray of float, shape (m,)
            How fast the values change, per second.
        """
        sizes = np.abs(slopes)
        if self.of_pulses and len(sizes) > 1:
            n = max(1, round(CARRIED / float(np.median(np.diff(self.time)))))
            sizes = sliding_window_view(np.pad(sizes, (n - 1, 0)), n).max(axis=1)
        errors: FloatArray = self.jitter * sizes
        return errors

    def channels(self, sensor: Sensor) -> tuple[str, ...]:
        """Return the name of each column.

        Parameters
        ----------
        sensor : Sensor
            Sensor that measured the signal.
        """
        if sensor is Sensor.POSITION:
            return ("x", "y")
        if sensor is Sensor.WHEEL_SPEEDS:
            return tuple(f"wheel speed {wheel}" for wheel in self.wheels)
        return (sensor.value,)


@dataclass(frozen=True)
class StartPose:
    """Pose at the start event as far as it is known besides the signals; by default not at all.

    Attributes
    ----------
    x, y : float, optional
        In the frame of the positions [m]; None: taken from the signals.
    heading : float, optional
        Left positive [rad]; None: taken from the signals.
    position_std, heading_std : float
        Standard deviations per axis [m] and of the heading [rad].
    speed : float
        Forward speed, known to some cm/s [m/s].

    Raises
    ------
    IdentificationError
        If a standard deviation is not positive.
    """

    x: float | None = None
    y: float | None = None
    heading: float | None = None
    position_std: float = 1.0
    heading_std: float = 0.5
    speed: float = 0.0

    def __post_init__(self) -> None:
        if not (self.position_std > 0 and self.heading_std > 0):
            raise IdentificationError("start pose: standard deviations must be positive")


@dataclass(frozen=True, eq=False)
class MeasuredDrive:
    """Commands and signals of one drive.

    Attributes
    ----------
    name : str
        For messages and figures.
    commands : Commands
        Played from the start event on.
    signals : mapping of Sensor to Signal
        A position is needed, the others narrow the intervals.
    start : StartPose
        Start pose as far as it is known.
    reference : PlanarTrajectory, optional
        The plan's nominal trajectory; shows whether the vehicle is the one of the plan.
    truth : mapping of str to float
        True values of the unknown parameters, where the drive was simulated and they are recorded.
    complete : bool
        False where the recording was cut off, lacks messages, or does not hold the end.
    began : float
        Time at which it was recorded [s since 1970]; NaN: not known.
    steering_angle : Samples, optional
        Measured angle of the steering motor, left positive [rad], since the start event [s].
    speed : ndarray of float, shape (t,), optional
        Forward, of the COM, at each tick of the commands [m/s]. The model has this speed, whatever
        its speed loop would make of the commands.
    speed_std : float
        Standard deviation of it [m/s].
    turn_std : float
        Standard deviation of the curvature that the commanded steering gives [1/m].
    steering_late : float
        By how much the steering of the commands may be late against the signals [s]; they go on
        for so long after these.
    pose_filter : float
        Time constant of the low-pass that its positions and headings come out of [s]; 0: none.
    recording : str
        Name of the recording that it is a window of; empty: a drive of its own.
    map_estimated : bool
        Whether its steering's angle is by a map that was estimated from the recording.
    vehicle_hash : str
        Fingerprint of the vehicle file that it was driven with; empty: not recorded.
    unheard : tuple of Sensor
        Sensors that the bag has, but of which too few samples are of the drive to be used.

    Raises
    ------
    IdentificationError
        If there is no position, or a signal has the wrong number of columns.
    """

    name: str
    commands: Commands
    signals: Mapping[Sensor, Signal]
    start: StartPose = field(default_factory=StartPose)
    reference: PlanarTrajectory | None = None
    truth: Mapping[str, float] = field(default_factory=dict)
    complete: bool = True
    began: float = math.nan
    steering_angle: Samples | None = None
    speed: FloatArray | None = None
    speed_std: float = 0.0
    turn_std: float = 0.0
    steering_late: float = 0.0
    pose_filter: float = 0.0
    recording: str = ""
    map_estimated: bool = False
    vehicle_hash: str = ""
    unheard: tuple[Sensor, ...] = ()

    def __post_init__(self) -> None:
        if Sensor.POSITION not in self.signals:
            raise IdentificationError(f"{self.name}: no positions: nothing to identify from")
        for sensor, signal in self.signals.items():
            columns = len(signal.channels(sensor))
            if signal.values.shape[1] != columns:
                raise IdentificationError(f"{self.name}: {sensor.value}: needs {columns} columns")

    @property
    def measured_throughout(self) -> frozenset[Input]:
        """Inputs measured all along the commands; from rest the speed may begin a little later."""
        found, end = set(), self.commands.duration
        if self.steering_angle is not None and _throughout(self.steering_angle.time, 0.0, end):
            found.add(Input.STEERING)
        if (wheels := self.signals.get(Sensor.WHEEL_SPEED)) is not None:
            first = float(wheels.time[0]) if self.start.speed == 0.0 else 0.0
            if _throughout(wheels.time, min(max(first, 0.0), LATEST_SPEED), end):
                found.add(Input.SPEED)
        return frozenset(found)


def of_wheels(wheels: Mapping[str, Samples]) -> Signal:
    """Return the speeds of single wheels as one signal, at the times at which all are known.

    Parameters
    ----------
    wheels : mapping of str to Samples
        Speeds [rad/s] by the names of the wheels, one or more.
    """
    time = common_times(list(wheels.values()))
    values = np.column_stack([samples.at(time) for samples in wheels.values()])
    return Signal(time, values, STAMP_JITTER[Sensor.WHEEL_SPEEDS], tuple(wheels))


def usable(signals: Mapping[Sensor, Signal], vehicle: Vehicle) -> dict[Sensor, Signal]:
    """Return the signals without those of too few samples, and without what would count twice.

    The speed of the motor is the mean of the driven wheels'. Where it and the speeds of all driven
    wheels were measured, that of the last driven wheel is left out.

    Parameters
    ----------
    signals : mapping of Sensor to Signal
        Signal of each sensor of a drive.
    vehicle : Vehicle
        Vehicle that drove.
    """
    found = {
        sensor: signal
        for sensor, signal in signals.items()
        if sensor is Sensor.POSITION or len(signal.time) >= MIN_SAMPLES
    }
    wheels = found.get(Sensor.WHEEL_SPEEDS)
    driven = [wheel.name for wheel in vehicle.wheels if wheel.driven]
    if wheels is None or Sensor.WHEEL_SPEED not in found or not {*driven} <= {*wheels.wheels}:
        return found
    kept = [column for column, wheel in enumerate(wheels.wheels) if wheel != driven[-1]]
    del found[Sensor.WHEEL_SPEEDS]
    if kept:
        names = tuple(wheels.wheels[column] for column in kept)
        found[Sensor.WHEEL_SPEEDS] = replace(wheels, values=wheels.values[:, kept], wheels=names)
    return found


def _throughout(time: FloatArray, begin: float, end: float) -> bool:
    """Whether there is no long gap between samples from a time to another one."""
    there = time[(time >= begin) & (time <= end)]
    return bool(np.diff(there, prepend=begin, append=end).max() <= MAX_GAP)


def resolved(speeds: Signal) -> Signal:
    """Return wheel speeds without those that are too low for a sensor of pulses.

    Such a sensor tells nothing before the first pulses have come, and the mean between two pulses
    where they are rare. It is known by the first steps from standstill: a wheel that begins to turn
    passes all low speeds, none faster than those that follow.

    Parameters
    ----------
    speeds : Signal
        Speed of one wheel [rad/s].
    """
    sizes = np.abs(speeds.values[:, 0])
    # until half of the highest speed: while the wheel slows down, the reading may pass all speeds
    low = np.unique(sizes[: int(np.argmax(sizes >= 0.5 * sizes.max()))])
    if len(low) < 10 or low[0] > 0.0:
        return speeds
    steps = np.diff(low)
    widest = int(np.argmax(steps[:FIRST_STEPS]))
    if steps[widest] < DEAD_ZONE * float(np.median(steps)):
        return speeds
    seen = sizes >= RESOLVED * low[widest + 1]
    return Signal(speeds.time[seen], speeds.values[seen], PULSE_JITTER)
