"""Vehicles once more, from energies: the oracle of the tests and benchmarks.

Nothing here is shared with `tricycle_sim.vehicle.kernel` but the constants of the vehicle.
Lagrange's equations are derived symbolically in the world frame, in coordinates x, y, z, yaw,
pitch, roll and the spins of the wheels *relative* to the body; the velocity of a contact point is
the time derivative of a position, and generalised forces follow from virtual power. A wheel adds
its share of the kinetic energy and its forces, so that there may be any number of them at any
place. The laws of tyre, steering, drive and motor are written again in plain Python.
Trajectories are integrated by SciPy's DOP853.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace

import numpy as np
import sympy as sp
from scipy.integrate import solve_ivp


@dataclass(frozen=True, kw_only=True)
class Wheel:
    """A wheel as the equations need it.

    `tyre` has the constants of its tyre by name, and `law`: one of `TYRE_LAWS`; `torque_share` is
    its share of the motor's torque, `brake_torque` [N m] what its brake gives at full command.
    """

    position: tuple[float, float, float]  # of the centre, in the body frame [m]
    inertia: float  # about the axle [kg m^2]
    tyre: SimpleNamespace
    caster: float = 0.0  # of the king-pin [rad]
    torque_share: float = 0.0
    brake_torque: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Description:
    """A vehicle as the equations need it; `motor` and `steering` are laws with their constants.

    `motor(state, spin, set_speed, demand)` returns the rates of motor torque and integrator,
    `steering(angle)` the angles about the king-pins and their slopes by the motor angle, one per
    wheel.
    """

    mass: float
    gravity: float
    inertia: tuple[float, float, float]
    wheels: tuple[Wheel, ...]
    motor: Callable
    steering: Callable
    road: tuple[float, float] = (0.0, 0.0)  # grade and bank [rad]
    air_drag: float = 0.0
    brake_smoothing_speed: float = 0.5
    servo: tuple[float, float] = (25.0, 0.9)  # natural frequency [rad/s], damping ratio


# ------------------------------------------------------------------------------ kinematics


def _compiled(arguments, outputs):
    """Function of arrays of expressions; common ones are found through all of them.

    SymPy looks for common subexpressions in a flat list only.
    """
    arrays = [np.array(output, dtype=object) for output in outputs]
    flat = sp.lambdify(arguments, [e for a in arrays for e in a.flat], cse=True, modules="math")
    ends = np.cumsum([a.size for a in arrays])[:-1]

    def function(*given):
        parts = np.split(np.array(flat(*given)), ends)
        return [p.reshape(a.shape)[()] for p, a in zip(parts, arrays, strict=True)]

    return function


@cache
def _functions():
    """Derive and lambdify: mass matrix and bias of body and of a wheel; kinematics of a wheel."""
    t = sp.Symbol("t")
    names = "x y z yaw pitch roll phi"
    q = [sp.Function(name)(t) for name in names.split()]
    dq = [sp.diff(item, t) for item in q]
    ddq = [sp.diff(item, t) for item in dq]
    q_symbols = sp.symbols(names)
    dq_symbols = sp.symbols([f"d{item}" for item in names.split()])
    ddq_symbols = sp.symbols([f"dd{item}" for item in names.split()])

    # Steering: a rotation about the king-pin, a prescribed function of time
    delta = sp.Function("delta")(t)
    steering = sp.symbols("delta ddelta dddelta")
    derivatives = [delta, sp.diff(delta, t), sp.diff(delta, t, 2)]
    to_symbols = {
        **dict(zip(reversed(derivatives), reversed(steering), strict=True)),
        **dict(zip(ddq, ddq_symbols, strict=True)),
        **dict(zip(dq, dq_symbols, strict=True)),
        **dict(zip(q, q_symbols, strict=True)),
    }

    def plain(expression):
        """Replace functions of time by symbols."""
        return expression.xreplace(to_symbols)

    yaw, pitch, roll = q[3:6]
    turn_z, turn_y = sp.rot_ccw_axis3(yaw), sp.rot_ccw_axis2(pitch)
    rotation = turn_z * turn_y * sp.rot_ccw_axis1(roll)
    # angular velocity in the world: each angle's rate about its own axis
    omega = (
        sp.Matrix([0, 0, sp.diff(yaw, t)])
        + turn_z * sp.Matrix([0, sp.diff(pitch, t), 0])
        + turn_z * turn_y * sp.Matrix([sp.diff(roll, t), 0, 0])
    )
    # the same in the body frame; without simplification, which takes longer than all the rest
    back_roll, back_pitch = sp.rot_ccw_axis1(roll).T, turn_y.T
    omega_body = (
        sp.Matrix([sp.diff(roll, t), 0, 0])
        + back_roll * sp.Matrix([0, sp.diff(pitch, t), 0])
        + back_roll * back_pitch * sp.Matrix([0, 0, sp.diff(yaw, t)])
    )

    caster = sp.Symbol("caster")
    king_pin = sp.Matrix([-sp.sin(caster), 0, sp.cos(caster)])
    tilt = sp.rot_ccw_axis2(-caster)  # takes z to the king-pin
    axle_body = tilt * sp.rot_ccw_axis3(delta) * tilt.T * sp.Matrix([0, 1, 0])

    def left_side(kinetic, count):
        """Mass matrix and the rest of Lagrange's left side, of a kinetic energy."""
        sides = [
            plain(sp.diff(sp.diff(kinetic, rate), t) - sp.diff(kinetic, item))
            for item, rate in zip(q[:count], dq[:count], strict=True)
        ]
        matrix = sp.Matrix(sides).jacobian(ddq_symbols[:count])
        rest = [item.subs(dict.fromkeys(ddq_symbols, 0)) for item in sides]
        return matrix.tolist(), rest

    # Kinetic energy: body with all masses, and the polar spin of each wheel
    mass, inertia = sp.Symbol("mass"), sp.symbols("ixx iyy izz")
    velocity = sp.Matrix(dq[:3])
    of_body = mass * velocity.dot(velocity) / 2 + sum(
        moment * rate**2 / 2 for moment, rate in zip(inertia, omega_body, strict=True)
    )
    body_motion = _compiled((q_symbols[:6], dq_symbols[:6], mass, inertia), left_side(of_body, 6))
    polar = sp.Symbol("iw")
    of_wheel = polar * (omega_body.dot(axle_body) + dq[6]) ** 2 / 2
    wheel_motion = _compiled(
        (q_symbols, dq_symbols, steering[:2], polar, caster), left_side(of_wheel, 7)
    )

    # A wheel at r in the body, with its own steering angle
    position = sp.symbols("rx ry rz")
    center = sp.Matrix(q[:3]) + rotation * sp.Matrix(position)
    axle = rotation * axle_body
    carrier = omega + rotation * king_pin * sp.diff(delta, t)
    up = sp.Matrix([0, 0, 1])
    downhill = -(up - axle * axle.dot(up))  # steepest descent within the wheel's plane
    downhill = downhill / sp.sqrt(downhill.dot(downhill))
    radius = center[2] / -downhill[2]  # the contact has height 0
    contact = radius * downhill
    hub_velocity = center.diff(t) + carrier.cross(contact)
    forward = axle.cross(up)
    forward = forward / sp.sqrt(forward.dot(forward))
    leftward = up.cross(forward)
    lean = -sp.asin(axle[2])

    # powers of forces and couples per generalised velocity; the spin's place is the last
    relative = dq_symbols[6]
    material_velocity = hub_velocity + relative * axle.cross(contact)
    turning = carrier + relative * axle

    outputs = (
        plain(radius),
        plain(sp.Matrix([hub_velocity.dot(item) for item in (forward, leftward, up)])),
        plain(lean),
        plain(turning.subs(relative, 0).dot(axle)),  # the body's part of the absolute spin
        plain(sp.Matrix.hstack(forward, leftward, up)),
        plain(material_velocity).jacobian(dq_symbols),
        plain(turning).jacobian(dq_symbols),
        plain(axle),
        plain(axle.diff(t)),
    )
    arguments = (q_symbols[:6], dq_symbols, steering[:2], position, caster)
    outputs = tuple(item.tolist() if hasattr(item, "tolist") else item for item in outputs)
    wheel = _compiled(arguments, outputs)

    # body frame from Euler angles, to compare with the kernel
    body = _compiled(
        (q_symbols[3:6], dq_symbols[3:6], ddq_symbols[3:6]),
        [plain(item).tolist() for item in (rotation, omega_body, omega_body.diff(t))],
    )
    return body_motion, wheel_motion, wheel, body


