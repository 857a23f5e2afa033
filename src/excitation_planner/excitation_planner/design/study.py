"""The study: a design by ask and tell, for simulators outside of this process.

E.g. in Simulink or on a test track.

>>> study = Study.create(path, operation, unknown, "cornering_stiffness")   # doctest: +SKIP
>>> while proposals := study.ask():                                         # doctest: +SKIP
...     for p in proposals:
...         study.tell(p.point, p.samples, my_simulator(p.x, p.P))
>>> study.design()                                                          # doctest: +SKIP

The same through files: `Study.ask` writes ``pending.csv``; a copy of it with a column ``output``
goes to `Study.tell_csv`, trajectories go to `Study.tell_parquet`. Several processes may tell; one
asks. The search is run again from what is on disk whenever it is asked, so a
study resumes after a kill, and ends in the design that `design_excitation` finds with that seed.
"""

from __future__ import annotations

import csv
import io
import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

from excitation_planner.box import Bounds, Box
from excitation_planner.design.criteria import Criterion
from excitation_planner.design.evaluation import judge_outcome, parameter_points
from excitation_planner.design.excitation import Design, search_design
from excitation_planner.design.information import simulated_values
from excitation_planner.design.noise import TrajectoryErrorNoise, TrajectoryNoise
from excitation_planner.design.prior import NO_NUISANCES, BoxPrior, NuisanceParameters
from excitation_planner.design.problem import DRAWS, DesignProblem, Search, Trajectories, Verified
from excitation_planner.design.store import (
    FAILED,
    INFEASIBLE,
    Store,
)
from excitation_planner.design.study_files import csv_text, read_study_file
from excitation_planner.design.study_trajectories import channels_of, read_trajectories
from excitation_planner.indices.sensitivity import real_outputs
from excitation_planner.indices.threads import THREADPOOLS
from tricycle_core.documents import write_whole
from tricycle_core.errors import DesignError
from tricycle_core.optional import check_installed
from tricycle_core.quantities import FloatArray

PENDING = "pending.csv"
"""File of the simulations that were asked for last."""
ROUNDED = 1e-5  # share of a parameter by which a told one may differ: programs write few digits


@dataclass(frozen=True)
class Proposal:
    """Simulations that a study asks for: one maneuver with many parameter values.

    Attributes
    ----------
    point : int
        Number of the maneuver.
    samples : tuple of int, length q
        Numbers of the simulations of this maneuver that are still to be run.
    x : ndarray of float, shape (l,)
        Operation parameters.
    P : ndarray of float, shape (q, k + e)
        Unknown parameters, followed by the nuisance parameters.
    """

    point: int
    samples: tuple[int, ...]
    x: FloatArray
    P: FloatArray


