"""Recordings of other systems: a table of numbers (CSV), and a mapping that says what is what.

`load_columns` reads the mapping, `read_recording` the table by it. What comes out is in SI units,
on one clock, without repeated or missing samples; `drives.windows` makes drives of it.
"""

import csv
import gzip
import io
import math
import reprlib
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from parameter_identification.drives.pose_filter import filter_of
from parameter_identification.drives.samples import Samples
from tricycle_core.documents import check_texts, decode, parse_yaml, read_bounded, separator_of
from tricycle_core.errors import IdentificationError, hint
from tricycle_core.quantities import FloatArray
from tricycle_sim.vehicle import Vehicle

MAX_BYTES = 256_000_000  # of a table, unpacked: an hour at 100 Hz has a fifth
MAX_MAPPING = 100_000
LARGEST = 1e8  # m, rad, ... that is read: maps count from 1e7 m away, and no sensor beyond
UNTIMED = 0.5  # of the rows, that may lack their time
G = 9.80665  # m/s^2, the unit

_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_ANGLE = {"rad": 1.0, "deg": math.pi / 180.0}
_RATE = {"rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": math.pi / 30.0}
_SPEED = {"m/s": 1.0, "km/h": 1.0 / 3.6}
_WHEEL = {**_RATE, **_SPEED}  # m/s: of the tread, the speed that a wheel without slip rolls at
_ACCELERATION = {"m/s^2": 1.0, "g": G}
UNITS: Mapping[str, Mapping[str, float]] = {
    "time": _TIME,
    "x": _LENGTH,
    "y": _LENGTH,
    "yaw": _ANGLE,
    "steering": {**_ANGLE, "1": 1.0},
    "steering_angle": {**_ANGLE, "1": 1.0},
    "speed_command": _SPEED,
    "wheel_speed": _WHEEL,
    "yaw_rate": _RATE,
    "acceleration_x": _ACCELERATION,
    "acceleration_y": _ACCELERATION,
    "motor_torque": {"N m": 1.0},
}
"""Units that an entry may have; the first one is meant where none is given."""
WHEELS = "wheel_speeds"
BESIDE = 1.0  # s before and after the poses from which samples are of use
STEADY = 30  # samples of a second clock from which its pace is looked at
PARTS = 8  # of a recording, in which it is
GROWN = 0.01  # s by which the offset of a clock changes that has another pace
PACE = 0.02  # of a clock's time, by which it may run faster or slower
UNSTEADY = 0.05  # s that a part may be off an even pace


@dataclass(frozen=True)
class Column:
    """Where a quantity is in a table.

    Attributes
    ----------
    column : str
        Heading of the column.
    unit : str
        One of `UNITS`; by default the first.
    clock : str
        Heading of the column with the times of its samples [s], where they have a clock of their
        own; a row where it does not change repeats the last sample.
    """

    column: str
    unit: str = ""
    clock: str = ""


@dataclass(frozen=True)
class SteeringMap:
    """Angle of the steering motor for a command c: gain c, or limit tanh(gain c / limit), + offset.

    Attributes
    ----------
    gain : float
        Slope at command 0 [rad per unit of the command].
    limit : float
        Angle that the command approaches [rad]; infinite: a straight line.
    gain_right, limit_right : float, optional
        To the right, where they differ.
    offset : float
        Angle at command 0 beyond the vehicle's own [rad].

    Raises
    ------
    IdentificationError
        If a gain is 0 or a limit is not positive, or gain or offset is not finite.
    """

    gain: float = 1.0
    limit: float = math.inf
    gain_right: float | None = None
    limit_right: float | None = None
    offset: float = 0.0

    def __post_init__(self) -> None:
        gains, limits = (self.gain, self.gain_right), (self.limit, self.limit_right)
        if 0.0 in gains or any(limit is not None and not limit > 0.0 for limit in limits):
            raise IdentificationError("needs a gain other than 0, a limit above 0")
        if not all(math.isfinite(value) for value in (*gains, self.offset) if value is not None):
            raise IdentificationError("gain and offset must be finite numbers")

    def angle(self, command: FloatArray) -> FloatArray:
        """Return the angles (m,) [rad] of commands (m,).

        Parameters
        ----------
        command : ndarray of float, shape (m,)
            In the unit of the table.
        """
        right = self.gain * command < 0.0
        straight: FloatArray = command * np.where(right, self.gain_right or self.gain, self.gain)
        limit = np.where(right, self.limit_right or self.limit, self.limit)
        with np.errstate(invalid="ignore"):
            bent: FloatArray = limit * np.tanh(straight / limit)
        return np.where(np.isinf(limit), straight, bent) + self.offset