# ---------------------------------------------------------------------------------- steering


@cache
def _steering_laws():
    """Angles about the king-pins by motor angle, and their slopes, differentiated symbolically."""
    angle = sp.Symbol("angle", real=True)

    def with_slopes(arguments, angles):
        outputs = (angles, [sp.diff(item, angle) for item in angles])
        return sp.lambdify((angle, *arguments), outputs, modules="numpy")

    limit, smoothing, straight, full = sp.symbols("limit smoothing straight full", real=True)
    ratio = straight + (full - straight) * sp.Abs(angle) / limit
    inner_left = (1 + angle / sp.sqrt(angle**2 + smoothing**2)) / 2
    left = angle * (inner_left + (1 - inner_left) * ratio)
    right = angle * ((1 - inner_left) + inner_left * ratio)
    # a wheel's path is square to the line from the turn's centre, which lies beside the axle that
    # is not steered, `turn` from the middle of the track
    ahead, aside = sp.symbols("ahead aside", real=True)  # of the wheel, from the unsteered axle
    turn = sp.Abs(ahead) / sp.tan(angle)
    abreast = ahead / (turn - aside)
    return SimpleNamespace(
        ratio=with_slopes((limit, smoothing, straight, full), [left, right]),
        ackermann=with_slopes((ahead, aside), [sp.atan(abreast)]),
    )


