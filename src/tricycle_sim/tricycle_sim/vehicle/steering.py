"""The steering: linkage and caster, from the motor's angle to the axles of the front wheels.

The servo is stiff: the tyres do not move it. Its history follows from the set-points alone and is
exact at every half step, whatever the vehicles of a batch do: one table holds it for all of them.

`LINKAGES` lists the laws of the linkage; each is one function, compiled into the steering, and the
constants that it reads. A vehicle file chooses one under `parts: {steering: NAME}`.
"""

import math
from typing import Any

from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.vehicle.actuators import GEARED, LONGEST_DELAY, SERVOS, behind_play
from tricycle_sim.vehicle.laws import Law, between, inlined, positive
from tricycle_sim.vehicle.layout import Formulas, blocks, numbered

RATIO: Formulas = {
    "limit": lambda v: v.steering_limit,
    "straight": lambda v: v.steering_ratio_straight,
    "full": lambda v: v.steering_ratio_full,
    "smoothing": lambda v: v.steering_ratio_smoothing,
}
_R = numbered(RATIO)

CONSTANTS = (
    between("caster_angle", "rad", -0.7, 0.7),
    between("steering_limit", "rad", 0.01, 1.2),  # of the motor: its end stop
    between("steering_offset", "rad", -0.5, 0.5, default=0.0),  # added to the motor's angle
    between("steering_scale", "1", 0.5, 2.0, default=1.0),  # of the motor's angle, before that
    # share of the limit that plans keep free
    between("steering_margin", "1", 0.0, 0.5, default=0.05, setting=True),
)
"""Constants of every linkage."""

GEOMETRY: Formulas = {
    "limit": lambda v: v.steering_limit,
    "sine": lambda v: math.sin(v.caster_angle),
    "cosine": lambda v: math.cos(v.caster_angle),
    "offset": lambda v: v.steering_offset,
    "sign": lambda v: v.steering_sign,
    "scale": lambda v: v.steering_scale,
}
"""Rows of every linkage: largest motor angle, caster angle of the king-pins, angle added to the
motor's, sign (-1 behind, where wheels turn right for a turn to the left), factor of the motor's
angle."""
_G = numbered(GEOMETRY)


@inlined
def ratio(constants: FloatArray, c: int, motor_angle: float) -> tuple[float, float, float, float]:
    """Return the wheels' angles for a ratio of outer to inner angle that falls with the angle.

    Parameters
    ----------
    constants : ndarray of float
        Constants of the steering; see `steering.BLOCK`.
    c : int
        Index in `constants` at which the linkage's begin.
    motor_angle : float
        Angle of the steering motor [rad].

    Returns
    -------
    left, right : float
        Angles about the king-pins [rad].
    left_slope, right_slope : float
        Their derivatives by the motor angle.
    """
    slope = (constants[c + _R.straight] - constants[c + _R.full]) / constants[c + _R.limit]
    ratio = constants[c + _R.straight] - slope * abs(motor_angle)  # outer to inner
    width = constants[c + _R.smoothing]
    length = math.sqrt(motor_angle**2 + width**2)
    side = motor_angle / length  # 1: left turn, the left wheel is the inner one
    common, split = 0.5 * (1.0 + ratio), 0.5 * side * (1.0 - ratio)
    ratio_slope = -slope * abs(motor_angle)  # times the motor angle
    side_slope = width**2 / length**3
    common_slope = common + 0.5 * ratio_slope
    split_slope = split + 0.5 * motor_angle * side_slope * (1.0 - ratio) - 0.5 * side * ratio_slope
    return (
        motor_angle * (common + split),
        motor_angle * (common - split),
        common_slope + split_slope,
        common_slope - split_slope,
    )


@inlined
def axle(constants: FloatArray, c: int, angle: float) -> tuple[float, float, float]:
    """Return the direction of a wheel's axle in the body frame.

    Parameters
    ----------
    constants : ndarray of float
        Constants of the steering; see `steering.BLOCK`.
    c : int
        Index in `constants` at which those of the geometry begin.
    angle : float
        Angle of the wheel about its king-pin [rad].
    """
    return (
        -constants[c + _G.cosine] * math.sin(angle),
        math.cos(angle),
        -constants[c + _G.sine] * math.sin(angle),
    )


PARALLEL: Formulas = {"gain": lambda v: v.steering_gain}
_PARALLEL = numbered(PARALLEL)


@inlined
def parallel(
    constants: FloatArray, c: int, motor_angle: float
) -> tuple[float, float, float, float]:
    """Return the wheels' angles where all turn alike, also where there is one.

    Parameters
    ----------
    constants : ndarray of float
        Constants of the steering; see `steering.BLOCK`.
    c : int
        Index in `constants` at which the linkage's begin.
    motor_angle : float
        Angle of the steering motor [rad].

    Returns
    -------
    left, right, left_slope, right_slope : float
        As of `ratio`.
    """
    gain = constants[c + _PARALLEL.gain]
    return gain * motor_angle, gain * motor_angle, gain, gain


