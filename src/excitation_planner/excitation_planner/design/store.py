"""The store of a study: every simulation of a design on disk, so that nothing is run twice.

The directory holds three files:

``study.json``
    The problem; written once.
``points.csv``
    ``point, verification, <operation parameters>``: a maneuver that was asked for.
``results.csv``
    ``point, sample, output``: a number, ``failed``, or (sample ``*``) ``infeasible: reason``.

The CSV files only grow, by whole lines; a line cut off by a crash is dropped on opening.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from excitation_planner.box import Box
from excitation_planner.design.criteria import Criterion
from excitation_planner.design.noise import TrajectoryErrorNoise, TrajectoryNoise
from excitation_planner.design.problem import DesignProblem, NoiseVariance, Outcome, Search
from tricycle_core.documents import (
    check_texts,
    decode,
    encode,
    parse_json,
    read_bounded,
    write_whole,
)
from tricycle_core.errors import DesignError
from tricycle_core.quantities import FloatArray

VERSION = 1
"""Of the description in ``study.json``."""

MAX_BYTES = 256_000_000
"""Largest file that is read; a result takes about 30 bytes."""

MAX_RUNS = 10_000_000
"""Most runs of a study that is read: its samples are drawn on opening."""

FAILED = "failed"
"""Output of a failed simulation."""

INFEASIBLE = "infeasible: "
"""Begins the output of a maneuver that cannot be driven."""


@dataclass(frozen=True)
class StudyDocument:
    """Content of ``study.json``.

    Attributes
    ----------
    version : int
        `VERSION`.
    operation, unknown : mapping of str to (float, float)
        Ranges by name.
    target : str
        Unknown parameter to excite.
    noise_variance : float or TrajectoryErrorNoise
        V_n.
    samples : int
        Runs per maneuver during the search.
    budget : int
        Largest number of runs.
    seed : int
        Of the design.
    search : Search
        How the operation box is searched.

    Raises
    ------
    DesignError
        A number that is out of range.
    """

    version: int
    operation: dict[str, tuple[float, float]]
    unknown: dict[str, tuple[float, float]]
    target: str
    noise_variance: float | TrajectoryErrorNoise
    samples: int
    budget: int
    seed: int
    search: Search

    def __post_init__(self) -> None:
        for name, high in (("samples", MAX_RUNS), ("budget", MAX_RUNS), ("seed", 2**63)):
            if not 0 <= getattr(self, name) <= high:
                raise DesignError(f"{name} must be a whole number from 0 to {high}")

    @classmethod
    def of(cls, problem: DesignProblem) -> Self:
        """Return the description of a problem."""
        if problem.criterion is not Criterion.H or problem.target is None:
            raise DesignError(f"a study keeps scalar outputs: criterion h, not {problem.criterion}")
        noise = problem.noise_variance
        if callable(noise) and not isinstance(noise, TrajectoryErrorNoise):
            raise DesignError(
                "a study needs a noise variance that is a number or TrajectoryErrorNoise"
            )
        return cls(
            version=VERSION,
            operation=problem.operation.bounds(),
            unknown=problem.unknown.bounds(),
            target=problem.target,
            noise_variance=noise,
            samples=problem.samples,
            budget=problem.budget,
            seed=problem.seed,
            search=problem.search,
        )

    def problem(self) -> DesignProblem:
        """Return the problem that is described."""
        return problem_of_outputs(
            Box.of(self.operation),
            Box.of(self.unknown),
            self.target,
            noise_variance=self.noise_variance,
            samples=self.samples,
            budget=self.budget,
            seed=self.seed,
            search=self.search,
        )


class Store:
    """What is known of a design, in memory and on disk.

    Attributes
    ----------
    path : Path
        Directory.
    problem : DesignProblem
        With the criterion H: trajectories are not kept.

    Raises
    ------
    DesignError
        Files that are damaged.
    """

    def __init__(self, path: Path, problem: DesignProblem) -> None:
        self.path, self.problem = path, problem
        self._sizes = [problem.runs(verification=v) for v in (False, True)]
        self._points: dict[tuple[float, ...], int] = {}  # (verification, *x) -> point
        self._outputs: dict[int, dict[int, float]] = {}  # point -> sample -> output
        self._reasons: dict[int, str] = {}  # point -> why it is infeasible
        try:
            self._read()
        except (ValueError, IndexError, csv.Error) as error:
            raise DesignError(f"{path}: points.csv and results.csv are damaged: {error}") from error

    def _read(self) -> None:
        for row in _rows(self.path / "points.csv"):
            verification, *x = map(float, row[1:])
            if verification not in (0, 1) or len(x) != len(self.problem.operation):
                raise ValueError(f"point {row[0]} has {len(x)} operation parameters")
            self._points[(verification, *x)] = int(row[0])
        for point, sample, output in _rows(self.path / "results.csv"):
            if sample == "*":
                self._reasons[int(point)] = output.removeprefix(INFEASIBLE)
            else:
                value = math.nan if output == FAILED else float(output)
                self._outputs.setdefault(int(point), {})[int(sample)] = value

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open the store in a directory."""
        file = path / "study.json"
        described = decode(StudyDocument, _load(path), str(file), DesignError)
        try:
            problem = described.problem()
        except DesignError as error:
            raise DesignError(f"{file}: {error}") from error
        return cls(path, problem)

    @classmethod
    def of(cls, path: Path, problem: DesignProblem) -> Self:
        """Open the store of a problem, or begin it.

        Parameters
        ----------
        path : Path
            Directory.
        problem : DesignProblem
            Of the design; that of an existing store must be the same.

        Raises
        ------
        DesignError
            A directory with the study of another problem.
        """
        text = json.dumps(encode(StudyDocument.of(problem)), indent=2) + "\n"
        if (path / "study.json").exists():
            kept, described = _load(path), json.loads(text)
            different = sorted(key for key in described if kept.get(key) != described[key])
            if different:
                raise DesignError(
                    f"{path}: is a study of another design (different: {', '.join(different)}); "
                    "give another directory"
                )
        else:
            write_whole(path / "study.json", text)
        return cls(path, problem)

    def outcome(self, x: FloatArray, *, verification: bool) -> Outcome | None:
        """Return all outputs at a maneuver, or why it is infeasible; None when some are missing.

        Parameters
        ----------
        x : ndarray of float, shape (l,)
            Operation parameters.
        verification : bool
            Whether the samples are those of the verification.
        """
        point = self._points.get((verification, *x.tolist()))
        if point is None:
            return None
        if point in self._reasons:
            return self._reasons[point]
        known = self._outputs.get(point, {})
        if self.missing(point, verification=verification):
            return None
        return (np.array([known[sample] for sample in range(len(known))]),)

    def missing(self, point: int, *, verification: bool) -> list[int]:
        """Return the samples of a point that have no output yet.

        Parameters
        ----------
        point : int
            Number of the maneuver.
        verification : bool
            Whether the samples are those of the verification.
        """
        known = self._outputs.get(point, {})
        return [sample for sample in range(self._sizes[verification]) if sample not in known]

    def number(self, x: FloatArray, *, verification: bool) -> int:
        """Return the number of a maneuver, given now if it has none.

        Parameters
        ----------
        x : ndarray of float, shape (l,)
            Operation parameters.
        verification : bool
            Whether the samples are those of the verification.
        """
        key = (float(verification), *x.tolist())
        if key not in self._points:
            point = len(self._points)
            _append(
                self.path / "points.csv",
                ["point", "verification", *self.problem.operation.names],
                [[point, int(verification), *map(repr, x.tolist())]],
            )
            self._points[key] = point
        return self._points[key]

    def keep(self, x: FloatArray, outcome: Outcome, *, verification: bool) -> None:
        """Add the outcome of a maneuver, unless it is known.

        Parameters
        ----------
        x : ndarray of float, shape (l,)
            Operation parameters.
        outcome : tuple or str
            What f gave there.
        verification : bool
            Whether the samples are those of the verification.
        """
        if self.outcome(x, verification=verification) is not None:
            return
        point = self.number(x, verification=verification)
        if isinstance(outcome, str):
            self.add_reason(point, outcome)
        else:
            samples = self.missing(point, verification=verification)
            self.add_outputs([(point, sample, float(outcome[0][sample])) for sample in samples])

    def add_outputs(self, results: Sequence[tuple[int, int, float]]) -> None:
        """Add (point, sample, output) each; an output that is not finite is a failed simulation."""
        self.add(results, {})

    def add_reason(self, point: int, reason: str) -> None:
        """Mark the maneuver as one that cannot be driven.

        Parameters
        ----------
        point : int
            Number of the maneuver.
        reason : str
            Why it cannot be driven.
        """
        self.add([], {point: reason})

    def add(self, results: Sequence[tuple[int, int, float]], reasons: Mapping[int, str]) -> None:
        """Add outputs and reasons why points are infeasible, all or none.

        DesignError, and nothing added, for one never asked for or one that is known otherwise.

        Parameters
        ----------
        results : sequence of (int, int, float)
            Point, sample and output.
        reasons : mapping of int to str
            By point, why it is infeasible.
        """
        sizes = {point: self._sizes[int(key[0])] for key, point in self._points.items()}
        new: dict[tuple[int, int], float] = {}
        for point, sample, value in results:
            output = value if math.isfinite(value) else math.nan
            if not 0 <= sample < sizes.get(point, 0):
                raise DesignError(
                    f"{self.path}: point {point}, sample {sample} was never asked for"
                )
            if point in self._reasons or point in reasons:
                raise DesignError(
                    f"{self.path}: point {point} has an output and is infeasible: which?"
                )
            known = self._outputs.get(point, {}).get(sample, new.get((point, sample)))
            if known is None:
                new[point, sample] = output
            elif not np.array_equal(known, output, equal_nan=True):
                raise DesignError(
                    f"{self.path}: point {point}, sample {sample} has the output {known!r} already"
                )
        new_reasons: dict[int, str] = {}
        for point, text in reasons.items():
            reason = " ".join(text.split())
            if point not in sizes:
                raise DesignError(f"{self.path}: point {point} was never asked for")
            if point in self._outputs:
                raise DesignError(f"{self.path}: point {point} has outputs already")
            if point not in self._reasons:
                new_reasons[point] = reason
            elif self._reasons[point] != reason:
                raise DesignError(
                    f"{self.path}: point {point} is infeasible already: {self._reasons[point]}"
                )
        _append(
            self.path / "results.csv",
            ["point", "sample", "output"],
            [
                *([p, s, FAILED if math.isnan(m) else repr(m)] for (p, s), m in new.items()),
                *([p, "*", INFEASIBLE + reason] for p, reason in new_reasons.items()),
            ],
        )
        for (point, sample), output in new.items():
            self._outputs.setdefault(point, {})[sample] = output
        self._reasons |= new_reasons