def ratio_steering(limit, smoothing, straight, full, wheels=3):
    """The paper's linkage: a ratio of outer to inner angle; the first two wheels are steered."""

    def steering(angle):
        both, slopes = _steering_laws().ratio(angle, limit, smoothing, straight, full)
        rest = [0.0] * (wheels - 2)
        return np.array([*both, *rest]), np.array([*slopes, *rest])

    return steering


def parallel_steering(gains):
    """Each wheel turns by its gain times the motor's angle; 0: not steered."""

    def steering(angle):
        return np.array(gains) * angle, np.array(gains, dtype=float)

    return steering


def ackermann_steering(places):
    """All wheels roll about one centre; the motor's angle is that of the middle of the axle.

    `places`: for each wheel, None if it is not steered, else how far ahead of the unsteered axle
    (negative: behind it) and to the left of the middle of its own axle it is [m].
    """

    def steering(angle):
        pairs = []
        for place in places:
            if place is None:
                pairs.append((0.0, 0.0))
                continue
            if abs(angle) < 1e-9:  # the turn's centre is infinitely far away
                pairs.append((math.copysign(angle, angle * place[0]), math.copysign(1.0, place[0])))
                continue
            (one,), (slope,) = _steering_laws().ackermann(angle, *place)
            pairs.append((float(one), float(slope)))
        angles, slopes = zip(*pairs, strict=True)
        return np.array(angles), np.array(slopes)

    return steering


# --------------------------------------------------------------------------------------- tyre


def linear(t, load, x, y):
    """Linear forces up to a friction circle; returns both forces and the aligning factor."""
    limit = t.friction_coefficient * load
    grip = limit / (limit**4 + (x**2 + y**2) ** 2 + 1e-12) ** 0.25
    return grip * x, grip * y, grip


