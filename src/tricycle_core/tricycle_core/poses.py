"""Poses in the plane: points seen from a body or fixed to it, and ways of constant curvature."""

import numpy as np
from numpy.typing import ArrayLike

from tricycle_core.quantities import FloatArray

Pose = tuple[float, float, float]
"""x, y [m] and heading [rad], left positive."""


def placed(points: FloatArray, x: ArrayLike, y: ArrayLike, heading: ArrayLike) -> FloatArray:
    """Return points fixed to a body at one or many poses.

    Parameters
    ----------
    points : ndarray of float, shape (m, 2)
        Points in the body frame [m].
    x, y, heading : float or ndarray of float, shape (...)
        Poses of the body [m, m, rad].

    Returns
    -------
    points : ndarray of float, shape (..., m, 2)
        Points in the frame of the poses [m].
    """
    c, s = np.cos(heading)[..., None], np.sin(heading)[..., None]
    px, py = points.T
    x, y = np.asarray(x)[..., None], np.asarray(y)[..., None]
    return np.stack([x + c * px - s * py, y + s * px + c * py], axis=-1)


def seen_from(points: FloatArray, x: ArrayLike, y: ArrayLike, heading: ArrayLike) -> FloatArray:
    """Return fixed points as a body sees them, at one or many poses.

    Parameters
    ----------
    points : ndarray of float, shape (m, 2)
        Points in the frame of the poses [m].
    x, y, heading : float or ndarray of float, shape (...)
        Poses of the body [m, m, rad].

    Returns
    -------
    points : ndarray of float, shape (..., m, 2)
        Points in the body frame [m].
    """
    c, s = np.cos(heading)[..., None], np.sin(heading)[..., None]
    px, py = points.T
    dx, dy = px - np.asarray(x)[..., None], py - np.asarray(y)[..., None]
    return np.stack([c * dx + s * dy, c * dy - s * dx], axis=-1)


def along_arc(
    x: float | FloatArray,
    y: float | FloatArray,
    course: float | FloatArray,
    curvature: float | FloatArray,
    way: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return where a way of constant curvature leads: x, y [m], and the turn until there [rad].

    Parameters
    ----------
    x, y, course : float or ndarray of float
        Start of the way, and its direction there [m, m, rad].
    curvature : float or ndarray of float
        Turn per metre, left positive [1/m].
    way : ndarray of float
        Length of the way; negative: backwards [m]. All shapes must broadcast.

    Examples
    --------
    A quarter of a circle to the left:

    >>> [round(float(v), 4) for v in along_arc(0.0, 0.0, 0.0, 1.0, np.array(np.pi / 2.0))]
    [1.0, 1.0, 1.5708]
    """
    turn = curvature * way
    chord = way * np.sinc(turn / (2.0 * np.pi))
    towards = course + 0.5 * turn
    return x + chord * np.cos(towards), y + chord * np.sin(towards), turn
