"""The store of a study: every simulation of a design on disk, so that nothing is run twice.

The directory holds:

``study.json``
    The problem; written once.
``points.csv``
    ``point, verification, <operation parameters>``: a maneuver that was asked for.
``results.csv``
    ``point, sample, output``: a number, a file of trajectories, ``failed``, or (sample ``*``)
    ``infeasible: reason``.
``trajectories/*.parquet``
    For the criteria c, d and a: a row per time point with the columns ``point``, ``sample``,
    ``maneuver`` (of a set, from 0) and one for each channel.
``lock``
    Held by a process while it adds something.

The CSV files only grow, by whole lines, and so may be added to by several processes; a line cut
off by a crash is left out, and removed before the next one is added.
"""

from __future__ import annotations

import csv
import fcntl
import hashlib
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import numpy as np

from excitation_planner.design.criteria import Criterion
from excitation_planner.design.problem import DesignProblem, Outcome
from excitation_planner.design.study_document import StudyDocument, load_study_document
from excitation_planner.design.study_files import GrowingTable
from excitation_planner.design.study_trajectories import (
    channels_of,
    read_trajectories,
    unnamed,
    write_trajectories,
)
from tricycle_core.documents import (
    encode,
    write_whole,
)
from tricycle_core.errors import DesignError
from tricycle_core.quantities import FloatArray

FAILED = "failed"
"""Output of a failed simulation."""

INFEASIBLE = "infeasible: "
"""Begins the output of a maneuver that cannot be driven."""

TRAJECTORIES = "trajectories"
"""Folder of the files of trajectories."""

_KEPT = ("points.csv", "results.csv", TRAJECTORIES)
_FILE = re.compile(r"[0-9a-f]{32}\.parquet")


