"""The plan and its file: one maneuver ready to drive, with what is known about it, as JSON.

The file is untrusted input when it is read: every field is checked, and nothing in it is run.
"""

import hashlib
import json
import math
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from excitation_planner.area.area import Area
from excitation_planner.area.fence import Fence
from excitation_planner.area.stops import longest_stop
from excitation_planner.design.criteria import Criterion
from excitation_planner.design.noise import MeasurementNoise
from tricycle_core.documents import (
    decode,
    encode,
    parse_json,
    read_bounded,
    write_whole,
)
from tricycle_core.errors import CommandsError, PlanError
from tricycle_core.poses import Pose
from tricycle_core.quantities import FloatArray
from tricycle_sim.commands import Commands

SCHEMA = 3
"""Version of the file format: docs/reference-files.md."""

MAX_BYTES = 64_000_000
"""Largest file that is read; a plan of an hour has a tenth of this."""

_NOISE = tuple(field.name for field in fields(MeasurementNoise))


@dataclass(frozen=True)
class Index:
    """A Sobol' index with its 95 % interval.

    Attributes
    ----------
    value : float
        Main or total index.
    low, high : float
        Ends of the interval.
    """

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Reference:
    """Nominal trajectory of `base_link` from the start pose.

    Attributes
    ----------
    time : ndarray of float, shape (t,)
        Time from the start of the maneuver [s].
    x, y, yaw : ndarray of float, shape (t,)
        Pose [m, m, rad]; it starts at the origin, heading +x.

    Raises
    ------
    PlanError
        Columns that are not finite or of different lengths, or times that do not increase from 0.
    """

    time: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray

    def __post_init__(self) -> None:
        _check_array("time", self.time, (None,))
        for name in ("x", "y", "yaw"):
            _check_array(name, getattr(self, name), (self.time.size,))
        if self.time[0] != 0.0 or not np.all(np.diff(self.time) > 0.0):
            raise PlanError("time must start at 0 and increase")


@dataclass(frozen=True)
class SearchHistory:
    """Maneuvers that the search evaluated, in order.

    Attributes
    ----------
    x : ndarray of float, shape (s, l)
        Operation parameters.
    cost : ndarray of float, shape (s,)
        Criterion there; infinite if the maneuver cannot be driven or judged, or does not fit the
        area. On an area, most costs are estimates by a few vehicles.

    Raises
    ------
    PlanError
        If shapes do not fit.
    """

    x: FloatArray
    cost: FloatArray

    def __post_init__(self) -> None:
        _check_array("x", self.x, (None, None))
        _check_array("cost", self.cost, (len(self.x),), finite=False)


