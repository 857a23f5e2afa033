"""Whether the servo is of the vehicle file's kind, by the steering angle that drives tell."""

import math
from collections.abc import Sequence
from enum import Enum

import numpy as np
from scipy.optimize import least_squares

from parameter_identification.drives.following import commanded_setpoints, servo_response
from parameter_identification.drives.measured import MeasuredDrive
from parameter_identification.drives.samples import Samples
from parameter_identification.estimation.noise import white_level
from parameter_identification.estimation.whiteness import resolution
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.setpoints import delayed
from tricycle_sim.vehicle import Vehicle

FREQUENCY = "servo_natural_frequency"
FASTER, LATER = 4.0, 0.2  # factor, and s, by which the servo may be faster or slower, and later
OTHER_KIND = 4.5  # times what the sensor is off by, from which the servo is of another kind
READ = TICK / math.sqrt(12.0)  # s, standard deviation of when the angle was read


class Steering(Enum):
    """What moves the steering of the model."""

    COMMANDS = "commands"  # through the servo of the vehicle file
    MEASURED = "measured"  # the angle that the drive tells
    EITHER = "either"  # this where the servo is of another kind, otherwise the commands


def servo_of_another_kind(drives: Sequence[MeasuredDrive], vehicle: Vehicle) -> bool:
    """Return whether no servo of the file's law has an angle that a drive tells.

    Parameters
    ----------
    drives : sequence of MeasuredDrive
        Where one of them tells no angle, nothing is known, and the answer is no.
    vehicle : Vehicle
        Its servo may have another bandwidth and dead time, its sensor another zero and gain.
    """
    told = [(d.commands, d.steering_angle) for d in drives if d.steering_angle is not None]
    return len(told) == len(drives) and any(
        servo_misfit(commands, angle, vehicle) > OTHER_KIND for commands, angle in told
    )


def servo_misfit(commands: Commands, measured: Samples, vehicle: Vehicle) -> float:
    """Return how far the nearest servo of a law is from a measured angle (root mean square).

    In units of what the sensor is off by: its noise or rounding, and when it was read.

    Parameters
    ----------
    commands : Commands
        Of a drive.
    measured : Samples
        Angle of the steering motor [rad], since the start event [s].
    vehicle : Vehicle
        Its servo is varied.
    """
    setpoints = commanded_setpoints(commands, vehicle)
    ticks = TICK * np.arange(len(setpoints))

    def off(point: FloatArray) -> FloatArray:
        own = vehicle
        if FREQUENCY in vehicle.values:
            own = vehicle.replace(**{FREQUENCY: vehicle.values[FREQUENCY] * math.exp(point[0])})
        response = servo_response(delayed(setpoints, point[1], setpoints[0]), own)
        angle = np.interp(measured.time, ticks, response)
        columns = np.column_stack([np.ones(len(angle)), angle])[:, : 1 + (np.ptp(angle) > 0.0)]
        fitted: FloatArray = columns @ np.linalg.lstsq(columns, measured.values, rcond=None)[0]
        return measured.values - fitted

    bounds = [-math.log(FASTER), 0.0], [math.log(FASTER), LATER]
    least = least_squares(off, [0.0, 0.02], bounds=bounds, x_scale=[1.0, 0.1], diff_step=1e-3)
    rate = float(np.std(np.gradient(servo_response(setpoints, vehicle), TICK)))
    rounding = resolution(measured.values) / math.sqrt(12.0)
    white = max(white_level(measured.time, measured.values[:, np.newaxis]), rounding)
    noise = math.hypot(white, READ * rate)
    return float(np.sqrt(np.mean(least.fun**2))) / max(noise, 1e-9)
