"""The fence: whether a vehicle that is stopped now stays on its ground.

The driver asks it at every tick and waits; `benchmarks/hot_paths.py --fence` measures how long.
It checks the stops that the plan's tube covers: the longest of the published ones, on the arc of
the present motion and on the one that the commands lead to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from excitation_planner.area.polygons import Rings, signed_distance
from excitation_planner.area.stops import longest_stop, stopping_path
from excitation_planner.localisation import PlanarState
from tricycle_core.errors import PlanError
from tricycle_core.poses import Pose, placed, seen_from
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK

START_POSITION_TOLERANCE = 0.05
"""Distance from the planned start pose at which a vehicle may start [m]."""

START_HEADING_TOLERANCE = math.radians(1.0)
"""Deviation from the planned heading at which a vehicle may start [rad]."""

CREEP = 0.05
"""Speed below which noise hides the direction of the motion [m/s]: the command's counts."""

SPACING = 0.25
"""Largest distance between the poses that are checked on a stop [m]; a tick moves them by less."""

ARC_SPACING = 0.25
"""Distance between the ends of the arcs that are checked while the wheels turn [m]."""

MAX_ARCS = 16
"""Largest number of these arcs, whatever the distance of their ends."""

LONGEST_WAY = 200.0
"""Longest stop that is predicted [m]: a longer one is from a pose that is 10 s old, or wrong."""

TIGHTEST = 100.0
"""Curvature beyond which a message is wrong, whatever the vehicle [1/m]."""

BLOCK = 8
"""Poses on each arc that are checked together, the nearest ones first."""


