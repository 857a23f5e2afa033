"""Content of a run's directory: plans, drives, identifications, and values derived from them.

A run is the directory of `tricycle demo`, `plan`, `drive` or `identify`, or a bag. Its files are
untrusted input.
"""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from excitation_planner.plan import Plan, load_plan
from parameter_identification.drives.reader import read_drive
from parameter_identification.drives.recorded import JointStates, RecordedDrive
from parameter_identification.identification_file import (
    IdentificationDocument,
    load_identification_file,
)
from parameter_identification.judging.judgement import Judgement, judge_drive
from trajectory_recorder.bag.location import bag_at
from tricycle_cli.reports.identification_files import IDENTIFICATION
from tricycle_cli.reports.result_file import DemoResult
from tricycle_core.errors import BagError, JudgeError, PlanError, ReportError
from tricycle_core.quantities import FloatArray
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import simulate


@dataclass(frozen=True)
class WheelLoads:
    """Vertical loads of the wheels.

    Attributes
    ----------
    time : ndarray of float, shape (t,)
        Time since the start [s].
    by_wheel : mapping of str to ndarray of float, shape (t,)
        Load of each wheel [N].
    """

    time: FloatArray
    by_wheel: Mapping[str, FloatArray]


@dataclass(frozen=True)
class Maneuver:
    """One maneuver of a run: planned, driven, or both.

    Attributes
    ----------
    name : str
        Name of its plan or bag; its path in the run if another one has this name.
    plan : Plan, optional
        None where only its bag is there.
    judgement : Judgement, optional
        None where it was not driven, or where its bag cannot be judged.
    joints : JointStates, optional
        During the drive; None where the bag has none.
    failure : str
        Why its bag cannot be judged; empty when it can.
    te_expected : float, optional
        Trajectory error [m²] of the model with the hidden true parameters, where a demo noted it.
    """

    name: str
    plan: Plan | None = None
    judgement: Judgement | None = None
    joints: JointStates | None = None
    failure: str = ""
    te_expected: float | None = None


@dataclass(frozen=True)
class Run:
    """Plans, drives and identifications found in a directory.

    Attributes
    ----------
    folder : Path
        The directory.
    maneuvers : tuple of Maneuver
        Each plan with its drives, one for each, and drives whose plan is elsewhere.
    identifications : tuple of (str, IdentificationDocument)
        Identifications in the directory, each with the name of its folder.
    left_out : str
        Why a `result.json` is not one of a demo; empty if it is, or if there is none.
    """

    folder: Path
    maneuvers: tuple[Maneuver, ...]
    identifications: tuple[tuple[str, IdentificationDocument], ...] = ()
    left_out: str = ""


def read_run(folder: Path, *, read: Callable[[Path], RecordedDrive] = read_drive) -> Run:
    """Read the plans, bags and results in a directory, or a single bag.

    Parameters
    ----------
    folder : Path
        Directory of `tricycle demo`, `plan` or `drive`, or a bag.
    read : callable
        Returns the drive in a bag.

    Raises
    ------
    ReportError
        If it holds none of them, with what was looked for.
    PlanError, IdentificationError
        If a plan or an identification is damaged.
    OSError
        If something cannot be read.
    """
    if not folder.is_dir():
        raise ReportError(f"{folder}: is not a directory; give that of a demo, a plan or a bag")
    plans = {file: load_plan(file) for file in _plan_files(folder)}
    result, left_out = DemoResult(), ""
    try:
        result = DemoResult.read(folder / "result.json")
    except ReportError as error:  # many programs write a file of this name
        left_out = f"Not shown, as it is not of tricycle demo: {error}"
    driven = {bag: _driven(bag, read, plans, result) for bag in _bags(folder)}
    planned: dict[Path, Maneuver] = {}
    for file, plan in plans.items():
        drives = {
            bag: m for bag, m in driven.items() if m.plan is not None and m.plan.id == plan.id
        }
        planned |= drives or {file: Maneuver(_name(file), plan)}
    maneuvers = _named_apart(planned | driven, folder)
    depths = ("", "*/", "*/*/")
    files = sorted(file for depth in depths for file in folder.glob(f"{depth}{IDENTIFICATION}"))
    identifications = tuple(_identification(file, result) for file in files)
    if not maneuvers and not identifications:
        raise ReportError(
            f"{folder}: holds no plan (plan.json, plan-1.json, plans/*.json), no bag "
            f"(metadata.yaml, *.mcap or *.db3) and no {IDENTIFICATION}, here or up to two "
            "directories below"
        )
    return Run(folder, maneuvers, identifications, left_out)