class Study:
    """A design on disk that asks for simulations; made by `create` or `open`.

    Parameters
    ----------
    store : Store
        Store of the simulations.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._judged: dict[tuple[float, ...], Verified] = {}

    @classmethod
    def create(
        cls,
        path: Path,
        operation: Box | Bounds,
        unknown: Box | Bounds,
        target: str | None,
        *,
        criterion: Criterion | str = Criterion.H,
        noise_variance: float | TrajectoryErrorNoise = 0.0,
        trajectory_noise: TrajectoryNoise = TrajectoryNoise(),  # noqa: B008  (frozen)
        samples: int = 100,
        prior: BoxPrior | None = None,
        nuisances: NuisanceParameters = NO_NUISANCES,
        draws: int = DRAWS,
        budget: int = 25_000,
        seed: int = 0,
        search: Search | str = Search.ADAPTIVE,
    ) -> Self:
        """Begin a study in a directory; its arguments are those of `design_excitation`.

        Parameters
        ----------
        path : Path
            Directory, made if missing.
        operation, unknown : Box or dict
            Ranges of the operation and of the unknown parameters.
        target : str or None
            Unknown parameter to excite; the criteria D and A need none.
        criterion : Criterion or str
            Criterion that is minimised. H needs a number per simulation, C, D and A its trajectory.
        noise_variance : float or TrajectoryErrorNoise
            For H: variance V_n that noise gives to the output.
        trajectory_noise : TrajectoryNoise
            For C, D and A: noise of the trajectory.
        samples : int
            Runs per maneuver during the search for H.
        prior : BoxPrior, optional
            For C, D and A: knowledge from earlier drives; None: uniform.
        nuisances : NuisanceParameters
            For C, D and A: the e uncertain inputs (nuisance parameters) after the k parameters.
        draws : int
            For C, D and A: parameter values over which the criterion is averaged.
        budget : int
            Largest number of runs.
        seed : int
            The same seed gives the same design.
        search : Search or str
            How the operation box is searched.

        Raises
        ------
        DesignError
            If the directory holds a study, or the problem is not valid.
        ReportError
            If trajectories are wanted and pyarrow is not installed.
        """
        path = Path(path)
        if (path / "study.json").exists():
            raise DesignError(f"{path}: holds a study already; open it")
        if Criterion(criterion) is not Criterion.H:
            check_installed("pyarrow", "a study of trajectories")
        operation, unknown = Box.of(operation), Box.of(unknown)
        names = ["output", *_header(operation, unknown, nuisances)]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise DesignError(f"columns of a study would have one name: {', '.join(twice)}")
        problem = DesignProblem(
            operation=operation,
            unknown=unknown,
            target=target,
            criterion=Criterion(criterion),
            noise_variance=noise_variance,
            trajectory_noise=trajectory_noise,
            samples=samples,
            draws=draws,
            budget=budget,
            seed=seed,
            search=Search(search),
            prior=prior,
            nuisances=nuisances,
        )
        return cls(Store.of(path, problem))

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open the study in a directory."""
        return cls(Store.open(Path(path)))

    def ask(self) -> list[Proposal]:
        """Simulations needed next, also written to ``pending.csv``; none when the design is done.

        Asking again gives what is still missing.
        """
        try:
            self.design()
        except PendingError as pending:
            proposals = [self._propose(x, pending.verification) for x in pending.points]
        else:
            proposals = []
        problem = self._store.problem
        header = _header(problem.operation, problem.unknown, problem.nuisances)
        rows = [
            [p.point, sample, *map(repr, p.x.tolist()), *map(repr, values)]
            for p in proposals
            for sample, values in zip(p.samples, p.P.tolist(), strict=True)
        ]
        write_whole(self._store.path / PENDING, csv_text([header, *rows]))
        return proposals

    def pending(self, part: int = 0, parts: int = 1) -> list[Proposal]:
        """Return one part of the simulations asked for that are still missing, without a search.

        For the tasks of an array job, each of which runs a part.

        Parameters
        ----------
        part : int
            Number of the part, from 0.
        parts : int
            Number of parts, of about the same size.

        Raises
        ------
        DesignError
            If there is no such part, or the file of what is missing is damaged.
        """
        if parts < 1:
            raise DesignError(f"{parts} parts: needs 1 or more")
        if not 0 <= part < parts:
            raise DesignError(f"part {part} of {parts}: parts are numbered from 0 to {parts - 1}")
        runs: list[tuple[int, int]] = []
        for row in csv.DictReader(io.StringIO(self._pending_text(), newline="")):
            try:
                runs.append((int(row["point"]), int(row["sample"])))
            except (KeyError, TypeError, ValueError):
                raise DesignError(f"{self._store.path / PENDING}: is damaged; ask again") from None
        by_point: dict[int, list[int]] = {}
        for point, sample in runs[part::parts]:
            by_point.setdefault(point, []).append(sample)
        return [
            proposal
            for point, samples in by_point.items()
            if (proposal := self._proposal(point, samples)).samples
        ]

    def tell(self, point: int, samples: Sequence[int], outputs: Trajectories) -> None:
        """Take outputs of some samples of a point.

        Parameters
        ----------
        point : int
            Number of the maneuver.
        samples : sequence of int, length q
            Numbers of the simulations, in any order.
        outputs : ndarray of float, shape (q,) or (q, t, c), or tuple of the latter
            Results of f: numbers for the criterion H, else trajectories. NaN marks a failed
            simulation.

        Raises
        ------
        DesignError
            If they were not asked for, are known otherwise, or are of another shape.
        """
        point, samples = _whole(point), [_whole(sample) for sample in samples]
        told = tuple(
            real_outputs(Y) for Y in (outputs if isinstance(outputs, tuple) else (outputs,))
        )
        dimensions = 1 if self._store.problem.criterion is Criterion.H else 3
        if not told or any(
            Y.ndim != dimensions or len(Y) != len(samples) or 0 in Y.shape[1:] for Y in told
        ):
            wanted = "number" if dimensions == 1 else "trajectory (time points, channels)"
            raise DesignError(
                f"point {point}: told {', '.join(str(Y.shape) for Y in told)} for {len(samples)} "
                f"samples; criterion {self._store.problem.criterion} needs a {wanted} each"
            )
        if dimensions == 1:
            results = zip([point] * len(samples), samples, told[0].tolist(), strict=True)
            self._store.add(list(results), {})
        else:
            self._store.add_trajectories(point, samples, told)

    def tell_infeasible(self, point: int, reason: str) -> None:
        """Mark a maneuver as one that cannot be driven, whatever the parameters.

        Parameters
        ----------
        point : int
            Number of the maneuver.
        reason : str
            Why it cannot be driven.
        """
        self._store.add([], {_whole(point): reason})

    def tell_csv(self, path: Path) -> None:
        """Take the outputs in a CSV file with the columns point, sample and output.

        An output is a number, ``failed``, ``infeasible: reason``, or empty (not run yet). Columns
        of parameters, as in ``pending.csv``, may be left out; they must be what was asked. All rows
        are checked before any is taken.

        Parameters
        ----------
        path : Path
            File of outputs.

        Raises
        ------
        DesignError
            If the file is none, or an output was not asked for, is known otherwise or of other
            parameters.
        OSError
            If the file cannot be read.
        """
        results: list[tuple[int, int, float]] = []
        reasons: dict[int, str] = {}
        try:
            text = read_study_file(path).decode("utf-8-sig")
            self._store.refresh()
            asked = _Asked(self._store)
            reader = csv.DictReader(io.StringIO(text, newline=""))
            needed, columns = ("output", "point", "sample"), list(reader.fieldnames or ())
            if missing := [name for name in needed if name not in columns]:
                raise DesignError(f"{path}: column {', '.join(missing)} is missing")
            if twice := [name for name in needed if columns.count(name) > 1]:
                raise DesignError(f"{path}: column {', '.join(twice)} is there twice")
            for row in reader:
                place = f"{path}, line {reader.line_num}"
                told = _told_by(row, place)
                if told is None:
                    continue
                if other := asked.other(told.point, row):
                    raise DesignError(
                        f"{place}: {other}: are the outputs of another study, or of other "
                        "parameters than it asked for?"
                    )
                if not told.reason:
                    results.append((told.point, told.sample, told.output))
                elif (known := reasons.setdefault(told.point, told.reason)) != told.reason:
                    raise DesignError(f"{place}: point {told.point} is infeasible already: {known}")
        except IsADirectoryError as error:
            raise DesignError(f"{path}: is a folder; a CSV file is needed") from error
        except (UnicodeDecodeError, csv.Error) as error:
            raise DesignError(f"{path}: is not a CSV file: {error}") from error
        self._store.add(results, reasons)

    def tell_parquet(self, path: Path) -> None:
        """Take the trajectories in a Parquet file, a row per time point in the order of time.

        Its columns are point, sample, maneuver (of a set, from 0) and the channels, in the order of
        other files. A point is taken whole or not at all.
        """
        channels = channels_of(path)
        for point, (samples, outputs) in read_trajectories(path).items():
            self._store.add_trajectories(point, samples, outputs, channels)

    def design(self) -> Design:
        """Return the design; PendingError while simulations are missing."""
        self._store.refresh()
        with THREADPOOLS.limit(limits=1):
            return search_design(self._store.problem, self._judge_known)

    def _judge_known(self, points: list[FloatArray], verification: bool) -> list[Verified]:
        missing = []
        U = parameter_points(self._store.problem, verification=verification)
        for x in points:
            key = (float(verification), *x.tolist())
            if key in self._judged:
                continue
            outcome = self._store.recall(x, verification=verification)
            if outcome is None:
                missing.append(x)
            else:
                self._judged[key] = judge_outcome(
                    self._store.problem, x, U, outcome, verification=verification
                )
        if missing:
            raise PendingError(missing, verification)
        return [self._judged[(float(verification), *x.tolist())] for x in points]

    def _propose(self, x: FloatArray, verification: bool) -> Proposal:
        return self._proposal(self._store.number(x, verification=verification))

    def _proposal(self, point: int, samples: list[int] | None = None) -> Proposal:
        """The missing simulations of a point, or those of some samples."""
        x, verification = self._store.asked(point)
        missing = self._store.missing(point, verification=verification)
        kept = missing if samples is None else sorted(set(samples) & set(missing))
        U = parameter_points(self._store.problem, verification=verification)[kept]
        return Proposal(point, tuple(kept), x, simulated_values(self._store.problem.unknown, U))

    def _pending_text(self) -> str:
        file = self._store.path / PENDING
        try:
            return read_study_file(file).decode()
        except FileNotFoundError:
            return ""
        except UnicodeDecodeError as error:
            raise DesignError(f"{file}: is damaged; ask again") from error


