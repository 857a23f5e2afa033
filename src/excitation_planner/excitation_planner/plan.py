"""A plan: one maneuver ready to drive, with what is known about it, as a JSON file.

The file is untrusted input when it is read: every field is checked, and nothing in it is run.
"""

import hashlib
import json
import math
import os
import reprlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from excitation_planner.design.criteria import Criterion
from tricycle_core.errors import CommandsError, PlanError
from tricycle_core.quantities import FloatArray
from tricycle_sim.commands import Commands

SCHEMA = 2  # docs/reference-files.md
MAX_BYTES = 64_000_000  # a plan of an hour has a tenth of this


@dataclass(frozen=True)
class Index:
    """A Sobol' index with its interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Reference:
    """Nominal trajectory of `base_link` from the start pose.

    Attributes
    ----------
    time, x, y, yaw
        (t,) s from the start of the maneuver, m, m, rad; it starts at the origin, heading +x.
    """

    time: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray


@dataclass(frozen=True)
class SearchHistory:
    """What the search evaluated, in order.

    Attributes
    ----------
    x
        (s, l) operation parameters.
    cost
        (s,) H there; infinite where the maneuver cannot be driven or judged.
    """

    x: FloatArray
    cost: FloatArray


@dataclass(frozen=True)
class Plan:
    """One maneuver, its commands and nominal trajectory, and its sensitivity.

    Attributes
    ----------
    maneuver, operation
        Family and the value of each operation parameter.
    target
        The unknown parameter that the maneuver is to excite.
    criterion
        By what the maneuver was chosen.
    number, drives
        Place of this maneuver in the set that was designed together, from 1, and the set's size.
    unknown
        Range of each unknown parameter.
    main, total
        Sobol' indices S and ST of TE by unknown parameter.
    variance
        Of TE over the box of the unknown parameters, m^4.
    cost
        H of the target (Eq. 11, with the noise term where `noise_std` > 0).
    criterion_cost
        Of the whole set: H, or for C, D and A what `information_costs` says, in ranges.
    predicted_cost
        What the search expected of `criterion_cost`; None where the maneuver was not searched for.
    predicted_std
        Expected standard deviation of each unknown parameter after all drives of the set, in its
        own unit, measured with the noise below; empty where `noise_std` is 0.
    leave_one_out_q2
        Of the Kriging model of TE.
    simulations, seconds, seed
        What the planning took; the same seed gives the same plan.
    feasible
        Whether the nominal vehicle can drive it.
    verdict
        Empty, or why the family cannot excite the target.
    vehicle, vehicle_hash, tyre_radius
        Name and hash of the vehicle file, and the rear wheel's radius, m.
    software
        Version that planned.
    commands
        What the maneuver driver plays.
    path
        (m, 2) m, path of the rear axle's ground point from the start pose.
    reference
        Nominal trajectory of `base_link`.
    noise_std, yaw_rate_std, drift_std, drift_time, start_position_std, start_heading_std
        How the drive is assumed to be measured, see `PlanRequest`.
    search
        How the maneuver was found; None where it was not searched for.
    """

    maneuver: str
    operation: Mapping[str, float]
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
    noise_std: float
    yaw_rate_std: float
    drift_std: float
    drift_time: float
    start_position_std: float
    start_heading_std: float
    feasible: bool
    verdict: str
    vehicle: str
    vehicle_hash: str
    tyre_radius: float
    software: str
    commands: Commands
    path: FloatArray
    reference: Reference
    search: SearchHistory | None = None

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


def _encode(plan: Plan) -> dict[str, Any]:
    document = {field.name: getattr(plan, field.name) for field in fields(plan)}
    commands, reference = plan.commands, plan.reference
    return {
        "schema": SCHEMA,
        "id": plan.id,
        **document,
        "main": {name: asdict(index) for name, index in plan.main.items()},
        "total": {name: asdict(index) for name, index in plan.total.items()},
        "commands": {
            "time": commands.time.tolist(),
            "steering_motor_angle": commands.steering_motor_angle.tolist(),
            "speed": commands.speed.tolist(),
        },
        "path": plan.path.tolist(),
        "reference": {key: value.tolist() for key, value in vars(reference).items()},
        "search": plan.search and {"x": plan.search.x.tolist(), "cost": plan.search.cost.tolist()},
    }


def save_plan(plan: Plan, path: Path) -> None:
    """Write a plan; the file is complete or not there.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    partial.write_text(json.dumps(_encode(plan)), encoding="utf-8")
    partial.replace(path)


