"""The equations of motion of a vehicle and their integration, eight vehicles at a time.

This is the only place where tyre, steering and actuators are put together to a vehicle: batches,
the live vehicle and the planner's path tracking all run `advance`. `functions_for` gives the
functions compiled for the wheels and laws of a vehicle. `docs/model.md` derives the equations.
"""

import functools
import hashlib
import math
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.compilation import compilable, compiled
from tricycle_sim.vehicle.approximations import arctan
from tricycle_sim.vehicle.body import BODY, PLACE
from tricycle_sim.vehicle.constants import Vehicle
from tricycle_sim.vehicle.laws import inlined
from tricycle_sim.vehicle.layout import (
    ALIVE,
    COMMANDED,
    COMMANDED_ROWS,
    EVALUATED,
    EVENT,
    EVENT_ROWS,
    LANES,
    SLOPE,
    START,
    STATE,
    SUM,
    WHEEL_EVALUATED,
    WHEEL_STATES,
    numbered,
    states_of,
)
from tricycle_sim.vehicle.parts import (
    BLOCK,
    ROWS,
    WHEEL,
    WHEEL_ROWS,
    Structure,
    structure_of,
)
from tricycle_sim.vehicle.registry import PARTS
from tricycle_sim.vehicle.steering import motor_angle_of, road_angle_of, run_servo, turned
from tricycle_sim.vehicle.tyre import rolling_resistance, slip_slopes, trail_side, vertical_load

COMMAND = numbered(["speed_mode", "demand", "brake"])
"""Columns of the drive's commands, a row per tick.

Speed mode 1: `demand` is a speed set-point [m/s]; 0: it is a motor torque [N m]. Brake 0 to 1.
"""
NO_ROWS, NO_OUTPUT = np.empty(0, dtype=np.int64), np.empty((0, LANES, 2))
"""`rows` and `out` of `advance` where nothing is to be recorded."""

_ONCE = threading.Lock()  # threads that ask at the same time get the same functions

_C = numbered(BODY, step=LANES)
_P = numbered(PLACE, step=LANES)


class Laws(NamedTuple):
    """Structure and laws that are compiled into the equations: constants for the compiler.

    Attributes
    ----------
    wheels : int
        Number of wheels, three or four.
    states : int
        Number of rows of states.
    own_commands : bool
        Whether each vehicle of a group has its own table of the steering, and a speed of its own
        that is added to the motor's set-point.
    sides, driven, braked : tuple
        As in `Structure`.
    tyre_0, tyre_1, tyre_2, tyre_3 : compiled function
        Law of each wheel's tyre; separate fields, because numba calls an entry of a tuple through a
        pointer.
    motor, brake, servo, linkage : compiled function
        Law of each of these parts.
    """

    wheels: int
    states: int
    own_commands: bool
    sides: Any
    driven: Any
    braked: Any
    tyre_0: Any
    tyre_1: Any
    tyre_2: Any
    tyre_3: Any
    motor: Any
    brake: Any
    servo: Any
    linkage: Any