@dataclass(frozen=True)
class EstimatedMap(SteeringMap):
    """One that was found from the turns of a table, by nominal tyres: it errs as these do."""

    def __str__(self) -> str:
        return (
            f"angle of the steering motor = {self.gain:.4g} * command {self.offset:+.4f} rad, "
            "estimated from the turns"
        )


@dataclass(frozen=True)
class SensorPlace:
    """Where on the body the pose is measured: of the point in front and left of the COM.

    Attributes
    ----------
    x, y : float
        Forward and to the left [m].
    yaw : float
        Direction of the sensor's forward axis in the body, to the left [rad].

    Raises
    ------
    IdentificationError
        If a number is not finite.
    """

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (self.x, self.y, self.yaw))):
            raise IdentificationError("x, y and yaw must be finite numbers")


@dataclass(frozen=True)
class Columns:
    """Columns of a table, by the quantity that they hold.

    Attributes
    ----------
    time, x, y : str or Column
        Headings; the others of this kind are optional.
    steering, steering_angle : str or Column
        Set-point of the steering motor, or its measured angle: one of both.
    yaw, yaw_rate, wheel_speed, speed_command, acceleration_x, acceleration_y : str or Column
        Wheel speed of the driven wheels. Without a speed command the speed is that of the pose.
        Accelerations as an accelerometer at the COM reads them.
    motor_torque : str or Column
        At the driven wheels.
    wheel_speeds : mapping of str to str or Column
        Speeds of single wheels, by the wheels' names in the vehicle file.
    steering_map : SteeringMap or str
        From the column to the steering motor's angle; the angle itself by default. "estimate": gain
        and offset, from the recording.
    sensor : SensorPlace
        Place on the body where the pose is measured.

    Raises
    ------
    IdentificationError
        If there is no steering, or both.
    """

    time: str | Column
    x: str | Column
    y: str | Column
    steering: str | Column | None = None
    steering_angle: str | Column | None = None
    yaw: str | Column | None = None
    yaw_rate: str | Column | None = None
    wheel_speed: str | Column | None = None
    speed_command: str | Column | None = None
    acceleration_x: str | Column | None = None
    acceleration_y: str | Column | None = None
    motor_torque: str | Column | None = None
    wheel_speeds: Mapping[str, str | Column] = field(default_factory=dict)
    steering_map: SteeringMap | str = field(default_factory=SteeringMap)
    sensor: SensorPlace = field(default_factory=SensorPlace)

    def __post_init__(self) -> None:
        if (self.steering is None) == (self.steering_angle is None):
            both = "; not both" if self.steering else ""
            raise IdentificationError(
                f"needs `steering`, the set-points, or `steering_angle`, the measured angle{both}"
            )

    def entries(self) -> dict[str, Column]:
        """Return where each quantity is, with its unit; of a wheel as `wheel_speeds.left`."""
        named = {name: getattr(self, name) for name in UNITS}
        named |= {f"{WHEELS}.{wheel}": entry for wheel, entry in self.wheel_speeds.items()}
        columns = {
            name: entry if isinstance(entry, Column) else Column(entry)
            for name, entry in named.items()
            if entry is not None
        }
        return {
            name: Column(c.column, c.unit or next(iter(units_of(name))), c.clock)
            for name, c in columns.items()
        }


def units_of(name: str) -> Mapping[str, float]:
    """Return the units that an entry may have.

    Parameters
    ----------
    name : str
        One of `UNITS`, or of a wheel.
    """
    return _WHEEL if name.startswith(f"{WHEELS}.") else UNITS[name]


def load_columns(path: Path | str) -> Columns:
    """Read a mapping (YAML).

    Parameters
    ----------
    path : Path or str
        File.

    Raises
    ------
    IdentificationError
        Naming the entry that is missing, unknown or wrong, and what would be right.
    OSError
        If the file cannot be read.
    """
    content = read_bounded(Path(path), MAX_MAPPING, "a mapping of columns", IdentificationError)
    values = parse_yaml(content, str(path), IdentificationError)
    if not isinstance(values, dict):
        raise IdentificationError(f"{path}: needs entries such as `time: HEADING`")
    check_texts(values, str(path), IdentificationError)
    for name, kind in ((None, Columns), ("steering_map", SteeringMap), ("sensor", SensorPlace)):
        part = values if name is None else values.get(name)
        known = [entry.name for entry in fields(kind)]
        _refuse_unknown(part, known, f"{path}" if name is None else f"{path}: {name}")
    wheels = values.get(WHEELS)
    of_wheels = wheels if isinstance(wheels, dict) else {}
    named = {name: values.get(name) for name in UNITS}
    for name, entry in (named | {f"{WHEELS}.{w}": e for w, e in of_wheels.items()}).items():
        _refuse_unknown(entry, ["column", "unit", "clock"], f"{path}: {name}")
    if isinstance(values.get("steering_map", {}), str) and values["steering_map"] != "estimate":
        raise IdentificationError(f"{path}: steering_map: needs `estimate`, or gain and limit")
    columns = decode(Columns, values, str(path), IdentificationError)
    for name, column in columns.entries().items():
        if column.unit not in (units := units_of(name)):
            raise IdentificationError(
                f"{path}: {name}: unit {column.unit!r} is not known; use one of {', '.join(units)}"
            )
    return columns


