"""What ideal instruments read, from the state of a vehicle at the COM, in the body frame.

All functions take floats, or arrays of one shape: of samples and times.
"""

from collections.abc import Iterable
from typing import TypeVar

from tricycle_core.quantities import FloatArray

Number = TypeVar("Number", float, FloatArray)
Vector = tuple[float, float, float]


def relative_spin(spin: Number, rates: Iterable[Number], axle: Iterable[Number] | None) -> Number:
    """Return the speed of a wheel relative to the body, as its encoder sees it [rad/s].

    Parameters
    ----------
    spin : float or ndarray of float
        Speed of the wheel about its axle, relative to the world [rad/s].
    rates : iterable of 3 floats or ndarrays
        Roll, pitch and yaw rate of the body [rad/s].
    axle : iterable of 3 floats or ndarrays, or None
        Direction of the axle, of the length 1; None: the body's +y, as of wheels without steering.
    """
    p, q, r = rates
    if axle is None:
        return spin - q
    x, y, z = axle
    return spin - (p * x + q * y + r * z)


def lateral_specific_force(
    velocity: tuple[Number, Number],
    rates: tuple[Number, Number],
    slope: Number,
    attitude: tuple[Number, Number, Number, Number],
    gravity: tuple[Number, Number, Number],
) -> Number:
    """Return what an accelerometer reads to the left [m/s^2].

    Parameters
    ----------
    velocity : tuple of 2 floats or ndarrays
        Velocity of the COM forwards and up [m/s].
    rates : tuple of 2 floats or ndarrays
        Roll and yaw rate [rad/s].
    slope : float or ndarray of float
        Derivative of the velocity to the left by time [m/s^2].
    attitude, gravity : tuple of floats or ndarrays
        As in `specific_force`.
    """
    (u, w), (p, r), (q0, q1, q2, q3), (up_x, up_y, up_z) = velocity, rates, attitude, gravity
    force = slope + r * u - p * w
    force += up_x * 2.0 * (q1 * q2 - q0 * q3) + up_y * (1.0 - 2.0 * (q1 * q1 + q3 * q3))
    force += up_z * 2.0 * (q2 * q3 + q0 * q1)
    return force


def specific_force(
    velocity: Vector,
    rates: Vector,
    slopes: Vector,
    attitude: tuple[float, float, float, float],
    gravity: Vector,
) -> Vector:
    """Return what an accelerometer reads: forwards, to the left and up [m/s^2].

    Parameters
    ----------
    velocity : tuple of 3 floats
        Velocity of the COM [m/s].
    rates : tuple of 3 floats
        Roll, pitch and yaw rate [rad/s].
    slopes : tuple of 3 floats
        Derivatives of the components of the velocity by time [m/s^2].
    attitude : tuple of 4 floats
        Quaternion (w, x, y, z), from the body to the world.
    gravity : tuple of 3 floats
        Components of the acceleration that holds the vehicle up, in the world [m/s^2].
    """
    (u, v, w), (p, q, r), (du, dv, dw) = velocity, rates, slopes
    q0, q1, q2, q3 = attitude
    up_x, up_y, up_z = gravity
    return (
        du
        + q * w
        - r * v
        + up_z * 2.0 * (q1 * q3 - q0 * q2)
        + up_x * (1.0 - 2.0 * (q2 * q2 + q3 * q3))
        + up_y * 2.0 * (q1 * q2 + q0 * q3),
        lateral_specific_force((u, w), (p, r), dv, attitude, gravity),
        dw
        + p * v
        - q * u
        + up_z * (1.0 - 2.0 * (q1 * q1 + q2 * q2))
        + up_x * 2.0 * (q1 * q3 + q0 * q2)
        + up_y * 2.0 * (q2 * q3 - q0 * q1),
    )
