"""Parquet files of simulated trajectories: those that a study keeps, and those it is given.

A row per time point, in the order of time, with the columns ``point`` and ``sample`` (whole
numbers), ``maneuver`` (from 0; may be missing where maneuvers are no sets), and one column per
channel, whatever its name, in the same order in all files. A failed simulation has NaN.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tricycle_core.documents import read_bounded, write_whole
from tricycle_core.errors import DesignError
from tricycle_core.optional import optional
from tricycle_core.quantities import FloatArray

MAX_BYTES = 256_000_000
"""Largest file that is read."""

MAX_VALUES = 100_000_000
"""Most numbers in a file that is read: compressed, they may take little room."""

KEYS = ("point", "sample", "maneuver")
"""Columns that are no channels."""

INDEX = re.compile(r"__index_level_\d+__")
"""Name of a column in which pandas writes the index of a table."""

Told = dict[int, tuple[list[int], tuple[FloatArray, ...]]]
"""Samples (q,) of each point, and their trajectories (q, t, c) in each maneuver."""


def write_trajectories(
    path: Path,
    point: int,
    samples: list[int],
    outputs: tuple[FloatArray, ...],
    channels: Sequence[str] | None = None,
) -> None:
    """Write trajectories of some samples of a point.

    Parameters
    ----------
    path : Path
        File that appears.
    point : int
        Number of the maneuver, or of the set.
    samples : list of int, length q
        Numbers of the simulations.
    outputs : tuple of ndarray, shape (q, t, c) each
        Trajectories in each maneuver of a set.
    channels : sequence of str, length c, optional
        Names of the channels.

    Raises
    ------
    DesignError
        If maneuvers have different channels, or a file of so many numbers is not read again.
    ReportError
        If pyarrow is not installed.
    """
    arrow = optional("pyarrow", "a study of trajectories")
    parquet = optional("pyarrow.parquet", "a study of trajectories")
    counts = {Y.shape[2] for Y in outputs}
    if len(counts) > 1:
        raise DesignError(f"point {point}: maneuvers have {sorted(counts)} channels: not the same")
    sample = [np.repeat(samples, Y.shape[1]) for Y in outputs]
    columns = {
        "point": np.full(sum(map(len, sample)), point),
        "sample": np.concatenate(sample),
        "maneuver": np.repeat(np.arange(len(outputs)), [len(rows) for rows in sample]),
    }
    values = np.concatenate([Y.reshape(-1, Y.shape[2]) for Y in outputs])
    columns |= dict(zip(channels or unnamed(len(values.T)), values.T, strict=True))
    if len(columns) * len(values) > MAX_VALUES:
        raise DesignError(
            f"point {point}: more than {MAX_VALUES} numbers: tell fewer samples at once"
        )
    sink = arrow.BufferOutputStream()
    parquet.write_table(arrow.table(columns), sink, compression="zstd")
    content = sink.getvalue().to_pybytes()
    if len(content) > MAX_BYTES:
        raise DesignError(f"point {point}: more than {MAX_BYTES} bytes: tell fewer samples at once")
    write_whole(path, content)


def unnamed(count: int) -> list[str]:
    """Return default names for channels that were given without names.

    Parameters
    ----------
    count : int
        Number of channels.
    """
    return [f"channel{i}" for i in range(count)]


def channels_of(path: Path) -> list[str]:
    """Return the names of the channels in a file, in their order.

    Parameters
    ----------
    path : Path
        Parquet file of trajectories.

    Raises
    ------
    DesignError, ReportError
        As of `read_trajectories`.
    """
    with _opened(path) as file:
        return [name for name in file.schema_arrow.names if name not in KEYS]


def read_trajectories(path: Path) -> Told:
    """Return the trajectories in a file.

    Parameters
    ----------
    path : Path
        Parquet file of trajectories.

    Raises
    ------
    DesignError
        If it is not such a file, or a point's simulations have different numbers of time points.
    ReportError
        If pyarrow is not installed.
    """
    columns = _columns(path)
    missing = [name for name in KEYS[:2] if name not in columns]
    channels = [name for name in columns if name not in KEYS]
    if missing or not channels:
        raise DesignError(f"{path}: column {', '.join(missing) or 'of a channel'} is missing")
    point, sample = (_whole(path, name, columns[name]) for name in KEYS[:2])
    maneuver = _whole(path, "maneuver", columns["maneuver"]) if "maneuver" in columns else 0 * point
    values = np.column_stack([columns[name] for name in channels]).astype(float)
    told: Told = {}
    for number in np.unique(point).tolist():
        here = point == number
        samples = np.unique(sample[here])
        outputs = []
        for part in np.unique(maneuver[here]).tolist():
            rows = np.flatnonzero(here & (maneuver == part))
            found, counts = np.unique(sample[rows], return_counts=True)
            if not np.array_equal(found, samples) or np.ptp(counts) > 0:
                raise DesignError(
                    f"{path}: point {number}: all samples must have the same number of time points"
                )
            rows = rows[np.argsort(sample[rows], kind="stable")]
            outputs.append(values[rows].reshape(len(samples), counts[0], len(channels)))
        told[number] = (samples.tolist(), tuple(outputs))
    return told


def _columns(path: Path) -> dict[str, NDArray[np.generic]]:
    with _opened(path) as file:
        if file.metadata.num_rows * file.metadata.num_columns > MAX_VALUES:
            raise DesignError(f"{path}: more than {MAX_VALUES} numbers")
        table = file.read()
    if index := [name for name in table.column_names if INDEX.fullmatch(name)]:
        raise DesignError(
            f"{path}: column {index[0]} is an index of pandas: write it with index=False"
        )
    if len(set(table.column_names)) < len(table.column_names):
        raise DesignError(f"{path}: a column is there twice: {', '.join(table.column_names)}")
    columns = {name: table.column(name).to_numpy() for name in table.column_names}
    for name, column in columns.items():
        if column.dtype.kind not in "iuf":
            raise DesignError(f"{path}: column {name} must be numbers")
    return columns


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a Parquet file; errors name its path."""
    arrow = optional("pyarrow", "a study of trajectories")
    parquet = optional("pyarrow.parquet", "a study of trajectories")
    content = read_bounded(path, MAX_BYTES, "a file of trajectories", DesignError)
    try:
        yield parquet.ParquetFile(arrow.BufferReader(content))
    except arrow.ArrowException as error:
        first = str(error).partition("\n")[0]
        raise DesignError(f"{path}: is not a Parquet file: {first}") from error
    except OSError as error:
        raise DesignError(f"{path}: is not a Parquet file: {error}") from error


def _whole(path: Path, name: str, column: NDArray[np.generic]) -> NDArray[np.int64]:
    numbers = column.astype(float)
    if not (np.isfinite(numbers).all() and np.array_equal(numbers, np.floor(numbers))):
        raise DesignError(f"{path}: column {name} must be whole numbers")
    return numbers.astype(np.int64)
