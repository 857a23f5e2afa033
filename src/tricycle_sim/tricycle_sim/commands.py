"""Commands of a drive: steering motor angle and speed over time, each held until the next."""

import csv
import io
import math
import reprlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from tricycle_bridge.protocol.limits import MAX_SPEED, STEERING_END_STOP
from tricycle_core.documents import read_bounded, separator_of, write_whole
from tricycle_core.errors import CommandsError
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK

COLUMNS = ("time", "steering_motor_angle", "speed")
MAX_BYTES = 64_000_000  # of a file; an hour at 100 Hz has a fifth of this
LONGEST = 86_400.0  # s; times beyond a day are taken for another unit or clock


@dataclass(frozen=True, eq=False)
class Commands:
    """Steering motor angle and speed over time; each row is held until the next, the last ends it.

    Parameters
    ----------
    time : array_like of float, shape (c,)
        Seconds from the start: starts at 0, strictly increasing, ends after a tick of 10 ms or more
        and a day or less.
    steering_motor_angle : array_like of float, shape (c,)
        Target of the steering motor [rad], left positive.
    speed : array_like of float, shape (c,)
        Target of the rear wheel's speed times tyre radius [m/s], negative backwards.

    Raises
    ------
    CommandsError
        If a number is not finite, goes back in time or is beyond what the PLCs accept; the message
        names the first row (from 1) and column.
    """

    time: FloatArray
    steering_motor_angle: FloatArray
    speed: FloatArray

    def __init__(self, time: ArrayLike, steering_motor_angle: ArrayLike, speed: ArrayLike) -> None:
        for name, values in zip(COLUMNS, (time, steering_motor_angle, speed), strict=True):
            column = np.array(values, dtype=float)  # a copy of our own, so that it stays as it is
            column.setflags(write=False)
            object.__setattr__(self, name, column)
        _check(self)

    @property
    def duration(self) -> float:
        """Seconds from the first to the last row."""
        return float(self.time[-1])

    def until(self, end: float) -> "Commands":
        """Return the commands up to a time before their end.

        Parameters
        ----------
        end : float
            Since the first row [s]; a tick or more.

        Raises
        ------
        CommandsError
            If it is less than a tick.
        """
        rows = int(np.searchsorted(self.time, min(end, self.duration)))
        last = rows - 1
        return Commands(
            np.append(self.time[:rows], min(end, self.duration)),
            np.append(self.steering_motor_angle[:rows], self.steering_motor_angle[last]),
            np.append(self.speed[:rows], self.speed[last]),
        )

    def save(self, path: Path) -> None:
        """Write a CSV file that `load_commands` reads back without loss.

        Parameters
        ----------
        path : Path
            File; missing folders are made.
        """
        text = io.StringIO(newline="")
        writer = csv.writer(text)
        writer.writerow(COLUMNS)
        columns = (self.time, self.steering_motor_angle, self.speed)
        writer.writerows(zip(*(column.tolist() for column in columns), strict=True))
        write_whole(path, text.getvalue())


def load_commands(path: Path) -> Commands:
    """Read commands from a CSV file with the columns `time, steering_motor_angle, speed`.

    Commas, semicolons or tabs separate them.

    Parameters
    ----------
    path : Path
        File with a header.

    Raises
    ------
    CommandsError
        If something is wrong; the message names file, row (the first one below the header is 1) and
        column.
    OSError
        If the file cannot be read.
    """
    content = read_bounded(path, MAX_BYTES, "a file of commands", CommandsError)
    if content.lstrip().startswith(b"{"):
        raise CommandsError(
            f"{path}: is JSON, not a table (CSV) with the header {','.join(COLUMNS)}; a plan is "
            "driven by `tricycle drive`"
        )
    try:
        text = io.StringIO(content.decode("utf-8-sig"), newline="")
        separator = separator_of(text)
        text.seek(0)
        rows_of_text = csv.reader(text, delimiter=separator)
        lines = [line for line in rows_of_text if any(cell.strip() for cell in line)]
    except UnicodeDecodeError as error:
        raise CommandsError(f"{path}: is not a CSV file in UTF-8") from error
    except csv.Error as error:
        raise CommandsError(f"{path}: is not a CSV file: {error}") from error
    if not lines:
        raise CommandsError(f"{path}: is empty; needs the header {','.join(COLUMNS)} and rows")
    header = [cell.strip() for cell in lines[0]]
    if sorted(header) != sorted(COLUMNS):
        raise CommandsError(
            f"{path}: header: needs the columns {', '.join(COLUMNS)}, not {reprlib.repr(header)}"
        )
    rows: list[list[float]] = []
    for number, line in enumerate(lines[1:], start=1):
        if len(line) != len(COLUMNS):
            raise CommandsError(f"{path}: row {number}: has {len(line)} columns instead of 3")
        rows.append(
            [
                _parse(cell, f"{path}: row {number}: {name}")
                for name, cell in zip(header, line, strict=True)
            ]
        )
    table = dict(zip(header, np.array(rows).reshape(-1, 3).T, strict=True))
    try:
        return Commands(**table)
    except CommandsError as error:
        raise CommandsError(f"{path}: {error}") from error


def _parse(cell: str, where: str) -> float:
    try:
        return float(cell)
    except ValueError:
        point = ", with a point for its decimals" if "," in cell else ""
        text = reprlib.repr(cell.strip())
        raise CommandsError(f"{where}: needs a number{point}, not {text}") from None


def _check(commands: Commands) -> None:
    columns = {name: getattr(commands, name) for name in COLUMNS}
    for name, column in columns.items():
        if column.ndim != 1 or column.shape != commands.time.shape:
            raise CommandsError(f"{name}: needs as many numbers as there are times")
    if len(commands.time) < 2:
        raise CommandsError("there must be at least two rows: the last one is the end")
    bounds = {"steering_motor_angle": (STEERING_END_STOP, "rad"), "speed": (MAX_SPEED, "m/s")}
    steps = np.diff(commands.time, prepend=-1.0)
    wrong = (commands.time[0] != 0.0) | ~(steps > 0.0)
    for name, column in columns.items():
        wrong |= ~np.isfinite(column)
        wrong |= np.abs(column) > bounds.get(name, (math.inf, ""))[0] + 1e-9
    for index in np.flatnonzero(wrong)[:1].tolist():  # the first one is named
        where = f"row {index + 1}"
        for name, column in columns.items():
            value = float(column[index])
            if not math.isfinite(value):
                raise CommandsError(f"{where}: {name}: is {value}; needs a finite number")
            limit, unit = bounds.get(name, (math.inf, ""))
            if abs(value) > limit + 1e-9:
                raise CommandsError(
                    f"{where}: {name}: {value:g} {unit} is beyond the PLC's limit of {limit:g}"
                )
        time = float(commands.time[index])
        if index == 0 and time != 0.0:
            raise CommandsError(f"{where}: time: starts at {time:g} s instead of 0")
        if index > 0 and time <= commands.time[index - 1]:
            raise CommandsError(
                f"{where}: time: {time:g} s does not come after {commands.time[index - 1]:g} s"
            )
    if not TICK <= commands.duration <= LONGEST:
        raise CommandsError(
            f"row {len(commands.time)}: time: the drive ends after {commands.duration:g} s; needs "
            f"{TICK:g} s to {LONGEST:g} s"
        )