def fiala(t, load, x, y):
    """Brush model with a parabolic pressure: the adhering share of the contact is 1 - theta."""
    limit, force = t.friction_coefficient * load, math.hypot(x, y)
    if force == 0.0 or limit == 0.0:
        return 0.0, 0.0, 1.0 if limit else 0.0
    adhering = max(0.0, 1.0 - force / (3.0 * limit))
    total = limit * (1.0 - adhering**3)
    return total * x / force, total * y / force, adhering**3


def softened(t, load, x, y):
    """Linear by the share that the saturation lacks to 1; above 1 a brush with less friction.

    By its rounding, the linear law's limiter is of second order instead of fourth.
    """
    weaker = max(1.0, t.tyre_saturation)
    brush = SimpleNamespace(friction_coefficient=t.friction_coefficient / weaker)
    share = t.tyre_saturation / weaker
    limit, force = t.friction_coefficient * load, math.hypot(x, y)
    factor = 1.0 / math.hypot(1.0, force / limit) if limit else 0.0
    bends = zip(linear(t, load, x, y), (factor * x, factor * y, factor), strict=True)
    straight_law = [s + t.tyre_rounding * (early - s) for s, early in bends]
    laws = zip(straight_law, fiala(brush, load, x, y), strict=True)
    return tuple((1.0 - share) * straight + share * curved for straight, curved in laws)


def magic_formula(t, load, x, y):
    """Magic Formula by the similarity method: slope and limit are those of `linear`."""
    relative = load / t.mean_load - 1.0
    friction = t.friction_coefficient * max(0.1, 1.0 - t.friction_load_slope * relative)
    limit = friction * load
    if limit == 0.0:
        return 0.0, 0.0, 0.0
    sx, sy = x / limit, y / limit
    s = math.hypot(sx, sy)
    if s < 1e-12:
        return x, y, 1.0
    px = _shape(s, t.shape_longitudinal, t.curvature_longitudinal)
    py = _shape(s, t.shape_lateral, t.curvature_lateral)
    p = (sx**2 * px + sy**2 * py) / s**2
    return limit * p * sx / s, limit * p * sy / s, py / s


def _shape(s, c, e):
    argument = s / c
    return math.sin(c * math.atan(argument - e * (argument - math.atan(argument))))


TYRE_LAWS = {
    "linear": linear,
    "fiala": fiala,
    "softened": softened,
    "magic_formula": magic_formula,
}


def _tyre(t, radius, lean, vx, vy, vz, spin, kappa, alpha):
    """Forces, torques and slip rates of a tyre; `t.mean_load` is the vehicle's weight per wheel."""
    load = max(
        0.0,
        t.vertical_stiffness * (t.tyre_radius - radius) / math.cos(lean) - t.vertical_damping * vz,
    )
    speed = math.hypot(vx, t.slip_speed_floor)
    fade = 1.0 / (1.0 + (vx / t.carcass_damping_speed) ** 2)
    slip_speed = vx - radius * spin
    stiffness = 1.0 + t.load_sensitivity * (load / t.mean_load - 1.0)
    by_speed = t.slip_by_speed if t.law is softened else 0.0
    stiffer = 1.0 + by_speed * (speed - 1.0)
    along = (1.0 - by_speed) * t.slip_stiffness + by_speed * t.cornering_stiffness
    x = along * kappa
    x -= t.longitudinal_carcass_damping * fade * slip_speed
    y = stiffness * (t.cornering_stiffness * alpha + t.camber_stiffness * lean)
    y -= t.lateral_carcass_damping * fade * vy
    x, y, aligning = t.law(t, load, x, y)
    surface = radius * spin
    coefficient = t.rolling_coefficient_1 + t.rolling_coefficient_2 * surface**2
    sign = surface / math.hypot(surface, t.rolling_smoothing_speed)
    # of the force: behind the contact as it rolls, in front of it backwards, in the middle at rest
    side = np.polyval([3, 0, -10, 0, 15, 0], np.clip(vx / t.slip_speed_floor, -1, 1)) / 8
    return SimpleNamespace(
        force=np.array([x, y, load]),
        aligning=-t.self_aligning_stiffness * alpha * aligning * side,
        resistance=radius * load * coefficient * sign,
        kappa=(-slip_speed - speed / stiffer * kappa) / t.longitudinal_relaxation_length,
        alpha=(-vy - speed / stiffer * alpha) / t.lateral_relaxation_length,
    )


