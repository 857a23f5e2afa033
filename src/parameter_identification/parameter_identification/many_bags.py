"""Drives of many bags, read through any executor and kept in files of a folder.

A bag whose drive is kept already is not read again. One that cannot be used is an error, or is left
out with the reason.
"""

import hashlib
from collections.abc import Sequence
from concurrent.futures import Executor
from pathlib import Path

from parameter_identification.drives.kept import content_key, is_kept, keep, positions_of
from parameter_identification.drives.measured_from_bag import read_measured_drive
from parameter_identification.drives.recorded import TopicNames
from parameter_identification.estimation.checks import (
    check_motion,
    check_reference,
    check_signs,
    same_drives,
)
from parameter_identification.workers import Steps, each
from tricycle_core.errors import ExcitationError, IdentificationError, naming
from tricycle_core.quantities import FloatArray
from tricycle_sim.vehicle import Vehicle

NAMED = 3  # bags in a message, of many that are at fault


def read_bags(
    bags: Sequence[Path],
    vehicle: Vehicle,
    *,
    folder: Path,
    executor: Executor | None,
    leave_out: bool,
    topics: TopicNames | None,
    steps: Steps,
    other_vehicle: bool = False,
) -> tuple[dict[Path, Path], list[str]]:
    """Keep the drives of bags; return the file of each that can be used, and why others cannot.

    Parameters
    ----------
    bags : sequence of Path
        One drive each.
    vehicle : Vehicle
        Vehicle that drove.
    folder : Path
        Folder in which the drives are kept.
    executor : concurrent.futures.Executor, optional
        Default: this process.
    leave_out : bool
        Whether bags that cannot be used are left out, instead of being an error.
    topics : TopicNames, optional
        Names of the topics, where they differ from the suite's.
    steps : Steps
        Takes a step for each bag.
    other_vehicle : bool
        Whether drives may have been planned for another vehicle, as for `identify_many`.

    Raises
    ------
    IdentificationError
        If a bag cannot be used, or comes twice.
    """
    folder.mkdir(parents=True, exist_ok=True)
    known: list[tuple[Path, Path]] = []  # bags and their files
    positions: list[FloatArray] = []  # of each
    left_out: list[str] = []
    jobs = [(bag, vehicle, folder, topics, other_vehicle) for bag in bags]
    for bag, (file, reason) in zip(bags, each(executor, _read, jobs), strict=True):
        if reason and not leave_out:
            raise IdentificationError(reason)
        if reason:
            left_out.append(reason)
        else:
            known.append((bag, file))
            positions.append(positions_of(file))
        steps.did()
    same = same_drives(positions)
    for later, earlier in same.items():
        left_out.append(f"{known[later][0]} and {known[earlier][0]} are the same drive")
        if not leave_out:
            raise IdentificationError(left_out[-1])
    return dict(one for number, one in enumerate(known) if number not in same), left_out


def _read(job: tuple[Path, Vehicle, Path, TopicNames | None, bool]) -> tuple[Path, str]:
    """Keep the drive of a bag; return its file and "", or the bag and why it cannot be used."""
    bag, vehicle, folder, topics, other_vehicle = job
    drive = None
    try:
        file = folder / f"{content_key(bag, vehicle)}.npz"
        if topics is not None:
            own = hashlib.sha256(repr(topics).encode()).hexdigest()[:8]
            file = file.with_name(f"{file.stem}-{own}.npz")
        if other_vehicle:
            file = file.with_name(f"{file.stem}-other.npz")
        if not is_kept(file):
            drive = read_measured_drive(bag, vehicle, topics=topics)
            check_motion(drive)
            if not other_vehicle:
                check_reference(drive, vehicle)
            check_signs([drive], vehicle)
    except (ExcitationError, OSError) as error:
        return bag, naming(error, bag)
    if drive is not None:
        keep(drive, file)
    return file, ""


def some_of(left_out: Sequence[str]) -> str:
    """Return the first reasons why bags were not used, as the end of a message; empty for none.

    Parameters
    ----------
    left_out : sequence of str
        All bags that were not used, with the reason.
    """
    more = "; …" if len(left_out) > NAMED else ""
    return f". Left out: {'; '.join(left_out[:NAMED])}{more}" if left_out else ""