class _Reader:
    """Checked access to a JSON document; errors name the file and the field."""

    def __init__(self, document: Mapping[str, Any], where: str) -> None:
        self._document, self._where = document, where

    def _take(self, name: str, kind: type | tuple[type, ...], wanted: str) -> Any:
        value = self._document.get(name)
        if not isinstance(value, kind) or isinstance(value, bool) is not (kind is bool):
            raise PlanError(f"{self._where}: {name} must be {wanted}")
        return value

    def text(self, name: str) -> str:
        text: str = self._take(name, str, "a text")
        if not text.isprintable():  # half a surrogate pair, terminal escapes
            raise PlanError(f"{self._where}: {name} must be a printable text")
        return text

    def flag(self, name: str) -> bool:
        return bool(self._take(name, bool, "true or false"))

    def number(self, name: str) -> float:
        try:
            return float(self._take(name, (int, float), "a number"))
        except OverflowError:
            raise PlanError(f"{self._where}: {name} is too large") from None

    def count(self, name: str) -> int:
        return int(self._take(name, int, "a whole number"))

    def inner(self, name: str) -> "_Reader":
        return _Reader(self._take(name, dict, "an object"), f"{self._where}: {name}")

    def names(self) -> list[str]:
        if not all(name.isprintable() for name in self._document):
            raise PlanError(f"{self._where}: its names must be printable texts")
        return list(self._document)

    def numbers(
        self, name: str, shape: tuple[int | None, ...] = (None,), *, finite: bool = True
    ) -> FloatArray:
        try:
            array = np.array(self._take(name, list, "a list"), dtype=float)
        except (TypeError, ValueError, OverflowError):
            array = np.empty(0)
        fits = array.ndim == len(shape) and all(
            size == want or (want is None and size > 0)
            for size, want in zip(array.shape, shape, strict=True)
        )
        if not fits or (finite and not np.isfinite(array).all()):
            raise PlanError(f"{self._where}: {name} must be a list of finite numbers {shape}")
        return array

    def index(self, name: str) -> Index:
        entry = self.inner(name)
        return Index(entry.number("value"), entry.number("low"), entry.number("high"))


def _decode(document: Mapping[str, Any], where: str) -> Plan:
    read = _Reader(document, where)
    unknown = read.inner("unknown")
    main, total, operation = read.inner("main"), read.inner("total"), read.inner("operation")
    commands, reference = read.inner("commands"), read.inner("reference")
    time = reference.numbers("time")
    same = (time.size,)
    if time[0] != 0.0 or not np.all(np.diff(time) > 0.0):
        raise PlanError(f"{where}: reference: time must start at 0 and increase")
    try:
        decoded = Commands(
            commands.numbers("time"),
            commands.numbers("steering_motor_angle"),
            commands.numbers("speed"),
        )
    except CommandsError as error:
        raise PlanError(f"{where}: commands: {error}") from error
    predicted, predicted_std = document.get("predicted_cost"), read.inner("predicted_std")
    if (criterion := read.text("criterion")) not in set(Criterion):
        raise PlanError(f"{where}: criterion must be one of {', '.join(Criterion)}")
    search = None
    if document.get("search") is not None:
        searched = read.inner("search")
        x = searched.numbers("x", (None, len(operation.names())))
        search = SearchHistory(x, searched.numbers("cost", (len(x),), finite=False))
    return Plan(
        maneuver=read.text("maneuver"),
        operation={name: operation.number(name) for name in operation.names()},
        target=read.text("target"),
        criterion=Criterion(criterion),
        number=read.count("number"),
        drives=read.count("drives"),
        unknown={
            name: (float(low), float(high))
            for name in unknown.names()
            for low, high in [unknown.numbers(name, (2,))]
        },
        main={name: main.index(name) for name in main.names()},
        total={name: total.index(name) for name in total.names()},
        variance=read.number("variance"),
        cost=read.number("cost"),
        criterion_cost=read.number("criterion_cost"),
        predicted_cost=None if predicted is None else read.number("predicted_cost"),
        predicted_std={name: predicted_std.number(name) for name in predicted_std.names()},
        leave_one_out_q2=read.number("leave_one_out_q2"),
        simulations=read.count("simulations"),
        seconds=read.number("seconds"),
        seed=read.count("seed"),
        noise_std=read.number("noise_std"),
        yaw_rate_std=read.number("yaw_rate_std"),
        drift_std=read.number("drift_std"),
        drift_time=read.number("drift_time"),
        start_position_std=read.number("start_position_std"),
        start_heading_std=read.number("start_heading_std"),
        feasible=read.flag("feasible"),
        verdict=read.text("verdict"),
        vehicle=read.text("vehicle"),
        vehicle_hash=read.text("vehicle_hash"),
        tyre_radius=read.number("tyre_radius"),
        software=read.text("software"),
        commands=decoded,
        path=read.numbers("path", (None, 2)),
        reference=Reference(time, *(reference.numbers(axis, same) for axis in ("x", "y", "yaw"))),
        search=search,
    )


def load_plan(path: Path) -> Plan:
    """Read and check a plan.

    Raises
    ------
    PlanError
        One line that names the file and the field that is wrong.
    OSError
        If the file cannot be read.
    """
    with path.open("rb") as file:
        content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise PlanError(f"{path}: larger than {MAX_BYTES} bytes; not a plan")
    try:
        document = json.loads(content.decode(), parse_constant=_not_a_number)
    except (ValueError, RecursionError) as error:
        raise PlanError(f"{path}: not a plan: {error}") from error
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        found = document.get("schema") if isinstance(document, dict) else None
        raise PlanError(
            f"{path}: schema {reprlib.repr(found)}; this version reads {SCHEMA}: plan again"
        )
    plan = _decode(document, str(path))
    if not 0.0 < plan.tyre_radius < math.inf:
        raise PlanError(f"{path}: tyre_radius must be above 0")
    if document.get("id") != plan.id:
        raise PlanError(f"{path}: commands or reference were changed after planning (id differs)")
    return plan


def _not_a_number(text: str) -> float:
    if text == "Infinity":  # H of a target without any main effect
        return math.inf
    raise ValueError(f"{text} is no number of a plan")
