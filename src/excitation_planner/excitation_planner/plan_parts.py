"""Messages that accompany a plan's commands: the same stamp, in any order."""

from collections import deque
from typing import TypedDict

import numpy as np

from excitation_planner.area.fence import Fence
from excitation_planner.area.polygons import Rings
from excitation_planner.schedule import MAX_ROWS
from tricycle_core.errors import PlanError
from tricycle_core.poses import Pose
from tricycle_core.quantities import FloatArray
from tricycle_sim.commands import LONGEST

KEPT = 8
"""Paths, lead-ins and areas that are kept until the commands with the same stamp arrive."""


class AreaParts(TypedDict, total=False):
    """What has come of a plan's area, each on the topic `maneuver/…` of its name."""

    ground: tuple[str, Rings]  # frame and rings [m]; no ring where the plan has no area
    footprint: FloatArray  # (m, 2) corners in the body frame [m]
    planned_start: Pose  # m, m, rad
    twist: FloatArray  # (c,) curvature of each command [1/m]


class PlanParts:
    """Keeps the newest paths, lead-ins and areas, by the stamp of their messages [ns]."""

    def __init__(self) -> None:
        self._paths: deque[tuple[int, FloatArray]] = deque(maxlen=KEPT)
        self._lead_ins: deque[tuple[int, float]] = deque(maxlen=KEPT)
        self._areas: dict[int, AreaParts] = {}  # by stamp

    def add_path(self, points: FloatArray, stamp: int = 0) -> None:
        """Take the path of the schedule with the same stamp, for the deviation limit.

        Parameters
        ----------
        points : ndarray of float, shape (m, 2)
            Relative to the start pose [m].
        stamp : int
            Stamp of its message [ns]; path and schedule may come in either order.

        Raises
        ------
        PlanError
            If it has too few or too many points, or one is not finite.
        """
        if not 2 <= len(points) <= MAX_ROWS:
            raise PlanError(f"{len(points)} points; needs 2 to {MAX_ROWS}")
        finite = np.isfinite(points).all(axis=1)
        if not finite.all():
            raise PlanError(f"point {int(np.argmin(finite))} holds a number that is not finite")
        self._paths.append((stamp, points))

    def add_lead_in(self, end: float, stamp: int = 0) -> None:
        """Take how long the schedule with the same stamp leads straight ahead, closed loop.

        Parameters
        ----------
        end : float
            Time since the start of the maneuver [s].
        stamp : int
            Stamp of its message [ns]; it and the schedule may come in either order.

        Raises
        ------
        PlanError
            If it is no time.
        """
        if not 0.0 <= end <= LONGEST:
            raise PlanError(f"end at {end:g} s: needs a time from 0 to {LONGEST:g} s")
        self._lead_ins.append((stamp, end))

    def add_area(self, some: AreaParts, stamp: int = 0) -> None:
        """Take one or more parts of the area of the schedule with the same stamp.

        Parameters
        ----------
        some : AreaParts
            Parts that have come.
        stamp : int
            Stamp of their message [ns]; parts and schedule may come in any order.
        """
        self._areas.setdefault(stamp, {}).update(some)
        if len(self._areas) > KEPT:
            del self._areas[next(iter(self._areas))]  # the oldest

    def path(self, stamp: int) -> FloatArray | None:
        """Return the path (m, 2) of the commands with a stamp [m]; None if none has come.

        Parameters
        ----------
        stamp : int
            Stamp of the commands [ns].
        """
        paths = [points for of, points in self._paths if of == stamp]
        return paths[-1] if paths else None

    def lead_in_end(self, stamp: int) -> float:
        """Return for how long the commands with a stamp lead straight ahead [s]; at least 0.

        Parameters
        ----------
        stamp : int
            Stamp of the commands [ns].
        """
        ends = [end for of, end in self._lead_ins if of == stamp]
        return ends[-1] if ends else 0.0

    def fence(self, stamp: int, rows: int, *, needed: bool) -> Fence | None:
        """Return the fence of the plan's area; None without an area.

        Parameters
        ----------
        stamp : int
            Stamp of the commands [ns].
        rows : int
            Number of the commands.
        needed : bool
            Whether a plan must state its ground, even if only that it has none.

        Raises
        ------
        PlanError
            If a part is missing, or does not fit the commands.
        """
        if not self._areas and not needed:
            return None
        parts = self._areas.get(stamp, {})
        if "ground" in parts and not parts["ground"][1]:
            return None
        if missing := [part for part in AreaParts.__annotations__ if part not in parts]:
            raise PlanError(
                f"nothing on maneuver/{missing[0]} with the stamp of the commands; publish both "
                "with one stamp"
                + (
                    " (an empty one where there is no area), or set unfenced_plans"
                    if missing[0] == "ground" and needed
                    else ""
                )
            )
        frame, rings = parts["ground"]
        fence = Fence(frame, rings, parts["footprint"], parts["twist"], parts["planned_start"])
        if len(fence.curvature) != rows:
            raise PlanError(
                f"{len(fence.curvature)} rows on maneuver/twist; the commands have {rows}"
            )
        return fence