def _refuse_unknown(part: object, known: list[str], where: str) -> None:
    for name in part if isinstance(part, dict) else ():
        if name not in known:
            raise IdentificationError(f"{where}: {name!r} is not an entry; {hint(name, known)}")


@dataclass(frozen=True, eq=False)
class Recording:
    """A table in SI units on one clock that starts at 0.

    Attributes
    ----------
    name : str
        Name of the file or drive.
    start : float
        Time of its clock at 0 [s].
    time, x, y : ndarray of float, shape (m,)
        Positions of the COM [s, m, m].
    yaw : ndarray of float, shape (m,), or None
        Continuous, left positive [rad].
    steering : Samples
        Command or angle, by the mapping's unit.
    steering_measured : bool
        Whether it is an angle that was measured, not a set-point.
    more : mapping of str to Samples
        The other quantities by the name of their entry.
    pose_filter : float
        Time constant of the low-pass that the poses come out of [s]; 0: none.
    """

    name: str
    start: float
    time: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray | None
    steering: Samples
    more: Mapping[str, Samples]
    steering_measured: bool = False
    pose_filter: float = 0.0

    @cached_property
    def earliest(self) -> float:
        """Time of the first sample of all [s]; below 0 where that is not a pose."""
        every = [self.time, self.steering.time, *(s.time for s in self.more.values())]
        return min(float(time[0]) for time in every)

    @property
    def poses(self) -> FloatArray:
        """Columns x, y and, where there is one, yaw, shape (m, 2 or 3)."""
        return np.column_stack([self.x, self.y, *([] if self.yaw is None else [self.yaw])])

    def wheel_speeds(self, vehicle: Vehicle) -> dict[str, Samples]:
        """Return the speeds of single wheels by their names.

        Parameters
        ----------
        vehicle : Vehicle
            Vehicle that drove.

        Raises
        ------
        IdentificationError
            If it has no such wheel.
        """
        prefix = f"{WHEELS}."
        found = {n.removeprefix(prefix): s for n, s in self.more.items() if n.startswith(prefix)}
        known = [wheel.name for wheel in vehicle.wheels]
        _refuse_unknown(found, known, f"{self.name}: {WHEELS}")
        return found