@inlined
def _wheel(
    laws: Laws,
    tyre_law: Any,
    side: int,
    driven: bool,
    braked: bool,
    g: FloatArray,
    i: int,
    wheel: int,
    e: tuple[float, float, float],
    steering: tuple[float, float, float, float, float, float, float, float],
    torque: float,
    brake: float,
) -> tuple[float, float, float, float, float, float]:
    """Evaluate a wheel of vehicle `i`.

    Writes the slopes of its spin and slips, its load and used friction; returns its force and its
    moment about the COM on the body, in the body frame [N, N m].
    """
    ex, ey, ez = e
    n1x, n1y, n1z, rate1, n2x, n2y, n2z, rate2 = steering
    if side == 0:
        nx, ny, nz, steering_rate = n1x, n1y, n1z, rate1
    elif side == 1:
        nx, ny, nz, steering_rate = n2x, n2y, n2z, rate2
    else:
        nx, ny, nz, steering_rate = 0.0, 1.0, 0.0, 0.0
    u, v, w = g[STATE.u * LANES + i], g[STATE.v * LANES + i], g[STATE.w * LANES + i]
    p, q, r = g[STATE.p * LANES + i], g[STATE.q * LANES + i], g[STATE.r * LANES + i]
    state, evaluated = wheel * WHEEL_STATES * LANES + i, wheel * WHEEL_EVALUATED * LANES + i
    spin = g[STATE.spin * LANES + state]
    kappa = g[STATE.kappa * LANES + state]
    alpha = g[STATE.alpha * LANES + state]
    body, own = BLOCK.body * LANES + i, wheel * WHEEL_ROWS * LANES + i
    place, tyre = WHEEL.place * LANES + own, WHEEL.tyre * LANES + own
    px, py, pz = g[place + _P.x], g[place + _P.y], g[place + _P.z]
    kx, kz = g[body + _C.king_pin_x], g[body + _C.king_pin_z]

    # Kinematics: sine s of the axle's elevation, lean, contact directions forward f and left l
    s = nx * ex + ny * ey + nz * ez
    cosine = math.sqrt(1.0 - s * s)
    reciprocal = 1.0 / (cosine * (1.0 + cosine))
    ic = reciprocal * (1.0 + cosine)  # 1 / cosine
    lean = -2.0 * arctan(s * (reciprocal * cosine))  # -asin(s)
    fx, fy, fz = (ny * ez - nz * ey) * ic, (nz * ex - nx * ez) * ic, (nx * ey - ny * ex) * ic
    lx, ly, lz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
    rho = (g[STATE.z * LANES + i] + px * ex + py * ey + pz * ez) * ic  # loaded radius
    dx, dy, dz = -rho * ic * (ex - nx * s), -rho * ic * (ey - ny * s), -rho * ic * (ez - nz * s)
    cx, cy, cz = px + dx, py + dy, pz + dz
    # velocity of the contact point as carried by the hub
    vcx = u + q * cz - r * cy - steering_rate * kz * dy
    vcy = v + r * cx - p * cz + steering_rate * (kz * dx - kx * dz)
    vcz = w + p * cy - q * cx + steering_rate * kx * dy
    vx = vcx * fx + vcy * fy + vcz * fz + rho * (p * nx + q * ny + r * nz)
    vy = vcx * lx + vcy * ly + vcz * lz
    vz = vcx * ex + vcy * ey + vcz * ez
    rolling = rho * spin
    slip_speed = vx - rolling

    load = vertical_load(g, tyre, rho, ic, vz)
    force_x, force_y, aligning, friction_squared, stiffer = tyre_law(
        g, WHEEL.tyre_law * LANES + own, load, kappa, alpha, lean, vx, slip_speed, vy
    )
    aligning *= trail_side(g, tyre, vx)
    kappa_slope, alpha_slope = slip_slopes(g, tyre, vx, slip_speed, vy, kappa, alpha, stiffer)
    resistance = rolling_resistance(g, tyre, rho, load, rolling)

    drive_torque = g[WHEEL.torque_share * LANES + own] * torque if driven else 0.0
    axle_torque = drive_torque - rho * force_x
    if braked:
        axle_torque -= laws.brake(
            g, WHEEL.brake * LANES + own, spin, brake, axle_torque - resistance
        )
    slope = SLOPE * LANES + state
    g[STATE.spin * LANES + slope] = (axle_torque - resistance) * g[place + _P.inverse_inertia]
    g[STATE.kappa * LANES + slope] = kappa_slope
    g[STATE.alpha * LANES + slope] = alpha_slope
    g[EVALUATED.load * LANES + evaluated] = load
    g[EVALUATED.friction_squared * LANES + evaluated] = friction_squared

    # On the body: force at the contact, aligning torque, axle torque, gyroscopic torque
    tx = force_x * fx + force_y * lx + load * ex
    ty = force_x * fy + force_y * ly + load * ey
    tz = force_x * fz + force_y * lz + load * ez
    momentum = g[place + _P.inertia] * spin
    gx, gy, gz = p + steering_rate * kx, q, r + steering_rate * kz
    mx = cy * tz - cz * ty + aligning * ex - axle_torque * nx - momentum * (gy * nz - gz * ny)
    my = cz * tx - cx * tz + aligning * ey - axle_torque * ny - momentum * (gz * nx - gx * nz)
    mz = cx * ty - cy * tx + aligning * ez - axle_torque * nz - momentum * (gx * ny - gy * nx)
    return tx, ty, tz, mx, my, mz