class Store:
    """Simulations of a design on disk; several processes may add to it.

    Attributes
    ----------
    path : Path
        Directory of the study.
    problem : DesignProblem
        Design problem to which the simulations belong.

    Raises
    ------
    DesignError
        If files are damaged.
    """

    def __init__(self, path: Path, problem: DesignProblem) -> None:
        self.path, self.problem = path, problem
        self._sizes = [problem.runs(verification=v) for v in (False, True)]
        self._points: dict[tuple[float, ...], int] = {}  # (verification, *x) -> point
        self._asked: dict[int, int] = {}  # point -> number of its samples
        # point -> sample -> output, or the file that has it; NaN: failed
        self._outputs: dict[int, dict[int, float | str]] = {}
        self._reasons: dict[int, str] = {}  # point -> why it is infeasible
        names = problem.operation.names
        self._points_file = GrowingTable(path / "points.csv", ["point", "verification", *names])
        self._results_file = GrowingTable(path / "results.csv", ["point", "sample", "output"])
        self.refresh()

    def refresh(self) -> None:
        """Read what other processes have added."""
        try:
            self._read()
        except (ValueError, IndexError, csv.Error) as error:
            for file in (self._points_file, self._results_file):
                file.begin_again()  # the next call must meet the damage too
            raise DesignError(
                f"{self.path}: points.csv and results.csv are damaged: {error}"
            ) from error

    def _read(self) -> None:
        results = self._results_file.new()  # first: their points are there then
        for row in self._points_file.new():
            verification, *x = map(float, row[1:])
            if verification not in (0, 1) or len(x) != len(self.problem.operation):
                raise ValueError(f"point {row[0]} has {len(x)} operation parameters")
            self._take_point(int(row[0]), (verification, *x))
        for cell, sample, output in results:
            if (point := int(cell)) not in self._asked:
                raise ValueError(f"results.csv has point {point}, and points.csv does not")
            if sample == "*":
                self._reasons[point] = output.removeprefix(INFEASIBLE)
            else:
                self._outputs.setdefault(point, {})[int(sample)] = self._parsed(output)

    def _take_point(self, point: int, key: tuple[float, ...]) -> None:
        self._points[key] = point
        self._asked[point] = self._sizes[int(key[0])]

    def _parsed(self, output: str) -> float | str:
        if output == FAILED:
            return math.nan
        if self.problem.criterion is Criterion.H:
            return float(output)
        if not _FILE.fullmatch(output):
            raise ValueError(f"{output!r} is not a file of trajectories")
        return output

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open the store in a directory."""
        described = load_study_document(path)
        try:
            problem = described.problem()
        except DesignError as error:
            raise DesignError(f"{path / 'study.json'}: {error}") from error
        return cls(path, problem)

    @classmethod
    def of(cls, path: Path, problem: DesignProblem) -> Self:
        """Open the store of a problem; create it if there is none.

        Parameters
        ----------
        path : Path
            Directory of the study.
        problem : DesignProblem
            Design problem; an existing store must have the same one.

        Raises
        ------
        DesignError
            If the directory holds the study of another problem.
        """
        described = encode(StudyDocument.of(problem))
        if (path / "study.json").exists():
            kept = encode(load_study_document(path))
            different = sorted(
                key for key in described if key != "version" and kept[key] != described[key]
            )
            if different:
                raise DesignError(
                    f"{path}: is a study of another design (different: {', '.join(different)}); "
                    "give another directory"
                )
        elif left := [name for name in _KEPT if (path / name).exists()]:
            raise DesignError(
                f"{path}: holds {', '.join(left)} of a study whose study.json is missing; give "
                "another directory"
            )
        else:
            write_whole(path / "study.json", json.dumps(described, indent=2) + "\n")
        return cls(path, problem)

    def recall(
        self, x: FloatArray, samples: range | None = None, *, verification: bool
    ) -> Outcome | None:
        """Return the result of f at a maneuver, or why it is infeasible; None if some is missing.

        Parameters
        ----------
        x : ndarray of float, shape (l,)
            Operation parameters.
        samples : range, optional
            Numbers of the simulations; by default all.
        verification : bool
            Whether the samples are those of the verification.
        """
        point = self._points.get((verification, *x.tolist()))
        if point is None:
            return None
        if point in self._reasons:
            return self._reasons[point]
        known = self._outputs.get(point, {})
        wanted = range(self._sizes[verification]) if samples is None else samples
        if any(sample not in known for sample in wanted):
            return None
        return self._rows(point, wanted)

    def _rows(self, point: int, samples: Iterable[int]) -> tuple[FloatArray, ...]:
        """Known outputs of some samples of a point."""
        known = [self._outputs[point][sample] for sample in samples]
        if self.problem.criterion is Criterion.H:
            return (np.array(known, dtype=float),)
        files = {
            name: read_trajectories(self.path / TRAJECTORIES / name).get(point, ([], ()))
            for name in dict.fromkeys(output for output in known if isinstance(output, str))
        }
        rows: list[tuple[FloatArray, ...] | None] = []
        for sample, output in zip(samples, known, strict=True):
            if isinstance(output, float):
                rows.append(None)
                continue
            has, outputs = files[output]
            if sample not in has:
                raise DesignError(
                    f"{self.path / TRAJECTORIES / output}: lacks point {point}, sample {sample}"
                )
            rows.append(tuple(Y[has.index(sample)] for Y in outputs))
        # of failed ones nothing but that is known, and nothing else is needed
        shapes = next((tuple(Y.shape for Y in row) for row in rows if row), ((1, 1),))
        failed = tuple(np.full(shape, np.nan) for shape in shapes)
        return tuple(np.stack(part) for part in zip(*(row or failed for row in rows), strict=True))

    def asked(self, point: int) -> tuple[FloatArray, bool]:
        """Return operation parameters (l,) of a point, and whether it is for the verification.

        Raises
        ------
        DesignError
            A point that was never asked for.
        """
        for (verification, *x), number in self._points.items():
            if number == point:
                return np.array(x), bool(verification)
        raise DesignError(f"{self.path}: point {point} was never asked for")

    def missing(self, point: int, *, verification: bool) -> list[int]:
        """Return the samples of a point that have no output yet.

        Parameters
        ----------
        point : int
            Number of the maneuver.
        verification : bool
            Whether the samples are those of the verification.
        """
        if point in self._reasons:
            return []
        known = self._outputs.get(point, {})
        return [sample for sample in range(self._sizes[verification]) if sample not in known]

    def number(self, x: FloatArray, *, verification: bool) -> int:
        """Return the number of a maneuver; a new maneuver gets the next one.

        Parameters
        ----------
        x : ndarray of float, shape (l,)
            Operation parameters.
        verification : bool
            Whether the samples are those of the verification.
        """
        key = (float(verification), *x.tolist())
        if key not in self._points:
            with self._adding():
                self._append_point(key)
        return self._points[key]

    def keep(self, x: FloatArray, samples: range, outcome: Outcome, *, verification: bool) -> None:
        """Add the outcome of some samples of a maneuver.

        Parameters
        ----------
        x : ndarray of float, shape (l,)
            Operation parameters.
        samples : range
            Numbers of the simulations.
        outcome : tuple or str
            Result of f there, or why the maneuver is infeasible.
        verification : bool
            Whether the samples are those of the verification.
        """
        with self._adding():
            point = self._append_point((float(verification), *x.tolist()))
            # one infeasible sample makes the maneuver infeasible, whatever others have given
            if point in self._reasons:
                return
            if isinstance(outcome, str):
                self._append({}, self._new_reasons({point: outcome}, despite_outputs=True))
            elif self.problem.criterion is Criterion.H:
                results = zip([point] * len(samples), samples, outcome[0].tolist(), strict=True)
                self._append(self._new_outputs(list(results), {}), {})
            else:
                self._append_trajectories(point, samples, outcome, None)

    def add(self, results: Sequence[tuple[int, int, float]], reasons: Mapping[int, str]) -> None:
        """Add outputs and reasons why points are infeasible, all or none.

        DesignError, and nothing added, for one never asked for or one that is known otherwise.

        Parameters
        ----------
        results : sequence of (int, int, float)
            Point, sample and output; one that is not finite is a failed simulation. For the
            criteria C, D and A failed ones alone: `add_trajectories` has the others.
        reasons : mapping of int to str
            Why a maneuver is infeasible, by its number.
        """
        with self._adding():
            self._append(self._new_outputs(results, reasons), self._new_reasons(reasons))

    def add_trajectories(
        self,
        point: int,
        samples: Sequence[int],
        outputs: tuple[FloatArray, ...],
        channels: Sequence[str] | None = None,
    ) -> None:
        """Add trajectories of a point, all or none; refused like those of `add`.

        Parameters
        ----------
        point : int
            Number of the maneuver.
        samples : sequence of int, length q
            Numbers of the simulations.
        outputs : tuple of ndarray, shape (q, t, c) each
            Trajectories in each maneuver of a set.
        channels : sequence of str, length c, optional
            Their names, which are those of all points.
        """
        if self.problem.criterion is Criterion.H:
            raise DesignError(f"{self.path}: criterion h needs a number per sample")
        with self._adding():
            self._append_trajectories(point, samples, outputs, channels)

    # ---- with the lock held ----

    def _append_point(self, key: tuple[float, ...]) -> int:
        if key not in self._points:
            point = len(self._points)
            self._points_file.append([[point, int(key[0]), *map(repr, key[1:])]])
            self._take_point(point, key)
        return self._points[key]

    def _new_outputs(
        self, results: Sequence[tuple[int, int, float]], reasons: Mapping[int, str]
    ) -> dict[tuple[int, int], float]:
        new: dict[tuple[int, int], float] = {}
        for point, sample, value in results:
            output = value if math.isfinite(value) else math.nan
            if self.problem.criterion is not Criterion.H and math.isfinite(value):
                raise DesignError(
                    f"{self.path}: criterion {self.problem.criterion} needs the trajectory of "
                    f"point {point}, sample {sample}, not a number"
                )
            self._check_asked(point, sample, reasons)
            known = self._outputs.get(point, {}).get(sample, new.get((point, sample)))
            if known is None:
                new[point, sample] = output
            elif isinstance(known, str) or not np.array_equal(known, output, equal_nan=True):
                self._refuse(point, sample, known)
        return new

    def _append_trajectories(
        self,
        point: int,
        samples: Sequence[int],
        outputs: tuple[FloatArray, ...],
        channels: Sequence[str] | None,
    ) -> None:
        if len(set(samples)) < len(samples):
            raise DesignError(f"{self.path}: point {point}: a sample is told twice")
        fresh = []
        for i, sample in enumerate(samples):
            self._check_asked(point, sample, {})
            if sample not in self._outputs.get(point, {}):
                fresh.append(i)
                continue
            known = self._rows(point, [sample])
            told = tuple(Y[i : i + 1] for Y in outputs)
            if len(known) != len(told) or not all(
                np.array_equal(a, b, equal_nan=True) for a, b in zip(known, told, strict=True)
            ):
                self._refuse(point, sample, self._outputs[point][sample])
        if not fresh:
            return
        self._check_shapes(point, outputs)
        self._check_channels(channels)
        new, parts = [samples[i] for i in fresh], tuple(Y[fresh] for Y in outputs)
        content = b"".join([repr((point, new)).encode(), *(Y.tobytes() for Y in parts)])
        name = f"{hashlib.sha256(content).hexdigest()[:32]}.parquet"
        write_trajectories(self.path / TRAJECTORIES / name, point, new, parts, channels)
        self._append({(point, sample): name for sample in new}, {})

    def _check_asked(self, point: int, sample: int, reasons: Mapping[int, str]) -> None:
        if not 0 <= sample < self._asked.get(point, 0):
            raise DesignError(f"{self.path}: point {point}, sample {sample} was never asked for")
        if point in self._reasons or point in reasons:
            raise DesignError(f"{self.path}: point {point} has an output and is infeasible: which?")

    def _check_shapes(self, point: int, outputs: tuple[FloatArray, ...]) -> None:
        known = self._outputs.get(point, {})
        sample = next((s for s, output in known.items() if isinstance(output, str)), None)
        if sample is None:
            return
        was, now = (
            ["x".join(map(str, Y.shape[1:])) for Y in Ys]
            for Ys in (self._rows(point, [sample]), outputs)
        )
        if was != now:
            raise DesignError(
                f"{self.path}: point {point} has trajectories of {', '.join(was)} time points and "
                f"channels, not {', '.join(now)}"
            )

    def _check_channels(self, channels: Sequence[str] | None) -> None:
        """Refuse channel names in another order than in the first file; names may be missing."""
        stored = (output for known in self._outputs.values() for output in known.values())
        first = next((output for output in stored if isinstance(output, str)), None)
        if channels is None or first is None:
            return
        was, now = channels_of(self.path / TRAJECTORIES / first), list(channels)
        without = unnamed(len(was)) in (was, now)
        if was != now and (sorted(was) == sorted(now) or not without):
            raise DesignError(
                f"{self.path}: channels are {', '.join(was)}, in this order, not {', '.join(now)}"
            )

    def _refuse(self, point: int, sample: int, known: float | str) -> None:
        raise DesignError(
            f"{self.path}: point {point}, sample {sample} has the output {known!r} already"
        )

    def _new_reasons(
        self, reasons: Mapping[int, str], *, despite_outputs: bool = False
    ) -> dict[int, str]:
        new: dict[int, str] = {}
        for point, text in reasons.items():
            reason = " ".join(text.split())
            if point not in self._asked:
                raise DesignError(f"{self.path}: point {point} was never asked for")
            if not reason:
                raise DesignError(f"{self.path}: point {point}: say why it is infeasible")
            if self._reasons.get(point, reason) != reason:
                raise DesignError(
                    f"{self.path}: point {point} is infeasible already: {self._reasons[point]}"
                )
            if point in self._reasons:
                continue
            if point in self._outputs and not despite_outputs:
                raise DesignError(f"{self.path}: point {point} has outputs already")
            new[point] = reason
        return new

    def _append(
        self, outputs: Mapping[tuple[int, int], float | str], reasons: dict[int, str]
    ) -> None:
        rows: list[list[object]] = []
        for (point, sample), output in outputs.items():
            cell = output if isinstance(output, str) else repr(output)
            rows.append([point, sample, FAILED if cell == "nan" else cell])
        rows += [[point, "*", INFEASIBLE + reason] for point, reason in reasons.items()]
        self._results_file.append(rows)
        for (point, sample), output in outputs.items():
            self._outputs.setdefault(point, {})[sample] = output
        self._reasons |= reasons

    @contextmanager
    def _adding(self) -> Iterator[None]:
        """Keep other processes from adding, and know what they have added."""
        with (self.path / "lock").open("ab") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # until it is closed
            self.refresh()
            yield
