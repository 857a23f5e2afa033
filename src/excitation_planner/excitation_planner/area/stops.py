"""The ways that a vehicle may take to rest: tube and fence look at the same ones."""

import numpy as np
from numpy.typing import ArrayLike

from tricycle_core.poses import along_arc
from tricycle_core.quantities import FloatArray
from tricycle_core.stopping import Cause, stopping_distance

ARC_POINTS = 6
"""Poses along the path of a stop, of the tube."""


def longest_stop(speed: FloatArray) -> FloatArray:
    """Return the way to rest of the published stop that is longest [m].

    Parameters
    ----------
    speed : ndarray of float
        Speed at the beginning of the stop [m/s].
    """
    longest: FloatArray = np.max([stopping_distance(cause, speed) for cause in Cause], axis=0)
    return longest


RUN_OUT = float(longest_stop(np.array(0.12)))
"""Room beyond the end of a way back: a stop while the vehicle creeps to it [m]."""


def stopping_path(
    x: ArrayLike,
    y: ArrayLike,
    yaw: ArrayLike,
    slip: ArrayLike,
    way: ArrayLike,
    curvature: ArrayLike,
    points: int = ARC_POINTS,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return poses x, y, yaw on arcs to rest, each of shape (..., points).

    Parameters
    ----------
    x, y, yaw : float or ndarray of float, shape (...)
        Poses from which the vehicle is stopped [m, m, rad].
    slip : float or ndarray of float, shape (...)
        Direction of the motion relative to the heading [rad].
    way : float or ndarray of float, shape (...)
        Length of the arc [m].
    curvature : float or ndarray of float, shape (...)
        Curvature of the arc in the direction of the motion, left positive [1/m].
    points : int
        Poses on each arc, from its start to its end.
    """
    s = np.asarray(way)[..., None] * np.linspace(0.0, 1.0, points)
    x, y, yaw = (np.asarray(start)[..., None] for start in (x, y, yaw))
    course = yaw + np.asarray(slip)[..., None]
    x, y, turn = along_arc(x, y, course, np.asarray(curvature)[..., None], s)
    return x, y, yaw + turn