@dataclass(frozen=True)
class Plan:
    """One maneuver, its commands and nominal trajectory, and its sensitivity.

    Attributes
    ----------
    maneuver : str
        Name of the family.
    operation : mapping of str to float
        Value of each operation parameter.
    ranges : mapping of str to (float, float)
        Range of each operation parameter: the box that was searched.
    target : str
        The unknown parameter that the maneuver is to excite.
    criterion : Criterion
        Criterion by which the maneuver was chosen.
    number, drives : int
        Place of this maneuver in the set that was designed together, from 1, and the set's size.
    unknown : mapping of str to (float, float)
        Range of each unknown parameter.
    main, total : mapping of str to Index
        Sobol' indices S and ST of TE by unknown parameter.
    variance : float
        Variance of TE over the box of the unknown parameters [m⁴].
    cost : float
        H of the target (Eq. 11, with the noise term where `noise_std` > 0).
    criterion_cost : float
        Cost of the whole set by the criterion: H, or C, D or A in ranges; if the maneuver was not
        searched for, that of the expected covariance.
    predicted_cost : float or None
        Value of `criterion_cost` that the search expected; None if the maneuver was not searched
        for.
    predicted_std : mapping of str to float
        Expected standard deviation of each unknown parameter after all drives of the set, in its
        own unit, measured with the noise below; empty where `noise_std` is 0.
    leave_one_out_q2 : float
        Leave-one-out Q² of the Kriging model of TE.
    simulations : int
        Simulations that the planning took: the search, the indices and the prediction.
    seconds : float
        Time that the planning took [s].
    seed : int
        Seed; the same seed gives the same plan.
    noise : MeasurementNoise
        How the drive is assumed to be measured; in the file its fields stand beside the others.
    feasible : bool
        Whether the nominal vehicle can drive it.
    verdict : str
        Why the family cannot excite the target; empty if it can, or was not searched.
    vehicle, vehicle_hash : str
        Name of the vehicle, and hash of its values.
    constants : mapping of str to float
        Constants of the vehicle that shape the commands: one that differs in them is another
        vehicle (see `excitation_planner.planning.check_vehicle`).
    parts : mapping of str to str
        Laws of the vehicle's parts: with another law it is another vehicle, too.
    tyre_radius : float
        Radius of the rear wheel [m].
    software : str
        Version of this software that made the plan.
    commands : Commands
        Commands that the maneuver driver plays.
    path : ndarray of float, shape (m, 2)
        Path of the unsteered axle's ground point from the start pose [m].
    reference : Reference
        Nominal trajectory of `base_link`.
    search : SearchHistory or None
        How the maneuver was found; None where it was not searched for.
    area : Area or None
        Ground that it was planned for; the next four are in its frame, and the next six empty
        without it.
    start_pose : (float, float, float) or None
        Start pose of `base_link`: x, y [m] and heading [rad].
    clearance : float or None
        Distance between the stopping zone and what bounds the area [m].
    tube : tuple of ndarray of float, each of shape (n, 2)
        Outline, then holes, of the ground that vehicles of the ranges cover [m].
    stopping_zone : tuple of ndarray of float, each of shape (n, 2)
        The same, with all ground that they need to stop from any point [m].
    footprint : ndarray of float, shape (m, 2), or None
        Corners of the vehicle in its body frame [m].
    curvature : ndarray of float, shape (c,), or None
        Curvature of the path at each command, without slip, left positive [1/m].
    lead_in : float
        Time from the start until which the driver keeps the vehicle on a straight line, closed loop
        [s]; 0: all of it is open loop.
    effects : tuple of str
        Errors of the vehicle file that the criterion and `predicted_std` count, by name.

    Raises
    ------
    PlanError
        If arrays do not fit each other, the radius is impossible, or an area comes without what
        keeps a vehicle on it.
    """

    maneuver: str
    operation: Mapping[str, float]
    ranges: Mapping[str, tuple[float, float]]
    target: str
    criterion: Criterion
    number: int
    drives: int
    unknown: Mapping[str, tuple[float, float]]
    main: Mapping[str, Index]
    total: Mapping[str, Index]
    variance: float
    cost: float
    criterion_cost: float
    predicted_cost: float | None
    predicted_std: Mapping[str, float]
    leave_one_out_q2: float
    simulations: int
    seconds: float
    seed: int
    noise: MeasurementNoise
    feasible: bool
    verdict: str
    vehicle: str
    vehicle_hash: str
    constants: Mapping[str, float]
    parts: Mapping[str, str]
    tyre_radius: float
    software: str
    commands: Commands
    path: FloatArray
    reference: Reference
    search: SearchHistory | None = None
    area: Area | None = None
    start_pose: Pose | None = None
    clearance: float | None = None
    tube: tuple[FloatArray, ...] = ()
    stopping_zone: tuple[FloatArray, ...] = ()
    footprint: FloatArray | None = None
    curvature: FloatArray | None = None
    lead_in: float = 0.0
    effects: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        _check_array("path", self.path, (None, 2))
        if self.target not in self.unknown:
            raise PlanError(f"target {self.target!r} is not an unknown parameter of the plan")
        for name in ("main", "total"):
            if set(getattr(self, name)) != set(self.unknown):
                raise PlanError(f"{name} must have an index of each unknown parameter")
        if not 0.0 < self.tyre_radius < math.inf:
            raise PlanError("tyre_radius must be above 0")
        if not 0.0 <= self.lead_in <= self.commands.duration:
            raise PlanError("lead_in must be a time of the maneuver")
        if self.search is not None and self.search.x.shape[1] != len(self.operation):
            raise PlanError(f"search: x must have {len(self.operation)} columns")
        if self.area is not None:
            for name in ("start_pose", "footprint", "curvature"):
                if getattr(self, name) is None:
                    raise PlanError(f"{name}: missing beside an area; plan again")
        if self.footprint is not None:
            _check_array("footprint", self.footprint, (None, 2))
        if self.curvature is not None:
            _check_array("curvature", self.curvature, (self.commands.time.size,))

    @property
    def fence(self) -> Fence | None:
        """Fence that keeps the vehicle on the area; None without an area."""
        area, start, footprint, curvature = (
            self.area,
            self.start_pose,
            self.footprint,
            self.curvature,
        )
        if area is None or start is None or footprint is None or curvature is None:
            return None
        # a localisation that errs by more than the margin must not take the vehicle out of the area
        ground = area.within(max(area.margin, 3.0 * self.noise.position_std))
        return Fence(area.frame, ground, footprint, curvature, start)

    @property
    def id(self) -> str:
        """Twelve hexadecimal digits that change with the commands or the reference."""
        content = hashlib.sha256()
        commands, reference = self.commands, self.reference
        for array in (
            *(commands.time, commands.steering_motor_angle, commands.speed),
            *(reference.time, reference.x, reference.y, reference.yaw),
        ):
            content.update(np.ascontiguousarray(array).tobytes())
        return content.hexdigest()[:12]

    @property
    def checksum(self) -> str:
        """Sixteen hexadecimal digits that change with any field."""
        return _checksum(encode(self))

    @property
    def space(self) -> tuple[float, float, float]:
        """Room that the drive needs [m]: along and across the start heading, and to stop besides.

        The last is the longest of the published stops (`tricycle_core.stopping`) from the fastest
        point.
        """
        along, across = np.ptp([self.reference.x, self.reference.y], axis=1)
        stop = longest_stop(np.abs(self.commands.speed).max())
        return float(along), float(across), float(stop)


