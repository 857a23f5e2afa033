"""The tube of a maneuver: all ground that a vehicle may cover in it, stops from any point included.

n: vehicles, t: time points, m: corners of the footprint.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import shapely
from numpy.typing import NDArray

from excitation_planner.area.fence import START_HEADING_TOLERANCE
from excitation_planner.area.stops import RUN_OUT, longest_stop, stopping_path
from excitation_planner.indices.sampling import sobol_sequence
from tricycle_core.errors import InfeasibleManeuver
from tricycle_core.poses import placed
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import CommandedBatch
from tricycle_sim.vehicle.kinematics import road_angles
from tricycle_sim.vehicle.layout import LANES

VEHICLES = 64
"""Vehicles of the ranges, beside the nominal one: half of them at corners."""

EVERY = 0.2
"""Time between footprints [s]; the hull of two covers the time between."""

STOP_EVERY = 0.1
"""Time between the points from which a stop is looked at [s]; hulls cover the time between."""

ROUGH_EVERY, ROUGH_STOP_EVERY = 0.6, 0.4
"""The same times of a rough tube, with nothing between."""

CACHED = 100_000
"""Numbers that are worked on at a time: they fit a processor's cache."""

CURVATURES = 128
"""Steering angles at which the curvature of a crawl is computed, and interpolated between."""

SLOWEST = 0.02
"""Speed below which the vehicle counts as at rest [m/s]."""

TOLERANCE = 0.01
"""Tolerance by which outlines are simplified, outwards [m]."""

BEYOND = 0.05
"""Distance by which the outline of a rough tube may reach beyond that of the whole one [m]."""

WHEEL_WIDTH = 0.1
"""Width on either side of a wheel's middle: half a tyre and what stands out beside it [m]."""

DIRECTIONS, ROUGH_DIRECTIONS = 64, 32
"""Directions whose outermost points make a hull: it lacks 1 cm, that of a rough tube some cm."""

_TURNS = np.array([-1.0, 0.0, 1.0]) * START_HEADING_TOLERANCE


def footprint_of(vehicle: Vehicle) -> FloatArray:
    """Return the corners of the rectangle around the wheels, (4, 2) [m].

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle; the corners are in its body frame.
    """
    wheels = [vehicle.of(wheel) for wheel in vehicle.wheels]
    front = max(wheel.x + wheel.tyre_radius for wheel in wheels)
    back = min(wheel.x - wheel.tyre_radius for wheel in wheels)
    left = max(wheel.y for wheel in wheels) + WHEEL_WIDTH
    right = min(wheel.y for wheel in wheels) - WHEEL_WIDTH
    return np.array([[front, left], [back, left], [back, right], [front, right]])


@dataclass(frozen=True)
class Tube:
    """Ground that a maneuver may cover, from its start pose.

    Attributes
    ----------
    drives : ndarray of shapely.Polygon, shape (t,)
        Covered by the footprint of any of the vehicles in the undisturbed maneuver, piece by piece,
        begun with any heading within `START_HEADING_TOLERANCE`.
    stops : ndarray of shapely.Polygon, shape (s,)
        Ground covered by the vehicle in stops from any time, up to where it rests; also when it
        drives backwards to the start.
    """

    drives: NDArray[np.object_]
    stops: NDArray[np.object_]

    @property
    def pieces(self) -> NDArray[np.object_]:
        """Pieces of the drives and of the stops."""
        return np.concatenate([self.drives, self.stops])

    @cached_property
    def drive(self) -> shapely.Polygon:
        """All ground of the undisturbed maneuver."""
        return _outline(self.drives)

    @cached_property
    def whole(self) -> shapely.Polygon:
        """All ground of the undisturbed maneuver and of the stops."""
        return _outline(self.pieces)


