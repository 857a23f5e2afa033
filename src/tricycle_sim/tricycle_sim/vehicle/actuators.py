"""The actuators: steering servo, hub motor with its speed controller, friction brake.

`SERVOS`, `MOTORS` and `BRAKES` list the laws; each is one function, compiled into the equations,
and the constants that it reads. A vehicle file chooses one under `parts: {motor: NAME}`.
`DRIVES` says which wheels get which share of the torque.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from tricycle_core.quantities import FloatArray
from tricycle_core.supplies import (
    DRIVE_SUPPLY_THRESHOLDS,
    STEER_SUPPLY_THRESHOLDS,
    SUPPLY_LIMIT,
)
from tricycle_sim.vehicle.laws import Constant, Law, between, inlined, not_negative, positive
from tricycle_sim.vehicle.layout import LANES, Formulas, StepFormulas, numbered


def _transition(v: Any, step: float) -> tuple[float, float, float, float]:
    """Transition over a step of theta'' = omega^2 (command - theta) - 2 zeta omega theta'."""
    frequency = v.servo_natural_frequency
    decay_rate = v.servo_damping_ratio * frequency
    square = decay_rate**2 - frequency**2
    root = math.sqrt(abs(square))
    if square > 0.0:  # two exponentials, of which the slower one is factored out: none overflows
        slower = math.exp(-(frequency**2) / (decay_rate + root) * step)
        gap = -math.expm1(-2.0 * root * step)
        even, odd = slower * (1.0 - 0.5 * gap), 0.5 * slower * gap / root
    else:
        decay = math.exp(-decay_rate * step)
        even = decay * math.cos(root * step)
        odd = decay * (math.sin(root * step) / root if root else step)
    return even + decay_rate * odd, odd, -(frequency**2) * odd, even - decay_rate * odd


SUPPLY: tuple[Constant, ...] = (
    not_negative("motor_copper_loss", "W/(N m)^2", setting=True),  # per torque squared
    positive("battery_voltage", "V", setting=True),
    # the boards' supplies, outside of which they do not arm; 0: not checked
    *(
        between(name, "V", 0.0, SUPPLY_LIMIT, default=default, setting=True)
        for name, default in (
            ("drive_supply_low", DRIVE_SUPPLY_THRESHOLDS[0]),
            ("drive_supply_high", DRIVE_SUPPLY_THRESHOLDS[1]),
            ("steer_supply_low", STEER_SUPPLY_THRESHOLDS[0]),
            ("steer_supply_high", STEER_SUPPLY_THRESHOLDS[1]),
        )
    ),
)
"""Constants of battery and boards, which every motor has."""
DRIVE_SLEW = (positive("acceleration", "m/s^2", setting=True),)
STEERING_SLEW = (positive("steering_slew", "rad/s", setting=True),)
"""Slew of the set-points on the boards: of the speed, of the steering motor's angle."""

SECOND_ORDER: StepFormulas = {
    "angle_by_angle": lambda v, step: _transition(v, step)[0],
    "angle_by_rate": lambda v, step: _transition(v, step)[1],
    "rate_by_angle": lambda v, step: _transition(v, step)[2],
    "rate_by_rate": lambda v, step: _transition(v, step)[3],
    "limit": lambda v, _: v.steering_limit,
}
_S = numbered(SECOND_ORDER)


def _dead_steps(v: Any, step: float) -> int:
    """Return the whole steps of the dead time; rounding does not make it one fewer."""
    steps: int = math.floor(v.servo_delay / step + 1e-9)
    return steps


def _after_change(v: Any, step: float) -> tuple[float, float, float, float]:
    """Transition over the rest of a step, after the delayed set-point has changed in it."""
    rest = v.servo_delay - _dead_steps(v, step) * step
    return _transition(v, step - max(rest, 0.0))


GEARED: StepFormulas = {
    **SECOND_ORDER,
    "angle_after_change": lambda v, step: _after_change(v, step)[0],
    "rate_after_change": lambda v, step: _after_change(v, step)[2],
    "dead_steps": _dead_steps,
    "play": lambda v, _: 0.5 * v.servo_backlash,  # to either side
}
_D = numbered(GEARED)

LONGEST_DELAY = 0.5
"""Longest delay of a servo [s]; set-points of this time are kept."""