# -------------------------------------------------------------------------------------- drive


def single_drive(count, wheel):
    """Shares of the torque: all on one wheel."""
    return [float(i == wheel) for i in range(count)]


def open_differential(count, wheels):
    """Shares of the torque: equal on the wheels of an axle."""
    return [1.0 / len(wheels) if i in wheels else 0.0 for i in range(count)]


def all_wheels(front, rear, front_share=0.5):
    """Shares of the torque: an open centre differential between two open axles."""
    count = len(front) + len(rear)
    return [
        front_share / len(front) if i in front else (1.0 - front_share) / len(rear)
        for i in range(count)
    ]


def hub_motor(v):
    """The drive PLC's speed loop, or a torque demand, on a hub motor; returns the law."""

    def motor(state, spin, set_speed, demand):
        sign = 1.0
        error = wanted = 0.0
        if set_speed is not None:
            sign = math.copysign(1.0, set_speed or spin)
            error = set_speed / v.tyre_radius - spin
            wanted = v.speed_gain_proportional * error + v.speed_gain_integral * state.integrator
        else:
            wanted = demand
            sign = math.copysign(1.0, spin or demand)
        available = min(
            v.motor_torque,
            v.motor_power / max(sign * spin, 0.5),
            v.motor_slope * (v.motor_no_load_speed - sign * spin),
        )
        given = sign * max(-v.regenerative_torque, min(sign * wanted, available))
        change = (given - state.torque) / v.motor_lag
        if set_speed is None:
            return change, 0.0
        return change, error + v.speed_anti_windup * (given - wanted)

    return motor


def uncontrolled_motor(v, wanted_at):
    """A motor that takes set-points for torques, by `wanted_at(set_speed)`; returns the law."""

    def motor(state, spin, set_speed, demand):
        wanted = demand if set_speed is None else wanted_at(set_speed)
        as_torque = SimpleNamespace(torque=state.torque, integrator=0.0)
        return hub_motor(v)(as_torque, spin, None, wanted)

    return motor


def direct_torque(v):
    """Torque in proportion to the set-point."""
    return uncontrolled_motor(v, lambda set_speed: v.setpoint_torque * set_speed)


def throttle_curve(v):
    """Torque by a table over the throttle, odd in the set-point."""
    torques = [0.0, *(getattr(v, f"throttle_torque_{percent}") for percent in (25, 50, 75, 100))]

    def wanted_at(set_speed):
        throttle = min(abs(set_speed) / v.throttle_full_setpoint, 1.0)
        return math.copysign(np.interp(throttle, [0.0, 0.25, 0.5, 0.75, 1.0], torques), set_speed)

    return uncontrolled_motor(v, wanted_at)


MOTORS = {
    "hub_motor": hub_motor,
    "direct_torque": direct_torque,
    "throttle_curve": throttle_curve,
}


# ------------------------------------------------------------------------------------ motion