@dataclass(frozen=True)
class Fence:
    """Ground that the driver keeps a vehicle on.

    Attributes
    ----------
    frame : str
        Frame in which ground and start are given.
    ground : sequence of ndarray of float, each of shape (n, 2)
        Outlines and holes of where the footprint may be [m].
    footprint : ndarray of float, shape (m, 2)
        Corners in the body frame [m].
    curvature : ndarray of float, shape (c,)
        Curvature of the path at each command, without slip, left positive [1/m].
    start : (float, float, float)
        Planned pose of `base_link` [m, m, rad].

    Raises
    ------
    PlanError
        If a polygon has fewer than three finite corners, the footprint crosses itself, a number is
        not finite, or no vehicle has such a curvature.
    """

    frame: str
    ground: Rings
    footprint: FloatArray
    curvature: FloatArray
    start: Pose
    _border: NDArray[np.object_] = field(init=False, repr=False)  # rings of the ground
    _insides: NDArray[np.object_] = field(init=False, repr=False)  # polygon of each ring
    _reach: float = field(init=False, repr=False)
    _spacing: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        import shapely  # only who has an area needs it, and not in the first tick

        for name, rings in (("ground", self.ground), ("footprint", (self.footprint,))):
            if not rings or any(len(r) < 3 or not np.isfinite(r).all() for r in rings):
                raise PlanError(f"{name}: needs polygons of three finite corners or more")
        if not (np.isfinite(self.curvature).all() and np.isfinite(self.start).all()):
            raise PlanError("curvature and start of an area must be finite numbers")
        if (sharpest := float(np.abs(self.curvature).max(initial=0.0))) > TIGHTEST:
            raise PlanError(
                f"curvature: {sharpest:.4g} 1/m, sharper than any vehicle turns ({TIGHTEST:g} 1/m)"
            )
        if not shapely.is_valid(shapely.polygons(self.footprint)):
            raise PlanError("footprint: crosses itself, or has no area")
        border = np.array([shapely.linearrings(ring) for ring in self.ground])
        object.__setattr__(self, "_border", border)
        object.__setattr__(self, "_insides", shapely.polygons(border))
        object.__setattr__(self, "_reach", float(np.hypot(*self.footprint.T).max()))
        # footprints one after the other overlap: the border cannot pass between them
        width = float(np.ptp(self.footprint, axis=0).min())
        object.__setattr__(self, "_spacing", min(SPACING, 0.5 * width))

    def off_start(self, state: PlanarState) -> str:
        """Return how far a vehicle stands from the planned start; empty within the tolerances.

        Parameters
        ----------
        state : PlanarState
            Pose of the vehicle.
        """
        x, y, heading = self.start
        ahead, left = seen_from(np.array([[state.x, state.y]]), x, y, heading)[0]
        turn = math.remainder(state.yaw - heading, math.tau)
        near = math.hypot(ahead, left) <= START_POSITION_TOLERANCE
        if near and abs(turn) <= START_HEADING_TOLERANCE:
            return ""
        return (
            f"{_directed(ahead, 'ahead', 'back')} and {_directed(left, 'left', 'right')} of the "
            f"planned start, heading {abs(math.degrees(turn)):.1f} deg to the "
            f"{'left' if turn > 0 else 'right'} (at most {START_POSITION_TOLERANCE:g} m and "
            f"{math.degrees(START_HEADING_TOLERANCE):g} deg)"
        )

    def trespass(self, state: PlanarState, *, age: float, curvature: float, push: float) -> str:
        """Return where a stop would leave the ground; empty if it would not.

        Parameters
        ----------
        state : PlanarState
            Pose and motion of the vehicle.
        age : float
            Time since that was measured [s]; the vehicle has moved on meanwhile.
        curvature : float
            Curvature without slip to which the commands lead, left positive [1/m].
        push : float
            Sign of the commanded drive: positive forwards, negative backwards, 0 none; it counts
            where the vehicle creeps.
        """
        import shapely

        if state.frame != self.frame:
            return f"the area is in frame '{self.frame}', the pose on odom in '{state.frame}'"
        if not state.turns_known:
            return "odom has no turn rate, without which no stop can be predicted"
        if state.implausible:
            return state.implausible
        creeps = state.speed <= CREEP
        delay = max(age, 0.0) + TICK
        way = 0.0
        if not creeps or push != 0.0:
            way = state.speed * delay + float(longest_stop(np.array(state.speed)))
        if not way <= LONGEST_WAY:
            return f"fence: a stop would take {way:.4g} m, from a pose {age:.4g} s old"
        here = shapely.Point(state.x, state.y)
        border = self._border[shapely.dwithin(self._border, here, way + self._reach)]
        corner = placed(self.footprint[:1], state.x, state.y, state.yaw)
        if not self._on_ground(corner).all():
            return self._out(state)
        if not border.size:
            return ""  # whatever the direction
        slip = (0.0 if push >= 0.0 else math.pi) if creeps else state.slip
        now = 0.0 if creeps else state.yaw_rate / state.speed
        then = math.copysign(1.0, math.cos(slip)) * curvature
        # while the wheels turn, the stop lies between the arcs
        apart = 0.5 * abs(then - now) * way**2
        arcs = np.linspace(now, then, min(2 + int(apart / ARC_SPACING), MAX_ARCS))
        points = 1 + math.ceil(way / self._spacing)
        ways = np.linspace(0.0, way, points)
        poses = stopping_path(state.x, state.y, state.yaw, slip, way, arcs, points=points)
        corners = placed(self.footprint, *poses)
        # a corner is on the ground now: so is each footprint before the first that meets the border
        lines = shapely.multilinestrings(border)
        shapely.prepare(lines)
        for first in range(0, points, BLOCK):
            block = corners[:, first : first + BLOCK]
            boxes = shapely.box(*block.min(axis=(1, 2)).T, *block.max(axis=(1, 2)).T)
            block = block[shapely.intersects(lines, boxes)]  # few of the arcs
            out = shapely.intersects(lines, shapely.polygons(block)).any(axis=0)
            if out.any():
                ahead = float(ways[first + int(np.argmax(out))])
                if ahead == 0.0:
                    return self._out(state)
                return f"fence: would come out of the area less its margin in {ahead:.1f} m"
        return ""

    def _on_ground(self, points: FloatArray) -> NDArray[np.bool_]:
        """Whether points (n, 2) are in an outline and in no hole: in an odd number of rings."""
        import shapely

        within = shapely.contains_xy(self._insides[:, np.newaxis], *points.T)
        return np.asarray(np.count_nonzero(within, axis=0) % 2 == 1)

    def _out(self, state: PlanarState) -> str:
        """How far the vehicle is out: its corners off the ground, or the border's within it."""
        import shapely

        corners = placed(self.footprint, state.x, state.y, state.yaw)
        off = shapely.points(corners[~self._on_ground(corners)])
        here = shapely.Point(state.x, state.y)
        near = self._border[shapely.dwithin(self._border, here, self._reach)]
        seen = seen_from(shapely.get_coordinates(near), state.x, state.y, state.yaw)
        depth = max(
            shapely.distance(self._border[:, np.newaxis], off).min(axis=0).max(initial=0.0),
            signed_distance(seen, (self.footprint,)).max(initial=0.0),
        )
        return f"fence: {depth:.2f} m out of the area less its margin"


def _directed(value: float, positive: str, negative: str) -> str:
    return f"{abs(value):.2f} m {positive if value > 0 else negative}"
