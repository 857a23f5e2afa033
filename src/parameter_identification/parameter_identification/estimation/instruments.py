"""Errors that each sensor has beside its noise, and what it sees of a motion.

An error is a nuisance of a drive: a constant, or in proportion to something of the motion.
"""

from dataclasses import dataclass

from excitation_planner.design.noise import GYRO_BIAS_STD
from parameter_identification.drives.measured import Sensor, Signal

CLOCKS = {  # position and heading come from one localisation
    Sensor.POSITION: "pose delay",
    Sensor.HEADING: "pose delay",
    Sensor.YAW_RATE: "gyro delay",
    Sensor.LATERAL_ACCELERATION: "gyro delay",
    Sensor.WHEEL_SPEED: "wheel delay",
    Sensor.WHEEL_SPEEDS: "wheel delay",
    Sensor.MOTOR_TORQUE: "wheel delay",
}
"""Name of the delay of each sensor's clock."""


@dataclass(frozen=True)
class SensorError:
    """An error of a sensor that is linear in what it sees.

    Attributes
    ----------
    name, unit : str
        Name and unit of the nuisance that is the size of the error.
    std : float
        Standard deviation of the nuisance's prior, in that unit; its mean is 0.
    channel : int
        Channel of the sensor that the error is added to.
    factor : int, optional
        Row of what the sensor sees by which the error is multiplied; None: 1.
    """

    name: str
    unit: str
    std: float
    channel: int = 0
    factor: int | None = None


_ERRORS = {
    Sensor.YAW_RATE: (SensorError("gyro bias", "rad/s", GYRO_BIAS_STD),),
    Sensor.LATERAL_ACCELERATION: (
        SensorError("accelerometer bias", "m/s^2", 0.3),  # tilted by 1 deg: 0.17
        # a body that rolls by other angles than the model's is one as well
        SensorError("accelerometer gain", "1", 0.03, factor=0),
        SensorError("accelerometer forward", "m", 0.1, factor=1),
    ),
    Sensor.MOTOR_TORQUE: (
        SensorError("torque bias", "N m", 0.5),
        SensorError("torque gain", "1", 0.1, factor=0),
    ),
}
RADIUS = 0.01  # share by which the radius of a single wheel may differ from the file's


def errors_of(sensor: Sensor, signal: Signal) -> tuple[SensorError, ...]:
    """Return the errors of a sensor.

    What a sensor sees has a row for each channel. Of the lateral acceleration it has a second row,
    the yaw acceleration, in proportion to which an accelerometer ahead of the COM reads more.

    Parameters
    ----------
    sensor : Sensor
        Sensor that measured the signal.
    signal : Signal
        Signal that was measured.
    """
    if sensor is Sensor.WHEEL_SPEEDS:
        return tuple(
            SensorError(f"gain of {wheel}", "1", RADIUS, channel, channel)
            for channel, wheel in enumerate(signal.wheels)
        )
    return _ERRORS.get(sensor, ())