def _named_apart(found: Mapping[Path, Maneuver], folder: Path) -> tuple[Maneuver, ...]:
    """The maneuvers of plan files and bags, by their paths where one name is that of several."""
    paths = [path.relative_to(folder).as_posix() for path in found]
    names = [maneuver.name for maneuver in found.values()]
    return tuple(
        dataclasses.replace(maneuver, name=path)
        if names.count(maneuver.name) > 1 or maneuver.name in {*paths} - {path}
        else maneuver
        for path, maneuver in zip(paths, found.values(), strict=True)
    )


def _identification(file: Path, result: DemoResult) -> tuple[str, IdentificationDocument]:
    """An identification with the true values that a demo noted, where it has none of its own."""
    document = load_identification_file(file)
    parameters = {
        name: dataclasses.replace(entry, truth=result.parameters[name].truth)
        if entry.truth is None and name in result.parameters
        else entry
        for name, entry in document.parameters.items()
    }
    return file.resolve().parent.name, dataclasses.replace(document, parameters=parameters)


def _plan_files(folder: Path) -> list[Path]:
    patterns = [
        f"{depth}{name}" for depth in ("", "*/") for name in ("plan.json", "plan-[0-9].json")
    ]
    return sorted({file for one in (*patterns, "plans/*.json") for file in folder.glob(one)})


def _name(plan_file: Path) -> str:
    """Name of a plan: of its file, or of its directory where all are called plan.json."""
    return plan_file.resolve().parent.name if plan_file.name == "plan.json" else plan_file.stem


def _bags(folder: Path) -> list[Path]:
    folders = [folder, *folder.glob("*/"), *folder.glob("*/*/")]
    files = [path for one in folders for path in one.glob("*") if path.is_file()]
    return sorted({bag for path in (*folders, *files) if (bag := bag_at(path)) is not None})


def _driven(
    bag: Path,
    read: Callable[[Path], RecordedDrive],
    plans: Mapping[Path, Plan],
    result: DemoResult,
) -> Maneuver:
    """The drive in a bag, with the plan that was driven and its name if it is there."""
    name = bag.resolve().name
    try:
        drive = read(bag)
        judgement, joints = judge_drive(drive), _joints(drive)
    except (BagError, JudgeError) as error:
        return Maneuver(name, failure=str(error))
    for file, plan in plans.items():
        if plan.id == drive.plan_id:
            known = _name(file)
            noted = result.drives.get(known)
            expected = None if noted is None else noted.te_expected
            return Maneuver(known, plan, judgement, joints, te_expected=expected)
    return Maneuver(name, None, judgement, joints)


def _joints(drive: RecordedDrive) -> JointStates | None:
    """Joint states from the start to the end of the drive."""
    found = drive.joint_states
    if found is None:
        return None
    during = (found.time >= 0.0) & (found.time <= drive.duration)
    if not during.any():
        return None
    return JointStates(*(values[during] for values in vars(found).values()))


def wheel_loads(vehicle: Vehicle, plan: Plan) -> WheelLoads:
    """Return the wheel loads of the nominal vehicle that follows the plan's commands.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle for which the plan was made.
    plan : Plan
        Plan with the commands.

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
    return WheelLoads(motion.time, {wheel: load[0] for wheel, load in motion.load.items()})
