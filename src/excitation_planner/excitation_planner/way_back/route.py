"""A route on the ground from pose to pose: Dubins paths forwards and backwards, pose by pose.

Poses are drawn on the ground, each is tied to each by its Dubins paths, and the shortest chain is
looked for; whether the vehicle has room on a path is looked at only where the chain takes it (lazy
probabilistic roadmap: R. Bohlin, L. E. Kavraki, "Path planning using lazy PRM", ICRA 2000). Where
that finds none, poses are added that arcs lead to from both ends, in many turns out of a corner
(expansive trees: D. Hsu, J.-C. Latombe, R. Motwani, "Path planning in expansive configuration
spaces", ICRA 1997).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from excitation_planner.area.polygons import Rings, contains
from excitation_planner.area.stops import RUN_OUT
from excitation_planner.way_back.dubins import WORDS, Arc, dubins_arcs, dubins_lengths
from tricycle_core.errors import PlanError
from tricycle_core.poses import Pose, placed, seen_from
from tricycle_core.quantities import FloatArray

APPROACHES = (1.5, 3.0, 5.0)
"""Lengths of the straight line into the goal, along which deviations die out [m]."""

SHORT_APPROACH = 0.75
"""Length of one where these lead to no route [m]; a shorter one would leave deviations."""

CLEARANCES = (0.15, 0.05)
"""Kept from the border of the ground, for what the pursuit deviates [m]; the second if need be."""

CHANGE = 2.0
"""Length that a stop between two paths counts for [m]."""

POSES = 60
"""Poses drawn on the ground, and arcs tried from each end."""

ARCS = (0.3, 5.0)
"""Shortest and longest of these arcs [m]."""

PATHS = 400
"""Paths that are looked at in each search."""

SPACING = 0.2
"""Distance between the poses of a path that are checked [m]."""

ALONG = 0.7
"""Distance between the points of the border that are checked, as a share of the vehicle's width."""


@dataclass(frozen=True)
class RouteRequest:
    """Poses, radius and ground between which a route is searched.

    Attributes
    ----------
    start, goal : (float, float, float)
        Poses of the middle of the unsteered axle [m, m, rad].
    radius : float
        Radius of the tightest arcs [m].
    ground : sequence of ndarray of float, each of shape (n, 2)
        Outlines and holes of where the footprint may be [m]; empty: anywhere.
    footprint : ndarray of float, shape (m, 2)
        Corners of the vehicle, relative to the axle's pose [m].
    """

    start: Pose
    goal: Pose
    radius: float
    ground: Rings = ()
    footprint: FloatArray = field(default_factory=lambda: np.empty((0, 2)))


def find_route(
    request: RouteRequest, abandoned: Callable[[], bool] = lambda: False
) -> tuple[Arc, ...]:
    """Return the arcs of the shortest route found; the same one for the same request.

    Parameters
    ----------
    request : RouteRequest
        Start, goal, radius and ground.
    abandoned : callable
        Called before each path that is looked at; the search ends where it returns True.

    Raises
    ------
    PlanError
        If there is none, or the search was abandoned.
    """
    none = "no way back to the start:"
    if not FreeGround(request, CLEARANCES[-1]).holds(*np.array([request.start]).T):
        raise PlanError(
            f"{none} the vehicle is not {CLEARANCES[-1]:g} m inside the ground less its margin; "
            "drive it there by hand"
        )
    for clearance in CLEARANCES:
        ground = FreeGround(request, clearance, abandoned)
        for approaches, arcs in ((APPROACHES, 0), ((*APPROACHES, SHORT_APPROACH), POSES)):
            legs = [_into(request.goal, way) for a in approaches for way in (a, -a)]
            legs = [leg for leg in legs if ground.free((leg,))]
            if route := _search(ground, request, legs, arcs):
                return route
    lacks = "room to turn" if legs else f"{SHORT_APPROACH:g} m straight ahead of it or behind it"
    raise PlanError(f"{none} the ground less its margin leaves no {lacks}; drive it by hand")