ACKERMANN: Formulas = {
    "base": lambda v: v.wheelbase,
    "left": lambda v: v.left_of_middle,
    "right": lambda v: -v.left_of_middle,
}
_A = numbered(ACKERMANN)


@inlined
def ackermann(
    constants: FloatArray, c: int, motor_angle: float
) -> tuple[float, float, float, float]:
    """Return the wheels' angles with which all wheels roll about one centre.

    The motor's angle is that of a wheel in the middle of the steered axle.

    Parameters
    ----------
    constants : ndarray of float
        Constants of the steering; see `steering.BLOCK`.
    c : int
        Index in `constants` at which the linkage's begin.
    motor_angle : float
        Angle of the steering motor [rad].

    Returns
    -------
    left, right, left_slope, right_slope : float
        As of `ratio`.
    """
    base, tangent = constants[c + _A.base], math.tan(motor_angle)
    across = base * tangent
    left = base - constants[c + _A.left] * tangent
    right = base - constants[c + _A.right] * tangent
    rise = base * base * (1.0 + tangent * tangent)
    return (
        math.atan2(across, left),
        math.atan2(across, right),
        rise / (left * left + across * across),
        rise / (right * right + across * across),
    )


LINKAGES = {
    "ratio": Law(
        ratio,
        RATIO,
        (
            between("steering_ratio_straight", "1", 0.3, 1.0),  # outer to inner wheel
            between("steering_ratio_full", "1", 0.3, 1.0),  # at the limit
            positive("steering_ratio_smoothing", "rad"),
        ),
    ),
    "parallel": Law(parallel, PARALLEL, (positive("steering_gain", "1", default=1.0),)),
    "ackermann": Law(ackermann, ACKERMANN),
}
"""Every law by name; the first is the default."""

BLOCK, SIZE = blocks(
    0,
    {
        "servo": [law.rows for law in SERVOS.values()],
        "linkage": [law.rows for law in LINKAGES.values()],
        "geometry": [GEOMETRY],
    },
)
"""Where each part's constants start in the array of the steering's constants; its length."""

_DEAD_STEPS = BLOCK.servo + [*GEARED].index("dead_steps")
_PAST = 3
"""First of the set-points of past ticks in the state of a geared servo."""
GEARED_STATES = _PAST + math.ceil(LONGEST_DELAY / TICK) + 2
"""Motor angle and rate, angle behind the play, set-points of the ticks of the longest delay."""


@inlined
def turned(
    linkage: Any, constants: FloatArray, motor_angle: float
) -> tuple[float, float, float, float]:
    """Return the wheels' angles about their king-pins, left and right [rad], and their slopes.

    Parameters
    ----------
    linkage : compiled function
        Law of the linkage.
    constants : ndarray of float, shape (SIZE,)
        Constants of the steering; see `steering.BLOCK`.
    motor_angle : float
        Angle of the steering motor [rad].
    """
    scale = constants[BLOCK.geometry + _G.scale]
    left, right, left_slope, right_slope = linkage(
        constants, BLOCK.linkage, scale * motor_angle + constants[BLOCK.geometry + _G.offset]
    )
    sign = constants[BLOCK.geometry + _G.sign]
    return sign * left, sign * right, sign * scale * left_slope, sign * scale * right_slope


@inlined
def road_angle_of(linkage: Any, motor_angle: float, constants: FloatArray) -> float:
    """Return the angle on the road [rad] of the one steered wheel that would do, in front.

    Parameters
    ----------
    linkage : compiled function
        Law of the linkage.
    motor_angle : float
        Angle of the steering motor [rad].
    constants : ndarray of float, shape (SIZE,)
        Constants of the steering; see `steering.BLOCK`.
    """
    left, right, _, _ = turned(linkage, constants, motor_angle)
    sign = constants[BLOCK.geometry + _G.sign]
    cosine = constants[BLOCK.geometry + _G.cosine]
    both = math.atan(cosine * math.tan(left)) + math.atan(cosine * math.tan(right))
    angle: float = sign * 0.5 * both
    return angle