def read_recording(path: Path | str, columns: Columns, vehicle: Vehicle | None = None) -> Recording:
    """Read a table of numbers.

    Empty cells and `nan` are missing samples, which are left out; so are rows with the time of the
    row before.

    Parameters
    ----------
    path : Path or str
        ``.csv`` or ``.csv.gz`` with a header.
    columns : Columns
        Columns of the table.
    vehicle : Vehicle, optional
        Vehicle that drove; its tyres' radii are needed where wheel speeds are in m/s or km/h.

    Raises
    ------
    IdentificationError
        Naming file, row (the first one below the header is 1) and column of what is wrong.
    OSError
        If the file cannot be read.
    """
    path, entries = Path(path), columns.entries()
    headings = {c.column for c in entries.values()} | {c.clock for c in entries.values() if c.clock}
    for name in ("time", "x", "y", "yaw"):
        if name in entries and entries[name].clock:
            raise IdentificationError(
                f"{path}: {name}: takes no clock: poses are timed by `time`, and where rows repeat "
                "them, their cells must be empty"
            )
    table = _read_table(path, headings)
    si = {
        name: table[c.column] * units_of(name)[c.unit] / _radius(name, c, vehicle, str(path))
        for name, c in entries.items()
    }
    for name, values in si.items():
        if name != "time" and (beyond := np.flatnonzero(np.abs(values) > LARGEST)).size:
            row, entry = beyond[0], entries[name]
            value = f"{table[entry.column][row]:g} {entry.unit}"
            raise IdentificationError(
                f"{path}: row {row + 1}: {entry.column}: {value} cannot be measured "
                f"(more than {LARGEST:g} in SI units): mend the table, or leave the cell empty"
            )
    clock = si.pop("time")
    if (lacking := np.flatnonzero(np.isnan(clock))).size > UNTIMED * len(clock):
        raise IdentificationError(
            f"{path}: {entries['time'].column}: is empty in {len(lacking)} of {len(clock)} rows "
            f"(the first is row {lacking[0] + 1}): rows need a time"
        )
    rows = _at_new_times(np.arange(len(clock)), clock, f"{path}: {entries['time'].column}")
    start = float(clock[rows[0]])
    time = clock[rows] - start
    pose = np.column_stack([si.pop(name)[rows] for name in ("x", "y", "yaw") if name in si])
    complete = np.isfinite(pose).all(axis=1)
    if np.count_nonzero(complete) < 2:
        raise IdentificationError(
            f"{path}: no two rows have {', '.join(('x', 'y', 'yaw')[: pose.shape[1]])}"
        )
    pose = _pose_of_com(pose[complete], columns.sensor, str(path))
    samples = {}
    for name, values in si.items():
        own = entries[name].clock
        if own:
            samples[name] = _by_own_clock(values, table[own], rows, time, f"{path}: {own}")
        else:
            known = np.isfinite(values[rows])
            samples[name] = Samples(time[known], values[rows][known])
        if not len(samples[name].time):
            raise IdentificationError(f"{path}: {entries[name].column}: holds no number")
    yaw, filtered = None, 0.0
    if pose.shape[1] > 2:
        yaw = pose[:, 2]
        if "yaw_rate" in samples:
            filtered = filter_of(time[complete], yaw, samples["yaw_rate"])
    return Recording(
        name=path.name,
        start=start,
        time=time[complete],
        x=pose[:, 0],
        y=pose[:, 1],
        yaw=yaw,
        steering=samples.pop("steering" if columns.steering_angle is None else "steering_angle"),
        more=samples,
        steering_measured=columns.steering_angle is not None,
        pose_filter=filtered,
    )


def _radius(name: str, column: Column, vehicle: Vehicle | None, where: str) -> float:
    """Radius [m] by which a wheel's speed in m/s becomes one in rad/s; 1 for all else."""
    if column.unit not in _SPEED or not name.startswith("wheel_speed"):
        return 1.0
    if vehicle is None:
        raise IdentificationError(f"{where}: {name}: {column.unit} needs a vehicle, for its tyres")
    if name == "wheel_speed":
        return vehicle.driven_radius
    known = {wheel.name: wheel for wheel in vehicle.wheels}
    wheel = name.removeprefix(f"{WHEELS}.")
    _refuse_unknown({wheel: None}, [*known], f"{where}: {WHEELS}")
    return float(vehicle.of(known[wheel]).tyre_radius)


def _read_table(path: Path, headings: set[str]) -> dict[str, FloatArray]:
    """Columns (rows,) of these headings; NaN where a cell is empty."""
    text = io.StringIO(_text(path), newline="")
    separator = separator_of(text)
    text.seek(0)
    try:
        lines = [line for line in csv.reader(text, delimiter=separator) if line]
    except csv.Error as error:
        raise IdentificationError(f"{path}: is not a CSV file: {error}") from error
    if not lines:
        raise IdentificationError(f"{path}: is empty: a header and rows of numbers are needed")
    header = [cell.strip() for cell in lines[0]]
    for heading in sorted(headings):
        if heading not in header:
            raise IdentificationError(
                f"{path}: column {heading!r} is missing; {hint(heading, header)}"
            )
        if header.count(heading) > 1:
            raise IdentificationError(f"{path}: column {heading!r} comes twice")
    if len(lines) == 1:
        raise IdentificationError(f"{path}: has a header and no rows")
    at = {heading: header.index(heading) for heading in headings}
    table = {heading: np.empty(len(lines) - 1) for heading in headings}
    for row, line in enumerate(lines[1:], start=1):
        if len(line) != len(header):
            last = row == len(lines) - 1 and len(line) < len(header)
            cut = "; it is the last one: if the recording was cut off, delete it" if last else ""
            raise IdentificationError(
                f"{path}: row {row}: has {len(line)} cells, the header {len(header)}{cut}"
            )
        for heading, place in at.items():
            cell = line[place].strip()
            try:
                # without digits in groups, as in 1_000, which Python takes
                value = float(cell.replace("_", "?")) if cell else math.nan
            except ValueError:
                value = math.inf
            if math.isinf(value):
                point = ", with a point for its decimals" if "," in cell else ""
                raise IdentificationError(
                    f"{path}: row {row}: {heading}: needs a number{point}, not {reprlib.repr(cell)}"
                )
            table[heading][row - 1] = value
    return table


