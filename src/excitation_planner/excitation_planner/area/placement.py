"""Start pose of a maneuver on an area at which its tube keeps the largest distance to the border.

p: poses tried, t: points of the tube's outline.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import TypeVar

import numpy as np
import shapely
from numpy.typing import NDArray

from excitation_planner.area.area import Area
from excitation_planner.area.polygons import Rings, edges_of, rings_of
from tricycle_core.poses import placed
from tricycle_core.quantities import FloatArray

Pieces = TypeVar("Pieces", shapely.Polygon, NDArray[np.object_])

HEADINGS = 24
"""Headings of a whole turn that are tried first."""

PLACES = 12
"""Places along each side of the area's bounds that are tried first at each heading."""

CANDIDATES = 60
"""Poses of these that are looked at closely: the best by the corners of the tube's hull alone."""

STARTS = 4
"""Poses of these from which the search goes on, by ever smaller random steps."""

ROUNDS, STEPS = 9, 24
"""Rounds of that search, and poses tried in each from each start."""

SPACING = 0.5
"""Distance between the points of outlines at which distances are computed [m]."""

ROUGH, FINE = 0.3, 0.05
"""Tolerances by which a tube is simplified for the first poses, and for the others [m]."""


@dataclass(frozen=True)
class Placement:
    """Start pose of a maneuver on an area.

    Attributes
    ----------
    x, y, heading : float
        Pose of `base_link` in the area's frame [m, m, rad].
    clearance : float
        Distance between the tube and what bounds the area [m]; negative by how far it reaches out.
    """

    x: float
    y: float
    heading: float
    clearance: float


def best_placement(tube: shapely.Polygon, area: Area, *, enough: float = math.inf) -> Placement:
    """Return the start pose at which a tube keeps the largest distance.

    Parameters
    ----------
    tube : shapely.Polygon or shapely.MultiPolygon
        Tube of the maneuver, seen from its start pose.
    area : Area
        Area, with the region of start poses.
    enough : float
        Distance at which the search ends [m].
    """
    bounds = shapely.Polygon(area.keep_in)
    # in a convex area the corners of the hull come closest to the border
    convex = bool(bounds.convex_hull.area < bounds.area + 1e-9)
    rough = _Sampled.of(shapely.simplify(tube, ROUGH), area, by_hull=True)
    fine = _Sampled.of(shapely.simplify(tube, FINE), area, by_hull=convex)
    rng = np.random.default_rng(0)  # the same pose for the same tube
    low, high, around = _limits(area)
    poses = rough.best(_grid(low, high, around), CANDIDATES)
    clearances = fine.clearance(poses)
    best = _best(clearances, STARTS)
    poses, clearances = poses[best], clearances[best]
    reach = np.maximum((high - low) / np.array([PLACES, PLACES, HEADINGS]), 0.0)
    for _ in range(ROUNDS):
        if clearances.max() > enough:
            break
        steps = rng.uniform(-1.0, 1.0, (len(poses), STEPS, 3)) * reach
        tried = np.clip(poses[:, None] + steps, low, high)
        values = fine.clearance(tried.reshape(-1, 3)).reshape(len(poses), STEPS)
        pick = np.argmax(values, axis=1)
        better = values[np.arange(len(poses)), pick] > clearances
        poses = np.where(better[:, None], tried[np.arange(len(poses)), pick], poses)
        clearances = np.maximum(clearances, values.max(axis=1))
        reach = 0.6 * reach
    x, y, heading = poses[np.argmax(clearances)].tolist()
    clearance = clearance_of(np.array([at_pose(tube, x, y, heading)]), area)
    if math.isinf(clearance):
        clearance = min(float(clearances.max()), 0.0)
    return Placement(x, y, float(np.angle(np.exp(1j * heading))), clearance)


def clearance_of(pieces: NDArray[np.object_], area: Area) -> float:
    """Return the smallest distance of polygons to the border and the keep-outs of an area [m].

    Parameters
    ----------
    pieces : ndarray of shapely.Polygon, shape (n,)
        Polygons in the area's frame.
    area : Area
        Area whose keep_in and keep_out count.

    Returns
    -------
    clearance : float
        Smallest distance [m]; minus infinity if a polygon is not wholly on the ground.
    """
    bounds = shapely.Polygon(area.keep_in)
    obstacles = np.array([shapely.Polygon(corners) for corners in area.keep_out], dtype=object)
    shapely.prepare(bounds)
    if not bounds.contains(pieces).all() or shapely.intersects(pieces[:, None], obstacles).any():
        return -math.inf
    lines = np.array([bounds.exterior, *obstacles], dtype=object)
    return float(shapely.distance(pieces[:, None], lines).min())


def at_pose(tube: Pieces, x: float, y: float, heading: float) -> Pieces:
    """Return a tube, or its pieces, in the area's frame.

    Parameters
    ----------
    tube : shapely.Polygon, or ndarray of them
        Tube, seen from its start pose.
    x, y, heading : float
        Start pose in the area's frame [m, m, rad].
    """
    return shapely.transform(tube, lambda points: placed(points, x, y, heading))