def derivative(vehicle, state, steering, drive):
    """Right-hand side of the model.

    Parameters
    ----------
    vehicle : Description
        With n wheels.
    state : namespace
        q, dq (6 + n,): coordinates and rates; kappa, alpha (n,); torque, integrator.
    steering : angles (n,) [rad] and rates (n,) [rad/s] about the king-pins, 0 where there is none
    drive : speed set-point [m/s] or None, motor torque demand [N m], brake 0..1

    Returns
    -------
    namespace with ddq (6 + n,), kappa, alpha (n,), torque, integrator: their rates; loads (n,); and
    in the kernel's terms velocity (3,), rate (3,): rates of the body-frame velocities; spin (n,):
    of the absolute spins; and external: power of all applied forces [W]
    """
    body_motion, wheel_motion, wheel_kinematics, body = _functions()
    v = vehicle
    (angles, rates), (set_speed, demand, brake) = steering, drive
    n = len(v.wheels)
    result = SimpleNamespace(kappa=np.zeros(n), alpha=np.zeros(n), loads=np.zeros(n))
    matrix, bias, force = np.zeros((6 + n, 6 + n)), np.zeros(6 + n), np.zeros(6 + n)
    of_body, rest = body_motion(state.q[:6], state.dq[:6], v.mass, v.inertia)
    matrix[:6, :6] += of_body
    bias[:6] += rest
    east, north = (math.sin(angle) for angle in v.road)
    force[:3] -= v.mass * v.gravity * np.array([east, north, math.sqrt(1 - east**2 - north**2)])
    body_spins, axles, axle_rates = np.zeros(n), [], []
    for i, wheel in enumerate(v.wheels):
        own = [*range(6), 6 + i]
        turned = (angles[i], rates[i])
        of_wheel, rest = wheel_motion(
            state.q[own], state.dq[own], turned, wheel.inertia, wheel.caster
        )
        matrix[np.ix_(own, own)] += of_wheel
        bias[own] += rest
        radius, velocity, lean, body_spin, frame, linear, angular, axle, axle_rate = (
            wheel_kinematics(state.q[:6], state.dq[own], turned, wheel.position, wheel.caster)
        )
        velocity = np.ravel(velocity)
        # forward speed of the rolling surface: hub plus the body's own turning about the axle
        vx = velocity[0] + radius * body_spin
        spin = body_spin + state.dq[6 + i]
        slips = (state.kappa[i], state.alpha[i])
        tyre = _tyre(wheel.tyre, radius, lean, vx, velocity[1], velocity[2], spin, *slips)
        total = np.array(frame) @ tyre.force
        turning = np.array(angular).T
        power = np.array(linear).T @ total - turning @ (tyre.resistance * np.ravel(axle))
        # the aligning torque acts on the hub's carrier, the wheel turns freely beneath it
        power[:6] += turning[:6] @ np.array([0.0, 0.0, tyre.aligning])
        force[own] += power
        result.kappa[i], result.alpha[i], result.loads[i] = tyre.kappa, tyre.alpha, tyre.force[2]
        body_spins[i] = body_spin
        axles.append(np.ravel(axle))
        axle_rates.append(np.ravel(axle_rate))
    # air drag along the body's x axis
    rotation, omega, _ = body(state.q[3:6], state.dq[3:6], (0.0, 0.0, 0.0))
    rotation = np.array(rotation)
    u = rotation[:, 0] @ state.dq[:3]
    force[:3] -= rotation[:, 0] * v.air_drag * u * abs(u)
    # The motor turns a shaft between body and wheels whose speed is a mean of the relative spins
    # (that is what differentials do): its torque has the power of that speed, which the speed
    # loop sees too.
    shares = np.array([wheel.torque_share for wheel in v.wheels])
    spins = body_spins + state.dq[6:]
    force[6:] += shares * state.torque
    for i, wheel in enumerate(v.wheels):
        if wheel.brake_torque:
            stiffness = min(wheel.brake_torque / v.brake_smoothing_speed, 100.0 * wheel.inertia)
            wanted = force[6 + i] + stiffness * spins[i]
            limit = brake * wheel.brake_torque
            force[6 + i] -= np.clip(wanted, -limit, limit)
    result.torque, result.integrator = v.motor(state, shares @ state.dq[6:], set_speed, demand)

    result.ddq = np.linalg.solve(matrix, force - bias)
    result.external = force @ state.dq
    _, _, rate_change = body(state.q[3:6], state.dq[3:6], result.ddq[3:6])
    omega, result.rate = np.ravel(omega), np.ravel(rate_change)
    result.velocity = rotation.T @ result.ddq[:3] - np.cross(omega, rotation.T @ state.dq[:3])
    world_omega, world_change = rotation @ omega, rotation @ result.rate
    result.spin = np.array(
        [
            result.ddq[6 + i] + world_change @ axles[i] + world_omega @ axle_rates[i]
            for i in range(n)
        ]
    )
    return result