def _text(path: Path) -> str:
    content = read_bounded(path, MAX_BYTES, "a table of a drive", IdentificationError)
    try:
        if path.suffix == ".gz":
            with gzip.open(io.BytesIO(content)) as packed:
                content = packed.read(MAX_BYTES + 1)
            if len(content) > MAX_BYTES:
                raise IdentificationError(f"{path}: unpacks to more than {MAX_BYTES} bytes")
        return content.decode("utf-8-sig")
    except EOFError as error:
        raise IdentificationError(f"{path}: is cut off: the gzip file ends too early") from error
    except (OSError, zlib.error) as error:
        raise IdentificationError(f"{path}: is not a gzip file: {error}") from error
    except UnicodeDecodeError as error:
        raise IdentificationError(f"{path}: is not a CSV file in UTF-8") from error


def _at_new_times(rows: NDArray[np.int64], clock: FloatArray, where: str) -> NDArray[np.int64]:
    """Rows, of those given, that have a time, and not the same one as the row before."""
    rows = rows[np.isfinite(clock[rows])]
    steps = np.diff(clock[rows])
    if len(back := np.flatnonzero(steps < 0.0)):
        row = rows[back[0] + 1]
        raise IdentificationError(
            f"{where}: goes back by {-steps[back[0]]:.3g} s at row {row + 1}; times must increase"
        )
    rows = rows[np.append(True, steps > 0.0)] if len(rows) else rows
    if len(rows) < 2:
        raise IdentificationError(f"{where}: needs two different times or more")
    return rows


def _by_own_clock(
    values: FloatArray, own: FloatArray, rows: NDArray[np.int64], time: FloatArray, where: str
) -> Samples:
    """Samples with a clock of their own, shifted to that of the poses.

    Only these rows of the table count, whose times by the clock of the poses are `time`.
    """
    new = _at_new_times(rows, own, where)
    new = new[np.isfinite(values[new])]
    if not len(new):
        return Samples(time[:0], values[:0])
    apart = time[np.searchsorted(rows, new)] - own[new]
    shifted = own[new] + np.median(apart)
    # a clock may begin elsewhere than it goes on
    inside = (shifted > time[0] - BESIDE) & (shifted < time[-1] + BESIDE)
    if np.mean(inside) < 0.5:
        raise IdentificationError(
            f"{where}: {np.mean(~inside):.0%} of its times are outside of those of the rows: it "
            "must be in s, and at their pace, or the unit of `time` is wrong"
        )
    shifted = own[new] + _shift(own[new], apart, where)
    return Samples(shifted[inside], values[new][inside])


def _shift(own: FloatArray, apart: FloatArray, where: str) -> FloatArray | float:
    """What to add to times (m,) of a clock, which are so far `apart` from those of the poses.

    The median; of a clock that runs faster or slower, what lies on a line through the medians of
    the first and the last third. Rows that come late bend neither.
    """
    shift: FloatArray | float = float(np.median(apart))
    if len(own) < STEADY:
        return shift
    third = len(own) // 3
    (t0, t1), (a0, a1) = ((np.median(v[:third]), np.median(v[-third:])) for v in (own, apart))
    if abs(a1 - a0) > GROWN and abs(a1 - a0) < PACE * (t1 - t0):
        line = (a1 - a0) / (t1 - t0) * own
        shift = line + np.median(apart - line)
    parts = np.array_split(np.arange(len(own)), PARTS)
    off = [abs(float(np.median((apart - shift)[part]))) for part in parts]
    if max(off) > UNSTEADY:
        raise IdentificationError(
            f"{where}: does not run evenly by `time`: it is {max(off):.2g} s off a line: was it "
            "set? Cut the table there"
        )
    return shift


def _pose_of_com(pose: FloatArray, sensor: SensorPlace, where: str) -> FloatArray:
    """Poses of the COM (m, 2 or 3) from those of the sensor."""
    if pose.shape[1] == 2:
        if (sensor.x, sensor.y, sensor.yaw) != (0.0, 0.0, 0.0):
            raise IdentificationError(f"{where}: sensor: needs the column yaw too")
        return pose
    yaw = np.unwrap(pose[:, 2]) - sensor.yaw
    c, s = np.cos(yaw), np.sin(yaw)
    x = pose[:, 0] - (c * sensor.x - s * sensor.y)
    y = pose[:, 1] - (s * sensor.x + c * sensor.y)
    return np.column_stack([x, y, yaw])
