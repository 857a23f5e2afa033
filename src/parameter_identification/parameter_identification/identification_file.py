"""The file of an identification: `identification.json`, and what `tricycle identify --json` prints.

Its keys are the names of the fields below. Files of older versions may lack those with defaults.
"""

import json
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from parameter_identification.drives.measured import Input
from parameter_identification.estimation.prior import GaussianPrior
from parameter_identification.estimation.results import (
    Combination,
    EffectEstimate,
    Estimate,
    HeldOut,
    Identification,
    NuisanceEstimate,
    Profile,
)
from parameter_identification.many_drives import ManyDrives
from tricycle_core.documents import (
    decode,
    encode,
    finite_or_none,
    parse_json,
    read_bounded,
    write_whole,
)
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray

MAX_BYTES = 64_000_000  # of a file; that of six parameters has 20 kB


@dataclass(frozen=True, kw_only=True)
class ParameterEntry:
    """Estimate of one parameter; see `Estimate`.

    Attributes
    ----------
    estimate, low, high : float
        Estimate and ends of its interval.
    unit : str
        Unit of the parameter, in which all numbers are.
    standard_deviation : float, optional
        Standard deviation of the estimate.
    linear : (float, float), optional
        Interval by linearisation.
    range : (float, float)
        Ends of the parameter's range in the vehicle file.
    identifiable : bool
        Whether the drives show it.
    profile : Profile, optional
        Profile likelihood, where it was computed.
    truth : float, optional
        True value, where it is known; else the file has no such key.
    """

    estimate: float
    low: float
    high: float
    unit: str = ""
    standard_deviation: float | None = None
    linear: tuple[float, float] | None = None
    range: tuple[float, float]
    identifiable: bool = False
    profile: Profile | None = None
    truth: float | None = None

    def __post_init__(self) -> None:
        numbers = [self.estimate, self.low, self.high, *self.range, *(self.linear or ())]
        numbers += [v for v in (self.standard_deviation, self.truth) if v is not None]
        if not all(map(math.isfinite, numbers)):
            raise IdentificationError("numbers must be finite")
        if self.profile is not None:
            values, rise = self.profile.values, self.profile.rise
            if values.ndim != 1 or not len(values) or values.shape != rise.shape:
                raise IdentificationError("a profile must be two lists of one length, not empty")
            if not (np.isfinite(values).all() and np.isfinite(rise).all()):
                raise IdentificationError("a profile must hold finite numbers")


@dataclass(frozen=True)
class NoiseEntry:
    """Noise of a sensor; see `NoiseLevel`.

    Attributes
    ----------
    white, drift : float
        Standard deviations of the white and of the correlated part.
    drift_time : float
        Correlation time [s].
    unit : str
        Unit of `white` and `drift`.
    """

    white: float
    drift: float
    drift_time: float
    unit: str


@dataclass(frozen=True)
class WhitenessEntry:
    """Test of the residuals of a channel; see `Whiteness`.

    Attributes
    ----------
    drive, channel : str
        Names of the drive and the channel.
    rms : float
        Root mean square of the residuals, in the channel's unit.
    correlation, statistic : float, optional
        From one sample to the next, and Q of Ljung and Box; None where not tested.
    lags : int
        In the statistic.
    p : float, optional
        Probability of a larger Q; None where not tested.
    """

    drive: str
    channel: str
    rms: float
    correlation: float | None
    statistic: float | None
    lags: int
    p: float | None


@dataclass(frozen=True)
class Starts:
    """Fits from different starts.

    Attributes
    ----------
    begun, agreed : int
        Number of fits, and how many of them ended at the estimate.
    """

    begun: int
    agreed: int


