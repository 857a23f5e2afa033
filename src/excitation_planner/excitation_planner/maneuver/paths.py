"""Maneuver families that prescribe a path: circle, double lane change, slalom."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from excitation_planner.box import Box
from excitation_planner.maneuver.family import (
    ACCELERATION,
    PATH_SPACING,
    SETTLING_TIME,
    DrivenPath,
    path_point,
)
from tricycle_core.errors import PlanError
from tricycle_core.quantities import FloatArray
from tricycle_sim.vehicle import Vehicle

LEAD_OUT = 6.0  # m of path beyond its end, so that the look-ahead point always exists

CIRCLE_OPERATION = Box.of({"radius": (2.0, 6.0), "speed": (0.6, 1.0)})  # m, m/s
LANE_CHANGE_OPERATION = Box.of({"d1": (0.0, 8.0), "d2": (0.0, 8.0)})  # m
SLALOM_OPERATION = Box.of({"spacing": (2.0, 6.0), "offset": (0.1, 1.0)})  # m


def _run_in_length(speed: float) -> float:
    return 0.5 * speed**2 / ACCELERATION + SETTLING_TIME * speed


def evenly_spaced(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a dense polyline resampled at `PATH_SPACING` of its arc length.

    Parameters
    ----------
    x, y : ndarray of float, shape (m,)
        Points [m].
    """
    arc = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))))
    wanted = np.arange(0.0, arc[-1], PATH_SPACING)
    return np.interp(wanted, arc, x), np.interp(wanted, arc, y)


def _bezier(points: FloatArray, n: int) -> FloatArray:
    """Cubic Bézier curve with control points (4, 2), at n parameter values: (n, 2)."""
    t = np.linspace(0.0, 1.0, n)[:, None]
    p0, p1, p2, p3 = points
    return np.asarray(
        (1 - t) ** 3 * p0 + 3 * (1 - t) ** 2 * t * p1 + 3 * (1 - t) * t**2 * p2 + t**3 * p3
    )


@dataclass(frozen=True)
class Circle:
    """Steady-state circle to the left: x = (radius in m, speed in m/s).

    The speed range is our reading of a misprint in the paper (section 5).

    Attributes
    ----------
    operation : Box
        Ranges of x.
    duration : float
        Time on the circle [s].
    """

    operation: Box = CIRCLE_OPERATION
    duration: float = 20.0
    name: ClassVar[str] = "circle"

    def drive(self, x: FloatArray, vehicle: Vehicle) -> DrivenPath:
        """Return the run-in along +x, and the circle to the left at its end.

        Parameters
        ----------
        x : ndarray of float, shape (2,)
            Radius [m] and speed [m/s].
        vehicle : Vehicle
            Vehicle; only its nominal values count.
        """
        radius, speed = (float(v) for v in x)
        if radius <= 0.0:
            raise PlanError(f"radius {radius:g} m must be above 0")
        run_in = _run_in_length(speed)
        arc = np.arange(0.0, speed * self.duration + LEAD_OUT, PATH_SPACING / 4)
        start = path_point(vehicle)
        px = np.concatenate(([start], start + run_in + radius * np.sin(arc / radius)))
        py = np.concatenate(([0.0], radius * (1.0 - np.cos(arc / radius))))
        return DrivenPath(*evenly_spaced(px, py), speed, run_in + speed * self.duration)


@dataclass(frozen=True)
class DoubleLaneChange:
    """S-shaped cubic Bézier curves out and back: x = handle lengths (d1, d2) in m.

    Control points (0,0), (d1,0), (L-d2,W), (L,W), then (L,W), (L+d1,W), (2L-d2,0), (2L,0).

    Attributes
    ----------
    operation : Box
        Ranges of x.
    length : float
        L, of one lane change [m].
    width : float
        W, lateral offset [m].
    speed : float
        Cruise speed [m/s].
    lead_out : float
        Distance driven straight on after the second change [m].
    """

    operation: Box = LANE_CHANGE_OPERATION
    length: float = 16.0
    width: float = 2.0
    speed: float = 2.0
    lead_out: float = 2.0
    name: ClassVar[str] = "double_lane_change"

    def drive(self, x: FloatArray, vehicle: Vehicle) -> DrivenPath:
        """Return the run-in along +x, the two lane changes, and straight on.

        Parameters
        ----------
        x : ndarray of float, shape (2,)
            Handle lengths d1 and d2 [m].
        vehicle : Vehicle
            Vehicle; only its nominal values count.
        """
        d1, d2 = (float(v) for v in x)
        if self.length < d1 + d2 - np.sqrt(d1 * d2):
            raise PlanError(
                f"with d1 = {d1:g} m and d2 = {d2:g} m the path runs "
                f"backwards; the length must be at least {d1 + d2 - np.sqrt(d1 * d2):.2f} m"
            )
        run_in, L, W = _run_in_length(self.speed), self.length, self.width
        out = _bezier(np.array([(0, 0), (d1, 0), (L - d2, W), (L, W)], dtype=float), 2000)
        back = np.array([L, 0.0]) + out * [1, -1] + [0, W]
        points = np.concatenate(
            (
                [(-run_in, 0.0)],
                out,
                back[1:],
                [(2 * L + self.lead_out + LEAD_OUT, 0.0)],
            )
        )
        points[:, 0] += run_in + path_point(vehicle)
        px, py = evenly_spaced(points[:, 0], points[:, 1])
        return DrivenPath(px, py, self.speed, (px.size - 1) * PATH_SPACING - LEAD_OUT)


@dataclass(frozen=True)
class Slalom:
    """Between gates on a straight line: x = (spacing of the gates, offset to either side) in m.

    A sine that passes gate k at (k spacing, ±offset), faded in and out over one spacing.

    Attributes
    ----------
    operation : Box
        Ranges of x.
    gates : float
        Number of gates; what is beyond a whole number goes into the last spacing.
    speed : float
        Cruise speed [m/s].
    lead_out : float
        Distance driven straight on after the last gate [m].
    """

    operation: Box = SLALOM_OPERATION
    gates: float = 6.0
    speed: float = 2.0
    lead_out: float = 2.0
    name: ClassVar[str] = "slalom"

    def drive(self, x: FloatArray, vehicle: Vehicle) -> DrivenPath:
        """Return the run-in along +x, the gates, and straight on.

        Parameters
        ----------
        x : ndarray of float, shape (2,)
            Spacing of the gates and offset [m].
        vehicle : Vehicle
            Vehicle; only its nominal values count.
        """
        spacing, offset = (float(v) for v in x)
        gate = np.linspace(0.0, self.gates + 1.0, round(400 * (self.gates + 1.0)))
        from_end = np.minimum(gate, self.gates + 1.0 - gate)
        fade = 0.5 * (1.0 - np.cos(np.pi * np.minimum(from_end, 1.0)))
        start, run_in = path_point(vehicle), _run_in_length(self.speed)
        end = start + run_in + spacing * (self.gates + 1.0) + self.lead_out
        px = np.concatenate(([start], start + run_in + spacing * gate, [end + LEAD_OUT]))
        py = np.concatenate(([0.0], -offset * fade * np.cos(np.pi * gate), [0.0]))
        px, py = evenly_spaced(px, py)
        return DrivenPath(px, py, self.speed, (px.size - 1) * PATH_SPACING - LEAD_OUT)
