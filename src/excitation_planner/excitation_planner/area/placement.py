"""Where on an area a maneuver begins, so that its tube keeps the largest distance to the border.

p: poses tried, t: points of the tube's outline.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from excitation_planner.area.area import Area
from excitation_planner.area.polygons import (
    Rings,
    placed,
    rings_of,
    seen_from,
    signed_distance,
)
from tricycle_core.quantities import FloatArray

HEADINGS = 24
"""Of a whole turn, tried first."""

PLACES = 12
"""Along each side of the area's bounds, tried first at each heading."""

CANDIDATES = 60
"""Poses of these that are looked at closely: the best by the corners of the tube's hull alone."""

STARTS = 4
"""Poses of these from which the search goes on, by ever smaller random steps."""

ROUNDS, STEPS = 9, 24
"""Of that search, and poses tried in each from each start."""

SPACING = 0.5
"""Between points of outlines at which distances are looked at [m]."""

ROUGH, FINE = 0.3, 0.05
"""By which a tube is simplified for the first poses, and for the others [m]."""


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


def best_placement(
    tube: shapely.Polygon, area: Area, *, seed: int = 0, enough: float = math.inf
) -> Placement:
    """Return the start pose at which a tube keeps the largest distance.

    Parameters
    ----------
    tube : shapely.Polygon
        Of the maneuver, from its start pose.
    area : Area
        With the region of start poses.
    seed : int
        Of the search.
    enough : float
        Distance at which the search ends [m].
    """
    bounds = shapely.Polygon(area.keep_in)
    # in a convex area the corners of the hull come closest to the border
    convex = bool(bounds.convex_hull.area < bounds.area + 1e-9)
    rough = _Sampled.of(shapely.simplify(tube, ROUGH), area, by_hull=True)
    fine = _Sampled.of(shapely.simplify(tube, FINE), area, by_hull=convex)
    rng = np.random.default_rng(seed)
    low, high, around = _limits(area)
    poses = _grid(low, high, around)
    poses = poses[_best(rough.clearance(poses), CANDIDATES)]
    found = fine.clearance(poses)
    best = _best(found, STARTS)
    poses, found = poses[best], found[best]
    reach = np.maximum((high - low) / np.array([PLACES, PLACES, HEADINGS]), 0.0)
    for _ in range(ROUNDS):
        if found.max() > enough:
            break
        steps = rng.uniform(-1.0, 1.0, (len(poses), STEPS, 3)) * reach
        tried = np.clip(poses[:, None] + steps, low, high)
        values = fine.clearance(tried.reshape(-1, 3)).reshape(len(poses), STEPS)
        pick = np.argmax(values, axis=1)
        better = values[np.arange(len(poses)), pick] > found
        poses = np.where(better[:, None], tried[np.arange(len(poses)), pick], poses)
        found = np.maximum(found, values.max(axis=1))
        reach = 0.6 * reach
    x, y, heading = poses[np.argmax(found)]
    return Placement(
        float(x),
        float(y),
        float(np.angle(np.exp(1j * heading))),
        _exact_clearance(at_pose(tube, float(x), float(y), float(heading)), area, found.max()),
    )


def at_pose(tube: shapely.Polygon, x: float, y: float, heading: float) -> shapely.Polygon:
    """Return a tube in the area's frame.

    Parameters
    ----------
    tube : shapely.Polygon
        From its start pose.
    x, y, heading : float
        Start pose [m, m, rad].
    """
    return shapely.transform(tube, lambda points: placed(points, x, y, heading))


def _limits(area: Area) -> tuple[FloatArray, FloatArray, bool]:
    """Lowest and highest pose (3,), and whether any heading is allowed."""
    corners, start = area.keep_in, area.start
    low = np.array([*np.maximum(corners.min(axis=0), [start.x[0], start.y[0]]), start.heading[0]])
    high = np.array([*np.minimum(corners.max(axis=0), [start.x[1], start.y[1]]), start.heading[1]])
    return low, np.maximum(low, high), bool(np.ptp(start.heading) > 2.0 * np.pi - 1e-6)


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
        return cls(area, outline, rings_of(tube), np.concatenate([np.empty((0, 2)), *obstacles]))

    def clearance(self, poses: FloatArray) -> FloatArray:
        """Clearance (p,) of the tube at poses (p, 3)."""
        x, y, heading = poses.T
        clearance: FloatArray = self.area.clearance(placed(self.outline, x, y, heading)).min(-1)
        if len(self.obstacles):
            seen = seen_from(self.obstacles, x, y, heading)
            clearance = np.minimum(clearance, -signed_distance(seen, self.rings).max(axis=-1))
        return clearance


def _points(polygon: shapely.Polygon) -> FloatArray:
    """Points (t, 2) along the outline of a polygon."""
    return np.asarray(shapely.get_coordinates(shapely.segmentize(polygon.exterior, SPACING)))


def _exact_clearance(tube: shapely.Polygon, area: Area, sampled: float) -> float:
    """Clearance of a tube in the area's frame; `sampled` where it reaches out."""
    bounds = shapely.Polygon(area.keep_in)
    obstacles = [shapely.Polygon(corners) for corners in area.keep_out]
    if not bounds.contains(tube) or any(tube.intersects(one) for one in obstacles):
        return float(min(sampled, 0.0))
    lines = [bounds.exterior, *obstacles]
    return float(min(shapely.distance(tube, line) for line in lines))