_LIMITS: Formulas = {
    "torque": lambda v: v.motor_torque,
    "power": lambda v: v.motor_power,
    "slope": lambda v: v.motor_slope,
    "no_load_speed": lambda v: v.motor_no_load_speed,
    "regenerative": lambda v: v.regenerative_torque,
    "inverse_lag": lambda v: 1.0 / v.motor_lag,
}
HUB_MOTOR: Formulas = {
    **_LIMITS,
    "proportional": lambda v: v.speed_gain_proportional,
    "integral": lambda v: v.speed_gain_integral,
    "anti_windup": lambda v: v.speed_anti_windup,
    "radius": lambda v: v.tyre_radius / v.speed_scale,
}
_M = numbered(HUB_MOTOR, step=LANES)
DIRECT_TORQUE: Formulas = {**_LIMITS, "gain": lambda v: v.setpoint_torque}
_T = numbered(DIRECT_TORQUE, step=LANES)


def _throttle_torque(v: Any, quarter: int) -> Any:
    """Return the torque at so many quarters of the throttle."""
    return getattr(v, f"throttle_torque_{25 * quarter}") if quarter else 0.0


def _rise(quarter: int) -> Callable[[Any], Any]:
    """Return what gives the rise of the torque over a quarter of the throttle, per m/s."""
    return lambda v: (
        (_throttle_torque(v, quarter) - _throttle_torque(v, quarter - 1))
        * 4.0
        / v.throttle_full_setpoint
    )


THROTTLE_CURVE: Formulas = {
    **_LIMITS,
    "quarter": lambda v: 0.25 * v.throttle_full_setpoint,
    **{f"rise_{quarter}": _rise(quarter) for quarter in (1, 2, 3, 4)},
}
_K = numbered(THROTTLE_CURVE, step=LANES)

BRAKE_RATE = 100.0
"""Fastest rate at which the brake takes the last of a wheel's spin [1/s]."""
FRICTION_BRAKE: Formulas = {
    "torque": lambda w: w.brake_torque / w.braked_wheels,
    # no stiffer than the integration's steps can follow
    "stiffness": lambda w: np.minimum(
        w.brake_torque / w.braked_wheels / w.brake_smoothing_speed, BRAKE_RATE * w.wheel_inertia
    ),
}
_B = numbered(FRICTION_BRAKE, step=LANES)


@inlined
def second_order(
    constants: FloatArray,
    c: int,
    angle: float,
    rate: float,
    earlier: float,  # noqa: ARG001 (of every servo)
    setpoint: float,
) -> tuple[float, float]:
    """Return angle [rad] and rate [rad/s] of a position loop after a step, exactly.

    Parameters
    ----------
    constants : ndarray of float
        Constants of the steering for the length of the step; see `steering.BLOCK`.
    c : int
        Index in `constants` at which the servo's begin.
    angle, rate : float
        Angle and rate at the start of the step [rad, rad/s].
    earlier : float
        Set-point before [rad]; a servo with dead time has it for the first part of the step.
    setpoint : float
        Held during the step [rad].
    """
    error = angle - setpoint
    angle = (
        setpoint + constants[c + _S.angle_by_angle] * error + constants[c + _S.angle_by_rate] * rate
    )
    rate = constants[c + _S.rate_by_angle] * error + constants[c + _S.rate_by_rate] * rate
    limit = constants[c + _S.limit]
    if abs(angle) > limit:  # at the stop
        angle = math.copysign(limit, angle)
        rate = 0.0
    return angle, rate


@inlined
def geared(
    constants: FloatArray, c: int, angle: float, rate: float, earlier: float, setpoint: float
) -> tuple[float, float]:
    """Return angle [rad] and rate [rad/s] of a position loop behind a dead time, exactly.

    The dead time need not be a number of whole steps: the loop is linear, so the set-point that
    changes within the step adds what its change does in the rest of it. A delay line costs less
    than a Padé approximation of its order, and is exact.

    Parameters
    ----------
    constants : ndarray of float
        Constants of the steering for the length of the step; see `steering.BLOCK`.
    c : int
        Index in `constants` at which the servo's begin.
    angle, rate : float
        Angle and rate at the start of the step [rad, rad/s].
    earlier, setpoint : float
        Set-points in the first and in the rest of the step [rad].
    """
    error, change = angle - earlier, earlier - setpoint
    angle = (
        setpoint
        + constants[c + _D.angle_by_angle] * error
        + constants[c + _D.angle_by_rate] * rate
        + constants[c + _D.angle_after_change] * change
    )
    rate = (
        constants[c + _D.rate_by_angle] * error
        + constants[c + _D.rate_by_rate] * rate
        + constants[c + _D.rate_after_change] * change
    )
    limit = constants[c + _D.limit]
    if abs(angle) > limit:  # at the stop
        angle = math.copysign(limit, angle)
        rate = 0.0
    return angle, rate


