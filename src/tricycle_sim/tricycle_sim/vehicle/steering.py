"""The steering: servo, linkage and caster, and the table of them that the kernel reads.

The servo is stiff: the tyres do not move it. Its history follows from the set-points alone and is
exact at every half step, whatever the vehicles of a batch do.
"""

import cmath
import math

import numpy as np

from tricycle_core.quantities import FloatArray
from tricycle_sim.compilation import compiled
from tricycle_sim.vehicle.file import Vehicle

# Entries of the array of constants
(_PHI, _LIMIT, _RATIO_STRAIGHT, _RATIO_FULL, _SMOOTHING, _SINE, _COSINE) = (0, 4, 5, 6, 7, 8, 9)


def steering_constants(vehicle: Vehicle, half_step: float) -> FloatArray:
    """Pack what the compiled functions of this module need, for servo steps of `half_step` [s]."""
    # Transition over a step of theta'' = omega^2 (command - theta) - 2 zeta omega theta'
    frequency = vehicle.servo_natural_frequency
    decay_rate = vehicle.servo_damping_ratio * frequency
    root = cmath.sqrt(decay_rate**2 - frequency**2)
    decay = math.exp(-decay_rate * half_step)
    even = decay * cmath.cosh(root * half_step).real
    odd = decay * ((cmath.sinh(root * half_step) / root).real if root else half_step)
    caster = vehicle.caster_angle
    return np.array(
        [
            *(even + decay_rate * odd, odd),
            *(-(frequency**2) * odd, even - decay_rate * odd),
            vehicle.steering_limit,
            vehicle.steering_ratio_straight,
            vehicle.steering_ratio_full,
            vehicle.steering_ratio_smoothing,
            math.sin(caster),
            math.cos(caster),
        ]
    )


@compiled
def wheel_angles(motor_angle: float, constants: FloatArray) -> tuple[float, float, float, float]:
    """Return the angles about the king-pins left, right [rad], and their slopes by motor angle."""
    slope = (constants[_RATIO_STRAIGHT] - constants[_RATIO_FULL]) / constants[_LIMIT]
    ratio = constants[_RATIO_STRAIGHT] - slope * abs(motor_angle)  # outer to inner
    width = constants[_SMOOTHING]
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


@compiled
def road_angle(motor_angle: float, constants: FloatArray) -> float:
    """Return the angle on the road [rad] of the one front wheel that would do for both."""
    left, right, _, _ = wheel_angles(motor_angle, constants)
    cosine = constants[_COSINE]
    angle: float = 0.5 * (math.atan(cosine * math.tan(left)) + math.atan(cosine * math.tan(right)))
    return angle


@compiled
def motor_angle_for(angle: float, constants: FloatArray) -> float:
    """Return the motor angle [rad] within its limit whose `road_angle` comes closest to `angle`."""
    low, high = -constants[_LIMIT], constants[_LIMIT]
    for _ in range(50):  # road_angle rises with the motor angle: halve to round-off
        middle = 0.5 * (low + high)
        if road_angle(middle, constants) < angle:
            low = middle
        else:
            high = middle
    return float(0.5 * (low + high))


@compiled
def _write_axles(
    table: FloatArray, row: int, angle: float, rate: float, constants: FloatArray
) -> None:
    left, right, left_slope, right_slope = wheel_angles(angle, constants)
    sine, cosine = constants[_SINE], constants[_COSINE]
    table[row, 0] = -cosine * math.sin(left)
    table[row, 1] = math.cos(left)
    table[row, 2] = -sine * math.sin(left)
    table[row, 3] = left_slope * rate
    table[row, 4] = -cosine * math.sin(right)
    table[row, 5] = math.cos(right)
    table[row, 6] = -sine * math.sin(right)
    table[row, 7] = right_slope * rate


@compiled
def run_servo(
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
    servo : shape (2,)
        Motor angle [rad] and rate [rad/s]; left at the end of the last tick.
    setpoints : shape (t,)
        Motor angle [rad] wanted during each tick; NaN: no servo pulse, the gear holds the angle.
    constants : shape (10,)
        `steering_constants` of the half step.
    half_steps : int
        Half steps per tick.
    table : shape (half_steps * t + 1, 8)
        Receives axle direction (x, y, z in the body frame) and steering rate [rad/s] of the left
        and the right wheel.
    angles : shape (2, t + 1)
        Receives motor angle [rad] and rate [rad/s] at the ticks.
    """
    limit = constants[_LIMIT]
    angle, rate = servo[0], servo[1]
    _write_axles(table, 0, angle, rate, constants)
    angles[0, 0], angles[1, 0] = angle, rate
    row = 0
    for k in range(setpoints.shape[0]):
        setpoint = setpoints[k]
        off = math.isnan(setpoint)
        if off:
            rate = 0.0
            _write_axles(table, row, angle, rate, constants)
        for _ in range(half_steps):
            if not off:
                error = angle - setpoint
                angle = setpoint + constants[_PHI] * error + constants[_PHI + 1] * rate
                rate = constants[_PHI + 2] * error + constants[_PHI + 3] * rate
                if abs(angle) > limit:  # at the stop
                    angle = math.copysign(limit, angle)
                    rate = 0.0
            row += 1
            _write_axles(table, row, angle, rate, constants)
        angles[0, k + 1], angles[1, k + 1] = angle, rate
    servo[0], servo[1] = angle, rate
