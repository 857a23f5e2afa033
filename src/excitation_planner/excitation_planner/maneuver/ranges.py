"""The search box: ranges of operation parameters other than those that a family brings."""

import dataclasses
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from excitation_planner.box import Bounds, Box
from excitation_planner.maneuver.family import DrivenPath, ManeuverFamily
from tricycle_core.documents import parse_yaml, read_bounded
from tricycle_core.errors import DesignError, PlanError
from tricycle_core.quantities import FloatArray
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle

MAX_BYTES = 100_000
"""Largest file of ranges that is read."""

SMALLER = {"speed": 0.5, "length": 0.4, "duration": 0.4, "gates": 0.5}
"""Settings by which a maneuver needs less ground, and the share down to which they are searched."""

TURNS = {"turn": (0.0, 0.6)}
"""Settings by which a maneuver stays near its start, and the ranges in which they are searched."""


@dataclass(frozen=True)
class RangedFamily:
    """A maneuver family whose operation parameters have other ranges than its own.

    Attributes
    ----------
    family : ManeuverFamily
        Gives the maneuvers.
    operation : Box
        Ranges, with the names of the family's; after them those of its settings that are searched
        too, as the speed of a slalom.
    """

    family: ManeuverFamily
    operation: Box

    @property
    def name(self) -> str:
        """Name of the family."""
        return self.family.name

    def drive(self, x: FloatArray, vehicle: Vehicle) -> DrivenPath | Commands:
        """Return what the family drives at x.

        Parameters
        ----------
        x : ndarray of float, shape (l,)
            Operation parameters.
        vehicle : Vehicle
            Vehicle; only its nominal values count.
        """
        own = len(self.family.operation)
        values = dict(zip(self.operation.names[own:], x[own:].tolist(), strict=True))
        family = dataclasses.replace(self.family, **values) if values else self.family  # type: ignore[type-var]
        return family.drive(x[:own], vehicle)


def parse_ranges(texts: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Return ranges by the name of the operation parameter.

    Parameters
    ----------
    texts : sequence of str
        ``NAME=LOW:HIGH``, or ``FAMILY.NAME=LOW:HIGH`` for one family only.

    Raises
    ------
    PlanError
        If a text has another form, or a name comes twice.

    Examples
    --------
    >>> parse_ranges(["radius=3:12", "circle.speed=0.5:1.5"])
    {'radius': (3.0, 12.0), 'circle.speed': (0.5, 1.5)}
    """
    ranges: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, _, limits = text.partition("=")
        try:
            low, high = map(float, limits.split(":"))
        except ValueError:
            raise PlanError(f"range {text!r}: needs NAME=LOW:HIGH, as in radius=3:12") from None
        if name in ranges:
            raise PlanError(f"range {text!r}: {name} is given twice")
        ranges[name] = low, high
    return ranges


def load_ranges(path: Path) -> dict[str, tuple[float, float]]:
    """Read ranges from YAML: ``radius: [3, 12]``, or ``circle: {radius: [3, 12]}``.

    Parameters
    ----------
    path : Path
        YAML file.

    Raises
    ------
    PlanError
        If the file holds anything else; the message names the entry.
    OSError
        If the file cannot be read.
    """
    content = read_bounded(path, MAX_BYTES, "a file of ranges", PlanError)
    document = parse_yaml(content, str(path), PlanError)
    if not isinstance(document, dict):
        raise PlanError(f"{path}: needs entries like radius: [3, 12]")
    entries: dict[str, Any] = {}
    for name, value in document.items():
        inner = value.items() if isinstance(value, dict) else [(None, value)]
        entries |= {f"{name}.{key}" if key else str(name): limits for key, limits in inner}
    ranges: dict[str, tuple[float, float]] = {}
    for name, limits in entries.items():
        if not (
            isinstance(limits, list)
            and len(limits) == 2
            and all(isinstance(n, int | float) and not isinstance(n, bool) for n in limits)
        ):
            raise PlanError(f"{path}: {name}: needs [low, high], not {reprlib.repr(limits)}")
        ranges[name] = float(limits[0]), float(limits[1])
    return ranges


def with_ranges(
    families: Sequence[ManeuverFamily], ranges: Bounds, *, smaller: bool = False
) -> tuple[ManeuverFamily, ...]:
    """Return the families with these ranges in place of their own.

    Parameters
    ----------
    families : sequence of ManeuverFamily
        Some have the parameters named.
    ranges : mapping of str to (float, float)
        Range by ``NAME``, for every family that has it, or by ``FAMILY.NAME``: an operation
        parameter, or a setting of the family that is a number, as the speed of a slalom, which then
        is one too.
    smaller : bool
        Whether of families whose speed is a setting those in `SMALLER` and `TURNS` are searched
        too, unless a range is given: a slow vehicle stops in less room, and a short maneuver, or
        one about a turn, needs less.

    Raises
    ------
    PlanError
        If a name belongs to none of the families, or a range is impossible.
    """
    known = {
        key: None
        for family in families
        for name in (*family.operation.names, *_settings(family))
        for key in (name, f"{family.name}.{name}")
    }
    for name in ranges:
        if name not in known:
            raise PlanError(f"range of {name!r}: the parameters are {', '.join(known)}")
    return tuple(_with_own_ranges(family, ranges, smaller=smaller) for family in families)


def _with_own_ranges(family: ManeuverFamily, ranges: Bounds, *, smaller: bool) -> ManeuverFamily:
    bounds = {
        name: ranges.get(f"{family.name}.{name}", ranges.get(name, limits))
        for name, limits in family.operation.bounds().items()
    }
    for name in _settings(family):
        limits = ranges.get(f"{family.name}.{name}", ranges.get(name))
        if limits is None and smaller and "speed" in _settings(family):
            usual, limits = float(getattr(family, name)), TURNS.get(name)
            if name in SMALLER:
                limits = SMALLER[name] * usual, usual
        if limits is not None:
            bounds[name] = limits
    if bounds == family.operation.bounds():
        return family
    try:
        return RangedFamily(family, Box.of(bounds))
    except DesignError as error:
        raise PlanError(f"{family.name}: {error}") from error


def _settings(family: ManeuverFamily) -> tuple[str, ...]:
    """Settings of a family that are numbers and no operation parameters."""
    if not dataclasses.is_dataclass(family):
        return ()
    return tuple(
        field.name
        for field in dataclasses.fields(family)
        if isinstance(getattr(family, field.name), float)
        and field.name not in family.operation.names
    )


def shown_ranges(bounds: Mapping[str, tuple[float, float]]) -> str:
    """Return ranges as a text that `parse_ranges` reads, word by word.

    Parameters
    ----------
    bounds : mapping of str to (float, float)
        Ranges by name.

    Examples
    --------
    >>> shown_ranges({"radius": (2.0, 6.0), "speed": (0.6, 1.0)})
    'radius=2:6 speed=0.6:1'
    """
    return " ".join(f"{name}={low:g}:{high:g}" for name, (low, high) in bounds.items())
