"""Drives that a command identifies from: bags, and windows of tables."""

from __future__ import annotations

from argparse import Namespace
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from trajectory_recorder.bag.location import is_remote
from tricycle_cli.options import topics_of
from tricycle_cli.progress import progress_bar
from tricycle_core.errors import IdentificationError

if TYPE_CHECKING:
    from parameter_identification.drives.measured import MeasuredDrive
    from parameter_identification.drives.table import Columns, Recording
    from parameter_identification.drives.windows import Selection, Windows
    from parameter_identification.estimation.redrawn import Table
    from tricycle_sim.vehicle import Vehicle


@dataclass
class ReadDrives:
    """Drives that a command has read.

    Attributes
    ----------
    used, held_out : list of MeasuredDrive
        Drives to identify from, and drives to predict.
    tables : list of Table
        Tables whose windows are drives to identify from.
    remarks : list of str
        How much of each table is used.
    """

    used: list[MeasuredDrive] = field(default_factory=list)
    held_out: list[MeasuredDrive] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


def is_table(path: Path) -> bool:
    """Return whether a file is a table, by its name.

    Parameters
    ----------
    path : Path
        Path of a drive.
    """
    return path.name.lower().endswith((".csv", ".csv.gz"))


def read_drives(args: Namespace, vehicle: Vehicle, columns: Columns | None) -> ReadDrives:
    """Read all drives of a command: a bag is one, a table several.

    Parameters
    ----------
    args : Namespace
        Parsed arguments: `drives` and `held_out`, and the options of windows and topics.
    vehicle : Vehicle
        Vehicle that drove.
    columns : Columns, optional
        Mapping of the tables' columns.

    Raises
    ------
    IdentificationError
        If a drive cannot be used, or a table has no mapping.
    BagError
        If a bag cannot be read.
    """
    from parameter_identification.drives.measured_from_bag import read_measured_drive
    from parameter_identification.drives.names import name_of
    from parameter_identification.drives.windows import Windows

    topics = topics_of(args)
    asked = {"length": args.window, "every": args.every, "above": args.above}
    windows = Windows(**{name: value for name, value in asked.items() if value is not None})
    paths = [*args.drives, *args.held_out]
    alike = len({p.stem if is_table(p) else name_of(p) for p in paths}) < len(paths)
    read = ReadDrives()
    with progress_bar("reading drives") as progress:
        for done, path in enumerate(paths, start=1):
            used = done <= len(args.drives)
            if is_table(path):
                table, drives, remark = _windows_of(path, vehicle, columns, windows)
                read.remarks.append(remark)
                read.tables += [table] if used else []
                if alike:
                    drives = [replace(one, name=f"{path.parent}/{one.name}") for one in drives]
            else:
                drive = read_measured_drive(path, vehicle, topics=topics)
                drives = [replace(drive, name=str(path)) if alike else drive]
            (read.used if used else read.held_out).extend(drives)
            progress(done, len(paths))
    return read


def _windows_of(
    path: Path, vehicle: Vehicle, columns: Columns | None, windows: Windows
) -> tuple[Table, list[MeasuredDrive], str]:
    """A table, its windows as drives, and how much of it they are."""
    from parameter_identification.drives.table import EstimatedMap, read_recording
    from parameter_identification.drives.windows import select_windows, steering_of
    from parameter_identification.estimation.redrawn import Table

    if is_remote(path):
        raise IdentificationError(f"{path}: only bags are read from a URL: download the table")
    if columns is None:
        raise IdentificationError(f"{path}: a table needs --columns, the mapping of its columns")
    recording = read_recording(path, columns, vehicle)
    steering = steering_of(recording, vehicle, columns)
    selection = select_windows(recording, vehicle, steering, windows)
    table = Table(recording, vehicle, steering, windows)
    remark = _used(recording, selection, windows)
    if recording.pose_filter > 0.0:
        remark += (
            f"\n{recording.name}: the poses come out of a filter, as the yaw rate shows: like a "
            f"low-pass of {recording.pose_filter:.2g} s; so do those of the model"
        )
    if isinstance(steering, EstimatedMap):
        remark += f"\n{recording.name}: {steering}; the effects of the steering are relative to it"
    if columns.acceleration_x is not None:
        remark += f"\n{recording.name}: acceleration_x is not used here, only by tricycle import"
    return table, [*selection.drives], remark


def _used(recording: Recording, selection: Selection, windows: Windows) -> str:
    """Return in words how much of a table is in windows, and what is left out."""
    count, whole = len(selection.drives), recording.time[-1] - recording.time[0]
    return (
        f"{recording.name}: {count} windows of {windows.length:g} s are "
        f"{count * windows.length:.3g} of its {whole:.3g} s; left out of the other "
        f"possible windows, one every {windows.every:g} s, for what is in them or in the "
        f"{selection.run_in:g} s before: {selection}"
    )
