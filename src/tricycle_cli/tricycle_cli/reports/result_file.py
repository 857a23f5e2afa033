"""`result.json`: what `tricycle demo` planned, measured and identified, in numbers."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tricycle_core.documents import decode, encode, parse_json, read_bounded
from tricycle_core.errors import ReportError

MAX_BYTES = 64_000_000
_PARAMETERS = "parameters"  # beside the drives' names


@dataclass(frozen=True)
class DriveResult:
    """Numbers of one maneuver; None if a file does not hold them.

    Attributes
    ----------
    x : mapping of str to float
        Value of each operation parameter.
    main, total : float
        Sobol' indices S and ST of the target.
    cost : float
        H (Eq. 11).
    te_expected : float
        Trajectory error of the model with the hidden true parameters [m²].
    te_measured, te_corrected : float
        Trajectory error of the drive, and that less the effect of noise [m²].
    rms : float
        Root mean square distance of the drive from its reference [m].
    """

    x: Mapping[str, float] = field(default_factory=dict)
    main: float | None = None
    total: float | None = None
    cost: float | None = None
    te_expected: float | None = None
    te_measured: float | None = None
    te_corrected: float | None = None
    rms: float | None = None


@dataclass(frozen=True)
class ParameterResult:
    """Estimate of an unknown parameter, in its unit; None where a file does not hold it.

    Attributes
    ----------
    estimate, low, high : float
        Estimate and the ends of its interval.
    truth : float
        Hidden true value.
    """

    estimate: float | None = None
    low: float | None = None
    high: float | None = None
    truth: float | None = None


@dataclass(frozen=True)
class DemoResult:
    """Numbers of a demo.

    Attributes
    ----------
    drives : mapping of str to DriveResult
        Results by name of the maneuver.
    parameters : mapping of str to ParameterResult
        Results by name of the parameter.
    """

    drives: Mapping[str, DriveResult] = field(default_factory=dict)
    parameters: Mapping[str, ParameterResult] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return the content of the file as JSON values."""
        return {**encode(self.drives), _PARAMETERS: encode(self.parameters)}

    @classmethod
    def read(cls, file: Path) -> "DemoResult":
        """Read the file; the result is empty if there is no file.

        Raises
        ------
        ReportError
            If it is too large or holds something else; the message names the place.
        """
        if not file.exists():
            return cls()
        content = read_bounded(file, MAX_BYTES, "the result of a demo", ReportError)
        where = str(file)
        values = decode(
            dict[str, dict[str, Any]], parse_json(content, where, ReportError), where, ReportError
        )
        parameters = values.pop(_PARAMETERS, {})
        return cls(
            decode(dict[str, DriveResult], values, where, ReportError),
            decode(dict[str, ParameterResult], parameters, where, ReportError),
        )
