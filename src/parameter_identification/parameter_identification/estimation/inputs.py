"""Check whether servo and speed loop are of the vehicle file's kind, by their measured outputs."""

import math
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from excitation_planner.choice import Choice
from parameter_identification.drives.following import (
    commanded_setpoints,
    has_gains,
    servo_response,
)
from parameter_identification.drives.measured import Input, MeasuredDrive, Sensor
from parameter_identification.drives.samples import Samples
from parameter_identification.drives.table import Columns
from parameter_identification.estimation.model import DriveModel
from parameter_identification.estimation.noise import white_level
from parameter_identification.estimation.prior import box_prior
from parameter_identification.estimation.problem import LeastSquares, Loss
from parameter_identification.estimation.whiteness import resolution
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.effects import EFFECTS, effects_of
from tricycle_sim.setpoints import delayed
from tricycle_sim.vehicle import Vehicle

FREQUENCY = "servo_natural_frequency"
FASTER, LATER = 4.0, 0.2  # factor, and s, by which the servo may be faster or slower, and later
OTHER_SERVO, OTHER_LOOP = 4.5, 1.3  # times what a sensor is off by: of another kind
FITTED = 6  # drives whose wheels are fitted together; more take long and show hardly more
READ = TICK / math.sqrt(12.0)  # s, standard deviation of when an angle was read
LOADING = (
    "speed-loop",
    "drive-dead-time",
    "wheel-radius",
    "slope-or-wind-along",
    "slope-or-wind-across",
)
"""Effects that change the speed of the wheels most."""
# far from the file's, these move the wheels as a loop of another kind does
_LIKE_A_LOOP = ("slip-stiffness", "relaxation-length-along")
_LOADING_TOO = tuple(option for option in EFFECTS if option not in _LIKE_A_LOOP)
# the steering of a table is logged when it is sent, or by another clock than the poses; the loop
# behind set-points of the speed need not be the vehicle file's
_OF_STEERING = ("servo-dead-time", "steering-play")
# the tyres with which a map is estimated are not yet known
_OF_ESTIMATED_MAP = ("steering-zero", "steering-gain")
_OF_SPEED_SETPOINTS = ("speed-loop", "drive-dead-time", "wheel-radius")
# what no effect explains; without them, poses of millimetres are explained by wrong tyres
_REST = ("speed-deviation", "turn-deviation")


class Inputs(Choice):
    """Choice of what moves the model: the commands, or what was measured."""

    COMMANDS = "commands"  # through servo and speed loop of the vehicle file
    MEASURED = "measured"  # the steering angle and the wheel speed that the drives tell
    EITHER = "either"  # what was measured of an actuator of another kind, otherwise the commands


def effects_of_columns(columns: Columns) -> tuple[str, ...]:
    """Return the effects of a table that are estimated beside the parameters.

    Parameters
    ----------
    columns : Columns
        Columns of the table.
    """
    of_map = _OF_ESTIMATED_MAP if isinstance(columns.steering_map, str) else ()
    of_speed = _OF_SPEED_SETPOINTS if columns.speed_command is not None else ()
    return _OF_STEERING + of_map + of_speed + _REST


def measured_inputs(
    drives: Sequence[MeasuredDrive], vehicle: Vehicle, inputs: Inputs, *, changing: bool = False
) -> frozenset[Input]:
    """Return the inputs that the model takes from measurement instead of from commands.

    Parameters
    ----------
    drives : sequence of MeasuredDrive
        An input that one of them does not measure throughout is commanded in all.
    vehicle : Vehicle
        The gains of its servo and speed loop, and their dead times, may be others.
    inputs : Inputs
        Choice of the inputs.
    changing : bool
        Whether parameters may differ between the drives, which no one vehicle then fits. Each is
        looked at alone, in which a slight lag of the speed loop may pass for other tyres.

    Raises
    ------
    IdentificationError
        If measured ones are asked for, and all drives have none in common; or if the servo is of
        another kind, and not all drives measure the steering angle.
    """
    if inputs is Inputs.COMMANDS:
        return frozenset()
    in_all = frozenset(Input).intersection(*(drive.measured_throughout for drive in drives))
    if not has_gains(vehicle):
        in_all -= {Input.SPEED}
    if inputs is Inputs.MEASURED:
        if not in_all:
            raise IdentificationError(
                "not all drives tell throughout a steering angle, or a wheel speed: identify from "
                "the commands"
            )
        return in_all
    followed: set[Input] = set()
    other = [
        drive.name
        for drive in drives
        if drive.steering_angle is not None
        and servo_misfit(drive.commands, drive.steering_angle, vehicle) > OTHER_SERVO
    ]
    if other and Input.STEERING not in in_all:
        lacks = next(d.name for d in drives if Input.STEERING not in d.measured_throughout)
        raise IdentificationError(
            f"{lacks}: does not tell the steering angle throughout, and that of {other[0]} is not "
            "what the servo of the vehicle file makes of its commands: leave this drive out, or "
            "take the commands of all (inputs: commands), whose intervals do not count it"
        )
    if other:
        followed.add(Input.STEERING)
    fitted = drives[:FITTED]
    groups = [[drive] for drive in fitted] if changing else [fitted]
    if Input.SPEED in in_all and any(_other_loop(g, vehicle, followed) for g in groups):
        followed.add(Input.SPEED)
    return frozenset(followed)