class _Told(NamedTuple):
    """What a row of a file of outputs says: an output, or why the maneuver is infeasible."""

    point: int
    sample: int = 0
    output: float = math.nan  # NaN: failed
    reason: str = ""


def _told_by(row: Mapping[str | None, Any], place: str) -> _Told | None:
    """Return what a row says; None where nothing was run yet."""
    if None in row:  # where the reader puts cells without a column
        raise DesignError(f"{place}: has more cells than the header; numbers need a decimal point")
    point, sample, output = row["point"], row["sample"], (row["output"] or "").strip()
    if not output:
        return None
    try:
        if output.startswith(INFEASIBLE):
            reason = " ".join(output.removeprefix(INFEASIBLE).split())
            return _Told(int(point), reason=reason)
        told = _Told(int(point), int(sample), float("nan" if output == FAILED else output))
    except (ValueError, TypeError):
        raise DesignError(
            f"{place}: point {point!r}, sample {sample!r} and output {output!r} must be numbers, "
            f"or the output {FAILED!r} or '{INFEASIBLE}reason'"
        ) from None
    if math.isinf(told.output):
        raise DesignError(f"{place}: output {output}: must be finite, or {FAILED!r}")
    return told


class _Asked:
    """Parameters that a study asked for, for comparison with those that are told.

    Parameters
    ----------
    store : Store
        Store of the study.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._points: dict[int, tuple[FloatArray, bool]] = {}
        self._values: dict[bool, FloatArray] = {}

    def other(self, point: int, row: Mapping[str, str | None]) -> str:
        """Return in words which parameter of a row differs from what was asked; else "".

        Samples that were never asked for are left to the store, which refuses them.
        """
        problem = self._store.problem
        names = _header(problem.operation, problem.unknown, problem.nuisances)[2:]
        told = {name: text for name in names if (text := (row.get(name) or "").strip())}
        if not told:
            return ""
        if point not in self._points:
            self._points[point] = self._store.asked(point)
        x, verification = self._points[point]
        if verification not in self._values:
            U = parameter_points(problem, verification=verification)
            self._values[verification] = simulated_values(problem.unknown, U)
        P, sample = self._values[verification], (row["sample"] or "").strip()
        of_sample = P[int(sample)].tolist() if sample.isdecimal() and int(sample) < len(P) else []
        for name, value in zip(names, [*x.tolist(), *of_sample], strict=False):
            try:
                same = name not in told or math.isclose(float(told[name]), value, rel_tol=ROUNDED)
            except ValueError:
                same = False
            if not same:
                return f"{name} {told[name]}, asked was {value!r}"
        return ""


class PendingError(DesignError):
    """Simulations are missing: ask for them.

    Parameters
    ----------
    points : list of ndarray
        Maneuvers x (l,) whose simulations are missing.
    verification : bool
        Whether they are for the verification.
    """

    def __init__(self, points: list[FloatArray], verification: bool) -> None:
        super().__init__(f"simulations of {len(points)} maneuvers are missing: ask for them")
        self.points, self.verification = points, verification


def _header(operation: Box, unknown: Box, nuisances: NuisanceParameters) -> list[str]:
    """Columns of what is pending."""
    others = [f"nuisance{i}" for i in range(len(nuisances.steps))]
    return ["point", "sample", *operation.names, *unknown.names, *others]


def _whole(number: object) -> int:
    """A point or sample as it is written to files."""
    try:
        if not isinstance(number, bool):
            return operator.index(number)  # type: ignore[arg-type]
    except TypeError:
        pass
    raise DesignError(f"{number!r} is not the number of a point or sample: needs a whole number")
