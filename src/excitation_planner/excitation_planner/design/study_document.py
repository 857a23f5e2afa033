"""The problem of a study, as ``study.json`` holds it."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Self

from excitation_planner.box import Box
from excitation_planner.design.criteria import Criterion
from excitation_planner.design.noise import TrajectoryErrorNoise, TrajectoryNoise
from excitation_planner.design.prior import NO_NUISANCES, BoxPrior, NuisanceParameters
from excitation_planner.design.problem import DesignProblem, Search
from excitation_planner.design.study_files import read_study_file
from tricycle_core.documents import decode, parse_json
from tricycle_core.errors import DesignError

VERSION = 2
"""Version of the description in ``study.json``; 1 had the criterion H alone."""

MAX_RUNS = 10_000_000
"""Most runs of a study that is read: its samples are drawn on opening."""


@dataclass(frozen=True)
class StudyDocument:
    """Content of ``study.json``.

    Attributes
    ----------
    version : int
        Version of the format; see `VERSION`.
    operation, unknown : mapping of str to (float, float)
        Ranges by name.
    target : str or None
        Unknown parameter to excite.
    noise_variance : float or TrajectoryErrorNoise
        For H: variance V_n that noise gives to the output.
    samples : int
        Runs per maneuver during the search for H.
    budget : int
        Largest number of runs.
    seed : int
        Seed of the design.
    search : Search
        How the operation box is searched.
    criterion : Criterion
        Criterion that is minimised.
    trajectory_noise : TrajectoryNoise
        For C, D and A: noise of the trajectory.
    draws : int
        For C, D and A: parameter values over which the criterion is averaged.
    prior : BoxPrior, optional
        For C, D and A: knowledge of the parameters before the drive; None: uniform.
    nuisances : NuisanceParameters
        For C, D and A: further uncertain inputs of f (nuisance parameters).

    Raises
    ------
    DesignError
        If a number is out of range.
    """

    version: int
    operation: dict[str, tuple[float, float]]
    unknown: dict[str, tuple[float, float]]
    target: str | None
    noise_variance: float | TrajectoryErrorNoise
    samples: int
    budget: int
    seed: int
    search: Search
    criterion: Criterion = Criterion.H
    trajectory_noise: TrajectoryNoise = TrajectoryNoise()  # noqa: RUF009  (frozen)
    draws: int = 1
    prior: BoxPrior | None = None
    nuisances: NuisanceParameters = NO_NUISANCES

    def __post_init__(self) -> None:
        for name, high in (
            *(("samples", MAX_RUNS), ("budget", MAX_RUNS)),
            *(("seed", 2**63), ("draws", MAX_RUNS)),
        ):
            if not 0 <= getattr(self, name) <= high:
                raise DesignError(f"{name} must be a whole number from 0 to {high}")

    @classmethod
    def of(cls, problem: DesignProblem) -> Self:
        """Return the description of a problem."""
        noise = problem.noise_variance
        if callable(noise) and not isinstance(noise, TrajectoryErrorNoise):
            raise DesignError(
                "a study needs a noise variance that is a number or TrajectoryErrorNoise"
            )
        settings = _settings(problem)
        settings |= {name: settings[name].bounds() for name in ("operation", "unknown")}
        return cls(version=VERSION, **settings)

    def problem(self) -> DesignProblem:
        """Return the problem that is described."""
        settings = _settings(self)
        settings |= {name: Box.of(settings[name]) for name in ("operation", "unknown")}
        return DesignProblem(**settings)


def _settings(described: "DesignProblem | StudyDocument") -> dict[str, Any]:
    """Return every field of a problem by name, from the problem or its description."""
    return {field.name: getattr(described, field.name) for field in fields(DesignProblem)}


def load_study_document(path: Path) -> StudyDocument:
    """Read the ``study.json`` of a study.

    Parameters
    ----------
    path : Path
        Directory of the study.

    Raises
    ------
    DesignError
        If it is missing, damaged or of another version.
    """
    file = path / "study.json"
    if not file.exists():
        raise DesignError(f"{path}: holds no study (study.json is missing)")
    kept = parse_json(read_study_file(file), str(file), DesignError)
    if not isinstance(kept, dict) or "version" not in kept:
        raise DesignError(f"{file}: is not the description of a study")
    if kept["version"] not in (1, VERSION):
        raise DesignError(
            f"{path}: study of version {kept['version']!r}; this program reads 1 and {VERSION}"
        )
    return decode(StudyDocument, kept, str(file), DesignError)
