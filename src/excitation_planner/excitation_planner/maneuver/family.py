"""Maneuver families: their interface, the paths that they give, and the search by name.

A family maps its operation parameters x (the design variables) either to a `DrivenPath`, the path
that the ground point of the unsteered axle follows and the speed along it, or to the `Commands`
themselves.
Each maneuver begins at rest with a straight run-in, so that the vehicle has settled when the
maneuver proper begins.

Families are found by their entry points, see docs/how-to-maneuver-family.md.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from excitation_planner.box import Box
from tricycle_bridge.protocol.limits import MAX_SPEED
from tricycle_bridge.protocol.units import ANGLE_UNIT
from tricycle_core.errors import PlanError, hint
from tricycle_core.quantities import FloatArray
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints

ENTRY_POINTS = "excitation_planner.maneuvers"
"""Group of the entry points: family name = module:class."""

COMMAND_TICKS = 2
"""PLC ticks per command: 50 Hz."""

ACCELERATION = 1.0
"""Acceleration of the run-in [m/s²]."""

SETTLING_TIME = 1.0
"""Time at cruise speed before the maneuver proper begins [s]."""

PATH_SPACING = 0.02
"""Distance between path points [m]."""


def steering_lock(vehicle: Vehicle) -> float:
    """Return the largest steering motor angle of a plan [rad], as the protocol can say it.

    Parameters
    ----------
    vehicle : Vehicle
        Has the end stop, and the margin that is kept before it.
    """
    return math.floor(vehicle.steering_reach / ANGLE_UNIT + 1e-6) * ANGLE_UNIT


def kept_margin(vehicle: Vehicle) -> str:
    """Return how far the steering may turn, for the reason why a maneuver is infeasible.

    Parameters
    ----------
    vehicle : Vehicle
        Has the end stop, and the margin that is kept before it.
    """
    return (
        f"it may turn to {steering_lock(vehicle):.4f} rad, {100.0 * vehicle.steering_margin:g} % "
        "before its end stop"
    )


@dataclass(frozen=True)
class DrivenPath:
    """A path and how to drive it.

    Attributes
    ----------
    x, y : ndarray of float, shape (m,)
        Points of the path [m], frame `odom`, evenly spaced along it; the first is the start of the
        unsteered axle's ground point.
    speed : float
        Cruise speed [m/s], reached from rest with `ACCELERATION`.
    length : float
        Arc length [m] after which the maneuver ends; the points go on beyond it.

    Raises
    ------
    PlanError
        Points that are not evenly spaced, an impossible speed or length.
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
        check_speed(self.speed)
        if not 0.0 < self.length <= self.x.size * PATH_SPACING:
            raise PlanError(f"the path must go on beyond its length, {self.length:g} m")


@runtime_checkable
class ManeuverFamily(Protocol):
    """A maneuver family, as the planner uses it."""

    @property
    def name(self) -> str:
        """Name with underscores."""
        ...

    @property
    def operation(self) -> Box:
        """The box of the operation parameters, in their order."""
        ...

    def drive(self, x: FloatArray, vehicle: Vehicle) -> DrivenPath | Commands:
        """Return what to drive, from rest.

        A path starts where the vehicle's own point is, at (path_point(vehicle), 0), along +x.

        Parameters
        ----------
        x : ndarray of float, shape (l,)
            Operation parameters.
        vehicle : Vehicle
            Vehicle; only its nominal values count.
        """
        ...


def path_point(vehicle: Vehicle) -> float:
    """Return how far ahead of the COM the point lies that follows paths [m].

    It is the middle of the axle that is not steered: on most vehicles the rear one.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its wheels.
    """
    return vehicle.axle_x(next(wheel.axle for wheel in vehicle.wheels if not wheel.steered))


@cache
def _installed(_: tuple[str, ...]) -> EntryPoints:
    """Read what is installed on a search path: once, it takes as long as to import NumPy."""
    from importlib.metadata import entry_points  # so does this

    return entry_points(group=ENTRY_POINTS)


def family_names() -> tuple[str, ...]:
    """Return the names of the families of all installed distributions, sorted."""
    return tuple(sorted(_installed(tuple(sys.path)).names))


def family_by_name(name: str) -> ManeuverFamily:
    """Return the family of a name, with its default settings.

    Parameters
    ----------
    name : str
        Hyphens count as underscores.

    Raises
    ------
    PlanError
        If the name is unknown, or the family cannot be used; the message lists the known ones, or
        gives the reason.
    """
    key = name.replace("-", "_")
    # a colcon workspace over an installed wheel registers the same class twice
    points = {point.value: point for point in _installed(tuple(sys.path)).select(name=key)}
    if not points:
        raise PlanError(f"unknown maneuver {name!r}; {hint(name, family_names())}")
    if len(points) > 1:
        raise PlanError(f"maneuver {key!r} is registered for {' and for '.join(sorted(points))}")
    ((value, point),) = points.items()
    try:
        family = point.load()()
    except Exception as error:  # whatever an installed package may raise
        raise PlanError(f"maneuver {key!r} cannot be loaded from {value}: {error!r}") from error
    if not isinstance(family, ManeuverFamily) or family.name != key:
        raise PlanError(f"{value} is not a maneuver family with the name {key!r}")
    return family


def operation_point(family: ManeuverFamily, values: Mapping[str, float]) -> FloatArray:
    """Return the operation parameters (l,) in the family's order.

    Parameters
    ----------
    family : ManeuverFamily
        Family with the names and ranges of the operation parameters.
    values : mapping of str to float
        Value of each operation parameter.

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
                f"{family.name}: {name} = {values[name]:g} is outside its range {low:g} to "
                f"{high:g}; --range {name}=LOW:HIGH sets another"
            )
    return np.array([values[name] for name in names], dtype=float)


def check_speed(speed: float) -> None:
    """Refuse a speed [m/s] that no maneuver is driven at.

    Parameters
    ----------
    speed : float
        Held by a maneuver [m/s].
    """
    if not 0.0 < speed <= MAX_SPEED:
        raise PlanError(f"speed {speed:g} m/s must be above 0 and at most {MAX_SPEED:g}")
