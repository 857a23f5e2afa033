"""Attitude as quaternion (w, x, y, z), body to world, and as ZYX angles (REP-103)."""

import math
from collections.abc import Iterable
from typing import Protocol

import numpy as np

from tricycle_core.quantities import FloatArray

UNIT_TOLERANCE = 0.01
"""Difference from 1 of the squared length of a quaternion that still counts as a unit's."""


class Quaternion(Protocol):
    """A geometry_msgs/Quaternion, or anything with its fields."""

    x: float
    y: float
    z: float
    w: float


def is_unit(q: Quaternion) -> bool:
    """Return whether a quaternion is an orientation: of length 1, within `UNIT_TOLERANCE`.

    Parameters
    ----------
    q : Quaternion
        Quaternion; its fields may be any numbers, also NaN.
    """
    return abs(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z - 1.0) < UNIT_TOLERANCE


def yaw_of(q: Quaternion) -> float:
    """Return the yaw angle [rad] of a quaternion, from -pi to pi.

    Parameters
    ----------
    q : Quaternion
        Unit quaternion, body to world.
    """
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))


def about_vertical(yaw: float) -> tuple[float, float]:
    """Return z and w of the unit quaternion of a yaw angle; its x and y are 0.

    Parameters
    ----------
    yaw : float
        Angle [rad].

    Examples
    --------
    >>> about_vertical(math.pi)[0]
    1.0
    """
    return math.sin(0.5 * yaw), math.cos(0.5 * yaw)


def roll_angle(quaternion: Iterable[FloatArray | float]) -> FloatArray:
    """Return the roll angle [rad], shape (...).

    Parameters
    ----------
    quaternion : iterable of four float or ndarray of float, shape (...)
        Unit quaternions (w, x, y, z).
    """
    w, x, y, z = quaternion
    roll: FloatArray = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return roll


def pitch_angle(quaternion: Iterable[FloatArray | float]) -> FloatArray:
    """Return the pitch angle [rad], shape (...); positive is nose down.

    Parameters
    ----------
    quaternion : iterable of four float or ndarray of float, shape (...)
        Unit quaternions (w, x, y, z).
    """
    w, x, y, z = quaternion
    pitch: FloatArray = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    return pitch


def yaw_angle(quaternion: Iterable[FloatArray | float]) -> FloatArray:
    """Return the yaw angle [rad] from -pi to pi, shape (...).

    Parameters
    ----------
    quaternion : iterable of four float or ndarray of float, shape (...)
        Unit quaternions (w, x, y, z).
    """
    w, x, y, z = quaternion
    yaw: FloatArray = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return yaw


def attitude_quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return the unit quaternion (w, x, y, z) of ZYX angles.

    Parameters
    ----------
    roll, pitch, yaw : float
        Angles [rad]; positive pitch is nose down.

    Examples
    --------
    >>> attitude_quaternion(0.0, 0.0, math.pi)[3]
    1.0
    """
    (a, b, c), (s, t, u) = (
        (math.cos(0.5 * roll), math.cos(0.5 * pitch), math.cos(0.5 * yaw)),
        (math.sin(0.5 * roll), math.sin(0.5 * pitch), math.sin(0.5 * yaw)),
    )
    return (
        a * b * c + s * t * u,
        s * b * c - a * t * u,
        a * t * c + s * b * u,
        a * b * u - s * t * c,
    )
