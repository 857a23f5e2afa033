"""The area: where a vehicle may drive, where not, and where it may start; its YAML file."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from excitation_planner.area.polygons import Rings, rings_of, signed_distance
from tricycle_core.documents import decode, parse_yaml, read_bounded
from tricycle_core.errors import PlanError, hint
from tricycle_core.frames import ODOM
from tricycle_core.quantities import FloatArray

MAX_BYTES = 1_000_000  # of an area file
MAX_CORNERS = 2_000  # of all polygons together
ARC = 16  # chords of a quarter of the arc by which a margin turns around a corner
FARTHEST = 100_000.0  # from the frame's origin [m]: beyond it metres are degrees by mistake
LARGE = 2_000.0  # width of an area [m] from which its corners may be mm

Span = tuple[float, float]


@dataclass(frozen=True)
class StartRegion:
    """Range of start poses: the pose of `base_link` in the area's frame.

    Attributes
    ----------
    x, y : (float, float)
        Lowest and highest coordinate [m]; infinite: anywhere in the area.
    heading : (float, float)
        Range of headings, from the first counter-clockwise to the second [rad]; a whole turn: any.
    """

    x: Span = (-math.inf, math.inf)
    y: Span = (-math.inf, math.inf)
    heading: Span = (-math.pi, math.pi)

    def __post_init__(self) -> None:
        for name in ("x", "y", "heading"):
            low, high = getattr(self, name)
            if not low <= high:
                raise PlanError(f"start.{name}: needs [low, high], not [{low:g}, {high:g}]")
        low, high = self.heading
        turn = 2 * math.pi + 1e-9
        if not (abs(low) <= turn and high - low <= turn):
            raise PlanError(f"start.heading: [{low:g}, {high:g}] is not part of a turn, in rad")


@dataclass(frozen=True)
class Area:
    """The ground that maneuvers may use.

    Attributes
    ----------
    keep_in : ndarray of float, shape (n, 2)
        Corners of the polygon that no part of the vehicle leaves [m].
    keep_out : tuple of ndarray of float, each of shape (m, 2)
        Corners of polygons that no part of the vehicle enters [m].
    margin : float
        Distance kept from all of them [m].
    start : StartRegion
        Range of start poses.
    frame : str
        Frame of all coordinates.
    datum : (float, float) or None
        Latitude and longitude [deg] of the frame's origin, its x axis to the east; None: the origin
        is that of `frame`.

    Raises
    ------
    PlanError
        If a polygon is not valid, the margin negative, a start outside, or the datum not a place on
        earth.
    """

    keep_in: FloatArray
    keep_out: tuple[FloatArray, ...] = ()
    margin: float = 0.5
    start: StartRegion = StartRegion()
    frame: str = ODOM
    datum: Span | None = None

    def __post_init__(self) -> None:
        named = {"keep_in": self.keep_in}
        named |= {f"keep_out[{i}]": polygon for i, polygon in enumerate(self.keep_out)}
        for name, polygon in named.items():
            _check_polygon(name, polygon)
        if sum(map(len, named.values())) > MAX_CORNERS:
            raise PlanError(f"the polygons have more than {MAX_CORNERS} corners")
        if not 0.0 <= self.margin < math.inf:
            raise PlanError(f"margin: needs a number of at least 0 m, not {self.margin:g}")
        if not self.frame.strip():
            raise PlanError("frame: needs the name of a frame, such as odom")
        if self.datum is not None:
            latitude, longitude = self.datum
            if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
                raise PlanError("datum: needs [latitude, longitude] in degrees")
        self._check_start()

    def _check_start(self) -> None:
        """Refuse a start region that lies wholly outside the ground."""
        import shapely  # only who reads an area needs it

        spans = np.array([self.start.x, self.start.y])
        limited = [
            f"{name} {low:g}" if low == high else f"{name} {low:g} to {high:g}"
            for name, (low, high) in zip("xy", spans, strict=True)
            if math.isfinite(low) or math.isfinite(high)
        ]
        if not limited:
            return
        x, y = np.clip(spans, -2.0 * FARTHEST, 2.0 * FARTHEST)
        region = shapely.MultiPoint([(a, b) for a in x for b in y]).convex_hull  # or line, or point
        ground = self._ground(0.0)
        if not region.intersects(ground) or region.touches(ground):
            whole = "all of " if region.length else ""
            raise PlanError(
                f"start: {whole}{', '.join(limited)} is outside of keep_in or in a keep_out"
            )

    @property
    def extent(self) -> Span:
        """Width of `keep_in` along x, and along y [m]."""
        along_x, along_y = np.ptp(self.keep_in, axis=0).tolist()
        return along_x, along_y

    @property
    def doubt(self) -> str:
        """What is doubtful about an area that is very large; empty: nothing."""
        if max(self.extent) <= LARGE:
            return ""
        along_x, along_y = self.extent
        return f"keep_in: is {along_x:g} m x {along_y:g} m large; its corners are in m"

    def clearance(self, points: FloatArray) -> FloatArray:
        """Return the distance of points to what bounds the area [m], without the margin.

        Parameters
        ----------
        points : ndarray of float, shape (..., 2)
            Points in the area's frame [m].

        Returns
        -------
        clearance : ndarray of float, shape (...)
            Negative outside of `keep_in` and in a `keep_out`.
        """
        clearance = signed_distance(points, (self.keep_in,))
        for polygon in self.keep_out:
            clearance = np.minimum(clearance, -signed_distance(points, (polygon,)))
        return clearance

    def _ground(self, distance: float) -> Any:
        """Polygons of the ground at a distance [m] from all that bounds the area."""
        import shapely  # only who reads an area needs it

        obstacles = [
            shapely.Polygon(corners).buffer(distance, quad_segs=ARC) for corners in self.keep_out
        ]
        ground = shapely.Polygon(self.keep_in).buffer(-distance, quad_segs=ARC)
        return ground.difference(shapely.unary_union(obstacles))

    def within(self, distance: float) -> Rings:
        """Return the ground at a distance from all that bounds the area.

        Parameters
        ----------
        distance : float
            Kept from `keep_in` and `keep_out` [m].

        Returns
        -------
        rings : sequence of ndarray of float, each of shape (n, 2)
            Outlines and holes [m].

        Raises
        ------
        PlanError
            If nothing is left.
        """
        import shapely  # only who reads an area needs it

        parts = shapely.get_parts(self._ground(distance))
        rings = [ring for part in parts if not part.is_empty for ring in rings_of(part)]
        if not rings:
            raise PlanError(f"nothing of the area is {distance:g} m away from its border")
        return rings


@dataclass(frozen=True)
class _Start:  # in a file, where a coordinate may be a number
    x: float | Span | None = None
    y: float | Span | None = None
    heading: float | Span | None = None


@dataclass(frozen=True)
class _File:
    keep_in: FloatArray
    keep_out: tuple[FloatArray, ...] = Area.keep_out
    margin: float = Area.margin
    start: _Start = _Start()
    frame: str = Area.frame
    datum: Span | None = Area.datum


_START_KEYS = tuple(field.name for field in fields(_Start))
_KEYS = (*(field.name for field in fields(_File)), "about")
_GEOJSON = {"features", "geometry", "geometries", "coordinates"}  # keys, one of which it has


def load_area(path: Path) -> Area:
    """Read an area file.

    Parameters
    ----------
    path : Path
        YAML file, see docs/how-to-area.md.

    Raises
    ------
    PlanError
        One line that names the file and the entry that is wrong.
    OSError
        If the file cannot be read.
    """
    where = str(path)
    document = parse_yaml(read_bounded(path, MAX_BYTES, "an area", PlanError), where, PlanError)
    if not isinstance(document, dict):
        raise PlanError(f"{where}: needs keep_in: [[x, y], ...], and may have {_listed(_KEYS[1:])}")
    if not _GEOJSON.isdisjoint(document):
        raise PlanError(
            f"{where}: is GeoJSON, in degrees; an area is in metres, in the frame of the poses: "
            "keep_in: [[x, y], ...]"
        )
    for name, allowed, values in (
        ("", _KEYS, document),
        ("start.", _START_KEYS, document.get("start")),
    ):
        for key in values if isinstance(values, dict) else ():
            if key not in allowed:
                raise PlanError(f"{where}: {name}{key}: is not a key; {hint(key, allowed)}")
    file = decode(
        _File, {key: document[key] for key in document if key != "about"}, where, PlanError
    )
    try:
        return Area(**vars(file) | {"start": _start_region(file.start)})
    except PlanError as error:
        raise PlanError(f"{where}: {error}") from error


def _start_region(start: _Start) -> StartRegion:
    given: dict[str, Any] = {
        name: value if isinstance(value, tuple) else (value, value)
        for name, value in vars(start).items()
        if value is not None
    }
    return StartRegion(**given)


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(names)


def _check_polygon(name: str, polygon: FloatArray) -> None:
    import shapely  # only who reads an area needs it

    if polygon.ndim != 2 or polygon.shape[1] != 2 or len(polygon) < 3:
        raise PlanError(f"{name}: needs three corners or more: [[x, y], ...] in m")
    far = ~(np.abs(polygon) <= FARTHEST)
    if far.any():
        corner = int(np.argmax(far.any(axis=1)))
        x, y = polygon[corner]
        raise PlanError(
            f"{name}[{corner}]: [{x:g}, {y:g}] must be metres within {FARTHEST / 1e3:g} km of the "
            "origin"
        )
    reason = shapely.is_valid_reason(shapely.Polygon(polygon))
    if reason != "Valid Geometry":
        raise PlanError(f"{name}: crosses or touches itself ({reason.lower()})")
