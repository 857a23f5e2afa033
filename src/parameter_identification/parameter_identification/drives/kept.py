"""Files of drives that were read from bags: they load a hundred times faster than the bags."""

import hashlib
import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple
from zipfile import BadZipFile

import numpy as np

from parameter_identification.drives.measured import Input, MeasuredDrive, Sensor, Signal
from parameter_identification.drives.samples import Samples
from trajectory_recorder.bag.location import is_remote
from trajectory_recorder.bag.remote import remote_state
from tricycle_core.documents import write_whole
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle

FORMAT = 9  # counted up with what is read of a bag, so that older files are read anew


def content_key(bag: Path, vehicle: Vehicle) -> str:
    """Return a hash of what a drive is read from: the bag's files and the vehicle.

    For a remote bag, what the server says of its files is hashed instead of their content: sizes,
    and times or checksums where it has them.

    Parameters
    ----------
    bag : Path
        rosbag2 directory or file.
    vehicle : Vehicle
        Vehicle by whose file the bag is read.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    content = hashlib.sha256(f"{FORMAT} {vehicle.fingerprint}".encode())
    if is_remote(bag):
        content.update(repr(remote_state(bag)).encode())
    else:
        for file in filter(Path.is_file, sorted(bag.iterdir()) if bag.is_dir() else [bag]):
            with file.open("rb") as stream:
                content.update(hashlib.file_digest(stream, "sha256").digest())
    return content.hexdigest()[:32]


def keep(drive: MeasuredDrive, file: Path) -> None:
    """Write a drive of a vehicle that stands still at the start event.

    Parameters
    ----------
    drive : MeasuredDrive
        Drive to write; its reference and start pose are not kept.
    file : Path
        Complete, or not there.
    """
    commands = drive.commands
    arrays = {
        "name": np.array(drive.name),
        "complete": np.array(drive.complete),
        "began": np.array(drive.began),
        "vehicle_hash": np.array(drive.vehicle_hash),
        "turn_std": np.array(drive.turn_std),
        "steering_late": np.array(drive.steering_late),
        "pose_filter": np.array(drive.pose_filter),
        "unheard": np.array([sensor.name for sensor in drive.unheard], dtype=str),
        "commands": np.array([commands.time, commands.steering_motor_angle, commands.speed]),
        "truth": np.array(list(drive.truth.values())),
        "true": np.array(list(drive.truth), dtype=str),
    }
    for sensor, signal in drive.signals.items():
        rows = np.column_stack([signal.time, signal.values])
        arrays |= {sensor.name: rows, f"{sensor.name}_jitter": np.array(signal.jitter)}
        if signal.wheels:
            arrays[f"{sensor.name}_of"] = np.array(signal.wheels)
    if (angle := drive.steering_angle) is not None:
        arrays[Input.STEERING.name] = np.column_stack([angle.time, angle.values])
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **arrays)
    write_whole(file, content.getvalue())


def load_kept(file: Path) -> MeasuredDrive:
    """Read a drive that `keep` wrote.

    Parameters
    ----------
    file : Path
        Written by `keep`.

    Raises
    ------
    IdentificationError
        If it is damaged.
    """
    with _arrays_of(file) as arrays:
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
            vehicle_hash=str(arrays["vehicle_hash"]),
            turn_std=float(arrays["turn_std"]),
            steering_late=float(arrays["steering_late"]),
            pose_filter=float(arrays["pose_filter"]),
            unheard=tuple(Sensor[name] for name in arrays["unheard"].tolist()),
            steering_angle=Samples(*arrays[Input.STEERING.name].T)
            if Input.STEERING.name in arrays
            else None,
        )


def positions_of(file: Path) -> FloatArray:
    """Return the positions (m, 2) of a kept drive [m].

    Parameters
    ----------
    file : Path
        Written by `keep`.

    Raises
    ------
    IdentificationError
        If it is damaged.
    """
    with _arrays_of(file) as arrays:
        return arrays[Sensor.POSITION.name][:, 1:]


def measured_in(file: Path) -> frozenset[Sensor | Input]:
    """Return which sensors a kept drive has, and `Input.STEERING` if it has the measured steering.

    Parameters
    ----------
    file : Path
        Written by `keep`.
    """
    with _arrays_of(file) as arrays:
        return frozenset(one for one in (*Sensor, Input.STEERING) if one.name in arrays)


class KeptTimes(NamedTuple):
    """Times of a kept drive.

    Attributes
    ----------
    began : float
        Time at which it began [s since 1970]; NaN: not known.
    steering_late : float
        By how much the steering of its commands may be late against the signals [s].
    """

    began: float
    steering_late: float


def times_of(file: Path) -> KeptTimes:
    """Return the times of a kept drive.

    Parameters
    ----------
    file : Path
        Written by `keep`.
    """
    with _arrays_of(file) as arrays:
        return KeptTimes(float(arrays["began"]), float(arrays["steering_late"]))


def is_kept(file: Path) -> bool:
    """Return whether a drive is kept there, by a file that is not cut off.

    Parameters
    ----------
    file : Path
        File that `keep` writes.
    """
    try:
        with _arrays_of(file):
            return True
    except (IdentificationError, FileNotFoundError):
        return False


@contextmanager
def _arrays_of(file: Path) -> Iterator[Mapping[str, FloatArray]]:
    try:
        with file.open("rb") as stream, np.load(stream) as arrays:
            yield arrays
    except (BadZipFile, EOFError, KeyError, ValueError) as error:
        raise IdentificationError(
            f"{file}: damaged: delete it, and the drive is read from its bag again"
        ) from error
