"""Every simulation of a design on disk, so that nothing is lost and nothing is run twice.

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
from dataclasses import asdict
from pathlib import Path
from typing import Any, Self

import numpy as np

from excitation_planner.box import Box
from excitation_planner.design.criteria import Criterion, TrajectoryErrorNoise
from excitation_planner.design.evaluation import NoiseVariance, Outcome, Problem
from excitation_planner.design.information import TrajectoryNoise
from excitation_planner.design.search import Search
from tricycle_core.errors import DesignError
from tricycle_core.quantities import FloatArray

VERSION = 1
MAX_BYTES = 256_000_000  # of a file; a result takes about 30
MAX_RUNS = 10_000_000  # of a study that is read: its samples are drawn on opening

FAILED = "failed"
INFEASIBLE = "infeasible: "


class Store:
    """What is known of a design, in memory and on disk.

    Attributes
    ----------
    path : Path
    problem : Problem
        With the criterion H: trajectories are not kept.
    """

    def __init__(self, path: Path, problem: Problem) -> None:
        self.path, self.problem = path, problem
        self._sizes = [len(problem.parameters(verification=v)) for v in (False, True)]
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
        try:
            return cls(path, _problem(_load(path)))
        except DesignError:
            raise
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise DesignError(f"{path}: study.json is damaged: {error!r}") from error

    @classmethod
    def of(cls, path: Path, problem: Problem) -> Self:
        """Open the store of this problem, or begin it."""
        described = _description(problem)
        if (path / "study.json").exists():
            kept = _load(path)
            different = sorted(key for key in described if kept[key] != described[key])
            if different:
                raise DesignError(
                    f"{path}: is a study of another design (different: {', '.join(different)}); "
                    "give another directory"
                )
        else:
            path.mkdir(parents=True, exist_ok=True)
            replace_file(path / "study.json", json.dumps(described, indent=2) + "\n")
        return cls(path, problem)

    def outcome(self, x: FloatArray, *, verification: bool) -> Outcome | None:
        """All outputs at x (l,), or why it is infeasible; None when some are missing."""
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
        """Samples of a point that have no output yet."""
        known = self._outputs.get(point, {})
        return [sample for sample in range(self._sizes[verification]) if sample not in known]

    def number(self, x: FloatArray, *, verification: bool) -> int:
        """Point number of the maneuver x (l,), given now if it has none."""
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
        """Add the outcome of the maneuver x (l,), unless it is there already."""
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
        """Mark the maneuver as one that cannot be driven."""
        self.add([], {point: reason})

    def add(self, results: Sequence[tuple[int, int, float]], reasons: Mapping[int, str]) -> None:
        """Add outputs (point, sample, output) and reasons why points are infeasible.

        DesignError, and nothing added, for one never asked for or one that is known otherwise.
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
    """Rows as the text of a CSV file."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def replace_file(path: Path, text: str) -> None:
    """Write a whole file, or leave the old one."""
    part = path.with_suffix(".part")
    part.write_text(text)
    part.replace(path)


def read_limited(path: Path) -> bytes:
    """Content of a file.

    Raises
    ------
    DesignError
        If it is larger than any study's.
    """
    with path.open("rb") as file:
        content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise DesignError(f"{path}: larger than {MAX_BYTES} bytes; not a file of a study")
    return content


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
    whole = read_limited(path)
    kept = whole[: whole.rfind(b"\n") + 1]
    if len(kept) < len(whole):
        with path.open("r+b") as file:
            file.truncate(len(kept))
    return list(csv.reader(io.StringIO(kept.decode())))[1:]


def _load(path: Path) -> dict[str, Any]:
    file = path / "study.json"
    if not file.exists():
        raise DesignError(f"{path}: holds no study (study.json is missing)")
    try:
        kept: dict[str, Any] = json.loads(read_limited(file))
        version = kept["version"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise DesignError(f"{file}: is not the description of a study ({error!r})") from error
    if version != VERSION:
        raise DesignError(f"{path}: study of version {version}; this program reads {VERSION}")
    return kept


def _description(problem: Problem) -> dict[str, Any]:
    """The problem as JSON values."""
    if problem.criterion is not Criterion.H:
        raise DesignError(f"a study keeps scalar outputs: criterion h, not {problem.criterion}")
    noise: object = problem.noise_variance
    if isinstance(noise, TrajectoryErrorNoise):
        noise = asdict(noise)
    elif callable(noise):
        raise DesignError("a study needs a noise variance that is a number or TrajectoryErrorNoise")
    return {
        "version": VERSION,
        "operation": {name: list(limits) for name, limits in problem.operation.bounds().items()},
        "unknown": {name: list(limits) for name, limits in problem.unknown.bounds().items()},
        "target": problem.target,
        "noise_variance": noise,
        "samples": problem.samples,
        "budget": problem.budget,
        "seed": problem.seed,
        "search": str(problem.search),
    }


def _problem(kept: dict[str, Any]) -> Problem:
    for name, high in (("samples", MAX_RUNS), ("budget", MAX_RUNS), ("seed", 2**63)):
        if not isinstance(kept[name], int) or not 0 <= kept[name] <= high:
            raise ValueError(f"{name} must be a whole number from 0 to {high}")
    noise: NoiseVariance = kept["noise_variance"]
    if isinstance(noise, dict):
        noise = TrajectoryErrorNoise(**noise)
    return problem_of_outputs(
        Box.of(kept["operation"]),
        Box.of(kept["unknown"]),
        kept["target"],
        noise_variance=noise,
        samples=kept["samples"],
        budget=kept["budget"],
        seed=kept["seed"],
        search=Search(kept["search"]),
    )


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
) -> Problem:
    """Problem of the criterion H."""
    return Problem(
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