@inlined
def behind_play(
    constants: FloatArray, c: int, output: float, angle: float, rate: float
) -> tuple[float, float]:
    """Return angle [rad] and rate [rad/s] behind a gear with play; it moves only when pushed.

    Parameters
    ----------
    constants : ndarray of float
        Constants of the steering; see `steering.BLOCK`.
    c : int
        Index in `constants` at which those of a `geared` servo begin.
    output : float
        Present angle behind the play [rad].
    angle, rate : float
        Angle and rate of the motor [rad, rad/s].
    """
    play = constants[c + _D.play]
    low, high = angle - play, angle + play
    pushed = output <= low if rate > 0.0 else output >= high
    output = min(max(output, low), high)
    return output, rate if pushed else 0.0


@inlined
def hub_motor(
    g: FloatArray,
    c: int,
    spin: float,
    torque: float,
    integrator: float,
    speed_mode: float,
    demand: float,
) -> tuple[float, float, float]:
    """Return the slopes of torque and integrator of a motor limited by power, speed and current.

    Parameters
    ----------
    g : ndarray of float, shape (rows * LANES,)
        Group of vehicles, as in `layout`.
    c : int
        Index in `g` at which the motor's constants of the vehicle begin.
    spin : float
        Spin of the driven wheel [rad/s].
    torque : float
        Torque of the motor [N m].
    integrator : float
        State of the speed controller's integrator [rad].
    speed_mode : float
        1: `demand` is a speed of the wheel's circumference [m/s]; 0: a torque [N m].
    demand : float
        Set-point of the motor: a speed or a torque, see `speed_mode`.

    Returns
    -------
    torque_slope, integrator_slope : float
        Slopes of the two states [N m/s, rad/s].
    excess : float
        Torque wanted beyond what the motor can give [N m].
    """
    # backwards everything is mirrored: by the sign of the set-point; without one, by the spin
    direction = _direction(
        speed_mode * demand + (1.0 - speed_mode) * spin,
        speed_mode * spin + (1.0 - speed_mode) * demand,
    )
    error = demand / g[c + _M.radius] - spin
    wanted = (
        speed_mode * (g[c + _M.proportional] * error + g[c + _M.integral] * integrator)
        + (1.0 - speed_mode) * demand
    )
    granted = _granted(g, c, spin, direction, wanted)
    excess = wanted - granted
    return (
        (granted - torque) * g[c + _M.inverse_lag],
        speed_mode * (error - g[c + _M.anti_windup] * excess),
        excess,
    )


@inlined
def _direction(first: float, second: float) -> float:
    """Return the sign of the first number, where that is 0 of the second, as -1 or 1."""
    # one comparison: with several the lanes are not evaluated at once
    return -1.0 if first + 1e-30 * second < 0.0 else 1.0


@inlined
def _granted(g: FloatArray, c: int, spin: float, direction: float, wanted: float) -> float:
    """Return the torque that current, power and no-load speed leave of a wanted one [N m]."""
    forward_spin = direction * spin
    available = min(g[c + _M.torque], g[c + _M.power] / max(forward_spin, 0.5))
    available = min(available, g[c + _M.slope] * (g[c + _M.no_load_speed] - forward_spin))
    granted: float = direction * max(-g[c + _M.regenerative], min(direction * wanted, available))
    return granted


@inlined
def _without_controller(
    g: FloatArray, c: int, spin: float, torque: float, wanted: float
) -> tuple[float, float, float]:
    """Return what a motor's law does, for a wanted torque that no controller corrects."""
    direction = _direction(spin, wanted)
    granted = _granted(g, c, spin, direction, wanted)
    return (granted - torque) * g[c + _M.inverse_lag], 0.0, wanted - granted


@inlined
def direct_torque(
    g: FloatArray,
    c: int,
    spin: float,
    torque: float,
    integrator: float,  # noqa: ARG001 (of every motor)
    speed_mode: float,
    demand: float,
) -> tuple[float, float, float]:
    """Return the slopes of torque and integrator of a motor whose set-point is a torque.

    Parameters
    ----------
    g : ndarray of float, shape (rows * LANES,)
        Group of vehicles, as in `layout`.
    c : int
        Index in `g` at which the law's constants of the vehicle begin.
    spin, torque, integrator, speed_mode : float
        As of `hub_motor`.
    demand : float
        A torque [N m]; with speed mode a set-point [m/s] that the motor takes for a torque.

    Returns
    -------
    torque_slope, integrator_slope, excess : float
        As of `hub_motor`; there is no integrator.
    """
    wanted = (speed_mode * g[c + _T.gain] + (1.0 - speed_mode)) * demand
    return _without_controller(g, c, spin, torque, wanted)


