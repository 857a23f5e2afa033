"""Set-points with which the nominal vehicle follows what was measured: its steering, its speed."""

import dataclasses
from contextlib import suppress
from functools import lru_cache
from typing import Any

import numpy as np

from parameter_identification.drives.measured import Signal
from parameter_identification.drives.samples import Samples
from tricycle_bridge.protocol.limits import MAX_SPEED
from tricycle_core.errors import VehicleError
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.setpoints import command_rows, slew_all
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import CommandedBatch, simulate
from tricycle_sim.vehicle.kernel import functions_for
from tricycle_sim.vehicle.parts import servo_at_rest, steering_constants
from tricycle_sim.vehicle.stability import check_step

FOLLOWING = 6  # iterations after which the model has the measured speed or steering angle
SPEED_LAG = 0.2  # s, of a speed loop
GAINS = "speed_gain_proportional", "speed_gain_integral"
STIFFER = 10.0, 3.0  # times as quick: the first one that the simulation's steps allow
STIFF_FOLLOWING = 2  # iterations with such a loop, after the first set-points
LOOP_STEP = 0.01  # m/s, by which its answer is found
ANSWERED = 60  # ticks after which it has answered
SMOOTHED = 1e-3  # weight of the changes from tick to tick of what it is given
FILTER = 21, 2  # Savitzky-Golay at 100 Hz: samples, order
SLIGHT = 1e-3  # rad, by which the steering motor turns to either side of straight ahead


def curvature_per_angle(vehicle: Vehicle) -> float:
    """Return by how much the way bends for an angle of the steering motor [1/(m rad)].

    Near straight ahead, to the same side as the motor or (negative) to the other one.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle that has the linkage.
    """
    constants, road_angle = steering_constants(vehicle, TICK), functions_for(vehicle).road_angle
    turned: float = road_angle(SLIGHT, constants) - road_angle(-SLIGHT, constants)
    return turned / (2.0 * SLIGHT * vehicle.wheelbase)


def servo_response(setpoints: FloatArray, vehicle: Vehicle) -> FloatArray:
    """Return the angles (t,) of the steering motor for set-points, without slew or stop.

    Parameters
    ----------
    setpoints : ndarray of float, shape (t,)
        On ticks; before them the motor stands at the first one.
    vehicle : Vehicle
        Vehicle that has the servo.
    """
    scale = 0.5 * vehicle.steering_limit / max(np.abs(setpoints).max(), 1e-9)
    servo = np.full_like(servo_at_rest(vehicle), scale * setpoints[0])
    servo[1] = 0.0
    table, angles = np.empty((len(setpoints) + 1, 8)), np.empty((2, len(setpoints) + 1))
    constants = steering_constants(vehicle, TICK)
    functions_for(vehicle).steer(servo, scale * setpoints, constants, 1, table, angles)
    response: FloatArray = angles[0, :-1] / scale
    return response


def steering_setpoints(angle: FloatArray, vehicle: Vehicle) -> FloatArray:
    """Return the set-points (t,) by which the servo reaches angles.

    Parameters
    ----------
    angle : ndarray of float, shape (t,)
        Smooth angles of the steering motor on ticks [rad].
    vehicle : Vehicle
        Vehicle that has the servo.
    """
    ramp = TICK * np.arange(1.0 / TICK)
    lag = float(ramp[-1] - servo_response(ramp, vehicle)[-1])
    wanted: FloatArray = angle.copy()
    for _ in range(FOLLOWING):
        error = angle - servo_response(wanted, vehicle)
        wanted += error + _ahead(error, lag)
    return wanted


def commanded_setpoints(commands: Commands, vehicle: Vehicle) -> FloatArray:
    """Return the set-points (t,) of the steering on ticks [rad].

    Parameters
    ----------
    commands : Commands
        Commands of a drive.
    vehicle : Vehicle
        Vehicle that drove; the slew rate of its steering is used.
    """
    rows = command_rows(commands)
    wanted: FloatArray = commands.steering_motor_angle[rows]
    setpoints: FloatArray = slew_all(wanted, vehicle.steering_slew)[0]
    return setpoints


def servo_angle(commands: Commands, time: FloatArray, vehicle: Vehicle) -> FloatArray:
    """Return the angles (m,) of the steering motor that commands give [rad].

    Parameters
    ----------
    commands : Commands
        Commands of a drive.
    time : ndarray of float, shape (m,)
        Times since the start event [s].
    vehicle : Vehicle
        Vehicle that drove; its servo and slew rate are used.
    """
    setpoints = commanded_setpoints(commands, vehicle)
    ticks = TICK * np.arange(len(setpoints))
    angle: FloatArray = np.interp(time, ticks, servo_response(setpoints, vehicle))
    return angle


def setpoints_for_steering(
    commands: Commands, measured: Samples, vehicle: Vehicle
) -> tuple[FloatArray, FloatArray]:
    """Return the set-points (t,) of the steering on ticks, and those that give a measured angle.

    What is measured is smoothed; what the servo does anyway is not, because it is known.

    Parameters
    ----------
    commands : Commands
        Commands of a drive.
    measured : Samples
        Angle of the steering motor [rad], since the start event [s].
    vehicle : Vehicle
        Vehicle that drove; its servo and slew rate are used.

    References
    ----------
    P. Craven, G. Wahba, Numerische Mathematik 31 (1979) 377-403: how much is smoothed.
    """
    setpoints = commanded_setpoints(commands, vehicle)
    ticks = TICK * np.arange(len(setpoints))
    expected = np.interp(measured.time, ticks, servo_response(setpoints, vehicle))
    off = _smoothed(measured.time, measured.values - expected)
    inside = np.clip(ticks, measured.time[0], measured.time[-1])
    return setpoints, setpoints + steering_setpoints(off(inside), vehicle)