def _check_array(
    name: str, array: FloatArray, shape: tuple[int | None, ...], *, finite: bool = True
) -> None:
    """Refuse an array of another shape (None: any length but 0), or with infinite numbers."""
    fits = array.ndim == len(shape) and all(
        size == want or (want is None and size > 0)
        for size, want in zip(array.shape, shape, strict=True)
    )
    if not fits or (finite and not np.isfinite(array).all()):
        raise PlanError(f"{name} must be a list of finite numbers {shape}")


def _checksum(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


def save_plan(plan: Plan, path: Path) -> None:
    """Write a plan; the file is complete or not there.

    Parameters
    ----------
    plan : Plan
        Plan to write.
    path : Path
        File; missing folders are made.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    plan = decode(Plan, encode(plan), str(path), PlanError)  # whole numbers as they are read
    content = encode(plan)
    document = {"schema": SCHEMA, "id": plan.id, "checksum": _checksum(content)}
    for name, value in content.items():
        document |= value if name == "noise" else {name: value}
    write_whole(path, json.dumps(document))


def load_plan(path: Path) -> Plan:
    """Read and check a plan.

    Parameters
    ----------
    path : Path
        File that `save_plan` wrote.

    Raises
    ------
    PlanError
        One line that names the file and the field that is wrong.
    OSError
        If the file cannot be read.
    """
    where = str(path)
    document = parse_json(read_bounded(path, MAX_BYTES, "a plan", PlanError), where, PlanError)
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        found = document.get("schema") if isinstance(document, dict) else None
        raise PlanError(
            f"{where}: schema {reprlib.repr(found)}; this version reads {SCHEMA}: plan again"
        )
    # in the file the noise is not an object of its own
    noise = {name: document.get(name) for name in _NOISE}
    plan = decode(Plan, document | {"noise": noise}, where, PlanError)
    try:  # `decode` does not call the constructor of Commands, which checks
        commands = Commands(**vars(plan.commands))
    except CommandsError as error:
        raise PlanError(f"{where}: commands: {error}") from error
    plan = replace(plan, commands=commands)
    if (document.get("id"), document.get("checksum")) != (plan.id, plan.checksum):
        raise PlanError(
            f"{where}: was changed after planning (checksum differs): its parts belong together, "
            "plan again"
        )
    return plan
