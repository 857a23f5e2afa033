"""Drives kept in files of numbers: read a hundred times faster than the bags that they are of."""

import hashlib
import io
from pathlib import Path

import numpy as np

from parameter_identification.drives.measured import MeasuredDrive, Sensor, Signal
from trajectory_recorder.bag.location import is_remote
from trajectory_recorder.bag.remote import remote_state
from tricycle_core.documents import write_whole
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle

FORMAT = 2  # counted up with what is read of a bag, so that older files are read anew


def content_key(bag: Path, vehicle: Vehicle) -> str:
    """Return what tells a drive from others: a hash of the bag's content and of the vehicle file.

    Of a bag elsewhere it is a hash of what the server tells of its files: sizes, and times or sums
    where it has them.

    Parameters
    ----------
    bag : Path
        rosbag2 directory or file.
    vehicle : Vehicle
        That reads it.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    found = hashlib.sha256(f"{FORMAT} {vehicle.fingerprint}".encode())
    if is_remote(bag):
        found.update(repr(remote_state(bag)).encode())
        return found.hexdigest()[:32]
    for file in filter(Path.is_file, sorted(bag.iterdir()) if bag.is_dir() else [bag]):
        with file.open("rb") as stream:
            found.update(hashlib.file_digest(stream, "sha256").digest())
    return found.hexdigest()[:32]


def keep(drive: MeasuredDrive, file: Path) -> None:
    """Write a drive that stands still at its start event.

    Parameters
    ----------
    drive : MeasuredDrive
        Its reference and start pose are not kept.
    file : Path
        Complete, or not there.
    """
    commands = drive.commands
    arrays = {
        "name": np.array(drive.name),
        "complete": np.array(drive.complete),
        "began": np.array(drive.began),
        "commands": np.array([commands.time, commands.steering_motor_angle, commands.speed]),
        "truth": np.array(list(drive.truth.values())),
        "true": np.array(list(drive.truth), dtype=str),
    }
    for sensor, signal in drive.signals.items():
        rows = np.column_stack([signal.time, signal.values])
        arrays |= {sensor.name: rows, f"{sensor.name}_jitter": np.array(signal.jitter)}
        if signal.wheels:
            arrays[f"{sensor.name}_of"] = np.array(signal.wheels)
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **arrays)
    write_whole(file, content.getvalue())


def kept(file: Path) -> MeasuredDrive:
    """Read a drive that `keep` wrote.

    Parameters
    ----------
    file : Path
        Written by `keep`.
    """
    with np.load(file) as arrays:
        signals = {
            sensor: Signal(
                arrays[sensor.name][:, 0],
                arrays[sensor.name][:, 1:],
                float(arrays[f"{sensor.name}_jitter"]),
                tuple(arrays[name].tolist()) if (name := f"{sensor.name}_of") in arrays else (),
            )
            for sensor in Sensor
            if sensor.name in arrays
        }
        return MeasuredDrive(
            str(arrays["name"]),
            Commands(*arrays["commands"]),
            signals,
            truth=dict(zip(arrays["true"].tolist(), arrays["truth"].tolist(), strict=True)),
            complete=bool(arrays["complete"]),
            began=float(arrays["began"]),
        )


def sensors_of(file: Path) -> frozenset[Sensor]:
    """Return which sensors a kept drive has.

    Parameters
    ----------
    file : Path
        Written by `keep`.
    """
    with np.load(file) as arrays:
        return frozenset(sensor for sensor in Sensor if sensor.name in arrays)


def began(file: Path) -> float:
    """Return when a kept drive began [s since 1970]; NaN: not known.

    Parameters
    ----------
    file : Path
        Written by `keep`.
    """
    with np.load(file) as arrays:
        return float(arrays["began"])