# --- files ----------------------------------------------------------------------------------------


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Return rows as the text of a CSV file.

    Parameters
    ----------
    rows : iterable
        Of cells.
    """
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def read_study_file(path: Path) -> bytes:
    """Return the content of a file of a study.

    Parameters
    ----------
    path : Path
        File of a study, or of outputs for one.
    """
    return read_bounded(path, MAX_BYTES, "a file of a study", DesignError)


def _append(path: Path, header: list[str], rows: list[list[object]]) -> None:
    """Add rows to a CSV file and wait until they are on disk."""
    if not rows:
        return
    with path.open("ab") as file:
        text = csv_text(rows if file.tell() else [header, *rows])
        file.write(text.encode())
        file.flush()
        os.fsync(file.fileno())


def _rows(path: Path) -> list[list[str]]:
    """Rows of a CSV file without its header; a last line cut off by a crash is removed from it."""
    if not path.exists():
        return []
    whole = read_study_file(path)
    kept = whole[: whole.rfind(b"\n") + 1]
    if len(kept) < len(whole):
        with path.open("r+b") as file:
            file.truncate(len(kept))
    return list(csv.reader(io.StringIO(kept.decode())))[1:]


def _load(path: Path) -> dict[str, Any]:
    file = path / "study.json"
    if not file.exists():
        raise DesignError(f"{path}: holds no study (study.json is missing)")
    kept = parse_json(read_study_file(file), str(file), DesignError)
    if not isinstance(kept, dict) or "version" not in kept:
        raise DesignError(f"{file}: is not the description of a study")
    check_texts(kept, str(file), DesignError)
    if kept["version"] != VERSION:
        raise DesignError(
            f"{path}: study of version {kept['version']!r}; this program reads {VERSION}"
        )
    return kept


def problem_of_outputs(
    operation: Box,
    unknown: Box,
    target: str,
    *,
    noise_variance: NoiseVariance,
    samples: int,
    budget: int,
    seed: int,
    search: Search,
) -> DesignProblem:
    """Return a problem of the criterion H.

    Parameters
    ----------
    operation, unknown : Box
        Ranges of the operation and of the unknown parameters.
    target : str
        Unknown parameter to excite.
    noise_variance : float or callable
        V_n.
    samples : int
        Runs per maneuver during the search.
    budget : int
        Largest number of runs.
    seed : int
        The same seed gives the same design.
    search : Search
        How the operation box is searched.
    """
    return DesignProblem(
        operation=operation,
        unknown=unknown,
        target=target,
        criterion=Criterion.H,
        noise_variance=noise_variance,
        trajectory_noise=TrajectoryNoise(),
        samples=samples,
        draws=1,
        budget=budget,
        seed=seed,
        search=search,
    )