class FreeGround:
    """Poses and arcs of a request that keep the vehicle on the ground.

    Parameters
    ----------
    request : RouteRequest
        Request with ground and footprint.
    clearance : float
        Distance kept from the border of the ground [m].
    abandoned : callable
        As for `find_route`.
    """

    def __init__(
        self,
        request: RouteRequest,
        clearance: float = CLEARANCES[0],
        abandoned: Callable[[], bool] = lambda: False,
    ) -> None:
        self.ground, self._abandoned = request.ground, abandoned
        self._request = request
        if not request.ground:
            return
        import shapely  # only who looks for a route on a ground needs it

        grown = shapely.Polygon(request.footprint).buffer(clearance, join_style="mitre")
        self._footprint = np.asarray(grown.exterior.coords)[:-1]
        # points along it, so that a thin wall has some within a footprint that lies across it
        sides = np.hypot(*np.diff(self._footprint, axis=0).T)
        apart = max(ALONG * float(sides.min()), SPACING)
        rings = (shapely.segmentize(shapely.LinearRing(r), apart) for r in request.ground)
        self._border = np.concatenate([np.asarray(ring.coords)[:-1] for ring in rings])

    def holds(self, x: FloatArray, y: FloatArray, heading: FloatArray) -> NDArray[np.bool_]:
        """Return whether the footprint is on the ground.

        Parameters
        ----------
        x, y, heading : ndarray of float, shape (n,)
            Poses [m, m, rad].

        Returns
        -------
        free : ndarray of bool, shape (n,)
            Whether the footprint is on the ground at each pose.
        """
        if not self.ground:
            return np.ones(np.shape(x), bool)
        corners = contains(placed(self._footprint, x, y, heading), self.ground).all(axis=-1)
        border = contains(seen_from(self._border, x, y, heading), (self._footprint,))
        return np.asarray(corners & ~border.any(axis=-1))

    def free(self, arcs: tuple[Arc, ...]) -> bool:
        """Return whether a path is on the ground, with the room to stop beyond each of its arcs.

        Parameters
        ----------
        arcs : tuple of Arc
            One after the other.

        Raises
        ------
        PlanError
            If the search was abandoned.
        """
        if self._abandoned():
            raise PlanError("the search for a way back was abandoned")
        if not self.ground:
            return True
        poses = []
        for arc in arcs:
            way = abs(arc.length) + RUN_OUT
            s = np.copysign(np.linspace(0.0, way, 2 + int(way / SPACING)), arc.length)
            poses.append(arc.at(s))
        return bool(self.holds(*np.concatenate(poses, axis=1)).all())

    def draw(self, rng: np.random.Generator, number: int) -> FloatArray:
        """Return random poses on the ground, without one around start and goal.

        Parameters
        ----------
        rng : Generator
            Random generator.
        number : int
            Largest number of poses.

        Returns
        -------
        poses : ndarray of float, shape (n, 3)
            x, y, heading [m, m, rad].
        """
        request = self._request
        if self.ground:
            corners = self._border
        else:
            ends, around = np.array([request.start[:2], request.goal[:2]]), 3.0 * request.radius
            corners = np.vstack([ends - around, ends + around])
        low, high = corners.min(axis=0), corners.max(axis=0)
        tries = 20 * number
        poses = np.column_stack(
            [rng.uniform(low, high, (tries, 2)), rng.uniform(-np.pi, np.pi, tries)]
        )
        # half of them lined up with the goal or across it: from there a straight line leads in
        lined = rng.integers(0, 4, tries) * 0.5 * np.pi + request.goal[2]
        poses[::2, 2] = lined[::2]
        return poses[self.holds(*poses.T)][:number]

    def grow(self, rng: np.random.Generator, root: Pose, number: int) -> FloatArray:
        """Return poses to and from which free arcs lead, from one pose and from one another.

        Parameters
        ----------
        rng : Generator
            Random generator.
        root : (float, float, float)
            The first pose [m, m, rad].
        number : int
            Number of arcs that are tried.

        Returns
        -------
        poses : ndarray of float, shape (n, 3)
            x, y, heading, the first one too [m, m, rad].
        """
        poses = [root]
        for _ in range(number):
            start = poses[rng.integers(len(poses))]
            curvature = float(rng.integers(-1, 2)) / self._request.radius
            there = Arc(start, curvature, float(rng.choice([-1.0, 1.0]) * rng.uniform(*ARCS)))
            if self.free((there, Arc(there.end, curvature, -there.length))):
                poses.append(there.end)
        return np.array(poses)


def _into(goal: Pose, way: float) -> Arc:
    """Straight line into the goal."""
    return Arc(Arc(goal, 0.0, -way).end, 0.0, way)


def _search(
    ground: FreeGround, request: RouteRequest, legs: list[Arc], arcs: int
) -> tuple[Arc, ...]:
    """Shortest chain of free paths over one of the legs to the goal; empty: none."""
    if not legs:
        return ()
    rng = np.random.default_rng(0)
    begins = np.array([request.start, *(leg.start for leg in legs)])
    poses = [begins, ground.draw(rng, POSES)]
    if arcs:
        poses += [ground.grow(rng, end, arcs) for end in (request.start, request.goal)]
    return _chain(np.vstack(poses), legs, ground, request)


def _chain(
    poses: FloatArray, legs: list[Arc], ground: FreeGround, request: RouteRequest
) -> tuple[Arc, ...]:
    """Shortest chain of free paths from the first pose, over a leg from one of the next."""
    from scipy.sparse.csgraph import dijkstra

    n = len(poses)
    forwards = dubins_lengths(poses, poses, request.radius)
    lengths = np.concatenate([forwards, -forwards[:, ::-1].transpose(0, 1, 3, 2)])  # (12, 3, n, n)
    words = WORDS + tuple(word[::-1] for word in WORDS)
    cost = np.abs(lengths).sum(axis=1) + CHANGE  # (12, n, n)
    cost[:, np.arange(n), np.arange(n)] = np.inf
    graph = np.full((n + 1, n + 1), np.inf)
    graph[:n, :n] = cost.min(axis=0)
    graph[1 : 1 + len(legs), n] = [abs(leg.length) for leg in legs]
    for _ in range(PATHS):
        distance, before = dijkstra(graph, indices=0, return_predecessors=True)
        if not np.isfinite(distance[n]):
            break
        node = int(before[n])
        route: tuple[Arc, ...] = (legs[node - 1],)
        while node != 0:
            last = int(before[node])
            word = int(np.argmin(cost[:, last, node]))
            start: Pose = tuple(poses[last].tolist())
            path = dubins_arcs(start, words[word], lengths[word, :, last, node], request.radius)
            if not ground.free(path):
                cost[word, last, node] = np.inf
                graph[last, node] = cost[:, last, node].min()
                break
            route = path + route
            node = last
        else:
            return route
    return ()
