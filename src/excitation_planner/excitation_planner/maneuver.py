"""Maneuver families: from operation parameters to the path and the speed to drive.

A family maps its operation parameters x (the design variables) to a `Drive`: the path that the
rear axle's ground point follows and the speed along it. Every drive begins at rest with a
straight run-in, so that the vehicle has settled when the path proper begins.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from excitation_planner.box import Box

Floats = NDArray[np.float64]

ACCELERATION = 1.0  # m/s^2, of the run-in's speed ramp
SETTLING_TIME = 1.0  # s at cruise speed before the path proper begins
PATH_SPACING = 0.02  # m between path points
LEAD_OUT = 6.0  # m of path beyond its end, so that the look-ahead point always exists


CIRCLE_OPERATION = Box.of({"radius": (2.0, 6.0), "speed": (0.6, 1.0)})  # m, m/s
LANE_CHANGE_OPERATION = Box.of({"d1": (0.0, 8.0), "d2": (0.0, 8.0)})  # m


class PlanError(ValueError):
    """A maneuver or plan that cannot be made, read or driven."""


@dataclass(frozen=True)
class Drive:
    """A path and how to drive it.

    Attributes
    ----------
    x, y
        (m,) points of the path in m, frame `odom`, evenly spaced along it; the first is the
        start of the rear axle's ground point.
    speed
        Cruise speed in m/s, reached from rest with `ACCELERATION`.
    length
        Arc length in m after which the maneuver ends; the points go on beyond it.
    """

    x: Floats
    y: Floats
    speed: float
    length: float


class ManeuverFamily(Protocol):
    """What the planner needs to know of a family."""

    @property
    def name(self) -> str:
        """Name with underscores."""
        ...

    @property
    def operation(self) -> Box:
        """The box of the operation parameters, in their order."""
        ...

    def drive(self, x: Floats, start: float) -> Drive:
        """Path and speed for the operation parameters x (l,), from (start, 0) along +x."""
        ...


def _run_in_length(speed: float) -> float:
    return 0.5 * speed**2 / ACCELERATION + SETTLING_TIME * speed


def _evenly_spaced(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Resample a dense polyline (m,) at `PATH_SPACING` of its arc length."""
    arc = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))))
    wanted = np.arange(0.0, arc[-1], PATH_SPACING)
    return np.interp(wanted, arc, x), np.interp(wanted, arc, y)


def _bezier(points: Floats, n: int) -> Floats:
    """Cubic Bézier curve with control points (4, 2), at n parameter values: (n, 2)."""
    t = np.linspace(0.0, 1.0, n)[:, None]
    p0, p1, p2, p3 = points
    return np.asarray(
        (1 - t) ** 3 * p0 + 3 * (1 - t) ** 2 * t * p1 + 3 * (1 - t) * t**2 * p2 + t**3 * p3
    )


@dataclass(frozen=True)
class Circle:
    """Steady-state circle to the left: x = (radius in m, speed in m/s), driven for `duration`.

    The speed range is our reading of a misprint in the paper (section 5).
    """

    operation: Box = CIRCLE_OPERATION
    duration: float = 20.0  # s on the circle
    name: ClassVar[str] = "circle"

    def drive(self, x: Floats, start: float) -> Drive:
        """Run-in along +x, then the circle about (run-in, radius)."""
        radius, speed = (float(v) for v in x)
        run_in = _run_in_length(speed)
        arc = np.arange(0.0, speed * self.duration + LEAD_OUT, PATH_SPACING / 4)
        px = np.concatenate(([start], start + run_in + radius * np.sin(arc / radius)))
        py = np.concatenate(([0.0], radius * (1.0 - np.cos(arc / radius))))
        return Drive(*_evenly_spaced(px, py), speed, run_in + speed * self.duration)


@dataclass(frozen=True)
class DoubleLaneChange:
    """S-shaped cubic Bézier curves out and back: x = handle lengths (d1, d2) in m.

    Control points (0,0), (d1,0), (L-d2,W), (L,W), then (L,W), (L+d1,W), (2L-d2,0), (2L,0).
    """

    operation: Box = LANE_CHANGE_OPERATION
    length: float = 16.0  # m, L: of one lane change
    width: float = 2.0  # m, W: lateral offset
    speed: float = 2.0  # m/s
    lead_out: float = 2.0  # m, driven straight on after the second change
    name: ClassVar[str] = "double_lane_change"

    def drive(self, x: Floats, start: float) -> Drive:
        """Run-in along +x, the two lane changes, and straight on."""
        d1, d2 = (float(v) for v in x)
        if self.length < d1 + d2 - np.sqrt(d1 * d2):
            raise PlanError(
                f"double_lane_change: with d1 = {d1:g} m and d2 = {d2:g} m the path runs "
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
        points[:, 0] += start + run_in
        px, py = _evenly_spaced(points[:, 0], points[:, 1])
        return Drive(px, py, self.speed, (px.size - 1) * PATH_SPACING - LEAD_OUT)


FAMILIES: dict[str, type[Circle] | type[DoubleLaneChange]] = {
    family.name: family for family in (Circle, DoubleLaneChange)
}


def family_by_name(name: str) -> ManeuverFamily:
    """The family of that name, with its default settings; hyphens count as underscores.

    Raises
    ------
    PlanError
        If there is none; the message lists those there are.
    """
    key = name.replace("-", "_")
    if key not in FAMILIES:
        raise PlanError(f"unknown maneuver {name!r}; there are: {', '.join(FAMILIES)}")
    return FAMILIES[key]()


def operation_point(family: ManeuverFamily, values: Mapping[str, float]) -> Floats:
    """Operation parameters (l,) in the family's order.

    Raises
    ------
    PlanError
        If one is missing, unknown, or outside its range.
    """
    names = family.operation.names
    if set(values) != set(names):
        raise PlanError(
            f"{family.name} takes {', '.join(names)}; got {', '.join(values) or 'nothing'}"
        )
    for name, low, high in zip(names, family.operation.low, family.operation.high, strict=True):
        if not low <= values[name] <= high:
            raise PlanError(
                f"{family.name}: {name} = {values[name]:g} is outside its range {low:g} to {high:g}"
            )
    return np.array([values[name] for name in names], dtype=float)
