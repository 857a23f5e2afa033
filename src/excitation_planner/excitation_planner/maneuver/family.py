"""Maneuver families: from operation parameters to what is driven.

A family maps its operation parameters x (the design variables) either to a `Drive`, the path that
the rear axle's ground point follows and the speed along it, or to the `Commands` themselves. The
families here give paths, those of `steering_maneuver` commands. Each begins at rest with a straight
run-in, so that the vehicle has settled when the maneuver proper begins.

Families are found by their entry points, see docs/how-to-maneuver-family.md.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np

from excitation_planner.box import Box
from tricycle_bridge.protocol.messages import MAX_SPEED
from tricycle_core.errors import PlanError
from tricycle_core.quantities import FloatArray
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle

ENTRY_POINTS = "excitation_planner.maneuvers"  # group: family name = module:class

ACCELERATION = 1.0  # m/s^2, of the run-in's speed ramp
SETTLING_TIME = 1.0  # s at cruise speed before the path proper begins
PATH_SPACING = 0.02  # m between path points
LEAD_OUT = 6.0  # m of path beyond its end, so that the look-ahead point always exists

CIRCLE_OPERATION = Box.of({"radius": (2.0, 6.0), "speed": (0.6, 1.0)})  # m, m/s
LANE_CHANGE_OPERATION = Box.of({"d1": (0.0, 8.0), "d2": (0.0, 8.0)})  # m
SLALOM_OPERATION = Box.of({"spacing": (2.0, 6.0), "offset": (0.1, 1.0)})  # m


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

    Raises
    ------
    PlanError
        If that is not what they are.
    """

    x: FloatArray
    y: FloatArray
    speed: float
    length: float

    def __post_init__(self) -> None:
        if self.x.ndim != 1 or self.x.shape != self.y.shape or self.x.size < 2:
            raise PlanError("a path needs x and y of as many points, two or more")
        spacing = np.hypot(np.diff(self.x), np.diff(self.y))
        # a chord is shorter than its arc, the more so where the path bends sharply
        if not (np.all(spacing > 0.0) and np.all(spacing < 1.01 * PATH_SPACING)):
            raise PlanError(f"a path needs points {PATH_SPACING:g} m apart: see `evenly_spaced`")
        if not 0.0 < self.speed <= MAX_SPEED:
            raise PlanError(f"speed {self.speed:g} m/s must be above 0 and at most {MAX_SPEED:g}")
        if not 0.0 < self.length <= self.x.size * PATH_SPACING:
            raise PlanError(f"the path must go on beyond its length, {self.length:g} m")


@runtime_checkable
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

    def drive(self, x: FloatArray, vehicle: Vehicle) -> Drive | Commands:
        """What to drive for the operation parameters x (l,), from rest.

        A path starts where the rear axle is, at (-vehicle.com_to_rear_axle, 0), along +x.
        """
        ...


def _run_in_length(speed: float) -> float:
    return 0.5 * speed**2 / ACCELERATION + SETTLING_TIME * speed


def evenly_spaced(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Resample a dense polyline (m,) at `PATH_SPACING` of its arc length."""
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
    """Steady-state circle to the left: x = (radius in m, speed in m/s), driven for `duration`.

    The speed range is our reading of a misprint in the paper (section 5).
    """

    operation: Box = CIRCLE_OPERATION
    duration: float = 20.0  # s on the circle
    name: ClassVar[str] = "circle"

    def drive(self, x: FloatArray, vehicle: Vehicle) -> Drive:
        """Run-in along +x, then the circle to the left at its end."""
        radius, speed = (float(v) for v in x)
        run_in = _run_in_length(speed)
        arc = np.arange(0.0, speed * self.duration + LEAD_OUT, PATH_SPACING / 4)
        start = -vehicle.com_to_rear_axle
        px = np.concatenate(([start], start + run_in + radius * np.sin(arc / radius)))
        py = np.concatenate(([0.0], radius * (1.0 - np.cos(arc / radius))))
        return Drive(*evenly_spaced(px, py), speed, run_in + speed * self.duration)


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

    def drive(self, x: FloatArray, vehicle: Vehicle) -> Drive:
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
        points[:, 0] += run_in - vehicle.com_to_rear_axle
        px, py = evenly_spaced(points[:, 0], points[:, 1])
        return Drive(px, py, self.speed, (px.size - 1) * PATH_SPACING - LEAD_OUT)


@dataclass(frozen=True)
class Slalom:
    """Between gates on a straight line: x = (spacing of the gates, offset to either side) in m.

    A sine that passes gate k at (k spacing, ±offset), faded in and out over one spacing.
    """

    operation: Box = SLALOM_OPERATION
    gates: int = 6
    speed: float = 2.0  # m/s
    lead_out: float = 2.0  # m, driven straight on after the last gate
    name: ClassVar[str] = "slalom"

    def drive(self, x: FloatArray, vehicle: Vehicle) -> Drive:
        """Run-in along +x, the gates, and straight on."""
        spacing, offset = (float(v) for v in x)
        gate = np.linspace(0.0, self.gates + 1.0, 400 * (self.gates + 1))
        from_end = np.minimum(gate, self.gates + 1.0 - gate)
        fade = 0.5 * (1.0 - np.cos(np.pi * np.minimum(from_end, 1.0)))
        start, run_in = -vehicle.com_to_rear_axle, _run_in_length(self.speed)
        end = start + run_in + spacing * (self.gates + 1.0) + self.lead_out
        px = np.concatenate(([start], start + run_in + spacing * gate, [end + LEAD_OUT]))
        py = np.concatenate(([0.0], -offset * fade * np.cos(np.pi * gate), [0.0]))
        px, py = evenly_spaced(px, py)
        return Drive(px, py, self.speed, (px.size - 1) * PATH_SPACING - LEAD_OUT)


def family_names() -> tuple[str, ...]:
    """Names of the families of all installed distributions, sorted."""
    return tuple(sorted(entry_points(group=ENTRY_POINTS).names))


def family_by_name(name: str) -> ManeuverFamily:
    """The family of that name, with its default settings; hyphens count as underscores.

    Raises
    ------
    PlanError
        If there is none, with those there are; or if it cannot be used, with the reason.
    """
    key = name.replace("-", "_")
    # a colcon workspace over an installed wheel registers the same class twice
    points = {point.value: point for point in entry_points(group=ENTRY_POINTS, name=key)}
    if not points:
        raise PlanError(f"unknown maneuver {name!r}; there are: {', '.join(family_names())}")
    if len(points) > 1:
        raise PlanError(f"maneuver {key!r} is registered for {' and for '.join(sorted(points))}")
    ((value, point),) = points.items()
    try:
        family = point.load()()
    except Exception as error:  # whatever an installed package may raise
        raise PlanError(f"maneuver {key!r} cannot be loaded from {value}: {error!r}") from error
    if not isinstance(family, ManeuverFamily) or family.name != key:
        raise PlanError(f"{value} is no maneuver family with the name {key!r}")
    return family


def operation_point(family: ManeuverFamily, values: Mapping[str, float]) -> FloatArray:
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