def _other_loop(
    drives: Sequence[MeasuredDrive], vehicle: Vehicle, followed: Collection[Input]
) -> bool:
    """Whether no speed loop of the vehicle file's kind moves the wheels as on these drives."""
    return all(
        max(speed_misfits(drives, vehicle, effects, followed)) > OTHER_LOOP
        for effects in (LOADING, _LOADING_TOO)  # the first mostly do, in a third of the time
    )


def speed_misfits(
    drives: Sequence[MeasuredDrive],
    vehicle: Vehicle,
    effects: Sequence[str],
    measured: Collection[Input] = (),
) -> list[float]:
    """Return the misfit of the wheel speed in each drive by the best fit of the model.

    It is a root mean square, in standard deviations of the sensor: of its noise or rounding, and of
    the time at which it was read. Only the speed of the wheels is fitted.

    Parameters
    ----------
    drives : sequence of MeasuredDrive
        Drives that measure the speed of the driven wheels.
    vehicle : Vehicle
        Vehicle whose unknown parameters are fitted.
    effects : sequence of str
        Names of the effects (of `EFFECTS`) that are fitted too; deviations are not.
    measured : collection of Input
        Inputs that move as measured.
    """
    varied = [e for e in effects_of(vehicle, effects) if not e.process]
    models = [DriveModel(vehicle, drive, varied, measured=measured) for drive in drives]
    prior = box_prior(vehicle, None)
    with LeastSquares(models, prior.mean, prior.information, Loss.SQUARED) as problem:
        problem.noise = {Sensor.WHEEL_SPEED: problem.noise[Sensor.WHEEL_SPEED]}
        start = problem.variables.beginning(problem.mean)
        predictions = problem.predictions(problem.minimise(start).at)
    found = []
    for drive, own in zip(drives, predictions, strict=True):
        (p,) = (p for p in own if p.sensor is Sensor.WHEEL_SPEED)
        wheels, rates = drive.signals[p.sensor], np.gradient(p.values[:, 0], p.time)
        stamps = wheels.stamp_errors(rates)
        noise = _sensor_noise(p.time, wheels.values[:, 0], stamps, alike=wheels.of_pulses)
        found.append(float(np.sqrt(np.mean((p.residual[:, 0] / noise) ** 2))))
    return found


def servo_misfit(commands: Commands, measured: Samples, vehicle: Vehicle) -> float:
    """Return the misfit of a measured steering angle by the best fit of the vehicle's servo.

    It is a root mean square, in standard deviations of the sensor: of its noise or rounding, and of
    the time at which it was read.

    Parameters
    ----------
    commands : Commands
        Commands of a drive.
    measured : Samples
        Angle of the steering motor [rad], since the start event [s].
    vehicle : Vehicle
        Vehicle whose servo is fitted.
    """
    setpoints = commanded_setpoints(commands, vehicle)
    ticks = TICK * np.arange(len(setpoints))

    def off(point: FloatArray) -> FloatArray:
        own = vehicle
        if FREQUENCY in vehicle.values:
            own = vehicle.replace(**{FREQUENCY: vehicle.values[FREQUENCY] * point[0]})
        response = servo_response(delayed(setpoints, point[1], setpoints[0]), own)
        angle = np.interp(measured.time, ticks, response)
        columns = np.column_stack([np.ones(len(angle)), angle])[:, : 1 + (np.ptp(angle) > 0.0)]
        fitted: FloatArray = columns @ np.linalg.lstsq(columns, measured.values, rcond=None)[0]
        return measured.values - fitted

    bounds = [1.0 / FASTER, 0.0], [FASTER, LATER]
    # relative steps: 0.1 % of the frequency, 1 ms at the first delay
    least = least_squares(
        off, [1.0, 0.02], bounds=bounds, x_scale=[1.0, 0.1], diff_step=[1e-3, 0.05]
    )
    rates = np.gradient(servo_response(setpoints, vehicle), TICK)
    noise = _sensor_noise(measured.time, measured.values, READ * np.std(rates))
    return float(np.sqrt(np.mean((least.fun / noise) ** 2)))


def _sensor_noise(
    time: FloatArray, values: FloatArray, stamps: ArrayLike, *, alike: bool = False
) -> FloatArray:
    """Standard deviations of samples to which the errors of their stamps add so much.

    A speed from pulses is the same for several samples: they err alike, by up to a step.
    """
    rounding = resolution(values) / (1.0 if alike else math.sqrt(12.0))
    white = max(white_level(time, values[:, np.newaxis]), rounding)
    return np.maximum(np.hypot(white, stamps), 1e-9)