@inlined
def throttle_curve(
    g: FloatArray,
    c: int,
    spin: float,
    torque: float,
    integrator: float,  # noqa: ARG001 (of every motor)
    speed_mode: float,
    demand: float,
) -> tuple[float, float, float]:
    """Return the slopes of torque and integrator of a throttle with a table of torques.

    Parameters
    ----------
    g : ndarray of float, shape (rows * LANES,)
        Group of vehicles, as in `layout`.
    c : int
        Index in `g` at which the law's constants of the vehicle begin.
    spin, torque, integrator, speed_mode : float
        As of `hub_motor`.
    demand : float
        A torque [N m]; with speed mode a set-point [m/s], the throttle times that of full throttle,
        negative backwards. Between the quarters of the throttle the torque is linear.

    Returns
    -------
    torque_slope, integrator_slope, excess : float
        As of `hub_motor`; there is no integrator.
    """
    throttle, quarter = abs(demand), g[c + _K.quarter]
    curve = (
        g[c + _K.rise_1] * min(throttle, quarter)
        + g[c + _K.rise_2] * min(max(throttle - quarter, 0.0), quarter)
        + g[c + _K.rise_3] * min(max(throttle - 2.0 * quarter, 0.0), quarter)
        + g[c + _K.rise_4] * min(max(throttle - 3.0 * quarter, 0.0), quarter)
    )
    wanted = speed_mode * math.copysign(curve, demand) + (1.0 - speed_mode) * demand
    return _without_controller(g, c, spin, torque, wanted)


@inlined
def friction_brake(g: FloatArray, c: int, spin: float, command: float, others: float) -> float:
    """Return the moment of the brake against the spin [N m].

    Coulomb's friction, which holds: up to its torque the brake takes up what else turns the wheel,
    so that a wheel at rest stays at rest.

    Parameters
    ----------
    g : ndarray of float, shape (rows * LANES,)
        Group of vehicles, as in `layout`.
    c : int
        Index in `g` at which the brake's constants of the vehicle begin.
    spin : float
        Spin of the braked wheel [rad/s].
    command : float
        Brake command, 0 (released) to 1 (full).
    others : float
        Moment of everything else on the wheel [N m].
    """
    most = command * g[c + _B.torque]
    moment: float = max(-most, min(most, others + g[c + _B.stiffness] * spin))
    return moment


_POSITION_LOOP = (
    positive("servo_natural_frequency", "rad/s"),
    positive("servo_damping_ratio", "1"),
)
SERVOS = {
    "second_order": Law(second_order, SECOND_ORDER, _POSITION_LOOP),
    "geared": Law(
        geared,
        GEARED,
        (
            *_POSITION_LOOP,
            between("servo_delay", "s", 0.0, LONGEST_DELAY, default=0.0),
            between("servo_backlash", "rad", 0.0, 0.5, default=0.0),  # from stop to stop
        ),
    ),
}
_MOTOR = (
    positive("motor_power", "W"),
    positive("motor_torque", "N m"),
    not_negative("regenerative_torque", "N m"),
    positive("motor_no_load_speed", "rad/s"),
    positive("motor_slope", "N m s/rad"),
    positive("motor_lag", "s"),
    *SUPPLY,
)
MOTORS = {
    "hub_motor": Law(
        hub_motor,
        HUB_MOTOR,
        (
            *_MOTOR,
            positive("speed_gain_proportional", "N m s/rad"),
            not_negative("speed_gain_integral", "N m/rad"),
            not_negative("speed_anti_windup", "rad/(N m s)"),
            # speed over the ground per speed told: of a tyre that is larger than the boards know
            between("speed_scale", "1", 0.5, 2.0, default=1.0),
        ),
    ),
    "direct_torque": Law(
        direct_torque,
        DIRECT_TORQUE,
        (*_MOTOR, positive("setpoint_torque", "N m s/m")),  # per m/s of the set-point
    ),
    "throttle_curve": Law(
        throttle_curve,
        THROTTLE_CURVE,
        (
            *_MOTOR,
            positive("throttle_full_setpoint", "m/s"),  # set-point of full throttle
            *(not_negative(f"throttle_torque_{percent}", "N m") for percent in (25, 50, 75, 100)),
        ),
    ),
}
BRAKES = {
    "friction_brake": Law(
        friction_brake,
        FRICTION_BRAKE,
        (not_negative("brake_torque", "N m"), positive("brake_smoothing_speed", "rad/s")),
    )
}
"""Every law by name; the first is the default."""


DRIVES = {
    "single": Law(None, {"torque_share": lambda _: 1.0}),
    "differential": Law(None, {"torque_share": lambda _: 0.5}),
    "all": Law(
        None,
        {
            "torque_share": lambda w: (
                (w.drive_front_share if w.in_front else 1.0 - w.drive_front_share) / w.abreast
            )
        },
        (between("drive_front_share", "1", 0.0, 1.0, default=0.5),),
    ),
}
"""Share of the motor's torque at each driven wheel, by the law's name.

The motor turns with the mean of the driven wheels by these shares, and so do the speed loop and the
hall sensors.
"""
