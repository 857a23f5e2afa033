"""The tricycle once more, from energies: the oracle of the tests and benchmarks.

Nothing here is shared with `tricycle_sim.vehicle.kernel` but the constants of the vehicle.
Lagrange's equations are derived symbolically in the world frame, in coordinates x, y, z, yaw,
pitch, roll and the spins of the wheels *relative* to the body; the velocity of a contact point is
the time derivative of a position, and generalised forces follow from virtual power. The tyre law is
written again in plain Python. Trajectories are integrated by SciPy's DOP853.
"""

import math
from functools import cache
from types import SimpleNamespace

import numpy as np
import sympy as sp
from scipy.integrate import solve_ivp

WHEELS = ("left", "right", "rear")


@cache
def _functions():
    """Derive and lambdify: mass matrix and bias; kinematics of a wheel."""
    t = sp.Symbol("t")
    names = "x y z yaw pitch roll phi_left phi_right phi_rear"
    q = [sp.Function(name)(t) for name in names.split()]
    dq = [sp.diff(item, t) for item in q]
    ddq = [sp.diff(item, t) for item in dq]
    q_symbols = sp.symbols(names)
    dq_symbols = sp.symbols([f"d{item}" for item in names.split()])
    ddq_symbols = sp.symbols([f"dd{item}" for item in names.split()])

    to_symbols = {
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
    omega_body = sp.Matrix([sp.trigsimp(item) for item in sp.expand(rotation.T * omega)])

    # Steering: rotations about the king-pins, prescribed functions of time
    caster = sp.Symbol("caster")
    angles = [sp.Function("delta_left")(t), sp.Function("delta_right")(t), sp.Integer(0)]
    angle_symbols = sp.symbols("delta_left delta_right")
    rate_symbols = sp.symbols("ddelta_left ddelta_right")
    for angle, symbol, rate in zip(angles, angle_symbols, rate_symbols, strict=False):
        to_symbols[angle], to_symbols[sp.diff(angle, t)] = symbol, rate

    king_pin = sp.Matrix([-sp.sin(caster), 0, sp.cos(caster)])
    tilt = sp.rot_ccw_axis2(-caster)  # takes z to the king-pin
    axles = [tilt * sp.rot_ccw_axis3(angle) * tilt.T * sp.Matrix([0, 1, 0]) for angle in angles]

    # Kinetic energy: body with all masses, and the polar spin of the wheels
    mass, inertia = sp.Symbol("mass"), sp.symbols("ixx iyy izz")
    wheel_inertia = sp.symbols("iw_left iw_right iw_rear")
    velocity = sp.Matrix(dq[:3])
    kinetic = mass * velocity.dot(velocity) / 2 + sum(
        moment * rate**2 / 2 for moment, rate in zip(inertia, omega_body, strict=True)
    )
    for moment, axle, relative in zip(wheel_inertia, axles, dq[6:], strict=True):
        kinetic += moment * (omega_body.dot(axle) + relative) ** 2 / 2
    left_side = [
        sp.diff(sp.diff(kinetic, rate), t) - sp.diff(kinetic, item)
        for item, rate in zip(q, dq, strict=True)
    ]
    left_side = sp.Matrix([plain(item) for item in left_side])
    mass_matrix = left_side.jacobian(ddq_symbols)
    bias = left_side.subs(dict.fromkeys(ddq_symbols, 0))
    constants = (mass, *inertia, *wheel_inertia, caster)
    arguments = (q_symbols, dq_symbols, angle_symbols, rate_symbols, constants)
    motion = sp.lambdify(arguments, (mass_matrix.tolist(), list(bias)), cse=True, modules="math")

    # One wheel, at r in the body, with its own steering angle
    delta = sp.Function("delta")(t)
    delta_symbol, rate_symbol = sp.symbols("delta ddelta")
    to_symbols[delta], to_symbols[sp.diff(delta, t)] = delta_symbol, rate_symbol
    position = sp.symbols("rx ry rz")
    center = sp.Matrix(q[:3]) + rotation * sp.Matrix(position)
    axle = rotation * tilt * sp.rot_ccw_axis3(delta) * tilt.T * sp.Matrix([0, 1, 0])
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
    relative = sp.Symbol("relative")
    material_velocity = hub_velocity + relative * axle.cross(contact)
    turning = carrier + relative * axle

    speeds = (*dq_symbols[:6], relative)
    outputs = (
        plain(radius),
        plain(sp.Matrix([hub_velocity.dot(item) for item in (forward, leftward, up)])),
        plain(lean),
        plain(turning.subs(relative, 0).dot(axle)),  # the body's part of the absolute spin
        plain(sp.Matrix.hstack(forward, leftward, up)),
        plain(material_velocity).jacobian(speeds),
        plain(turning).jacobian(speeds),
        plain(axle),
        plain(axle.diff(t)),
    )
    arguments = (*(q_symbols[:6], dq_symbols[:6], delta_symbol, rate_symbol, position, caster),)
    outputs = tuple(item.tolist() if hasattr(item, "tolist") else item for item in outputs)
    wheel = sp.lambdify(arguments, outputs, cse=True, modules="math")

    # body frame from Euler angles, to compare with the kernel
    body = sp.lambdify(
        (q_symbols[3:6], dq_symbols[3:6], ddq_symbols[3:6]),
        tuple(plain(item).tolist() for item in (rotation, omega_body, omega_body.diff(t))),
        cse=True,
        modules="math",
    )
    return motion, wheel, body


@cache
def _linkage():
    """Angles about the king-pins and their slopes by motor angle, differentiated symbolically."""
    angle, limit, smoothing = sp.symbols("angle limit smoothing", real=True)
    straight, full = sp.symbols("straight full")
    ratio = straight + (full - straight) * sp.Abs(angle) / limit
    inner_left = (1 + angle / sp.sqrt(angle**2 + smoothing**2)) / 2
    both = [
        angle * (inner_left + (1 - inner_left) * ratio),
        angle * ((1 - inner_left) + inner_left * ratio),
    ]
    outputs = (both, [sp.diff(item, angle) for item in both])
    return sp.lambdify((angle, straight, full, limit, smoothing), outputs, modules="numpy")


def _linkage_at(vehicle, motor_angle):
    return _linkage()(
        motor_angle,
        vehicle.steering_ratio_straight,
        vehicle.steering_ratio_full,
        vehicle.steering_limit,
        vehicle.steering_ratio_smoothing,
    )


def linkage(vehicle, motor_angle):
    """Angles about the king-pins, left and right [rad]."""
    return np.array(_linkage_at(vehicle, motor_angle)[0])


def linkage_slopes(vehicle, motor_angle):
    """Their derivatives by the motor angle."""
    return np.array(_linkage_at(vehicle, motor_angle)[1])


def derivative(vehicle, state, steering, drive):
    """Right-hand side of the model.

    Parameters
    ----------
    vehicle : Vehicle
    state : namespace
        q, dq (9,): coordinates and rates; kappa, alpha (3,); torque, integrator.
    steering : angles (2,) [rad] and rates (2,) [rad/s] about the king-pins
    drive : speed set-point [m/s] or None, motor torque demand [N m], brake 0..1

    Returns
    -------
    namespace with ddq (9,), kappa, alpha (3,), torque, integrator: their rates; loads (3,); and in
    the kernel's terms velocity (3,), rate (3,): rates of the body-frame velocities; spin (3,): of
    the absolute spins
    """
    motion, wheel_kinematics, body = _functions()
    v = vehicle
    (angles, rates), (set_speed, demand, brake) = steering, drive
    inertias = (v.front_wheel_inertia, v.front_wheel_inertia, v.rear_wheel_inertia)
    constants = (v.mass, v.roll_inertia, v.pitch_inertia, v.yaw_inertia, *inertias, v.caster_angle)
    mass_matrix, bias = motion(state.q, state.dq, angles, rates, constants)
    force = np.zeros(9)
    east, north = math.sin(v.road_grade), math.sin(v.road_bank)
    force[:3] -= v.mass * v.gravity * np.array([east, north, math.sqrt(1 - east**2 - north**2)])
    height = v.tyre_radius - v.com_height
    positions = (
        (v.com_to_front_axle, v.left_wheel_y, height),
        (v.com_to_front_axle, v.right_wheel_y, height),
        (-v.com_to_rear_axle, v.rear_wheel_y, height),
    )
    result = SimpleNamespace(kappa=np.zeros(3), alpha=np.zeros(3), loads=np.zeros(3))
    body_spins, axles, axle_rates = np.zeros(3), [], []
    for i, position in enumerate(positions):
        delta, rate = (angles[i], rates[i]) if i < 2 else (0.0, 0.0)
        radius, velocity, lean, body_spin, frame, linear, angular, axle, axle_rate = (
            wheel_kinematics(state.q[:6], state.dq[:6], delta, rate, position, v.caster_angle)
        )
        velocity = np.ravel(velocity)
        spin = body_spin + state.dq[6 + i]
        # forward speed of the rolling surface: hub plus the body's own turning about the axle
        vx = velocity[0] + radius * body_spin
        tyre = _tyre(v, radius, lean, vx, velocity[1], velocity[2], spin, state, i)
        total = np.array(frame) @ tyre.force
        turning = np.array(angular).T
        power = np.array(linear).T @ total - turning @ (tyre.resistance * np.ravel(axle))
        # the aligning torque acts on the hub's carrier, the wheel turns freely beneath it
        power[:6] += turning[:6] @ np.array([0.0, 0.0, tyre.aligning])
        force[:6] += power[:6]
        force[6 + i] += power[6]
        result.kappa[i], result.alpha[i], result.loads[i] = tyre.kappa, tyre.alpha, tyre.force[2]
        body_spins[i] = body_spin
        axles.append(np.ravel(axle))
        axle_rates.append(np.ravel(axle_rate))
    # air drag along the body's x axis
    rotation, omega, _ = body(state.q[3:6], state.dq[3:6], (0.0, 0.0, 0.0))
    rotation = np.array(rotation)
    u = rotation[:, 0] @ state.dq[:3]
    force[:3] -= rotation[:, 0] * v.air_drag * u * abs(u)
    # drive torque acts between body and wheel: on the relative spin alone
    rear_spin = body_spins[2] + state.dq[8]
    force[8] += state.torque
    stiffness = min(v.brake_torque / v.brake_smoothing_speed, 100.0 * v.rear_wheel_inertia)
    wanted = force[8] + stiffness * rear_spin
    force[8] -= np.clip(wanted, -brake * v.brake_torque, brake * v.brake_torque)
    result.torque, result.integrator = _motor(v, state, rear_spin, set_speed, demand)

    result.ddq = np.linalg.solve(np.array(mass_matrix), force - np.ravel(bias))
    _, _, rate_change = body(state.q[3:6], state.dq[3:6], result.ddq[3:6])
    omega, result.rate = np.ravel(omega), np.ravel(rate_change)
    result.velocity = rotation.T @ result.ddq[:3] - np.cross(omega, rotation.T @ state.dq[:3])
    world_omega, world_change = rotation @ omega, rotation @ result.rate
    result.spin = np.array(
        [
            result.ddq[6 + i] + world_change @ axles[i] + world_omega @ axle_rates[i]
            for i in range(3)
        ]
    )
    return result


def _tyre(v, radius, lean, vx, vy, vz, spin, state, i):
    load = max(
        0.0,
        v.vertical_stiffness * (v.tyre_radius - radius) / math.cos(lean) - v.vertical_damping * vz,
    )
    kappa, alpha = state.kappa[i], state.alpha[i]
    speed = math.hypot(vx, v.slip_speed_floor)
    fade = 1.0 / (1.0 + (vx / v.carcass_damping_speed) ** 2)
    slip_speed = vx - radius * spin
    per_load = 3.0 * load / (v.mass * v.gravity)
    stiffness = 1.0 + v.load_sensitivity * (per_load - 1.0)
    x = v.slip_stiffness * kappa - v.longitudinal_carcass_damping * fade * slip_speed
    y = stiffness * (v.cornering_stiffness * alpha + v.camber_stiffness * lean)
    y -= v.lateral_carcass_damping * fade * vy
    limit = v.friction_coefficient * load
    grip = limit / (limit**4 + (x**2 + y**2) ** 2 + 1e-12) ** 0.25
    surface = radius * spin
    coefficient = v.rolling_coefficient_1 + v.rolling_coefficient_2 * surface**2
    return SimpleNamespace(
        force=np.array([grip * x, grip * y, load]),
        aligning=-v.self_aligning_stiffness * alpha * grip,
        resistance=radius
        * load
        * coefficient
        * surface
        / math.hypot(surface, v.rolling_smoothing_speed),
        kappa=(-slip_speed - speed * kappa) / v.longitudinal_relaxation_length,
        alpha=(-vy - speed * alpha) / v.lateral_relaxation_length,
    )


def _motor(v, state, spin, set_speed, demand):
    """Rates of motor torque and integrator."""
    sign = 1.0
    error = wanted = 0.0
    if set_speed is not None:
        sign = -1.0 if set_speed < 0.0 else 1.0
        error = set_speed / v.tyre_radius - spin
        wanted = v.speed_gain_proportional * error + v.speed_gain_integral * state.integrator
    else:
        wanted = demand
        sign = -1.0 if demand < 0.0 and spin <= 0.0 else 1.0
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


def simulate(vehicle, pose, steering_setpoints, speed_setpoints, tick, *, rtol=1e-10):
    """Integrate from rest with set-points held for a tick each; DOP853.

    Parameters
    ----------
    pose : COM height [m], roll and pitch [rad] of the start
    steering_setpoints, speed_setpoints : shape (t,)

    Returns
    -------
    shape (t + 1, 28): q, dq, kappa, alpha, torque, integrator, motor angle and rate at the ticks
    """
    z, roll, pitch = pose
    flat = np.zeros(28)
    flat[[2, 4, 5]] = z, pitch, roll
    frequency, damping = vehicle.servo_natural_frequency, vehicle.servo_damping_ratio

    def slope(_, y, steering, speed):
        state = SimpleNamespace(
            q=y[:9], dq=y[9:18], kappa=y[18:21], alpha=y[21:24], torque=y[24], integrator=y[25]
        )
        angle, rate = y[26], y[27]
        angles = linkage(vehicle, angle)
        rates = linkage_slopes(vehicle, angle) * rate
        r = derivative(vehicle, state, (angles, rates), (speed, 0.0, 0.0))
        turn = frequency**2 * (steering - angle) - 2.0 * damping * frequency * rate
        rest = (r.torque, r.integrator, rate, turn)
        return np.concatenate([y[9:18], r.ddq, r.kappa, r.alpha, rest])

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