@inlined
def _driven_spin(
    g: FloatArray,
    i: int,
    wheel: int,
    side: int,
    steering: tuple[float, float, float, float, float, float, float, float],
) -> float:
    """Return what a driven wheel adds to the motor's spin relative to the body [rad/s]."""
    n1x, n1y, n1z, _, n2x, n2y, n2z, _ = steering
    p, q, r = g[STATE.p * LANES + i], g[STATE.q * LANES + i], g[STATE.r * LANES + i]
    if side == 0:
        carried = p * n1x + q * n1y + r * n1z
    elif side == 1:
        carried = p * n2x + q * n2y + r * n2z
    else:
        carried = q
    torque_share = g[(WHEEL.torque_share + wheel * WHEEL_ROWS) * LANES + i]
    spin: float = torque_share * (g[(STATE.spin + wheel * WHEEL_STATES) * LANES + i] - carried)
    return spin


@inlined
def slopes(
    laws: Laws,
    g: FloatArray,
    i: int,
    steering: tuple[float, float, float, float, float, float, float, float],
    speed_mode: float,
    demand: float,
    brake: float,
) -> None:
    """Write the time derivatives of all states of a vehicle; called from compiled code.

    Parameters
    ----------
    laws : Laws
        Structure and laws of the vehicle.
    g : ndarray of float, shape (ROWS * LANES,)
        Group of the vehicle.
    i : int
        Lane of the vehicle in the group.
    steering : tuple of float
        Row of the table that `steer` writes.
    speed_mode, demand, brake : float
        Values of a row of `COMMAND`.
    """
    q0, q1 = g[STATE.q0 * LANES + i], g[STATE.q1 * LANES + i]
    q2, q3 = g[STATE.q2 * LANES + i], g[STATE.q3 * LANES + i]
    u, v, w = g[STATE.u * LANES + i], g[STATE.v * LANES + i], g[STATE.w * LANES + i]
    p, q, r = g[STATE.p * LANES + i], g[STATE.q * LANES + i], g[STATE.r * LANES + i]
    body = BLOCK.body * LANES + i
    e = (
        2.0 * (q1 * q3 - q0 * q2),
        2.0 * (q2 * q3 + q0 * q1),
        1.0 - 2.0 * (q1 * q1 + q2 * q2),
    )

    # Drive: the motor turns with the mean of the driven wheels
    spin = 0.0
    if laws.driven[0]:
        spin += _driven_spin(g, i, 0, laws.sides[0], steering)
    if laws.driven[1]:
        spin += _driven_spin(g, i, 1, laws.sides[1], steering)
    if laws.driven[2]:
        spin += _driven_spin(g, i, 2, laws.sides[2], steering)
    if laws.driven[3]:
        spin += _driven_spin(g, i, 3, laws.sides[3], steering)
    torque = g[STATE.torque * LANES + i]
    integrator = g[STATE.integrator * LANES + i]
    torque_slope, integrator_slope, excess = laws.motor(
        g, BLOCK.motor * LANES + i, spin, torque, integrator, speed_mode, demand
    )
    g[EVALUATED.excess * LANES + i] = excess
    g[(SLOPE + STATE.torque) * LANES + i] = torque_slope
    g[(SLOPE + STATE.integrator) * LANES + i] = integrator_slope

    # Wheels
    sides, driven, braked = laws.sides, laws.driven, laws.braked
    ax, ay, az, al, am, an = _wheel(
        laws, laws.tyre_0, sides[0], driven[0], braked[0], g, i, 0, e, steering, torque, brake
    )
    bx, by, bz, bl, bm, bn = _wheel(
        laws, laws.tyre_1, sides[1], driven[1], braked[1], g, i, 1, e, steering, torque, brake
    )
    cx, cy, cz, cl, cm, cn = _wheel(
        laws, laws.tyre_2, sides[2], driven[2], braked[2], g, i, 2, e, steering, torque, brake
    )
    fx, fy, fz = ax + bx + cx, ay + by + cy, az + bz + cz
    mx, my, mz = al + bl + cl, am + bm + cm, an + bn + cn
    if laws.wheels == 4:
        dx, dy, dz, dl, dm, dn = _wheel(
            laws, laws.tyre_3, sides[3], driven[3], braked[3], g, i, 3, e, steering, torque, brake
        )
        fx, fy, fz = fx + dx, fy + dy, fz + dz
        mx, my, mz = mx + dl, my + dm, mz + dn

    # Body: Newton and Euler in the body frame
    ixx, iyy, izz = g[body + _C.ixx], g[body + _C.iyy], g[body + _C.izz]
    inverse_mass = g[body + _C.inverse_mass]
    gravity_x, gravity_y = g[body + _C.gravity_x], g[body + _C.gravity_y]
    gravity_z = g[body + _C.gravity_z]
    ex, ey, ez = e
    # the road's x and y axes in the body frame
    xx, xy, xz = (
        1.0 - 2.0 * (q2 * q2 + q3 * q3),
        2.0 * (q1 * q2 - q0 * q3),
        2.0 * (q1 * q3 + q0 * q2),
    )
    yx, yy, yz = (
        2.0 * (q1 * q2 + q0 * q3),
        1.0 - 2.0 * (q1 * q1 + q3 * q3),
        2.0 * (q2 * q3 - q0 * q1),
    )
    drag = g[body + _C.drag_per_mass] * u * abs(u)
    g[(SLOPE + STATE.u) * LANES + i] = (
        fx * inverse_mass - gravity_z * ex - drag - q * w + r * v
    ) - (gravity_x * xx + gravity_y * yx)
    g[(SLOPE + STATE.v) * LANES + i] = (fy * inverse_mass - gravity_z * ey - r * u + p * w) - (
        gravity_x * xy + gravity_y * yy
    )
    g[(SLOPE + STATE.w) * LANES + i] = (fz * inverse_mass - gravity_z * ez - p * v + q * u) - (
        gravity_x * xz + gravity_y * yz
    )
    g[(SLOPE + STATE.p) * LANES + i] = (mx - (izz - iyy) * q * r) * g[body + _C.inverse_ixx]
    g[(SLOPE + STATE.q) * LANES + i] = (my - (ixx - izz) * r * p) * g[body + _C.inverse_iyy]
    g[(SLOPE + STATE.r) * LANES + i] = (mz - (iyy - ixx) * p * q) * g[body + _C.inverse_izz]
    # Pose; the last term of the quaternion's rate keeps its length 1
    g[(SLOPE + STATE.x) * LANES + i] = xx * u + xy * v + xz * w
    g[(SLOPE + STATE.y) * LANES + i] = yx * u + yy * v + yz * w
    g[(SLOPE + STATE.z) * LANES + i] = ex * u + ey * v + ez * w
    excess = 1.0 - (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    g[(SLOPE + STATE.q0) * LANES + i] = 0.5 * (-q1 * p - q2 * q - q3 * r) + excess * q0
    g[(SLOPE + STATE.q1) * LANES + i] = 0.5 * (q0 * p + q2 * r - q3 * q) + excess * q1
    g[(SLOPE + STATE.q2) * LANES + i] = 0.5 * (q0 * q + q3 * p - q1 * r) + excess * q2
    g[(SLOPE + STATE.q3) * LANES + i] = 0.5 * (q0 * r + q1 * q - q2 * p) + excess * q3
    g[EVALUATED.tilt * LANES + i] = ez


@inlined
def _evaluate_each(
    laws: Laws, g: FloatArray, lanes: int, table: FloatArray, row: int, drive: FloatArray
) -> None:
    """Write the slopes of a group whose table has a column for each number of each vehicle."""
    speed_mode, demand, brake = (
        drive[COMMAND.speed_mode],
        drive[COMMAND.demand],
        drive[COMMAND.brake],
    )
    # beside the states: loads from another array, which might be the one written, do not vectorise
    first = COMMANDED * LANES
    for j in range(COMMANDED_ROWS * LANES):
        g[first + j] = table[row, j]
    for i in range(lanes):
        steering = (
            g[first + i],
            g[first + LANES + i],
            g[first + 2 * LANES + i],
            g[first + 3 * LANES + i],
            g[first + 4 * LANES + i],
            g[first + 5 * LANES + i],
            g[first + 6 * LANES + i],
            g[first + 7 * LANES + i],
        )
        faster = g[first + 8 * LANES + i]
        slopes(laws, g, i, steering, speed_mode, demand + faster, brake)


@inlined
def _evaluate(
    laws: Laws, g: FloatArray, lanes: int, table: FloatArray, row: int, drive: FloatArray
) -> None:
    """Write the slopes of a whole group, with row `row` of the steering table."""
    if laws.own_commands:
        _evaluate_each(laws, g, lanes, table, row, drive)
        return
    steering = (
        table[row, 0],
        table[row, 1],
        table[row, 2],
        table[row, 3],
        table[row, 4],
        table[row, 5],
        table[row, 6],
        table[row, 7],
    )
    speed_mode, demand, brake = (
        drive[COMMAND.speed_mode],
        drive[COMMAND.demand],
        drive[COMMAND.brake],
    )
    for i in range(lanes):
        slopes(laws, g, i, steering, speed_mode, demand, brake)


@inlined
def _note(g: FloatArray, i: int, event: int, new: bool, value: float, tick: float) -> None:
    """Keep value, tick and place of an event of vehicle `i` if it is `new`."""
    x, y = g[STATE.x * LANES + i], g[STATE.y * LANES + i]
    g[event * LANES + i] = value if new else g[event * LANES + i]
    g[(event + 1) * LANES + i] = tick if new else g[(event + 1) * LANES + i]
    g[(event + 2) * LANES + i] = x if new else g[(event + 2) * LANES + i]
    g[(event + 3) * LANES + i] = y if new else g[(event + 3) * LANES + i]


@inlined
def watch(laws: Laws, g: FloatArray, i: int, tick: float, steering_lag: float) -> None:
    """Record the limits that a vehicle reaches at a tick, and whether it is upright; compiled.

    Parameters
    ----------
    laws : Laws
        As for `slopes`.
    g : ndarray of float, shape (ROWS * LANES,)
        Group of the vehicle, with its slopes evaluated.
    i : int
        Lane of the vehicle in the group.
    tick : float
        Number of the tick.
    steering_lag : float
        As for `advance` of `Functions`, at this tick [rad].
    """
    friction_squared = 0.0
    for wheel in range(laws.wheels):
        evaluated = wheel * WHEEL_EVALUATED * LANES + i
        load = g[EVALUATED.load * LANES + evaluated]
        event = EVENT.least_load + EVENT_ROWS * wheel
        _note(g, i, event, load < g[event * LANES + i], load, tick)
        friction_squared = max(friction_squared, g[EVALUATED.friction_squared * LANES + evaluated])
    more = friction_squared > g[EVENT.friction_squared * LANES + i]
    _note(g, i, EVENT.friction_squared, more, friction_squared, tick)
    excess = abs(g[EVALUATED.excess * LANES + i])
    first = g[EVENT.motor * LANES + i] == 0.0 and excess > 1e-9
    _note(g, i, EVENT.motor, first, excess, tick)
    first = g[EVENT.steering * LANES + i] == 0.0 and steering_lag > 0.0
    _note(g, i, EVENT.steering, first, steering_lag, tick)
    upright = g[EVALUATED.tilt * LANES + i] >= g[BLOCK.body * LANES + i + _C.rollover_cosine]
    _note(g, i, EVENT.rollover, g[ALIVE * LANES + i] == 1.0 and not upright, 1.0, tick)
    g[ALIVE * LANES + i] = g[ALIVE * LANES + i] if upright else 0.0


@inlined
def _watch_group(laws: Laws, g: FloatArray, lanes: int, tick: float, steering_lag: float) -> bool:
    """Note what happens to a group at a tick; return whether a vehicle has rolled over by now."""
    for i in range(lanes):
        watch(laws, g, i, tick, steering_lag)
    alive = 0.0
    for i in range(lanes):
        alive += g[ALIVE * LANES + i]
    return alive < lanes


@inlined
def _halt(laws: Laws, g: FloatArray, lanes: int) -> None:
    """Bring the vehicles that have rolled over to rest."""
    for i in range(lanes):
        if g[ALIVE * LANES + i] == 0.0:
            for row in range(STATE.u, laws.states):
                g[row * LANES + i] = 0.0
            for row in range(SLOPE, SLOPE + laws.states):
                g[row * LANES + i] = 0.0


@inlined
def _advance(
    laws: Laws,
    groups: FloatArray,
    table: FloatArray,
    steering_lag: FloatArray,
    drive: FloatArray,
    substeps: int,
    first_tick: int,
    rows: NDArray[np.int64],
    every: int,
    out: FloatArray,
) -> None:
    # Known only at run time: a constant number of lanes is unrolled instead of vectorised.
    lanes = groups.shape[1] // ROWS
    ticks = drive.shape[0] - 1
    h = TICK / substeps
    rows_of_group = table.shape[0] // groups.shape[0] if laws.own_commands else 0
    for b in range(groups.shape[0]):
        g = groups[b]
        halted = False
        for k in range(ticks + 1):
            for s in range(substeps):
                row = b * rows_of_group + 2 * (k * substeps + s)
                for stage in range(4):  # of the classical Runge-Kutta method
                    _evaluate(laws, g, lanes, table, row + (stage + 1) // 2, drive[k])
                    if stage == 0:
                        if s == 0:
                            halted = _watch_group(
                                laws, g, lanes, float(first_tick + k), steering_lag[k]
                            )
                            if halted:
                                _halt(laws, g, lanes)
                            if k % every == 0:
                                for m in range(rows.shape[0]):
                                    for i in range(LANES):  # unrolled: scattered stores are slow
                                        out[m, b * LANES + i, k // every] = g[rows[m] * LANES + i]
                        if k == ticks:
                            break
                        for j in range(laws.states * LANES):
                            start, slope = g[j], g[SLOPE * LANES + j]
                            g[START * LANES + j] = start
                            g[SUM * LANES + j] = start + h / 6.0 * slope
                            g[j] = start + h / 2.0 * slope
                    elif stage == 3:
                        for j in range(laws.states * LANES):
                            g[j] = g[SUM * LANES + j] + h / 6.0 * g[SLOPE * LANES + j]
                    else:
                        ahead = h if stage == 2 else h / 2.0
                        for j in range(laws.states * LANES):
                            slope = g[SLOPE * LANES + j]
                            g[SUM * LANES + j] += h / 3.0 * slope
                            g[j] = g[START * LANES + j] + ahead * slope
                if k == ticks:
                    break
                if halted:  # stay where the step began
                    for i in range(lanes):
                        if g[ALIVE * LANES + i] == 0.0:
                            for j in range(laws.states):
                                g[j * LANES + i] = g[(START + j) * LANES + i]


@inlined
def position(groups: FloatArray) -> tuple[float, float]:
    """Return the COM's x and y [m] of the first vehicle; callable from compiled code.

    Parameters
    ----------
    groups : ndarray of float, shape (b, ROWS * LANES)
        Groups of vehicles, from `tricycle_sim.vehicle.groups.pack`.
    """
    return groups[0, STATE.x * LANES], groups[0, STATE.y * LANES]


@inlined
def yaw(groups: FloatArray) -> float:
    """Return the yaw angle of the first vehicle [rad]; callable from compiled code.

    Parameters
    ----------
    groups : ndarray of float, shape (b, ROWS * LANES)
        Groups of vehicles, from `tricycle_sim.vehicle.groups.pack`.
    """
    g = groups[0]
    w, x = g[STATE.q0 * LANES], g[STATE.q1 * LANES]
    y, z = g[STATE.q2 * LANES], g[STATE.q3 * LANES]
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


class Functions(NamedTuple):
    """Compiled functions of all vehicles of the same structure; their arguments are positional.

    Letters of shapes: `b` groups, `t` ticks, `m` recorded rows.

    Attributes
    ----------
    advance : callable
        Advances groups by t ticks under the same commands; with 0 ticks it evaluates the slopes.
        Arguments: groups (b, ROWS * LANES), advanced in place; table (2 * substeps * t + 1, 8) from
        `steer`, or of each group one after the other, with LANES numbers for each of the 8 (own
        steering); steering lag (t + 1,), set-point behind the command beyond what one tick of slew
        makes up for [rad], else 0; drive (t + 1, 3), columns of `COMMAND`, the last row for the
        slopes at the end; substeps, Runge-Kutta steps per tick; first tick, its number in the
        events; rows (m,) of a group to record; every, ticks from one record to the next; out
        (m, b * LANES, t // every + 1) for them.
    advance_tick : callable
        Advances groups and their servo by one tick. Arguments: groups; servo, from
        `servo_at_rest`, motor angle [rad] and rate [rad/s] first; constants of the steering for
        TICK / (2 * substeps); steering set-point [rad], slewed already, NaN for no servo pulse;
        drive, a tuple in the order of `COMMAND`, slewed already; substeps, 1 as in the batch, 2 as
        live.
    steer : callable
        `tricycle_sim.vehicle.steering.run_servo` without its first two arguments.
    wheel_angles : callable
        Function from motor angle [rad] and constants of the steering to the angles of the wheels
        about their king-pins, left and right [rad], and their slopes by the motor angle.
    road_angle, motor_angle_for : callable
        `road_angle_of`, `motor_angle_of` of `tricycle_sim.vehicle.steering` without their first
        argument.
    """

    advance: Any
    advance_tick: Any
    steer: Any
    wheel_angles: Any
    road_angle: Any
    motor_angle_for: Any


def functions_for(vehicle: Vehicle, *, own_commands: bool = False) -> Functions:
    """Return the functions compiled for the structure of a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle; its wheels and laws are used.
    own_commands : bool
        Whether each vehicle of a group has its own table of the steering and of what is added to
        the motor's demand.
    """
    with _ONCE:
        return _compile(structure_of(vehicle), own_commands)


def compiled_for(vehicle: Vehicle, function: Callable[..., Any]) -> Any:
    """Return a function compiled for the structure of a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle; its wheels and laws are used.
    function : callable
        Function at the top level of a module; names of `Functions` are global names in it.
    """
    with _ONCE:
        return _compile_caller(structure_of(vehicle), function)


def laws_of(
    structure: Structure, own_commands: bool = False, take: Callable[[Any], Any] = compilable
) -> Laws:
    """Return the structure and laws that are compiled into the equations of a vehicle.

    Parameters
    ----------
    structure : Structure
        Structure, from `structure_of`.
    own_commands : bool
        As for `functions_for`.
    take : callable
        Turns a law's Python function into one that the compiler accepts.
    """

    def law(part: str, name: str) -> Any:
        return take(PARTS[part][name].function)

    return Laws(
        wheels=structure.wheels,
        states=states_of(structure.wheels),
        own_commands=own_commands,
        sides=structure.sides,
        driven=structure.driven,
        braked=structure.braked,
        **{f"tyre_{wheel}": law("tyre", name) for wheel, name in enumerate(structure.tyres)},
        motor=law("motor", structure.motor),
        brake=law("brake", structure.brake),
        servo=law("servo", structure.servo),
        linkage=law("steering", structure.steering),
    )


def variant_of(structure: Structure, own_commands: bool = False) -> str:
    """Return a short name of the laws from `laws_of`, for file names.

    Parameters
    ----------
    structure : Structure
        As for `laws_of`.
    own_commands : bool
        As for `laws_of`.
    """
    name = hashlib.sha256(repr(structure).encode()).hexdigest()[:16]
    return name + ("-own" if own_commands else "")


@functools.cache
def _compile_caller(structure: Structure, function: Callable[..., Any]) -> Any:
    return compiled(function, variant_of(structure), **_compile(structure, False)._asdict())


@functools.cache
def _compile(structure: Structure, own_commands: bool) -> Functions:  # one way to call: one key
    chosen = laws_of(structure, own_commands)
    variant = variant_of(structure, own_commands)
    advancing = compiled(_advance_with, variant, laws=chosen)
    steering_ahead = compiled(_steer_with, variant, laws=chosen)
    return Functions(
        advance=advancing,
        advance_tick=compiled(_advance_tick_with, variant, advance=advancing, steer=steering_ahead),
        steer=steering_ahead,
        wheel_angles=compiled(_wheel_angles_with, variant, laws=chosen),
        road_angle=compiled(_road_angle_with, variant, laws=chosen),
        motor_angle_for=compiled(_motor_angle_for_with, variant, laws=chosen),
    )


# Templates: `_compile` puts compiled functions in place of these names.
laws: Any = None
advance: Any = None
steer: Any = None


def _advance_with(
    groups: FloatArray,
    table: FloatArray,
    steering_lag: FloatArray,
    drive: FloatArray,
    substeps: int,
    first_tick: int,
    rows: NDArray[np.int64],
    every: int,
    out: FloatArray,
) -> None:
    _advance(laws, groups, table, steering_lag, drive, substeps, first_tick, rows, every, out)


def _steer_with(
    servo: FloatArray,
    setpoints: FloatArray,
    constants: FloatArray,
    half_steps: int,
    table: FloatArray,
    angles: FloatArray,
) -> None:
    run_servo(laws.servo, laws.linkage, servo, setpoints, constants, half_steps, table, angles)


def _advance_tick_with(
    groups: FloatArray,
    servo: FloatArray,
    constants: FloatArray,
    steering_setpoint: float,
    drive: tuple[float, float, float],
    substeps: int,
) -> None:
    table = np.empty((2 * substeps + 1, 8))
    steer(servo, np.full(1, steering_setpoint), constants, 2 * substeps, table, np.empty((2, 2)))
    commands = np.empty((2, 3))
    commands[:] = np.array(drive)
    rows, out = np.empty(0, dtype=np.int64), np.empty((0, LANES, 2))
    advance(groups, table, np.zeros(2), commands, substeps, 0, rows, 1, out)


def _wheel_angles_with(
    motor_angle: float, constants: FloatArray
) -> tuple[float, float, float, float]:
    angles: tuple[float, float, float, float] = turned(laws.linkage, constants, motor_angle)
    return angles


def _road_angle_with(motor_angle: float, constants: FloatArray) -> float:
    angle: float = road_angle_of(laws.linkage, motor_angle, constants)
    return angle


def _motor_angle_for_with(angle: float, constants: FloatArray) -> float:
    motor_angle: float = motor_angle_of(laws.linkage, angle, constants)
    return motor_angle
