"""Distances to polygons, in NumPy alone.

A polygon is a tuple of rings, each an array (n, 2) of its corners without the first repeated: the
outline, then the holes. Which way round a ring goes does not matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tricycle_core.quantities import FloatArray

if TYPE_CHECKING:  # only who reads an area needs it
    import shapely

Rings = Sequence[FloatArray]


def signed_distance(points: FloatArray, rings: Rings) -> FloatArray:
    """Return the distance of points to the border of a polygon [m], positive inside.

    Parameters
    ----------
    points : ndarray of float, shape (..., 2)
        Points, x and y [m].
    rings : sequence of ndarray of float, each of shape (n, 2)
        Outline and holes [m].

    Returns
    -------
    distance : ndarray of float, shape (...)
        Negative outside of the outline and in a hole.
    """
    x, y = points[..., 0, None], points[..., 1, None]
    (ax, ay), (bx, by) = edges_of(rings)
    dx, dy = bx - ax, by - ay
    length2 = np.maximum(dx * dx + dy * dy, 1e-300)
    along = np.clip(((x - ax) * dx + (y - ay) * dy) / length2, 0.0, 1.0)
    squared = (x - ax - along * dx) ** 2 + (y - ay - along * dy) ** 2
    sign = np.where(contains(points, rings), 1.0, -1.0)
    distance: FloatArray = sign * np.sqrt(squared.min(axis=-1))
    return distance


def contains(points: FloatArray, rings: Rings) -> NDArray[np.bool_]:
    """Return whether points lie within a polygon.

    Parameters
    ----------
    points : ndarray of float, shape (..., 2)
        Points, x and y [m].
    rings : sequence of ndarray of float, each of shape (n, 2)
        Outlines and holes [m].

    Returns
    -------
    inside : ndarray of bool, shape (...)
        False outside of every outline and in a hole.
    """
    x, y = points[..., 0, None], points[..., 1, None]
    (ax, ay), (bx, by) = edges_of(rings)
    # a ray towards +x crosses an odd number of edges from inside
    spans = (ay > y) != (by > y)
    slope = (bx - ax) / np.where(by == ay, 1.0, by - ay)
    crossing = spans & (x < ax + (y - ay) * slope)
    inside: NDArray[np.bool_] = np.count_nonzero(crossing, axis=-1) % 2 == 1
    return inside


def edges_of(rings: Rings) -> tuple[FloatArray, FloatArray]:
    """Return coordinates of the edges' first and of their last points, each (2, e).

    Parameters
    ----------
    rings : sequence of ndarray of float, each of shape (n, 2)
        Outlines and holes [m].
    """
    start = np.concatenate(rings)
    end = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
    return start.T, end.T


def rings_of(polygon: shapely.Polygon) -> tuple[FloatArray, ...]:
    """Return outline and holes of a polygon, each (n, 2) without the first corner repeated.

    Parameters
    ----------
    polygon : shapely.Polygon
        Polygon without self-intersections.
    """
    rings = (polygon.exterior, *polygon.interiors)
    return tuple(np.asarray(ring.coords)[:-1] for ring in rings)
