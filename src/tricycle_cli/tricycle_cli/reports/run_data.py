"""What a run left in its directory: plans, drives, identifications, and what they tell.

A run is the directory of `tricycle demo`, `plan`, `drive` or `identify`, or a bag. Its files are
untrusted input.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from excitation_planner.plan import Plan, load_plan
from parameter_identification.drives.recorded import RecordedDrive, read_drive
from parameter_identification.judging.judgement import Judgement, judge_drive
from trajectory_recorder.bag.reader import BagReader
from trajectory_recorder.bag.topics import decode
from tricycle_core.errors import BagError, JudgeError, PlanError, ReportError
from tricycle_core.joints import JOINTS
from tricycle_core.quantities import FloatArray
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import simulate

MAX_BYTES = 64_000_000  # of a JSON file
IDENTIFIED = "identification.json"


@dataclass(frozen=True)
class Motion:
    """What the joints did, as measured by the PLCs.

    Attributes
    ----------
    time
        (t,) s since the start event.
    steering_motor_angle, wheel_rate
        (t,) rad and rad/s; the wheel is the rear one.
    """

    time: FloatArray
    steering_motor_angle: FloatArray
    wheel_rate: FloatArray


@dataclass(frozen=True)
class Loads:
    """Vertical loads (t,) of the wheels, N, over time (t,), s."""

    time: FloatArray
    left: FloatArray
    right: FloatArray
    rear: FloatArray


@dataclass(frozen=True)
class Maneuver:
    """One maneuver of a run: planned, driven, or both.

    Attributes
    ----------
    name
        Of its plan or bag.
    judgement
        None where it was not driven, or where its bag cannot be judged.
    motion
        None where the bag has no joint states.
    failure
        Why its bag cannot be judged; empty when it can.
    te_expected
        TE of the model with the hidden true parameters, m²; None where no demo noted it.
    """

    name: str
    plan: Plan | None = None
    judgement: Judgement | None = None
    motion: Motion | None = None
    failure: str = ""
    te_expected: float | None = None


@dataclass(frozen=True)
class IdentifiedParameter:
    """Estimate of an unknown parameter, in its unit.

    Attributes
    ----------
    range, low, high
        What was known before, and the interval.
    truth
        None where it is not known.
    profile
        Values (j,) and by how much the cost rises there (j,); None where it was not computed.
    """

    name: str
    unit: str
    range: tuple[float, float]
    estimate: float
    low: float
    high: float
    identifiable: bool
    truth: float | None
    profile: tuple[FloatArray, FloatArray] | None


@dataclass(frozen=True)
class IdentificationResult:
    """What `tricycle identify` found.

    Attributes
    ----------
    name
        Of its directory.
    level
        Of the intervals.
    """

    name: str
    level: float
    parameters: tuple[IdentifiedParameter, ...]


@dataclass(frozen=True)
class Run:
    """Everything found in a directory.

    Attributes
    ----------
    folder
        Where.
    maneuvers
        Each plan with its drive, and drives whose plan is elsewhere.
    identifications
        Of these or other drives.
    """

    folder: Path
    maneuvers: tuple[Maneuver, ...]
    identifications: tuple[IdentificationResult, ...] = ()


def read_run(folder: Path) -> Run:
    """Read the plans, bags and results in a directory, or a single bag.

    Parameters
    ----------
    folder
        Directory of `tricycle demo`, `plan` or `drive`, or a bag.

    Raises
    ------
    ReportError
        If it holds none of them, with what was looked for.
    PlanError
        If a plan is damaged.
    OSError
        If something cannot be read.
    """
    if not folder.is_dir():
        raise ReportError(f"{folder}: is not a directory; give that of a demo, a plan or a bag")
    plans = {_name(file): load_plan(file) for file in _plan_files(folder)}
    result = read_json(folder / "result.json")
    driven: dict[str, Maneuver] = {}
    for bag in _bags(folder):
        maneuver = _driven(bag, plans, result)
        driven[maneuver.name] = maneuver
    planned = {name: Maneuver(name, plan) for name, plan in plans.items()}
    maneuvers = planned | driven
    files = [found for depth in ("", "*/", "*/*/") for found in folder.glob(f"{depth}{IDENTIFIED}")]
    identifications = tuple(_identification(file, result) for file in sorted(files))
    if not maneuvers and not identifications:
        raise ReportError(
            f"{folder}: holds no plan (plan.json, plans/*.json), no bag (metadata.yaml or *.mcap) "
            f"and no {IDENTIFIED}, here or up to two directories below"
        )
    return Run(folder, tuple(maneuvers.values()), identifications)


def _identification(file: Path, result: Mapping[str, Any]) -> IdentificationResult:
    document = read_json(file)
    level, parameters = number(document, "level"), document.get("parameters")
    if level is None or not isinstance(parameters, dict):
        raise ReportError(f"{file}: has no level and parameters; identify again")
    return IdentificationResult(
        file.resolve().parent.name,
        level,
        tuple(_parameter(file, name, entry, result) for name, entry in parameters.items()),
    )


def _parameter(
    file: Path, name: str, entry: object, result: Mapping[str, Any]
) -> IdentifiedParameter:
    def need(value: float | None, what: str) -> float:
        if value is None:
            raise ReportError(f"{file}: {name}: {what} must be a number")
        return value

    def numbers(of: object, what: str, size: int | None = None) -> FloatArray:
        values = [number(v) for v in of] if isinstance(of, list) else []
        if not values or None in values or size not in (None, len(values)):
            raise ReportError(f"{file}: {name}: {what} must be a list of numbers")
        return np.array(values, dtype=float)

    fields = entry if isinstance(entry, dict) else {}
    low, high = numbers(fields.get("range"), "range", 2)
    profile = fields.get("profile")
    if isinstance(profile, dict):
        values = numbers(profile.get("values"), "profile")
        profile = values, numbers(profile.get("rise"), "profile", len(values))
    truth = number(fields, "truth")
    return IdentifiedParameter(
        name=name,
        unit=str(fields.get("unit", "")),
        range=(float(low), float(high)),
        estimate=need(number(fields, "estimate"), "estimate"),
        low=need(number(fields, "low"), "low"),
        high=need(number(fields, "high"), "high"),
        identifiable=fields.get("identifiable") is True,
        truth=number(result, "parameters", name, "truth") if truth is None else truth,
        profile=profile if isinstance(profile, tuple) else None,
    )


def _plan_files(folder: Path) -> list[Path]:
    found = [*folder.glob("plan.json"), *folder.glob("*/plan.json"), *folder.glob("plans/*.json")]
    return sorted(set(found))


def _name(plan_file: Path) -> str:
    """Name of a plan: of its file, or of its directory where all are called plan.json."""
    return plan_file.resolve().parent.name if plan_file.name == "plan.json" else plan_file.stem


def _bags(folder: Path) -> list[Path]:
    candidates = [folder, *folder.glob("*/"), *folder.glob("*/*/")]
    return sorted(path for path in candidates if _is_bag(path))


def _is_bag(path: Path) -> bool:
    return (path / "metadata.yaml").exists() or any(path.glob("*.mcap"))


def _driven(bag: Path, plans: Mapping[str, Plan], result: Mapping[str, Any]) -> Maneuver:
    """The drive in a bag, with the plan that was driven if it is there; else that of its name."""
    name = bag.resolve().name
    try:
        drive = read_drive(bag)
        judgement, motion = judge_drive(drive), _motion(drive)
    except (BagError, JudgeError) as error:
        return Maneuver(name, plans.get(name), failure=str(error))
    for known, plan in plans.items():
        if plan.id == drive.plan_id:
            expected = number(result, known, "te_expected")
            return Maneuver(known, plan, judgement, motion, te_expected=expected)
    return Maneuver(name, None, judgement, motion)


def _motion(drive: RecordedDrive) -> Motion | None:
    """Joint states of the drive; None where the bag has none."""
    rows: list[tuple[float, float, float]] = []
    with BagReader(drive.bag) as reader:
        found = [name for name in reader.topics if name.endswith("joint_states")]
        for topic, _, data in reader.messages(found[:1]):
            message = decode(reader.topics[topic].type, data)
            try:
                steering, wheel = map(message.name.index, JOINTS)
                angle, rate = message.position[steering], message.velocity[wheel]
            except (ValueError, IndexError, AttributeError):
                continue  # a message of other joints
            stamp = message.header.stamp
            since = stamp.sec * 1_000_000_000 + stamp.nanosec - drive.start
            rows.append((since * 1e-9, angle, rate))
    time, angle, rate = np.array(rows, dtype=float).reshape(-1, 3).T
    inside = (time >= 0.0) & (time <= drive.duration)
    if not inside.any():
        return None
    return Motion(time[inside], angle[inside], rate[inside])


def wheel_loads(vehicle: Vehicle, plan: Plan) -> Loads:
    """Loads of the nominal vehicle driving the plan's commands.

    Raises
    ------
    PlanError
        If the plan was made for another vehicle.
    """
    if plan.vehicle_hash != vehicle.fingerprint:
        raise PlanError(
            f"the plan was made for the vehicle {plan.vehicle} of another file; give it with "
            "--vehicle"
        )
    motion = simulate(vehicle, plan.commands)
    return Loads(motion.time, motion.load_left[0], motion.load_right[0], motion.load_rear[0])


def read_json(file: Path) -> Mapping[str, Any]:
    """Object in a JSON file; an empty one where there is no such file.

    Raises
    ------
    ReportError
        If the file is too large or holds no JSON object.
    """
    if not file.exists():
        return {}
    if file.stat().st_size > MAX_BYTES:
        raise ReportError(f"{file}: larger than {MAX_BYTES} bytes; not of this suite")
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ReportError(f"{file}: not JSON: {error}") from error
    if not isinstance(document, dict):
        raise ReportError(f"{file}: must hold an object")
    return document


def number(document: object, *keys: str) -> float | None:
    """Finite number at the end of these keys; None where there is none."""
    for key in keys:
        document = document.get(key) if isinstance(document, Mapping) else None
    if isinstance(document, bool) or not isinstance(document, int | float):
        return None
    return float(document) if math.isfinite(document) else None
