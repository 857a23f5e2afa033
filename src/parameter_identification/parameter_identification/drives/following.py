"""Set-points with which the nominal vehicle follows what was measured: its steering, its speed."""

import dataclasses

import numpy as np

from parameter_identification.drives.samples import Samples
from tricycle_bridge.protocol.limits import MAX_SPEED
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.setpoints import command_rows, slew_all
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import simulate
from tricycle_sim.vehicle.kernel import functions_for
from tricycle_sim.vehicle.parts import servo_at_rest, steering_constants

FOLLOWING = 6  # iterations after which the model has the measured speed or steering angle
SPEED_LAG = 0.2  # s, of a speed loop
FILTER = 21, 2  # Savitzky-Golay at 100 Hz: samples, order


def servo_response(setpoints: FloatArray, vehicle: Vehicle) -> FloatArray:
    """Return the angles (t,) of the steering motor for set-points, without slew or stop.

    Parameters
    ----------
    setpoints : ndarray of float, shape (t,)
        On ticks; before them the motor stands at the first one.
    vehicle : Vehicle
        Its servo is used.
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
        Of the steering motor, smooth, on ticks [rad].
    vehicle : Vehicle
        Its servo is used.
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
        Of a drive.
    vehicle : Vehicle
        Its slew is used.
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
        Of a drive.
    time : ndarray of float, shape (m,)
        Since the start event [s].
    vehicle : Vehicle
        Its servo and slew are used.
    """
    setpoints = commanded_setpoints(commands, vehicle)
    ticks = TICK * np.arange(len(setpoints))
    angle: FloatArray = np.interp(time, ticks, servo_response(setpoints, vehicle))
    return angle


def measured_setpoints(
    commands: Commands, measured: Samples, vehicle: Vehicle
) -> tuple[FloatArray, FloatArray]:
    """Return the set-points (t,) of the steering on ticks, and those that give a measured angle.

    What is measured is smoothed; what the servo does anyway is not, because it is known.

    Parameters
    ----------
    commands : Commands
        Of a drive.
    measured : Samples
        Angle of the steering motor [rad], since the start event [s].
    vehicle : Vehicle
        Its servo and slew are used.

    References
    ----------
    P. Craven, G. Wahba, Numerische Mathematik 31 (1979) 377-403: how much is smoothed.
    """
    from scipy.interpolate import make_smoothing_spline  # takes as long as NumPy

    setpoints = commanded_setpoints(commands, vehicle)
    ticks = TICK * np.arange(len(setpoints))
    expected = np.interp(measured.time, ticks, servo_response(setpoints, vehicle))
    off = make_smoothing_spline(measured.time, measured.values - expected)
    inside = np.clip(ticks, measured.time[0], measured.time[-1])
    return setpoints, setpoints + steering_setpoints(off(inside), vehicle)


def speed_followed(vehicle: Vehicle, angle: FloatArray, speed: FloatArray) -> Commands:
    """Return commands with which the nominal vehicle has a speed, as far as it can.

    Parameters
    ----------
    vehicle : Vehicle
        With its speed loop.
    angle, speed : ndarray of float, shape (t,)
        Of the steering motor [rad] and forward, of the COM [m/s], at each tick.
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


def _ahead(error: FloatArray, lag: float) -> FloatArray:
    """What a loop that lags by so many seconds has to be told besides the error."""
    from scipy.signal import savgol_filter  # takes as long as NumPy

    rise: FloatArray = lag * np.gradient(savgol_filter(error, *FILTER), TICK)
    return rise