def _limits(area: Area) -> tuple[FloatArray, FloatArray, bool]:
    """Lowest and highest pose (3,), and whether any heading is allowed."""
    corners, start = area.keep_in, area.start
    low = np.array([*np.maximum(corners.min(axis=0), [start.x[0], start.y[0]]), start.heading[0]])
    high = np.array([*np.minimum(corners.max(axis=0), [start.x[1], start.y[1]]), start.heading[1]])
    return low, high, bool(np.ptp(start.heading) > 2.0 * np.pi - 1e-6)


def _grid(low: FloatArray, high: FloatArray, around: bool) -> FloatArray:
    """Poses (p, 3) over a box, one for an axis without extent."""
    counts = np.where(high > low, [PLACES, PLACES, HEADINGS], 1)
    axes = [
        np.linspace(a, b, n, endpoint=not around if axis == 2 else True) if n > 1 else np.array([a])
        for axis, (a, b, n) in enumerate(zip(low, high, counts, strict=True))
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _best(values: FloatArray, count: int) -> NDArray[np.intp]:
    return np.argsort(-values, kind="stable")[:count]


@dataclass(frozen=True)
class _Sampled:
    """A tube and what bounds an area, at points: what is between them is left out."""

    area: Area
    outline: FloatArray  # points (t, 2) of the tube
    rings: Rings  # of the tube
    obstacles: FloatArray  # points (o, 2) of the area's obstacles

    @classmethod
    def of(cls, tube: shapely.Polygon, area: Area, *, by_hull: bool) -> _Sampled:
        """Sample a tube, its outline at the corners of its hull only or all along."""
        outline = shapely.get_coordinates(tube.convex_hull) if by_hull else _points(tube)
        obstacles = [_points(shapely.Polygon(corners)) for corners in area.keep_out]
        # of a part of a tube there may be several
        rings = [ring for polygon in shapely.get_parts(tube) for ring in rings_of(polygon)]
        return cls(area, outline, rings, np.concatenate([np.empty((0, 2)), *obstacles]))

    def best(self, poses: FloatArray, count: int) -> FloatArray:
        """Return those of the poses (p, 3) with the largest clearance."""
        # obstacles, which take most of the time, only lower what the border leaves
        border = _least_depth(self.outline, poses, (self.area.keep_in,))
        order = _best(border, len(poses))
        if not self.area.keep_out:
            return poses[order[:count]]
        first = np.sort(order[: max(len(poses) // 4, count)])
        found = self.clearance(poses[first])
        kept = _best(found, count)
        if len(first) < len(poses) and found[kept[-1]] <= border[order[len(first)]]:
            return poses[_best(self.clearance(poses), count)]
        return poses[first[kept]]

    def clearance(self, poses: FloatArray) -> FloatArray:
        """Clearance (p,) of the tube at poses (p, 3)."""
        least, keep_out = partial(_least_depth, poses=poses), self.area.keep_out
        found = [least(self.outline, rings=(self.area.keep_in,))]
        found += [least(self.outline, rings=(corners,), sign=-1.0) for corners in keep_out]
        if len(self.obstacles):
            found.append(least(self.obstacles, rings=self.rings, sign=-1.0, seen=True))
        clearance: FloatArray = np.min(found, axis=0)
        return clearance


def _least_depth(
    points: FloatArray, poses: FloatArray, rings: Rings, sign: float = 1.0, *, seen: bool = False
) -> FloatArray:
    """Least of the signed distances of points (n, 2) to a polygon at poses (p, 3), times a sign.

    The points are fixed to the body, the polygon is not; or it is to be as `seen` from the body.
    """
    least = np.empty(len(poses))
    turned = np.column_stack([poses[:, :2], np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    _compiled()(points, turned, *edges_of(rings), sign, seen, least)
    return least


@cache
def _compiled() -> Callable[..., None]:
    """Return `_find_least` as machine code, six times as fast as NumPy's tables."""
    from tricycle_sim.compilation import compiled

    find: Callable[..., None] = compiled(_find_least, exact=True)
    return find


def _find_least(points, poses, start, end, sign, seen, least):  # type: ignore[no-untyped-def]  # pragma: no cover
    for pose in range(poses.shape[0]):
        left, up, c, s = poses[pose]
        found = np.inf
        for n in range(points.shape[0]):
            px, py = points[n]
            if seen:  # as `polygons.seen_from`
                x, y = c * (px - left) + s * (py - up), c * (py - up) - s * (px - left)
            else:  # as `polygons.placed`
                x, y = left + c * px - s * py, up + s * px + c * py
            nearest, inside = np.inf, False
            for e in range(start.shape[1]):  # as `polygons.signed_distance`
                ax, ay, by = start[0, e], start[1, e], end[1, e]
                dx, dy = end[0, e] - ax, by - ay
                along = ((x - ax) * dx + (y - ay) * dy) / max(dx * dx + dy * dy, 1e-300)
                along = min(max(along, 0.0), 1.0)
                nearest = min(nearest, (x - ax - along * dx) ** 2 + (y - ay - along * dy) ** 2)
                if (ay > y) != (by > y) and x < ax + (y - ay) * (dx / dy):
                    inside = not inside
            depth = math.sqrt(nearest)
            found = min(found, sign * (depth if inside else -depth))
        least[pose] = found


def _points(tube: shapely.Geometry) -> FloatArray:
    """Points (t, 2) along the outlines of polygons."""
    outlines = shapely.get_exterior_ring(shapely.get_parts(tube))
    return np.asarray(shapely.get_coordinates(shapely.segmentize(outlines, SPACING)))