def tube_of(
    vehicle: Vehicle,
    commands: Commands,
    footprint: FloatArray,
    *,
    rough: bool = False,
    kept_load: float = 0.0,
) -> Tube:
    """Return the ground that vehicles of the ranges may cover under the same commands.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with the ranges of its unknown parameters.
    commands : Commands
        Commands of the maneuver.
    footprint : ndarray of float, shape (m, 2)
        Corners in the body frame [m].
    rough : bool
        Whether a part of the tube is enough that takes less time: that of the first `LANES`
        vehicles, at `ROUGH_EVERY` and `ROUGH_STOP_EVERY`.
    kept_load : float
        Least load of every wheel, as a share of the mean load of the wheels at rest.

    Raises
    ------
    InfeasibleManeuver
        If the nominal vehicle cannot drive the maneuver, another one rolls over, or a wheel of one
        carries less than `kept_load`.
    """
    batch = CommandedBatch(vehicle, commands)
    # eight vehicles take as long as one
    drawn = _vehicles(vehicle)[: LANES if rough else None]
    # the last tick has to be among those recorded
    every = math.gcd(len(batch.time) - 1, round(EVERY / TICK), round(STOP_EVERY / TICK))
    run = batch.run(drawn, ("x", "y", "yaw", "vx", "vy", "yaw_rate"), every=every)
    if not run.feasibility.feasible[0]:
        raise InfeasibleManeuver("; ".join(run.feasibility.reasons(0)))
    if (over := run.feasibility.rolled_over.happened).any():
        reason = "; ".join(run.feasibility.reasons(int(np.argmax(over))))
        raise InfeasibleManeuver(f"a vehicle of the ranges: {reason}")
    least = min(float(load.value.min()) for load in run.feasibility.least_load.values())
    if least < (kept := kept_load * vehicle.of(vehicle.wheels[0]).mean_load):
        raise InfeasibleManeuver(
            f"a vehicle of the ranges: a wheel carries {least:.0f} N, {kept:.0f} N are kept"
        )

    def thinned(column: FloatArray, seconds: float) -> FloatArray:
        step = round(seconds / TICK) // every
        return np.concatenate([column[:, :-1:step], column[:, -1:]], axis=1)

    each, each_stop = (ROUGH_EVERY, ROUGH_STOP_EVERY) if rough else (EVERY, STOP_EVERY)
    motion = run.columns
    poses = placed(footprint, *(thinned(motion[name], each) for name in ("x", "y", "yaw")))
    x, y, yaw, u, v, r = (thinned(column, each_stop) for column in motion.values())
    angle = thinned(run.steering_motor_angle[:1], each_stop)  # the same for all
    speed, slip = np.hypot(u, v), np.arctan2(v, u)
    way = np.where(speed > SLOWEST, longest_stop(speed), 0.0)
    # the curvature of a stop lies between that of the drive and that of a crawl
    crawl = np.broadcast_to(crawl_curvature(vehicle, angle), speed.shape)
    curvatures = (r / np.maximum(speed, SLOWEST), crawl)
    arcs = [
        placed(footprint, *stopping_path(x, y, yaw, slip, way, curvature))
        for curvature in curvatures
    ]
    behind = np.vstack([footprint, footprint - [RUN_OUT, 0.0]])
    back = _hulls(behind[np.newaxis, np.newaxis])
    if rough:
        ends = np.concatenate([arc[:, :, part] for arc in arcs for part in (2, -1)], axis=1)
        few = ROUGH_DIRECTIONS
        return Tube(_hulls(poses, directions=few), np.append(_hulls(ends, directions=few), back))
    first, last, outward = slice(None, -1), slice(1, None), _directions(DIRECTIONS)
    arcs = [_outermost(_of_all(arc), outward) for arc in arcs]  # (t, parts, d, 2)
    ends = np.stack([arc[t, part] for arc in arcs for t in (first, last) for part in (first, last)])
    # the outermost points of all are among those of each in the same direction
    farthest = np.argmax(np.sum(ends * outward, axis=-1), axis=0)
    stops = _hulls(np.take_along_axis(ends, farthest[np.newaxis, ..., np.newaxis], axis=0))
    return Tube(_hulls(poses[:, :-1], poses[:, 1:]), np.append(stops, back))


def _vehicles(vehicle: Vehicle) -> FloatArray:
    """Values (n, k) of the unknown parameters: the nominal ones, and draws from the ranges."""
    nominal = vehicle.nominal_point()[None]
    if not vehicle.unknown:
        return nominal
    low, high = np.array(list(vehicle.unknown.values())).T
    U = sobol_sequence(VEHICLES, len(low), seed=0)
    U[::2] = U[::2] > 0.5  # corners of the ranges: there the paths differ most
    return np.vstack([nominal, low + U * (high - low)])


def crawl_curvature(vehicle: Vehicle, angle: FloatArray) -> FloatArray:
    """Return the curvature of the path without slip [1/m], left positive.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its steering linkage.
    angle : ndarray of float
        Steering motor angle [rad], left positive.
    """
    return np.interp(angle, *_curvatures(vehicle))


@lru_cache(maxsize=4)
def _curvatures(vehicle: Vehicle) -> tuple[FloatArray, FloatArray]:
    """Curvatures of a crawl [1/m] at angles of the steering motor [rad], from stop to stop."""
    angles = np.linspace(-vehicle.steering_limit, vehicle.steering_limit, CURVATURES)
    return angles, np.tan(road_angles(vehicle, angles)) / vehicle.wheelbase


def _hulls(*corners: FloatArray, directions: int = DIRECTIONS) -> NDArray[np.object_]:
    """Convex hulls (...) of the corners (n, ..., m, 2) of all vehicles, with any start heading."""
    outward = _directions(directions)
    # few points make almost the same hull
    points = _outermost(np.concatenate([_of_all(c) for c in corners], axis=-2), outward)
    c, s = np.cos(_TURNS)[:, None], np.sin(_TURNS)[:, None]
    x, y = points[..., None, :, 0], points[..., None, :, 1]
    turned = np.stack([c * x - s * y, s * x + c * y], axis=-1)  # about the start
    hulls = _outermost(turned.reshape(*points.shape[:-2], -1, 2), outward)
    return np.asarray(shapely.polygons(hulls))


def _of_all(corners: FloatArray) -> FloatArray:
    """Corners (n, ..., m, 2) of all vehicles together, (..., n m, 2)."""
    together = np.moveaxis(corners, 0, -2)
    return together.reshape(*together.shape[:-3], -1, 2)


def _directions(count: int) -> FloatArray:
    """So many unit vectors (d, 2), counter-clockwise."""
    angles = np.linspace(0.0, math.tau, count, endpoint=False)
    return np.column_stack([np.cos(angles), np.sin(angles)])


def _outermost(points: FloatArray, directions: FloatArray) -> FloatArray:
    """Return the farthest of points (..., n, 2) in each direction (d, 2): (..., d, 2)."""
    sets = points.reshape(-1, *points.shape[-2:])
    together = max(1, CACHED // (len(directions) * sets.shape[1]))
    far = np.concatenate([
        np.argmax(directions @ np.swapaxes(sets[first : first + together], 1, 2), axis=2)
        for first in range(0, len(sets), together)
    ])  # fmt: skip
    found = np.take_along_axis(sets, far[:, :, None], axis=1)
    return found.reshape(*points.shape[:-2], -1, 2)


def _outline(polygons: NDArray[np.object_]) -> shapely.Polygon:
    """One polygon around all, simplified outwards."""
    return shapely.simplify(shapely.buffer(shapely.unary_union(polygons), TOLERANCE), TOLERANCE)
