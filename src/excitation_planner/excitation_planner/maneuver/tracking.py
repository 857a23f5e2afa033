"""Path tracking: the steer and drive commands with which the nominal vehicle follows a path.

Pure pursuit of the unsteered axle's ground point, every 20 ms, on the compiled vehicle model.
Commands change no faster than the PLCs slew their set-points, so that no limiter acts when they are
replayed. The steering keeps its margin before the end stop; a path that the vehicle cannot hold so
makes the drive infeasible.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from excitation_planner.maneuver.family import (
    ACCELERATION,
    COMMAND_TICKS,
    PATH_SPACING,
    DrivenPath,
    kept_margin,
    path_point,
    steering_lock,
)
from tricycle_bridge.protocol.units import ANGLE_UNIT, SPEED_UNIT
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.setpoints import slew
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.groups import equilibrium, pack
from tricycle_sim.vehicle.kernel import compiled_for, position, yaw
from tricycle_sim.vehicle.parts import servo_at_rest, steering_constants

LOOK_AHEAD = 0.6  # m, of pure pursuit ...
LOOK_AHEAD_TIME = 0.3  # s, ... plus this times the speed
SLOW = 0.8  # m/s of cruise speed below which it grows again, by 1 m per m/s: the pursuit of a near
# point would sway with the body, which rolls at 2.4 Hz, until a wheel lifts
AT_LOCK = 0.1  # m from the path, steering as far as it may, at which the steering does not suffice
OFF_PATH = 1.0  # m from the path at which tracking has failed

ARRIVED, SATURATED, LOST = range(3)  # how a drive ends


@dataclass(frozen=True)
class Tracking:
    """The commands of a tracked drive.

    Attributes
    ----------
    commands : Commands
        50 Hz, from rest to the end of the path, or to where the vehicle could not follow it.
    infeasible : str
        Why the vehicle could not drive the path, with time and place; empty when it could.
    """

    commands: Commands
    infeasible: str


# `compiled_for` puts the functions of the vehicle in place of these names.
advance_tick: Any = None
motor_angle_for: Any = None


def _track(
    vehicle: FloatArray,
    servo: FloatArray,
    steering: FloatArray,
    path_x: FloatArray,
    path_y: FloatArray,
    length: float,
    wheelbase: float,
    point: float,
    speed: float,
    slew_rate: float,
    acceleration: float,
    lock: float,
    commands: FloatArray,
) -> tuple[int, int]:
    """Drive the path, as far as the vehicle can follow it.

    Returns the number of rows written, and how it ended: `ARRIVED`, `SATURATED` or `LOST`.

    Parameters
    ----------
    vehicle : ndarray of float, shape (1, ROWS * LANES)
        Group from `pack`, at rest at the start of the path; advanced in place.
    servo, steering : ndarray of float
        Servo and constants of the steering, as for `Functions.advance_tick`.
    path_x, path_y : ndarray of float, shape (m,)
        Points of the path, `PATH_SPACING` apart [m].
    length, speed : float
        As in `DrivenPath` [m, m/s].
    wheelbase, slew_rate, acceleration : float
        Of the vehicle [m], of its steering motor [rad/s], of the speed set-point [m/s^2].
    point : float
        `path_point` [m].
    lock : float
        `steering_lock` [rad].
    commands : ndarray of float, shape (c, 2)
        Receives steering motor angle [rad] and speed [m/s].
    """
    near, target, speed_setpoint = 0, 0.0, 0.0
    # straight on, not at 0 where the steering is mounted askew: the driver waits for it before
    angle = round(motor_angle_for(0.0, steering) / ANGLE_UNIT) * ANGLE_UNIT
    angle_setpoint = angle
    servo[:] = angle
    servo[1] = 0.0
    for row in range(commands.shape[0]):
        heading = yaw(vehicle)
        c, s = math.cos(heading), math.sin(heading)
        x, y = position(vehicle)
        own_x, own_y = x + point * c, y + point * s
        # the nearest point of the path, forward of the last one
        distance = math.hypot(path_x[near] - own_x, path_y[near] - own_y)
        while near + 1 < path_x.shape[0]:
            following = math.hypot(path_x[near + 1] - own_x, path_y[near + 1] - own_y)
            if following > distance:
                break
            near, distance = near + 1, following
        if near * PATH_SPACING >= length:
            return row, ARRIVED
        if distance > OFF_PATH:
            return row, LOST
        ahead = LOOK_AHEAD + LOOK_AHEAD_TIME * target + max(SLOW - speed, 0.0)
        goal = min(near + int(ahead / PATH_SPACING), path_x.shape[0] - 1)
        dx, dy = path_x[goal] - own_x, path_y[goal] - own_y
        lateral = -s * dx + c * dy
        wanted = math.atan(wheelbase * 2.0 * lateral / (dx * dx + dy * dy))
        if distance > AT_LOCK and abs(angle) > lock - 0.5 * ANGLE_UNIT:
            return row, SATURATED
        reach = slew_rate * COMMAND_TICKS * TICK
        turned = min(max(motor_angle_for(wanted, steering), -lock), lock)
        angle += min(max(turned - angle, -reach), reach)
        target = min(speed, target + acceleration * COMMAND_TICKS * TICK)
        # rounded to the protocol's units, as it is driven: 0.5 mm/s are 1 cm after 20 s
        angle = round(angle / ANGLE_UNIT) * ANGLE_UNIT
        commands[row, 0] = angle
        commands[row, 1] = round(target / SPEED_UNIT) * SPEED_UNIT
        for _ in range(COMMAND_TICKS):
            angle_setpoint = slew(angle_setpoint, angle, slew_rate)
            speed_setpoint = slew(speed_setpoint, commands[row, 1], acceleration)
            advance_tick(vehicle, servo, steering, angle_setpoint, (1.0, speed_setpoint, 0.0), 1)
    return commands.shape[0], LOST


def track(vehicle: Vehicle, path: DrivenPath) -> Tracking:
    """Drive a path with the nominal vehicle.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle that is driven with its nominal values, from rest at the origin heading +x.
    path : DrivenPath
        Path of the unsteered axle's ground point, starting where that point is.
    """
    acceleration = min(ACCELERATION, vehicle.acceleration)
    duration = path.length / path.speed + path.speed / acceleration
    period = COMMAND_TICKS * TICK
    rows = np.empty((math.ceil(1.5 * duration / period), 2))
    steering = steering_constants(vehicle, 0.5 * TICK)
    n, end = compiled_for(vehicle, _track)(
        pack(vehicle, vehicle.nominal_point()[np.newaxis], equilibrium(vehicle)),
        servo_at_rest(vehicle),
        steering,
        path.x,
        path.y,
        path.length,
        vehicle.wheelbase,
        path_point(vehicle),
        path.speed,
        vehicle.steering_slew,
        acceleration,
        steering_lock(vehicle),
        rows,
    )
    infeasible = {
        ARRIVED: "",
        SATURATED: f"the steering saturates at {n * period:.2f} s: {kept_margin(vehicle)}",
        LOST: f"the path was lost at {n * period:.2f} s",
    }[end]
    held = np.vstack([rows[:n], rows[n - 1 : n]])  # the last row is the end
    return Tracking(Commands(period * np.arange(n + 1), *held.T), infeasible)
