"""The equations of motion of the tricycle and their integration, eight vehicles at a time.

This is the only place of the equations: batches, the live vehicle and the planner's path tracking
all run `advance`. `docs/model.md` derives them in the order of this file.

Layout. A *group* is one flat float64 array of `GROUP_SIZE` numbers that holds `LANES` vehicles: row
`r` of vehicle `i` is element `r * LANES + i`. One array with row offsets known at compile time lets
LLVM turn the loop over the lanes into vector instructions; separate arrays do not vectorise. Every
constant is a row too, so any of them may differ from vehicle to vehicle.

The steering servo is not loaded by the tyres, so its history is the same for all vehicles: it is
computed once per half step (`tricycle_sim.vehicle.steering`) and handed in as a table.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tricycle_core.quantities import TICK, FloatArray
from tricycle_core.rotations import attitude_quaternion
from tricycle_sim.compilation import compiled, inlined
from tricycle_sim.vehicle.file import Vehicle
from tricycle_sim.vehicle.steering import run_servo

LANES = 8

# Rows of a group. First the state:
# fmt: off
(
    X, Y, Z,  # COM in the world [m]
    Q0, Q1, Q2, Q3,  # unit quaternion body to world, scalar first
    U, V, W,  # COM velocity in the body frame [m/s]
    P, Q, R,  # angular rate in the body frame [rad/s]
    SPIN_LEFT, SPIN_RIGHT, SPIN_REAR,  # absolute spins about the axles [rad/s]
    KAPPA_LEFT, KAPPA_RIGHT, KAPPA_REAR,  # relaxed longitudinal slips
    ALPHA_LEFT, ALPHA_RIGHT, ALPHA_REAR,  # relaxed lateral slips
    TORQUE,  # of the motor [N m]
    INTEGRATOR,  # of the speed controller [rad]
) = range(24)
# fmt: on
STATES = 24
# its value at the start of the step, the weighted sum of slopes, and the slope;
START, SUM, SLOPE = STATES, 2 * STATES, 3 * STATES
# what the last evaluation saw: wheel loads [N], squared shares of the friction limit, motor torque
# beyond the motor's limits [N m], cosine of the body's tilt;
LOAD = 4 * STATES
SHARE = LOAD + 3
EXCESS, TILT = SHARE + 3, SHARE + 4
# what is remembered of the run: 1 until the vehicle has rolled over, then 0; an event is four rows:
# value, tick, x, y (least loads, largest friction share, first motor saturation, roll-over,
# steering saturation);
ALIVE = TILT + 1
EVENTS = ALIVE + 1
(LEAST_LOAD_LEFT, LEAST_LOAD_RIGHT, LEAST_LOAD_REAR) = (EVENTS, EVENTS + 4, EVENTS + 8)
(FRICTION, MOTOR, ROLLOVER, STEERING) = (EVENTS + 12, EVENTS + 16, EVENTS + 20, EVENTS + 24)
# and the constants.
CONSTANTS = EVENTS + 28
# fmt: off
(
    _GRAVITY, _INVERSE_MASS, _DRAG_PER_MASS,
    _IXX, _IYY, _IZZ, _INVERSE_IXX, _INVERSE_IYY, _INVERSE_IZZ,
    _FRONT_X, _REAR_X, _LEFT_Y, _RIGHT_Y, _REAR_Y, _WHEEL_Z, _RADIUS,
    _IW_FRONT, _IW_REAR, _INVERSE_IW_FRONT, _INVERSE_IW_REAR,
    _KZ, _CZ, _MU, _C_ALPHA, _C_GAMMA, _SAP, _F1, _F2, _LS0, _LS1,
    _C_KAPPA, _INVERSE_SIGMA_X, _INVERSE_SIGMA_Y,
    _V0_SQUARED, _VL_SQUARED, _DX, _DY, _V_EPS_SQUARED,
    _KING_PIN_X, _KING_PIN_Z,
    _MOTOR_TORQUE, _MOTOR_POWER, _MOTOR_SLOPE, _NO_LOAD_SPEED, _REGENERATIVE, _INVERSE_LAG,
    _KP, _KI, _ANTI_WINDUP, _BRAKE_TORQUE, _BRAKE_SMOOTHING_SQUARED, _ROLLOVER_COSINE,
) = range(CONSTANTS, CONSTANTS + 52)
# fmt: on
ROWS = _ROLLOVER_COSINE + 1
GROUP_SIZE = ROWS * LANES

# Columns of the drive's commands, one row per tick
SPEED_MODE, DEMAND, BRAKE = 0, 1, 2
"""1: `DEMAND` is a speed set-point [m/s]; 0: it is a motor torque [N m]. Brake 0 to 1."""


NO_ROWS, NO_OUTPUT = np.empty(0, dtype=np.int64), np.empty((0, LANES, 2))
"""`rows` and `out` of `advance` where nothing is to be recorded."""


@inlined
def _arctan(t: float) -> float:
    """Return atan(t) for |t| <= 1 to 1e-15, without branches."""
    # odd polynomial through the Chebyshev nodes of t^2 in [0, 1]
    z = t * t
    even = -1.93423475928923e-05
    even = even * z + 0.00021423810738603946
    even = even * z - 0.0011252544302234645
    even = even * z + 0.003751138483965141
    even = even * z - 0.00899108054265826
    even = even * z + 0.01671959606350739
    even = even * z - 0.02556862364437174
    even = even * z + 0.03387126702700675
    even = even * z - 0.040811247503178855
    even = even * z + 0.04668745304848529
    even = even * z - 0.052374234719188166
    even = even * z + 0.058768281144872724
    even = even * z - 0.06665764910689723
    even = even * z + 0.07692198997458294
    even = even * z - 0.09090899793217341
    even = even * z + 0.11111110578002083
    even = even * z - 0.14285714266926733
    even = even * z + 0.1999999999964796
    even = even * z - 0.333333333333307
    return t * (even * z + 1.0)


@inlined
def _wheel(
    g: FloatArray,
    i: int,
    wheel: int,
    e: tuple[float, float, float],
    n: tuple[float, float, float],
    steering_rate: float,
    position: tuple[float, float, float],
    inertia: float,
    inverse_inertia: float,
    drive_torque: float,
) -> tuple[float, float, float, float, float, float]:
    """Evaluate one wheel (0 left, 1 right, 2 rear) of vehicle `i`.

    Writes the slopes of its spin and slips, its load and friction share; returns its force and its
    moment about the COM on the body, in the body frame [N, N m].
    """
    ex, ey, ez = e
    nx, ny, nz = n
    px, py, pz = position
    u, v, w = g[U * LANES + i], g[V * LANES + i], g[W * LANES + i]
    p, q, r = g[P * LANES + i], g[Q * LANES + i], g[R * LANES + i]
    spin = g[(SPIN_LEFT + wheel) * LANES + i]
    kappa = g[(KAPPA_LEFT + wheel) * LANES + i]
    alpha = g[(ALPHA_LEFT + wheel) * LANES + i]
    kx, kz = g[_KING_PIN_X * LANES + i], g[_KING_PIN_Z * LANES + i]

    # Kinematics: sine s of the axle's elevation, lean, contact directions forward f and left l
    s = nx * ex + ny * ey + nz * ez
    cosine = math.sqrt(1.0 - s * s)
    reciprocal = 1.0 / (cosine * (1.0 + cosine))
    ic = reciprocal * (1.0 + cosine)  # 1 / cosine
    lean = -2.0 * _arctan(s * (reciprocal * cosine))  # -asin(s)
    fx, fy, fz = (ny * ez - nz * ey) * ic, (nz * ex - nx * ez) * ic, (nx * ey - ny * ex) * ic
    lx, ly, lz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
    rho = (g[Z * LANES + i] + px * ex + py * ey + pz * ez) * ic  # loaded radius
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

    # Tyre: load, relaxed slips, friction circle
    load = max(
        0.0, g[_KZ * LANES + i] * (g[_RADIUS * LANES + i] - rho) * ic - g[_CZ * LANES + i] * vz
    )
    vx2 = vx * vx
    speed = math.sqrt(vx2 + g[_V0_SQUARED * LANES + i])
    fade_speed = g[_VL_SQUARED * LANES + i]
    fade = fade_speed / (vx2 + fade_speed)
    slip_speed = vx - rolling
    x0 = g[_C_KAPPA * LANES + i] * kappa - g[_DX * LANES + i] * fade * slip_speed
    stiffness = g[_LS0 * LANES + i] + g[_LS1 * LANES + i] * load
    y0 = (
        stiffness * (g[_C_ALPHA * LANES + i] * alpha + g[_C_GAMMA * LANES + i] * lean)
        - g[_DY * LANES + i] * fade * vy
    )
    limit = g[_MU * LANES + i] * load
    limit2 = limit * limit
    force2 = x0 * x0 + y0 * y0
    inverse = 1.0 / math.sqrt(math.sqrt(limit2 * limit2 + force2 * force2 + 1e-12))
    grip = limit * inverse
    force_x, force_y = grip * x0, grip * y0
    aligning = -g[_SAP * LANES + i] * alpha * grip
    rolling2 = rolling * rolling
    resistance = (
        rho
        * load
        * (g[_F1 * LANES + i] + g[_F2 * LANES + i] * rolling2)
        * rolling
        / math.sqrt(rolling2 + g[_V_EPS_SQUARED * LANES + i])
    )

    axle = drive_torque - rho * force_x
    g[(SLOPE + SPIN_LEFT + wheel) * LANES + i] = (axle - resistance) * inverse_inertia
    g[(SLOPE + KAPPA_LEFT + wheel) * LANES + i] = (
        -(slip_speed + speed * kappa) * g[_INVERSE_SIGMA_X * LANES + i]
    )
    g[(SLOPE + ALPHA_LEFT + wheel) * LANES + i] = (
        -(vy + speed * alpha) * g[_INVERSE_SIGMA_Y * LANES + i]
    )
    g[(LOAD + wheel) * LANES + i] = load
    g[(SHARE + wheel) * LANES + i] = force2 * inverse * inverse

    # On the body: force at the contact, aligning torque, axle torque, gyroscopic torque
    tx = force_x * fx + force_y * lx + load * ex
    ty = force_x * fy + force_y * ly + load * ey
    tz = force_x * fz + force_y * lz + load * ez
    momentum = inertia * spin
    gx, gy, gz = p + steering_rate * kx, q, r + steering_rate * kz
    mx = cy * tz - cz * ty + aligning * ex - axle * nx - momentum * (gy * nz - gz * ny)
    my = cz * tx - cx * tz + aligning * ey - axle * ny - momentum * (gz * nx - gx * nz)
    mz = cx * ty - cy * tx + aligning * ez - axle * nz - momentum * (gx * ny - gy * nx)
    return tx, ty, tz, mx, my, mz


@inlined
def _slopes(
    g: FloatArray,
    i: int,
    steering: tuple[float, float, float, float, float, float, float, float],
    speed_mode: float,
    demand: float,
    brake: float,
) -> None:
    """Write the slopes of all states of vehicle `i` of group `g` at its present state.

    Parameters
    ----------
    g : shape (GROUP_SIZE,)
    i : lane
    steering : axle direction (x, y, z) and steering rate [rad/s] of the left and the right wheel
    speed_mode, demand, brake : see `SPEED_MODE`
    """
    q0, q1, q2, q3 = (
        g[Q0 * LANES + i],
        g[Q1 * LANES + i],
        g[Q2 * LANES + i],
        g[Q3 * LANES + i],
    )
    u, v, w = g[U * LANES + i], g[V * LANES + i], g[W * LANES + i]
    p, q, r = g[P * LANES + i], g[Q * LANES + i], g[R * LANES + i]
    e = (
        2.0 * (q1 * q3 - q0 * q2),
        2.0 * (q2 * q3 + q0 * q1),
        1.0 - 2.0 * (q1 * q1 + q2 * q2),
    )

    # Motor and speed controller
    spin = g[SPIN_REAR * LANES + i]
    torque = g[TORQUE * LANES + i]
    direction = -1.0 if speed_mode * demand < 0.0 else 1.0  # reverse gear: everything mirrored
    error = demand / g[_RADIUS * LANES + i] - spin
    wanted = (
        speed_mode * (g[_KP * LANES + i] * error + g[_KI * LANES + i] * g[INTEGRATOR * LANES + i])
        + (1.0 - speed_mode) * demand
    )
    forward_spin = direction * spin
    available = min(
        g[_MOTOR_TORQUE * LANES + i],
        g[_MOTOR_POWER * LANES + i] / max(forward_spin, 0.5),
    )
    available = min(
        available, g[_MOTOR_SLOPE * LANES + i] * (g[_NO_LOAD_SPEED * LANES + i] - forward_spin)
    )
    granted = direction * max(-g[_REGENERATIVE * LANES + i], min(direction * wanted, available))
    g[EXCESS * LANES + i] = wanted - granted
    g[(SLOPE + TORQUE) * LANES + i] = (granted - torque) * g[_INVERSE_LAG * LANES + i]
    g[(SLOPE + INTEGRATOR) * LANES + i] = speed_mode * (
        error - g[_ANTI_WINDUP * LANES + i] * (wanted - granted)
    )
    drive_torque = torque - brake * g[_BRAKE_TORQUE * LANES + i] * spin / math.sqrt(
        spin * spin + g[_BRAKE_SMOOTHING_SQUARED * LANES + i]
    )

    # Wheels
    front_x, wheel_z = g[_FRONT_X * LANES + i], g[_WHEEL_Z * LANES + i]
    n1x, n1y, n1z, rate1, n2x, n2y, n2z, rate2 = steering
    iw, inverse_iw = g[_IW_FRONT * LANES + i], g[_INVERSE_IW_FRONT * LANES + i]
    position = (front_x, g[_LEFT_Y * LANES + i], wheel_z)
    ax, ay, az, al, am, an = _wheel(
        g, i, 0, e, (n1x, n1y, n1z), rate1, position, iw, inverse_iw, 0.0
    )
    position = (front_x, g[_RIGHT_Y * LANES + i], wheel_z)
    bx, by, bz, bl, bm, bn = _wheel(
        g, i, 1, e, (n2x, n2y, n2z), rate2, position, iw, inverse_iw, 0.0
    )
    iw, inverse_iw = g[_IW_REAR * LANES + i], g[_INVERSE_IW_REAR * LANES + i]
    position = (g[_REAR_X * LANES + i], g[_REAR_Y * LANES + i], wheel_z)
    cx, cy, cz, cl, cm, cn = _wheel(
        g, i, 2, e, (0.0, 1.0, 0.0), 0.0, position, iw, inverse_iw, drive_torque
    )

    # Body: Newton and Euler in the body frame
    ixx, iyy, izz = g[_IXX * LANES + i], g[_IYY * LANES + i], g[_IZZ * LANES + i]
    inverse_mass, gravity = g[_INVERSE_MASS * LANES + i], g[_GRAVITY * LANES + i]
    ex, ey, ez = e
    drag = g[_DRAG_PER_MASS * LANES + i] * u * abs(u)
    g[(SLOPE + U) * LANES + i] = (ax + bx + cx) * inverse_mass - gravity * ex - drag - q * w + r * v
    g[(SLOPE + V) * LANES + i] = (ay + by + cy) * inverse_mass - gravity * ey - r * u + p * w
    g[(SLOPE + W) * LANES + i] = (az + bz + cz) * inverse_mass - gravity * ez - p * v + q * u
    g[(SLOPE + P) * LANES + i] = (al + bl + cl - (izz - iyy) * q * r) * g[_INVERSE_IXX * LANES + i]
    g[(SLOPE + Q) * LANES + i] = (am + bm + cm - (ixx - izz) * r * p) * g[_INVERSE_IYY * LANES + i]
    g[(SLOPE + R) * LANES + i] = (an + bn + cn - (iyy - ixx) * p * q) * g[_INVERSE_IZZ * LANES + i]
    # Pose; the last term of the quaternion's rate keeps its length 1
    g[(SLOPE + X) * LANES + i] = (
        (1.0 - 2.0 * (q2 * q2 + q3 * q3)) * u
        + 2.0 * (q1 * q2 - q0 * q3) * v
        + 2.0 * (q1 * q3 + q0 * q2) * w
    )
    g[(SLOPE + Y) * LANES + i] = (
        2.0 * (q1 * q2 + q0 * q3) * u
        + (1.0 - 2.0 * (q1 * q1 + q3 * q3)) * v
        + 2.0 * (q2 * q3 - q0 * q1) * w
    )
    g[(SLOPE + Z) * LANES + i] = ex * u + ey * v + ez * w
    excess = 1.0 - (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    g[(SLOPE + Q0) * LANES + i] = 0.5 * (-q1 * p - q2 * q - q3 * r) + excess * q0
    g[(SLOPE + Q1) * LANES + i] = 0.5 * (q0 * p + q2 * r - q3 * q) + excess * q1
    g[(SLOPE + Q2) * LANES + i] = 0.5 * (q0 * q + q3 * p - q1 * r) + excess * q2
    g[(SLOPE + Q3) * LANES + i] = 0.5 * (q0 * r + q1 * q - q2 * p) + excess * q3
    g[TILT * LANES + i] = ez


@inlined
def _evaluate(
    g: FloatArray,
    lanes: int,
    table: FloatArray,
    row: int,
    drive: FloatArray,
) -> None:
    """Write the slopes of a whole group, with row `row` of the steering table."""
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
    speed_mode, demand, brake = drive[SPEED_MODE], drive[DEMAND], drive[BRAKE]
    for i in range(lanes):
        _slopes(g, i, steering, speed_mode, demand, brake)


@inlined
def _note(g: FloatArray, i: int, event: int, new: bool, value: float, tick: float) -> None:
    """Keep value, tick and place of an event of vehicle `i` if it is `new`."""
    g[event * LANES + i] = value if new else g[event * LANES + i]
    g[(event + 1) * LANES + i] = tick if new else g[(event + 1) * LANES + i]
    g[(event + 2) * LANES + i] = g[X * LANES + i] if new else g[(event + 2) * LANES + i]
    g[(event + 3) * LANES + i] = g[Y * LANES + i] if new else g[(event + 3) * LANES + i]


@inlined
def _watch(g: FloatArray, i: int, tick: float, steering_lag: float) -> None:
    """Note what happens to vehicle `i` at a tick; end its run if it has rolled over."""
    for wheel in range(3):
        load, event = g[(LOAD + wheel) * LANES + i], LEAST_LOAD_LEFT + 4 * wheel
        _note(g, i, event, load < g[event * LANES + i], load, tick)
    share = max(g[SHARE * LANES + i], g[(SHARE + 1) * LANES + i])
    share = max(share, g[(SHARE + 2) * LANES + i])
    _note(g, i, FRICTION, share > g[FRICTION * LANES + i], share, tick)
    excess = abs(g[EXCESS * LANES + i])
    first = g[MOTOR * LANES + i] == 0.0 and excess > 1e-9
    _note(g, i, MOTOR, first, excess, tick)
    first = g[STEERING * LANES + i] == 0.0 and steering_lag > 0.0
    _note(g, i, STEERING, first, steering_lag, tick)
    upright = g[TILT * LANES + i] >= g[_ROLLOVER_COSINE * LANES + i]
    _note(g, i, ROLLOVER, g[ALIVE * LANES + i] == 1.0 and not upright, 1.0, tick)
    g[ALIVE * LANES + i] = g[ALIVE * LANES + i] if upright else 0.0


@inlined
def _watch_group(g: FloatArray, lanes: int, tick: float, steering_lag: float) -> bool:
    """Note what happens to a group at a tick; return whether a vehicle has rolled over by now."""
    for i in range(lanes):
        _watch(g, i, tick, steering_lag)
    alive = 0.0
    for i in range(lanes):
        alive += g[ALIVE * LANES + i]
    return alive < lanes


@inlined
def _halt(g: FloatArray, lanes: int) -> None:
    """Bring the vehicles that have rolled over to rest."""
    for i in range(lanes):
        if g[ALIVE * LANES + i] == 0.0:
            for row in range(U, STATES):
                g[row * LANES + i] = 0.0
            for row in range(SLOPE, SLOPE + STATES):
                g[row * LANES + i] = 0.0


@compiled
def advance(
    groups: FloatArray,
    table: FloatArray,
    steering_lag: FloatArray,
    drive: FloatArray,
    substeps: int,
    first_tick: int,
    rows: NDArray[np.int64],
    out: FloatArray,
) -> None:
    """Advance groups of vehicles by t ticks under the same commands; 0 ticks evaluate the slopes.

    Parameters
    ----------
    groups : shape (b, GROUP_SIZE)
        From `pack`; advanced in place.
    table : shape (2 * substeps * t + 1, 8)
        From `tricycle_sim.vehicle.steering.run_servo`.
    steering_lag : shape (t + 1,)
        Set-point behind the command beyond what one tick of slew makes up for [rad], else 0.
    drive : shape (t + 1, 3)
        Columns `SPEED_MODE`, `DEMAND`, `BRAKE`; the last row is for the slopes at the end.
    substeps : int
        Runge-Kutta steps per tick.
    first_tick : int
        Number of the first tick in the events.
    rows : shape (m,)
        Rows of a group to record at every tick.
    out : shape (m, b * LANES, t + 1)
        Receives them.
    """
    # Known only at run time: a constant number of lanes is unrolled instead of vectorised.
    lanes = groups.shape[1] // ROWS
    ticks = drive.shape[0] - 1
    h = TICK / substeps
    for b in range(groups.shape[0]):
        g = groups[b]
        halted = False
        for k in range(ticks + 1):
            for s in range(substeps):
                row = 2 * (k * substeps + s)
                for stage in range(4):  # of the classical Runge-Kutta method
                    _evaluate(g, lanes, table, row + (stage + 1) // 2, drive[k])
                    if stage == 0:
                        if s == 0:
                            halted = _watch_group(g, lanes, float(first_tick + k), steering_lag[k])
                            if halted:
                                _halt(g, lanes)
                            for m in range(rows.shape[0]):
                                for i in range(LANES):  # unrolled: scattered stores are slow
                                    out[m, b * LANES + i, k] = g[rows[m] * LANES + i]
                        if k == ticks:
                            break
                        for j in range(STATES * LANES):
                            g[START * LANES + j] = g[j]
                            g[SUM * LANES + j] = g[j]
                    weight = h / 6.0 if stage == 0 or stage == 3 else h / 3.0
                    ahead = h if stage == 2 else h / 2.0
                    for j in range(STATES * LANES):
                        slope = g[SLOPE * LANES + j]
                        g[SUM * LANES + j] += weight * slope
                        g[j] = g[START * LANES + j] + ahead * slope
                if k == ticks:
                    break
                for j in range(STATES * LANES):
                    g[j] = g[SUM * LANES + j]
                if halted:  # stay where the step began
                    for i in range(lanes):
                        if g[ALIVE * LANES + i] == 0.0:
                            for j in range(STATES):
                                g[j * LANES + i] = g[(START + j) * LANES + i]


@compiled
def advance_tick(
    groups: FloatArray,
    servo: FloatArray,
    constants: FloatArray,
    steering_setpoint: float,
    drive: tuple[float, float, float],
    substeps: int,
) -> None:
    """Advance groups and their steering servo by one tick; callable from compiled code.

    Parameters
    ----------
    groups : shape (b, GROUP_SIZE)
        From `pack`; advanced in place. A single vehicle is element `row * LANES` of `groups[0]`.
    servo : shape (2,)
        Motor angle [rad] and rate [rad/s]; advanced in place.
    constants : shape (10,)
        `steering_constants(vehicle, TICK / (2 * substeps))`.
    steering_setpoint : float
        Motor angle [rad], slewed already; NaN: no servo pulse.
    drive : tuple
        `SPEED_MODE`, `DEMAND` (slewed already), `BRAKE`.
    substeps : int
        Runge-Kutta steps per tick: 1 equals the batch, 2 the live vehicle.
    """
    table = np.empty((2 * substeps + 1, 8))
    run_servo(
        servo, np.full(1, steering_setpoint), constants, 2 * substeps, table, np.empty((2, 2))
    )
    commands = np.empty((2, 3))
    commands[:] = np.array(drive)
    no_rows = np.empty(0, dtype=np.int64)
    advance(groups, table, np.zeros(2), commands, substeps, 0, no_rows, np.empty((0, LANES, 2)))


def pack(
    vehicle: Vehicle,
    parameters: FloatArray,
    pose: tuple[float, float, float],
    speed: FloatArray | None = None,
) -> FloatArray:
    """Put vehicles at the origin, heading +x, into groups.

    Parameters
    ----------
    vehicle : Vehicle
    parameters : shape (n, k)
        Values of `vehicle.unknown`, in its order.
    pose : tuple
        COM height [m], roll and pitch [rad], from `equilibrium(vehicle)`.
    speed : shape (n,), optional
        At which they roll straight on [m/s]; by default they are at rest.

    Returns
    -------
    shape (ceil(n / LANES), GROUP_SIZE)
        Lanes beyond n repeat the last vehicle.
    """
    n = len(parameters)
    groups = np.zeros((-(-n // LANES), ROWS, LANES))
    constants = _constants(vehicle)
    sample = np.minimum(np.arange(len(groups) * LANES), n - 1).reshape(-1, LANES)
    for name, column in zip(vehicle.unknown, np.asarray(parameters).T, strict=True):
        constants.update(_unknown_constants(name, column[sample]))
    for row, value in constants.items():
        groups[:, row] = value
    groups[:, ALIVE] = 1.0
    groups[:, [LEAST_LOAD_LEFT, LEAST_LOAD_RIGHT, LEAST_LOAD_REAR]] = np.inf
    z, roll, pitch = pose
    groups[:, Z] = z
    quaternion = attitude_quaternion(roll, pitch, 0.0)
    groups[:, Q0 : Q3 + 1] = np.reshape(quaternion, (4, 1))
    if speed is not None:
        groups[:, U] = speed[sample]
        groups[:, SPIN_LEFT : SPIN_REAR + 1] = (groups[:, U] / vehicle.tyre_radius)[:, np.newaxis]
    return groups.reshape(len(groups), GROUP_SIZE)


def equilibrium(vehicle: Vehicle) -> tuple[float, float, float]:
    """Return COM height [m], roll and pitch [rad] at rest on the vertical tyre springs.

    Camber thrust is set aside (0.01 N): it depends on the unknown parameters, the start must not.
    """
    group = np.zeros((ROWS, LANES))
    for row, value in _constants(vehicle).items():
        group[row] = value
    group[_C_GAMMA], group[ALIVE] = 0.0, 1.0
    straight = np.array([[0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
    pose = np.array([vehicle.com_height, 0.0, 0.0])
    variation = 1e-7 * np.eye(3)
    for _ in range(8):  # Newton's method, Jacobian by central differences in lanes 1 to 6
        poses = np.vstack([pose, pose + variation, pose - variation, pose])
        group[Z] = poses[:, 0]
        group[Q0 : Q3 + 1] = np.transpose([attitude_quaternion(r, p, 0.0) for _, r, p in poses])
        flat = group.reshape(1, GROUP_SIZE)
        advance(flat, straight, np.zeros(1), np.zeros((1, 3)), 1, 0, NO_ROWS, NO_OUTPUT)
        residual = flat.reshape(ROWS, LANES)[[SLOPE + W, SLOPE + P, SLOPE + Q]]
        jacobian = (residual[:, 1:4] - residual[:, 4:7]) / 2e-7
        pose = pose - np.linalg.solve(jacobian, residual[:, 0])
    return float(pose[0]), float(pose[1]), float(pose[2])


def _constants(vehicle: Vehicle) -> dict[int, float]:
    """Return the constants of the nominal vehicle by row."""
    reference_load = vehicle.mass * vehicle.gravity / 3.0
    constants = {
        _GRAVITY: vehicle.gravity,
        _INVERSE_MASS: 1.0 / vehicle.mass,
        _DRAG_PER_MASS: vehicle.air_drag / vehicle.mass,
        _IXX: vehicle.roll_inertia,
        _IYY: vehicle.pitch_inertia,
        _INVERSE_IXX: 1.0 / vehicle.roll_inertia,
        _INVERSE_IYY: 1.0 / vehicle.pitch_inertia,
        _FRONT_X: vehicle.com_to_front_axle,
        _REAR_X: -vehicle.com_to_rear_axle,
        _LEFT_Y: vehicle.left_wheel_y,
        _RIGHT_Y: vehicle.right_wheel_y,
        _REAR_Y: vehicle.rear_wheel_y,
        _WHEEL_Z: vehicle.tyre_radius - vehicle.com_height,
        _RADIUS: vehicle.tyre_radius,
        _IW_FRONT: vehicle.front_wheel_inertia,
        _IW_REAR: vehicle.rear_wheel_inertia,
        _INVERSE_IW_FRONT: 1.0 / vehicle.front_wheel_inertia,
        _INVERSE_IW_REAR: 1.0 / vehicle.rear_wheel_inertia,
        _KZ: vehicle.vertical_stiffness,
        _CZ: vehicle.vertical_damping,
        _MU: vehicle.friction_coefficient,
        _LS0: 1.0 - vehicle.load_sensitivity,
        _LS1: vehicle.load_sensitivity / reference_load,
        _C_KAPPA: vehicle.slip_stiffness,
        _INVERSE_SIGMA_X: 1.0 / vehicle.longitudinal_relaxation_length,
        _INVERSE_SIGMA_Y: 1.0 / vehicle.lateral_relaxation_length,
        _V0_SQUARED: vehicle.slip_speed_floor**2,
        _VL_SQUARED: vehicle.carcass_damping_speed**2,
        _DX: vehicle.longitudinal_carcass_damping,
        _DY: vehicle.lateral_carcass_damping,
        _V_EPS_SQUARED: vehicle.rolling_smoothing_speed**2,
        _KING_PIN_X: -math.sin(vehicle.caster_angle),
        _KING_PIN_Z: math.cos(vehicle.caster_angle),
        _MOTOR_TORQUE: vehicle.motor_torque,
        _MOTOR_POWER: vehicle.motor_power,
        _MOTOR_SLOPE: vehicle.motor_slope,
        _NO_LOAD_SPEED: vehicle.motor_no_load_speed,
        _REGENERATIVE: vehicle.regenerative_torque,
        _INVERSE_LAG: 1.0 / vehicle.motor_lag,
        _KP: vehicle.speed_gain_proportional,
        _KI: vehicle.speed_gain_integral,
        _ANTI_WINDUP: vehicle.speed_anti_windup,
        _BRAKE_TORQUE: vehicle.brake_torque,
        _BRAKE_SMOOTHING_SQUARED: vehicle.brake_smoothing_speed**2,
        _ROLLOVER_COSINE: math.cos(vehicle.rollover_angle),
    }
    for name in _UNKNOWN_ROWS:
        constants.update(_unknown_constants(name, getattr(vehicle, name)))
    return constants


_UNKNOWN_ROWS = {
    "cornering_stiffness": _C_ALPHA,
    "camber_stiffness": _C_GAMMA,
    "self_aligning_stiffness": _SAP,
    "yaw_inertia": _IZZ,
    "rolling_coefficient_1": _F1,
    "rolling_coefficient_2": _F2,
}


def _unknown_constants(name: str, value: Any) -> dict[int, Any]:
    """Return the rows that an unknown parameter sets; `value` a number or an array of them."""
    rows = {_UNKNOWN_ROWS[name]: value}
    if name == "yaw_inertia":
        rows[_INVERSE_IZZ] = 1.0 / value
    return rows