@dataclass(frozen=True, kw_only=True, eq=False)
class IdentificationDocument:
    """An identification without its samples; see `Identification`.

    Attributes
    ----------
    vehicle, vehicle_hash : str
        Name and hash of the vehicle file.
    drives : tuple of str
        Names of the drives.
    level : float
        Probability of the intervals.
    parameters : mapping of str to ParameterEntry
        The k parameters by name.
    covariance, correlation : ndarray of float, shape (k, k)
        Covariance of the estimates, in their units, and their correlation.
    fixed : mapping of str to float
        Parameters that were held at their nominal values.
    hidden : tuple of Combination
        Directions that the drives do not show.
    noise : mapping of str to NoiseEntry
        By name of the sensor.
    white : bool
        Whether residuals look white.
    whiteness : tuple of WhitenessEntry
        Tests of all channels of all drives.
    nuisances : mapping of str to mapping of str to NuisanceEstimate
        By name of the drive and of the nuisance.
    held_out : tuple of HeldOut
        Predicted drives.
    outliers : int
        Number of samples beyond 6 standard deviations.
    rivals : tuple of mapping of str to float
        Other parameters that fit as well.
    starts : Starts
        Fits from different starts.
    seed : int
        Seed of the starts.
    seconds : float
        Time that the computation took [s].
    effects : tuple of EffectEstimate
        Effects that were estimated beside the parameters.
    scatter : float or None
        As in `Identification`; None where it is not known.
    missed : float
        As in `Identification`.
    measured : tuple of str
        Inputs that moved as measured: "steering", "speed".
    friction_used : float or None
        Largest share of its friction limit that a wheel of the fitted vehicle used, if known.
    converged : bool
        As in `Identification`.
    others : mapping of str to ParameterEntry
        Parameters that were not asked for, but estimated.
    left_out : tuple of str
        Bags that were not used, with the reason.
    """

    vehicle: str = ""
    vehicle_hash: str = ""
    drives: tuple[str, ...] = ()
    level: float
    parameters: Mapping[str, ParameterEntry]
    covariance: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    correlation: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    fixed: Mapping[str, float] = field(default_factory=dict)
    hidden: tuple[Combination, ...] = ()
    noise: Mapping[str, NoiseEntry] = field(default_factory=dict)
    white: bool = True
    whiteness: tuple[WhitenessEntry, ...] = ()
    nuisances: Mapping[str, Mapping[str, NuisanceEstimate]] = field(default_factory=dict)
    held_out: tuple[HeldOut, ...] = ()
    outliers: int = 0
    rivals: tuple[Mapping[str, float], ...] = ()
    starts: Starts = field(default_factory=lambda: Starts(0, 0))
    seed: int = 0
    seconds: float = 0.0
    effects: tuple[EffectEstimate, ...] = ()
    scatter: float | None = None
    missed: float = 0.0
    measured: tuple[str, ...] = ()
    friction_used: float | None = None
    converged: bool = True
    others: Mapping[str, ParameterEntry] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not 0.0 < self.level < 1.0:
            raise IdentificationError("level must lie between 0 and 1")

    def posterior(self) -> GaussianPrior:
        """Return the estimates as the prior of the next identification.

        Raises
        ------
        IdentificationError
            If the file holds no covariance of theirs.
        """
        estimates = [entry.estimate for entry in self.parameters.values()]
        return GaussianPrior(tuple(self.parameters), np.array(estimates), self.covariance)

    def to_json(self) -> dict[str, Any]:
        """Return the content of the file as plain JSON values."""
        values: dict[str, Any] = encode(self)
        for entry in (*values["parameters"].values(), *values["others"].values()):
            if entry.get("truth") is None:
                entry.pop("truth", None)
        return values


def document_of(found: Identification | ManyDrives) -> IdentificationDocument:
    """Return an identification without its samples; drive by drive, less of it is known.

    Parameters
    ----------
    found : Identification or ManyDrives
        Result of `identify` or `identify_many`.
    """
    document = IdentificationDocument(
        vehicle=found.vehicle,
        vehicle_hash=found.vehicle_hash,
        drives=tuple(drive.name for drive in found.drives),
        level=found.level,
        parameters=_entries(found.parameters, found.truth),
        others=_entries(found.others, found.truth),
        covariance=found.covariance,
        correlation=found.correlation,
        fixed=found.fixed,
        white=found.white,
        seed=found.seed,
        effects=found.effects,
        scatter=finite_or_none(found.scatter),
        measured=_names(found.measured),
        converged=found.converged,
    )
    if isinstance(found, ManyDrives):
        return replace(document, left_out=found.left_out)
    return replace(
        document,
        hidden=found.hidden,
        noise={
            sensor.value: NoiseEntry(**vars(noise), unit=sensor.unit)
            for sensor, noise in found.noise.items()
        },
        whiteness=tuple(
            WhitenessEntry(
                **vars(test)
                | {n: finite_or_none(getattr(test, n)) for n in ("correlation", "statistic", "p")}
            )
            for test in found.whiteness
        ),
        nuisances={drive.name: drive.nuisances for drive in found.drives},
        held_out=found.held_out,
        outliers=found.outliers,
        rivals=tuple(dict(zip(found.names, p.tolist(), strict=True)) for p in found.rivals),
        starts=Starts(*found.starts),
        seconds=found.seconds,
        missed=found.missed,
        friction_used=finite_or_none(found.friction_used),
    )


def _entries(
    estimates: Mapping[str, Estimate], truth: Mapping[str, float]
) -> dict[str, ParameterEntry]:
    return {name: ParameterEntry(**vars(e), truth=truth.get(name)) for name, e in estimates.items()}


def _names(inputs: Collection[Input]) -> tuple[str, ...]:
    return tuple(one.value for one in Input if one in inputs)


def save_identification_file(document: IdentificationDocument, path: Path) -> None:
    """Write an identification, whole or not at all.

    Parameters
    ----------
    document : IdentificationDocument
        From `document_of`.
    path : Path
        JSON file; an old one is replaced.
    """
    write_whole(path, json.dumps(document.to_json(), allow_nan=False) + "\n")


def load_identification_file(path: Path) -> IdentificationDocument:
    """Read the file of an identification.

    Parameters
    ----------
    path : Path
        JSON file.

    Raises
    ------
    IdentificationError
        If it is none; the message names the first entry that is wrong.
    OSError
        If it cannot be read.
    """
    content = read_bounded(path, MAX_BYTES, "an identification", IdentificationError)
    values = parse_json(content, str(path), IdentificationError)
    return decode(IdentificationDocument, values, str(path), IdentificationError)