def kinetic_energy(vehicle, q, dq, steering):
    """Kinetic energy of body and wheels [J], half of dq M dq by the derived mass matrix."""
    body_motion, wheel_motion, _, _ = _functions()
    of_body, _ = body_motion(q[:6], dq[:6], vehicle.mass, vehicle.inertia)
    total = 0.5 * dq[:6] @ np.array(of_body) @ dq[:6]
    for i, wheel in enumerate(vehicle.wheels):
        own = [*range(6), 6 + i]
        turned = (steering[0][i], steering[1][i])
        matrix, _ = wheel_motion(q[own], dq[own], turned, wheel.inertia, wheel.caster)
        total += 0.5 * dq[own] @ np.array(matrix) @ dq[own]
    return float(total)


def simulate(vehicle, pose, steering_setpoints, speed_setpoints, tick, *, rtol=1e-10):
    """Integrate from rest with set-points held for a tick each; DOP853.

    Parameters
    ----------
    vehicle : Description
        With n wheels.
    pose : COM height [m], roll and pitch [rad] of the start
    steering_setpoints, speed_setpoints : shape (t,)

    Returns
    -------
    shape (t + 1, 16 + 4 n): q, dq, kappa, alpha, torque, integrator, motor angle and rate at the
    ticks
    """
    z, roll, pitch = pose
    n = len(vehicle.wheels)
    flat = np.zeros(16 + 4 * n)
    flat[[2, 4, 5]] = z, pitch, roll
    frequency, damping = vehicle.servo

    def slope(_, y, steering, speed):
        q, dq, kappa, alpha, (torque, integrator, angle, rate) = np.split(
            y, np.cumsum([6 + n, 6 + n, n, n])
        )
        state = SimpleNamespace(
            q=q, dq=dq, kappa=kappa, alpha=alpha, torque=torque, integrator=integrator
        )
        angles, slopes = vehicle.steering(angle)
        r = derivative(vehicle, state, (angles, slopes * rate), (speed, 0.0, 0.0))
        turn = frequency**2 * (steering - angle) - 2.0 * damping * frequency * rate
        rest = (r.torque, r.integrator, rate, turn)
        return np.concatenate([dq, r.ddq, r.kappa, r.alpha, rest])

    states = [flat]
    setpoints = np.column_stack([steering_setpoints, speed_setpoints])
    # runs of equal set-points are one integration
    starts = np.flatnonzero(np.r_[True, np.any(np.diff(setpoints, axis=0) != 0.0, axis=1)])
    for first, last in zip(starts, np.r_[starts[1:], len(setpoints)], strict=True):
        times = tick * np.arange(last - first + 1)
        solution = solve_ivp(
            slope,
            (0.0, times[-1]),
            states[-1],
            method="DOP853",
            t_eval=times[1:],
            rtol=rtol,
            atol=1e-12,
            args=tuple(setpoints[first]),
        )
        states.extend(solution.y.T)
    return np.array(states)


# ------------------------------------------------------------- from the file of a vehicle


def describe(vehicle):
    """The `Description` of a `Vehicle`."""
    listed = [dataclasses.asdict(wheel) for wheel in vehicle.wheels]
    return describe_file(listed, vehicle.parts, dict(vehicle.values))