def setpoints_for_speed(
    commands: Commands, measured: Signal, vehicle: Vehicle, start: float
) -> tuple[FloatArray, FloatArray]:
    """Return the set-points (t,) of the speed on ticks, and those that give a measured wheel speed.

    What is measured is smoothed; what the speed loop does anyway is not.

    Parameters
    ----------
    commands : Commands
        Commands of a drive.
    measured : Signal
        Speed of the driven wheels [rad/s], since the start event [s].
    vehicle : Vehicle
        `with_stiff_loop`; its nominal speed loop is used.
    start : float
        Speed at the start event [m/s].
    """
    batch = CommandedBatch(vehicle, commands, setpoint=start)
    nominal = vehicle.nominal_point()[np.newaxis]

    def wheels(faster: FloatArray) -> FloatArray:
        added = np.append(faster, faster[-1])[np.newaxis]
        run = batch.run(nominal, ("drive_speed",), speed=np.array([start]), faster=added)
        rates: FloatArray = run.columns["drive_speed"][0, :-1]
        return rates

    wanted = commands.speed[command_rows(commands)]
    commanded: FloatArray = slew_all(wanted, vehicle.acceleration, start)[0]
    ticks = batch.time[:-1]
    expected = wheels(np.zeros(len(commanded)))
    time = measured.time
    off = measured.values[:, 0] - np.interp(time, ticks, expected)
    if time[0] > 0.0:  # it begins as the model does
        time, off = np.insert(time, 0, 0.0), np.insert(off, 0, 0.0)
    rate = expected + _smoothed(time, off)(np.clip(ticks, time[0], time[-1]))
    speeds = np.abs(commanded[: max(1, len(commanded) - ANSWERED)])
    fast = np.flatnonzero(speeds >= 0.999 * speeds.max())
    steady = fast[len(fast) // 2]
    more = np.where(np.arange(len(commanded)) < steady, 0.0, LOOP_STEP)
    answer = vehicle.driven_radius * (wheels(more) - expected)[steady : steady + ANSWERED]
    response = np.diff(answer / LOOP_STEP, prepend=0.0)
    faster = _deconvolved(vehicle.driven_radius * (rate - expected), response)
    for _ in range(STIFF_FOLLOWING):
        faster += _deconvolved(vehicle.driven_radius * (rate - wheels(faster)), response)
    return commanded, commanded + faster


def has_gains(vehicle: Vehicle) -> bool:
    """Return whether the gains of a vehicle's speed loop are known.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle, with a speed loop or without.
    """
    return vehicle.has_speed_loop and not set(GAINS) & set(vehicle.unknown)


def with_stiff_loop(vehicle: Vehicle) -> Vehicle:
    """Return a vehicle whose wheels hardly differ from the set-points, whatever resists them.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle that has a speed loop with known gains.

    Raises
    ------
    VehicleError
        If it is too stiff for the simulation's steps as it is.
    """
    for factor in STIFFER:
        stiff = vehicle.replace(
            **{gain: factor**i * vehicle.values[gain] for i, gain in enumerate(GAINS, start=1)}
        )
        with suppress(VehicleError):
            check_step(stiff, TICK)
            return stiff
    return vehicle


def speed_followed(vehicle: Vehicle, angle: FloatArray, speed: FloatArray) -> Commands:
    """Return commands with which the nominal vehicle has a speed, as far as it can.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle that has a speed loop.
    angle, speed : ndarray of float, shape (t,)
        Angle of the steering motor [rad] and forward speed of the COM [m/s], at each tick.
    """
    nominal = dataclasses.replace(vehicle, unknown={})
    time = np.arange(len(speed)) * TICK
    wanted = speed.copy()
    for _ in range(FOLLOWING):
        commands = Commands(time, angle, np.clip(wanted, -MAX_SPEED, MAX_SPEED))
        motion = simulate(nominal, commands, speed=speed[0], setpoint=speed[0], threads=1)
        error = speed - np.append(motion.vx[0], motion.vx[0, -1])[: len(speed)]
        wanted = wanted + error + _ahead(error, SPEED_LAG)
    return Commands(time, angle, np.clip(wanted, -MAX_SPEED, MAX_SPEED))


def _smoothed(time: FloatArray, values: FloatArray) -> Any:
    """Spline, as smooth as generalised cross-validation says; it takes a second, so it is kept."""
    return _spline(time.tobytes(), values.tobytes())


@lru_cache(maxsize=512)
def _spline(time: bytes, values: bytes) -> Any:
    from scipy.interpolate import make_smoothing_spline  # takes as long as NumPy

    return make_smoothing_spline(np.frombuffer(time), np.frombuffer(values))


def _deconvolved(wanted: FloatArray, response: FloatArray) -> FloatArray:
    """Input (t,) whose answer, by an impulse response (m,), is nearest to that wanted (t,)."""
    from scipy.linalg import solveh_banded  # takes as long as NumPy

    alike = np.correlate(response, response, "full")[len(response) - 1 :]
    bands = np.repeat(alike[::-1, np.newaxis], len(wanted), axis=1)
    bands[-1] += 2.0 * SMOOTHED
    bands[-1, [0, -1]] -= SMOOTHED
    bands[-2] -= SMOOTHED
    seen = np.correlate(np.pad(wanted, (0, len(response) - 1)), response, "valid")
    found: FloatArray = solveh_banded(bands, seen)
    return found


def _ahead(error: FloatArray, lag: float) -> FloatArray:
    """Lead for a loop that lags by some seconds: the lag times the smoothed slope of the error."""
    from scipy.signal import savgol_filter  # takes as long as NumPy

    rise: FloatArray = lag * np.gradient(savgol_filter(error, *FILTER), TICK)
    return rise