@inlined
def motor_angle_of(linkage: Any, angle: float, constants: FloatArray) -> float:
    """Return the motor angle [rad] within its limit whose `road_angle_of` comes closest.

    Parameters
    ----------
    linkage : compiled function
        Law of the linkage.
    angle : float
        Angle on the road [rad].
    constants : ndarray of float, shape (SIZE,)
        Constants of the steering; see `steering.BLOCK`.
    """
    limit = constants[BLOCK.geometry + _G.limit]
    low, high = -limit, limit  # road_angle_of rises with the motor angle
    below = road_angle_of(linkage, low, constants) - angle
    above = road_angle_of(linkage, high, constants) - angle
    if below >= 0.0 or above <= 0.0:
        return float(low if below >= 0.0 else high)
    middle, side = low, 0
    for _ in range(50):  # Illinois method, to round-off
        middle = (low * above - high * below) / (above - below)
        off = road_angle_of(linkage, middle, constants) - angle
        if abs(off) < 1e-15:
            break
        if off < 0.0:
            above *= 0.5 if side < 0 else 1.0
            low, below, side = middle, off, -1
        else:
            below *= 0.5 if side > 0 else 1.0
            high, above, side = middle, off, 1
    return float(middle)


@inlined
def _write_axles(
    linkage: Any, table: FloatArray, row: int, angle: float, rate: float, constants: FloatArray
) -> None:
    left, right, left_slope, right_slope = turned(linkage, constants, angle)
    table[row, 0], table[row, 1], table[row, 2] = axle(constants, BLOCK.geometry, left)
    table[row, 3] = left_slope * rate
    table[row, 4], table[row, 5], table[row, 6] = axle(constants, BLOCK.geometry, right)
    table[row, 7] = right_slope * rate


@inlined
def _setpoint(servo: FloatArray, setpoints: FloatArray, half_step: int, half_steps: int) -> float:
    """Return the set-point of a half step; those before the first one are in the servo's state."""
    tick = half_step // half_steps
    if tick < 0:
        return float(servo[servo.shape[0] + tick])
    return float(setpoints[tick])


@inlined
def _keep_past(servo: FloatArray, setpoints: FloatArray) -> None:
    """Put the set-points behind those of past ticks and drop as many of the oldest."""
    ticks, last = setpoints.shape[0], servo.shape[0]
    for at in range(_PAST, last):
        tick = at - last + ticks
        servo[at] = setpoints[tick] if tick >= 0 else servo[at + ticks]


@inlined
def run_servo(
    servo_law: Any,
    linkage: Any,
    servo: FloatArray,
    setpoints: FloatArray,
    constants: FloatArray,
    half_steps: int,
    table: FloatArray,
    angles: FloatArray,
) -> None:
    """Run the servo through its set-points, one per tick.

    Parameters
    ----------
    servo_law, linkage : compiled function
        Laws of servo and linkage.
    servo : ndarray of float, shape (2,) or (GEARED_STATES,)
        Motor angle [rad] and rate [rad/s], of a geared servo also the angle behind the play and
        past set-points; left at the end of the last tick.
    setpoints : ndarray of float, shape (t,)
        Motor angle [rad] wanted during each tick; NaN: no servo pulse, the gear holds the angle.
    constants : ndarray of float, shape (SIZE,)
        Constants of the steering for the half step; see `steering.BLOCK`.
    half_steps : int
        Half steps per tick.
    table : ndarray of float, shape (half_steps * t + 1, 8)
        Receives axle direction (x, y, z in the body frame) and steering rate [rad/s] of the left
        and the right wheel.
    angles : ndarray of float, shape (2, t + 1)
        Receives motor angle [rad] and rate [rad/s] at the ticks.
    """
    angle, rate = servo[0], servo[1]
    ticks = setpoints.shape[0]
    is_geared = servo.shape[0] > 2
    dead = int(constants[_DEAD_STEPS]) if is_geared else 0
    # one place that writes: what is computed in two may be rounded differently, by optimisation
    for row in range(half_steps * ticks + 1):
        if row > 0:
            setpoint = _setpoint(servo, setpoints, row - 1 - dead, half_steps)
            if not math.isnan(setpoint):
                earlier = setpoint
                if is_geared:
                    before = _setpoint(servo, setpoints, row - 2 - dead, half_steps)
                    earlier = setpoint if math.isnan(before) else before
                angle, rate = servo_law(constants, BLOCK.servo, angle, rate, earlier, setpoint)
        if ticks == 0 or row % half_steps == 0:
            k = 0 if ticks == 0 else row // half_steps
            angles[0, k], angles[1, k] = angle, rate
        if row < half_steps * ticks and math.isnan(
            _setpoint(servo, setpoints, row - dead, half_steps)
        ):
            rate = 0.0
        turned_angle, turned_rate = angle, rate
        if is_geared:
            servo[2], turned_rate = behind_play(constants, BLOCK.servo, servo[2], angle, rate)
            turned_angle = servo[2]
        _write_axles(linkage, table, row, turned_angle, turned_rate, constants)
    servo[0], servo[1] = angle, rate
    if is_geared:
        _keep_past(servo, setpoints)