def describe_file(listed, parts, values):
    """The `Description` of what a vehicle file says.

    Parameters
    ----------
    listed : sequence of mapping
        The wheels: name, axle, and what they are (steered, driven, braked).
    parts : mapping
        Laws by part, where they are not the default ones.
    values : mapping
        Constants by name, in SI units; of a wheel or an axle with its prefix.
    """
    v = SimpleNamespace(**{name: value for name, value in values.items() if "." not in name})

    def of(wheel, name, default=None):
        candidates = (f"{wheel['name']}.{name}", f"{wheel['axle']}.{name}", name)
        found = [values[candidate] for candidate in candidates if candidate in values]
        return found[0] if found else default

    names = {name.rpartition(".")[2] for name in values}
    count = len(listed)
    listed = [{"steered": False, "driven": False, "braked": False, **wheel} for wheel in listed]
    ahead = {"front": values.get("com_to_front_axle"), "rear": -values.get("com_to_rear_axle", 0.0)}
    driven = [i for i, wheel in enumerate(listed) if wheel["driven"]]
    braked = [i for i, wheel in enumerate(listed) if wheel["braked"]]
    front = [i for i, wheel in enumerate(listed) if wheel["axle"] == "front"]
    rear = [i for i, wheel in enumerate(listed) if wheel["axle"] == "rear"]
    shares = {
        "single": lambda: single_drive(count, driven[0]),
        "differential": lambda: open_differential(count, driven),
        "all": lambda: all_wheels(front, rear, values.get("drive_front_share", 0.5)),
    }[parts.get("drive", "single" if len(driven) == 1 else "differential")]()
    wheels = []
    for i, wheel in enumerate(listed):
        law = parts.get(f"{wheel['axle']}.tyre", parts.get("tyre", "linear"))
        tyre = SimpleNamespace(**{name: of(wheel, name) for name in names})
        tyre.law, tyre.mean_load = TYRE_LAWS[law], v.mass * v.gravity / count
        x = of(wheel, "x", ahead[wheel["axle"]])
        y = of(wheel, "y", values.get(f"{wheel['name']}_wheel_y"))
        wheels.append(
            Wheel(
                position=(x, y, tyre.tyre_radius - v.com_height),
                inertia=of(wheel, "wheel_inertia", values.get(f"{wheel['axle']}_wheel_inertia")),
                tyre=tyre,
                caster=of(wheel, "caster_angle", 0.0) if wheel["steered"] else 0.0,
                torque_share=shares[i],
                brake_torque=v.brake_torque / len(braked) if i in braked else 0.0,
            )
        )
    of_motor = SimpleNamespace(**{**values, "tyre_radius": wheels[driven[0]].tyre.tyre_radius})
    return Description(
        mass=v.mass,
        gravity=v.gravity,
        inertia=(v.roll_inertia, v.pitch_inertia, v.yaw_inertia),
        wheels=tuple(wheels),
        motor=MOTORS[parts.get("motor", "hub_motor")](of_motor),
        steering=_with_offset(
            _steering(listed, wheels, parts.get("steering", "ratio"), values),
            values.get("steering_offset", 0.0),
        ),
        road=(values.get("road_grade", 0.0), values.get("road_bank", 0.0)),
        air_drag=v.air_drag,
        brake_smoothing_speed=v.brake_smoothing_speed,
        servo=(v.servo_natural_frequency, v.servo_damping_ratio),
    )


def _with_offset(steering, offset):
    """The law of a steering whose motor stands at -offset when the wheels stand straight."""
    return lambda angle: steering(angle + offset)


def _steering(listed, wheels, law, values):
    steered = [i for i, wheel in enumerate(listed) if wheel["steered"]]
    behind = [-1.0 if listed[i]["axle"] == "rear" else 1.0 for i in range(len(listed))]
    if law == "parallel":
        gain = values.get("steering_gain", 1.0)
        return parallel_steering(
            [behind[i] * gain if i in steered else 0.0 for i in range(len(listed))]
        )
    if law == "ackermann":
        others = [wheel.position[0] for i, wheel in enumerate(wheels) if i not in steered]
        middle = np.mean([wheels[i].position[1] for i in steered])
        places = [
            (wheel.position[0] - np.mean(others), wheel.position[1] - middle)
            if i in steered
            else None
            for i, wheel in enumerate(wheels)
        ]
        return ackermann_steering(places)
    return ratio_steering(
        values["steering_limit"],
        values["steering_ratio_smoothing"],
        values["steering_ratio_straight"],
        values["steering_ratio_full"],
        len(listed),
    )
