"""Drives measured in simulation: the motion of a vehicle seen by sensors of given noise.

Letters of shapes: `m` samples of a signal, `t` times of a motion.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from parameter_identification.drives.measured import MeasuredDrive, Sensor, Signal, StartPose
from parameter_identification.drives.samples import Samples
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle.batch import Trajectory


@dataclass(frozen=True)
class SensorNoise:
    """Noise of a simulated sensor.

    Attributes
    ----------
    white : float
        Standard deviation of the white part, in the sensor's unit.
    drift : float
        Standard deviation of an exponentially correlated part, in the sensor's unit.
    drift_time : float
        Correlation time of that part [s].
    rate : float
        Samples per second [Hz].

    Raises
    ------
    IdentificationError
        If a standard deviation is negative, or a time or rate is not positive.
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
        """Return the noise (m,) of samples at `rate`.

        Parameters
        ----------
        m : int
            Number of samples.
        rng : Generator
            Source of random numbers.
        """
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
class SensedMotion:
    """The quantities of one vehicle's motion that sensors measure.

    Attributes
    ----------
    time : ndarray of float, shape (t,)
        From the start event on [s].
    x, y : ndarray of float, shape (t,)
        Position [m].
    heading, yaw_rate : ndarray of float, shape (t,)
        Left positive [rad] and [rad/s].
    wheel_speed : ndarray of float, shape (t,)
        Rotation rate of the driven wheels relative to the body [rad/s].
    wheel_speeds : mapping of str to ndarray of float, shape (t,)
        Rotation rate of each single wheel relative to the body [rad/s], by its name.
    lateral_acceleration, motor_torque : ndarray of float, shape (t,), optional
        What an accelerometer reads, to the left [m/s^2], and at the driven wheels [N m].
    steering_motor_angle : ndarray of float, shape (t,), optional
        Left positive [rad].
    """

    time: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    yaw_rate: FloatArray
    wheel_speed: FloatArray
    wheel_speeds: Mapping[str, FloatArray] = field(default_factory=dict)
    lateral_acceleration: FloatArray | None = None
    motor_torque: FloatArray | None = None
    steering_motor_angle: FloatArray | None = None

    @classmethod
    def of(cls, trajectory: Trajectory, sample: int = 0) -> "SensedMotion":
        """Return the motion of one sample of a simulation.

        Parameters
        ----------
        trajectory : Trajectory
            From `tricycle_sim.vehicle.batch.simulate`.
        sample : int
            Number of the vehicle in it.
        """
        t = trajectory
        return cls(
            t.time,
            x=t.x[sample],
            y=t.y[sample],
            heading=t.yaw[sample],
            yaw_rate=t.yaw_rate[sample],
            wheel_speed=t.drive_speed[sample],
            wheel_speeds={wheel: speeds[sample] for wheel, speeds in t.wheel_speed.items()},
            lateral_acceleration=t.lateral_acceleration[sample],
            motor_torque=t.motor_torque[sample],
            steering_motor_angle=t.steering_motor_angle[sample],
        )

    def columns(self, sensor: Sensor) -> list[FloatArray]:
        """Return the columns that a sensor sees, each of shape (t,), in the frame of the motion.

        Parameters
        ----------
        sensor : Sensor
            Sensor that measures; the list is empty where the motion lacks what it measures.
        """
        seen: dict[Sensor, tuple[FloatArray | None, ...]] = {
            Sensor.POSITION: (self.x, self.y),
            Sensor.HEADING: (self.heading,),
            Sensor.YAW_RATE: (self.yaw_rate,),
            Sensor.WHEEL_SPEED: (self.wheel_speed,),
            Sensor.WHEEL_SPEEDS: tuple(self.wheel_speeds.values()),
            Sensor.LATERAL_ACCELERATION: (self.lateral_acceleration,),
            Sensor.MOTOR_TORQUE: (self.motor_torque,),
        }
        return [column for column in seen[sensor] if column is not None]


def measure(
    motion: SensedMotion,
    commands: Commands,
    noise: Mapping[Sensor, SensorNoise],
    *,
    rng: np.random.Generator,
    name: str = "simulated",
    standstill: float = 0.0,
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
    start: StartPose | None = None,
    truth: Mapping[str, float] | None = None,
    steering_step: float = 0.0,
) -> MeasuredDrive:
    """Measure a motion with sensors of given noise.

    Parameters
    ----------
    motion : SensedMotion
        Motion of the vehicle.
    commands : Commands
        Commands that the vehicle was driven with.
    noise : mapping of Sensor to SensorNoise
        Noise of each sensor of the vehicle.
    rng : Generator
        Source of the noise.
    name : str
        Name of the drive.
    standstill : float
        Time before the start event at which the sensors begin [s].
    pose : (float, float, float)
        Pose at the start, in the frame of the positions: x, y, heading [m, m, rad].
    start : StartPose, optional
        Start pose as far as the identification shall know it.
    truth : mapping of str to float, optional
        Parameters of the vehicle, for `MeasuredDrive.truth`.
    steering_step : float
        Step of the steering's angle sensor [rad], which is read on every tick; 0: no such sensor.

    Raises
    ------
    IdentificationError
        If the motion lacks what a sensor measures.
    """
    x0, y0, psi0 = pose
    c, s = math.cos(psi0), math.sin(psi0)
    placed = replace(
        motion,
        x=x0 + c * motion.x - s * motion.y,
        y=y0 + s * motion.x + c * motion.y,
        heading=psi0 + motion.heading,
    )
    signals = {}
    for sensor, model in noise.items():
        before = math.floor(standstill * model.rate)
        count = math.floor(motion.time[-1] * model.rate + 1e-9)
        time = np.arange(-before, count + 1) / model.rate
        seen = placed.columns(sensor)
        if not seen:
            raise IdentificationError(f"{name}: the motion has no {sensor.value}")
        exact = [np.interp(time, motion.time, column) for column in seen]
        values = [v + model.draw(len(time), rng) for v in exact]
        wheels = tuple(motion.wheel_speeds) if sensor is Sensor.WHEEL_SPEEDS else ()
        signals[sensor] = Signal(time, np.column_stack(values), wheels=wheels)
    return MeasuredDrive(
        name,
        commands,
        signals,
        start or StartPose(),
        truth=dict(truth or {}),
        steering_angle=_steering_angle(motion, steering_step, rng),
    )


def _steering_angle(motion: SensedMotion, step: float, rng: np.random.Generator) -> Samples | None:
    """Steering angle from a PLC: counts, read anywhere within the tick before the stamp."""
    if motion.steering_motor_angle is None or not step > 0.0:
        return None
    stamps = np.arange(0.0, motion.time[-1], TICK)
    read = stamps - TICK * rng.uniform(size=len(stamps))
    angle = np.interp(read, motion.time, motion.steering_motor_angle)
    return Samples(stamps, step * np.round(angle / step))
