"""Changes that make a maneuver fit an area that is too small for it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from excitation_planner.area.polygons import rings_of
from excitation_planner.area.room import Room
from excitation_planner.indices.sampling import corners, sobol_sequence
from excitation_planner.maneuver import ManeuverFamily
from excitation_planner.planning.replay import nominal_run
from tricycle_core.errors import InfeasibleManeuver
from tricycle_core.quantities import FloatArray
from tricycle_sim.vehicle import Vehicle

_INSIDE = 12  # points of the operation box that are tried beside its corners
_STEPS = 5  # to each end of an operation parameter's range
_HALVINGS = 4  # of the last of them
_LEAST = 0.01  # m, step of what would be enough
_FAR = 100.0  # m further out, where nothing is in the way of a maneuver


def closest_fit(vehicle: Vehicle, family: ManeuverFamily, room: Room) -> str:
    """Return by how much a family that does not fit an area falls short, and what would help.

    Empty where one of its maneuvers fits.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with the ranges of its unknown parameters.
    family : ManeuverFamily
        Family of the maneuver.
    room : Room
        Area, footprint and position noise that the maneuver must fit.
    """
    box = family.operation
    at = np.vstack([corners(len(box), seed=0), sobol_sequence(_INSIDE, len(box))])
    tried = box.from_unit(at)
    shortages = ((_shortage(vehicle, family, room, x), x) for x in tried)
    found = [(shortage, x) for shortage, x in shortages if shortage is not None]
    if not found:
        return f"none of {len(tried)} maneuvers of {family.name} can be driven"
    shortage, x = min(found, key=lambda pair: pair[0])
    if shortage <= 0.0:
        return ""
    return (
        f"the {family.name} that comes closest ({_named(family, x)}) needs {shortage:.2f} m more: "
        f"{_larger(vehicle, family, room, x, shortage)}"
    )


def nearest_that_fits(vehicle: Vehicle, family: ManeuverFamily, room: Room, x: FloatArray) -> str:
    """Return by how much one maneuver does not fit, and what would make it fit.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with the ranges of its unknown parameters.
    family : ManeuverFamily
        Family of the maneuver.
    room : Room
        Area, footprint and position noise that the maneuver must fit.
    x : ndarray of float, shape (l,)
        Operation parameters.
    """
    shortage = max(_shortage(vehicle, family, room, x) or 0.0, 0.0)
    box = family.operation
    fitting = []
    for axis, (name, low, high) in enumerate(zip(box.names, box.low, box.high, strict=True)):
        for end in (low, high):
            value = _first_that_fits(vehicle, family, room, x, axis, end)
            if value is not None:
                fitting.append(f"{name} {value:.3g}")
    changes = [f"{' or '.join(fitting)} fits"] if fitting else []
    lacking = f"needs {shortage:.2f} m more room in the area"
    return f"{lacking}: {'; '.join([*changes, _larger(vehicle, family, room, x, shortage)])}"


def _larger(
    vehicle: Vehicle, family: ManeuverFamily, room: Room, x: FloatArray, shortage: float
) -> str:
    """Return the change of the area that makes up for a shortage [m] of a maneuver."""
    import shapely  # only who plans on an area needs it

    area, margin = room.area, room.area.margin
    margins = f"margin {margin - shortage:.2f} instead of {margin:.2f} m"

    def lacks(further: float) -> float:
        """Return the shortage [m] with keep_in moved outwards by this distance [m]."""
        outwards = shapely.Polygon(area.keep_in).buffer(further, join_style="mitre")
        wider = replace(room, area=replace(area, keep_in=rings_of(outwards)[0]))
        still = _shortage(vehicle, family, wider, x)
        return math.inf if still is None else still

    needed = shortage
    if area.keep_out and lacks(_FAR) > 0.0:  # the shortage may be that to a keep_out
        blamed = "a keep_out is in its way, however large keep_in is"
        return f"{blamed}; {margins} would do" if shortage < margin else blamed
    # the start pose is searched anew in a larger area, and may be another one
    while needed < _FAR and (still := lacks(needed)) > 0.0:
        needed += max(still, _LEAST)
    change = f"keep_in {needed:.2f} m further out on every side would do"
    return f"{change}, or {margins}" if shortage < margin else change


def _shortage(vehicle: Vehicle, family: ManeuverFamily, room: Room, x: FloatArray) -> float | None:
    """Return the shortage of a maneuver [m]; None if the vehicle cannot drive it."""
    try:
        return room.fit(vehicle, nominal_run(vehicle, family, x).commands).shortage
    except InfeasibleManeuver:
        return None


def _first_that_fits(
    vehicle: Vehicle, family: ManeuverFamily, room: Room, x: FloatArray, axis: int, end: float
) -> float | None:
    """Value of one operation parameter, nearest to that of x, with which it fits, if any does."""
    other = x.copy()

    def fits(value: float) -> bool:
        other[axis] = value
        shortage = _shortage(vehicle, family, room, other)
        return shortage is not None and shortage <= 0.0

    steps = np.linspace(x[axis], end, _STEPS + 1)
    good = next((i for i in range(1, _STEPS + 1) if fits(steps[i])), None)
    if good is None:
        return None
    bad, value = steps[good - 1], steps[good]
    for _ in range(_HALVINGS):
        middle = 0.5 * (value + bad)
        value, bad = (middle, bad) if fits(middle) else (value, middle)
    return float(value)


def _named(family: ManeuverFamily, x: FloatArray) -> str:
    return ", ".join(f"{n} {v:.3g}" for n, v in zip(family.operation.names, x, strict=True))
