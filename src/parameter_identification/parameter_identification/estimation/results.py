"""Results of an identification: what `identify` returns."""

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from parameter_identification.drives.measured import Input, Sensor
from parameter_identification.estimation.model import Prediction
from parameter_identification.estimation.noise import NoiseLevel
from parameter_identification.estimation.prior import GaussianPrior
from parameter_identification.estimation.whiteness import SIGNIFICANCE, Whiteness, coloured
from tricycle_core.optional import optional, own_axes
from tricycle_core.palette import BLUE, GREY, VERMILLION
from tricycle_core.quantities import FloatArray, with_unit


@dataclass(frozen=True, eq=False)
class Profile:
    """Profile likelihood of one parameter.

    Attributes
    ----------
    values : ndarray of float, shape (g,)
        Values of the parameter, in its unit.
    rise : ndarray of float, shape (g,)
        Rise of twice the negative log-likelihood above its minimum at each value, everything else
        fitted anew.
    """

    values: FloatArray
    rise: FloatArray


@dataclass(frozen=True)
class Estimate:
    """Estimate of one parameter from the drives and the prior.

    Attributes
    ----------
    unit : str
        Unit of the parameter, in which all numbers are.
    estimate : float
        Estimated value of the parameter.
    standard_deviation : float
        Standard deviation of the estimate, by linearisation.
    low, high : float
        Interval, from the profile likelihood where it was computed, else `linear`.
    linear : (float, float)
        Interval by linearisation at the estimate.
    range : (float, float)
        Ends of the parameter's range in the vehicle file.
    identifiable : bool
        Whether at most half the standard deviation of the range is left.
    profile : Profile, optional
        Profile likelihood, where it was asked for.
    """

    unit: str
    estimate: float
    standard_deviation: float
    low: float
    high: float
    linear: tuple[float, float]
    range: tuple[float, float]
    identifiable: bool
    profile: Profile | None = None


def in_range(limits: tuple[float, float], share: float) -> float:
    """Return the value at a share of a range, never beyond its ends.

    Parameters
    ----------
    limits : (float, float)
        Ends of the range.
    share : float
        0 to 1; below and above the ends are returned.
    """
    low, high = limits
    return float(min(max(low + (high - low) * share, low), high))


def common_truth(truths: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Return the true parameters that all drives have alike; empty where they differ.

    Parameters
    ----------
    truths : iterable of mapping of str to float
        True parameters of each drive, by name.
    """
    first, *others = truths
    return dict(first) if all(truth == first for truth in others) else {}


@dataclass(frozen=True)
class Combination:
    """A direction in the space of the parameters that the drives do not show.

    Attributes
    ----------
    weights : mapping of str to float
        Component of each parameter, in ranges, largest first; small ones are left out.
    remaining : float
        Standard deviation along it, divided by that of the ranges: 0.5 to 1.
    """

    weights: Mapping[str, float]
    remaining: float

    def __str__(self) -> str:
        if len(self.weights) == 1:
            return next(iter(self.weights))
        return " ".join(f"{weight:+.2f} {name}" for name, weight in self.weights.items())


@dataclass(frozen=True)
class NuisanceEstimate:
    """Estimate of a quantity of one drive that is no vehicle parameter, e.g. its start heading.

    Attributes
    ----------
    estimate, standard_deviation : float
        Estimate of the quantity and its standard deviation.
    unit : str
        Unit of both numbers.
    """

    estimate: float
    standard_deviation: float
    unit: str


@dataclass(frozen=True)
class EffectEstimate:
    """Estimate of something that the vehicle file does not know, e.g. of the steering's zero.

    Attributes
    ----------
    name, unit : str
        "1": a share of the value in the file.
    estimate, standard_deviation : float
        Estimate of the effect and its standard deviation; of a deviation, which varies in time
        about 0, they are 0 and its size.
    prior : float
        Standard deviation before the drives.
    drive : str
        Name of the drive that the effect belongs to; "": it is that of all drives.
    acts : float or None
        Probability that it does, where the effects were weighed.
    chance : float or None
        Probability that drives would show as much of a deviation if there were none; None where
        this is not tested.
    at_an_end : bool
        Whether the estimate is at an end of what is taken for possible.
    """

    name: str
    unit: str
    estimate: float
    standard_deviation: float
    prior: float
    drive: str = ""
    acts: float | None = None
    chance: float | None = None
    at_an_end: bool = False

    def __str__(self) -> str:
        factor, unit = _SHOWN_UNITS.get(self.unit, (1.0, f" {self.unit}"))
        deviation = factor * self.standard_deviation
        digits = max(0, 1 - math.floor(math.log10(deviation))) if deviation > 0.0 else 3
        where = f", {self.drive}" if self.drive else ""
        value = f"{factor * self.estimate:+.{digits}f}{unit} "
        acts = "" if self.acts is None else f", acts with {self.acts:.0%}"
        shown = value if self.estimate else ""
        return f"{self.name}{where}: {shown}± {deviation:.{digits}f}{unit}{acts}"


SURE = 0.9  # probability from which a weighed deviation counts as shown
_SHOWN_UNITS = {"rad": (180.0 / math.pi, "°"), "1": (100.0, " %"), "m": (100.0, " cm")}


@dataclass(frozen=True, eq=False)
class Lack:
    """Misfit of the model along a drive, once a second, and the motion of the vehicle then.

    Attributes
    ----------
    time, speed, steering_motor_angle, lateral_acceleration : ndarray of float, shape (s,)
        Since the start event [s]; forward [m/s]; set-point, left positive [rad]; speed times yaw
        rate [m/s^2].
    values, standard_deviations : mapping of str to ndarray of float, shape (s,)
        By name with unit: the mean residual of the position along and across the vehicle, and
        the deviations of speed and turning where they act.
    """

    time: FloatArray
    speed: FloatArray
    steering_motor_angle: FloatArray
    lateral_acceleration: FloatArray
    values: Mapping[str, FloatArray]
    standard_deviations: Mapping[str, FloatArray]


@dataclass(frozen=True, eq=False)
class DriveFit:
    """Predictions of one drive before and after the identification.

    Attributes
    ----------
    name : str
        Name of the drive.
    nuisances : mapping of str to NuisanceEstimate
        By name.
    before : mapping of Sensor to Prediction
        By the nominal vehicle from the same start.
    after : mapping of Sensor to Prediction
        By the estimates.
    weights : mapping of Sensor to ndarray of float, shape (m,)
        Weights of the m samples; below 1 where errors of their stamps or the robust loss reduce
        them.
    lack : Lack, optional
        Misfit of the model along the drive.
    recording : str
        Name of the recording that the drive is a window of; empty: a drive of its own.
    map_estimated : bool
        Whether its steering's angle is by a map that was estimated from the recording.
    steering_late : float
        By how much the steering of its commands may be late against the signals [s].
    """

    name: str
    nuisances: Mapping[str, NuisanceEstimate]
    before: Mapping[Sensor, Prediction]
    after: Mapping[Sensor, Prediction]
    weights: Mapping[Sensor, FloatArray]
    lack: Lack | None = None
    recording: str = ""
    map_estimated: bool = False
    steering_late: float = 0.0


@dataclass(frozen=True)
class HeldOut:
    """Prediction of a drive that was not used for the estimates.

    Its start pose, delays and bias are fitted, the parameters are not. The band around the
    predicted positions follows from the covariance of parameters and effects, the size of the
    deviations and the noise, all found without this drive.

    Attributes
    ----------
    name : str
        Name of the drive.
    rms_nominal, rms_estimated : float
        Root mean square distance of measured and predicted positions [m], with the nominal and with
        the estimated parameters.
    noise : float
        The same if there were only the measurement noise [m].
    expected : float or None
        Root mean square distance with the estimates that the band expects [m]; None in files of
        versions that had no band.
    inside : float or None
        Share of the measured positions in the band, of the identification's level.
    """

    name: str
    rms_nominal: float
    rms_estimated: float
    noise: float
    expected: float | None = None
    inside: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class IdentifiedParameters:
    """Estimates of k parameters of a vehicle with their uncertainty.

    Attributes
    ----------
    vehicle : str
        Name in the vehicle file.
    vehicle_hash : str
        Hash of the values of the vehicle file.
    parameters : mapping of str to Estimate
        Estimate of each parameter, by name.
    covariance : ndarray of float, shape (k, k)
        Covariance of the estimates, in their units.
    scatter : float
        Largest ratio of a standard deviation by the drives' scatter to that by the noise; NaN for
        one drive. Far above 1 the drives contradict each other: the model lacks something.
    truth : mapping of str to float
        True parameters, where the drives were simulated and all have the same.
    level : float
        Probability of the intervals.
    effects : tuple of EffectEstimate
        Effects that were estimated beside the parameters.
    others : mapping of str to Estimate
        Parameters that were not asked for, but estimated: the intervals count their uncertainty.
    fixed : mapping of str to float
        Parameters that were held at their nominal values: no interval counts an error in them.
    measured : frozenset of Input
        Inputs that moved as measured, not as the commands say.
    seed : int
        Seed of the starts.
    converged : bool
        Whether the estimates are a minimum. If not, none of the parameters counts as shown.
    """

    vehicle: str
    vehicle_hash: str
    parameters: Mapping[str, Estimate]
    covariance: FloatArray
    scatter: float = math.nan
    truth: Mapping[str, float]
    level: float
    effects: tuple[EffectEstimate, ...] = ()
    others: Mapping[str, Estimate] = field(default_factory=dict)
    fixed: Mapping[str, float] = field(default_factory=dict)
    measured: frozenset[Input] = frozenset()
    seed: int = 0
    converged: bool = True

    def only(self, names: Collection[str]) -> Self:
        """Return the result for some of the parameters, the rest of which are its `others`.

        Parameters
        ----------
        names : collection of str
            Names of the parameters that are asked for.
        """
        at = [i for i, name in enumerate(self.names) if name in names]
        return replace(
            self,
            parameters={name: e for name, e in self.parameters.items() if name in names},
            others={name: e for name, e in self.parameters.items() if name not in names},
            covariance=self.covariance[np.ix_(at, at)],
        )

    def to_dataframe(self) -> Any:
        """Return the estimates as a pandas DataFrame, a row per parameter.

        Raises
        ------
        ReportError
            If pandas is not installed.
        """
        rows = [
            {
                "unit": e.unit,
                "estimate": e.estimate,
                "standard_deviation": e.standard_deviation,
                "low": e.low,
                "high": e.high,
                "range_low": e.range[0],
                "range_high": e.range[1],
                "shown": e.identifiable,
                "truth": self.truth.get(name, np.nan),
            }
            for name, e in self.parameters.items()
        ]
        return optional("pandas", "to_dataframe").DataFrame(rows, index=list(self.parameters))

    def plot(self, axes: Any = None) -> Any:
        """Draw estimate and interval of each parameter over its range; return the matplotlib Axes.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Drawn on; default: those of a new figure.

        Raises
        ------
        ReportError
            If matplotlib is not installed.
        """
        axes = own_axes() if axes is None else axes
        labels = []
        for row, (name, e) in enumerate(self.parameters.items()):
            low, high = e.range

            def share(value: float, low: float = low, high: float = high) -> float:
                return (value - low) / (high - low)

            color = BLUE if e.identifiable else GREY
            axes.plot([share(e.low), share(e.high)], [row, row], color=color, linewidth=2)
            axes.plot(share(e.estimate), row, "o", color=color)
            if name in self.truth:
                axes.plot(share(self.truth[name]), row, "x", color=VERMILLION, zorder=3)
            hidden = "" if e.identifiable else " (not shown)"
            ends = with_unit(f"{low:.4g} to {high:.4g}", e.unit)
            labels.append(f"{name.replace('_', ' ')}{hidden}\n{ends}")
        axes.set_yticks(range(len(labels)), labels)
        axes.invert_yaxis()
        truth = ", crosses: truth" if self.truth else ""
        xlabel = f"place in the range; bars: {self.level:.0%} intervals{truth}"
        axes.set(xlim=(0, 1), xlabel=xlabel)
        axes.grid(alpha=0.3)
        return axes

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the k parameters."""
        return tuple(self.parameters)

    @property
    def estimates(self) -> FloatArray:
        """Estimates (k,) in their units."""
        return np.array([e.estimate for e in self.parameters.values()])

    @property
    def standard_deviations(self) -> FloatArray:
        """Standard deviations (k,) in their units."""
        return np.array([e.standard_deviation for e in self.parameters.values()])

    @property
    def intervals(self) -> FloatArray:
        """Lower and upper ends (k, 2) in their units."""
        return np.array([(e.low, e.high) for e in self.parameters.values()])

    @property
    def correlation(self) -> FloatArray:
        """Correlation matrix (k, k) of the estimates."""
        std = np.sqrt(np.diag(self.covariance))
        correlation: FloatArray = self.covariance / np.outer(std, std)
        return correlation

    @property
    def identifiable(self) -> dict[str, bool]:
        """Whether the drives show each parameter, by name."""
        return {name: e.identifiable for name, e in self.parameters.items()}

    @property
    def deviations(self) -> tuple[EffectEstimate, ...]:
        """Deviations that the drives show: the vehicle moves as the model with its effects cannot.

        They take up what the model lacks, so that residuals are white; the intervals of the
        parameters do not count what it did to them. Of weighed ones also those that act with a
        probability of `SURE`.
        """
        tested = [e for e in self.effects if e.chance is not None]
        return tuple(
            e
            for e in tested
            if (e.chance or 0.0) * len(tested) < SIGNIFICANCE or (e.acts or 0.0) > SURE
        )

    def posterior(self) -> GaussianPrior:
        """Return the estimates as the prior of the next identification."""
        return GaussianPrior(self.names, self.estimates, self.covariance)


@dataclass(frozen=True, kw_only=True, eq=False)
class Identification(IdentifiedParameters):
    """Parameters from a few drives, and how well they fit each of them.

    Attributes
    ----------
    hidden : tuple of Combination
        Directions that the drives do not show; along them the ranges still hold.
    noise : mapping of Sensor to NoiseLevel
        Estimated noise of each sensor.
    whiteness : tuple of Whiteness
        Test of the residuals of each channel of each drive.
    drives : tuple of DriveFit
        Predictions of each drive, for reports.
    held_out : tuple of HeldOut
        Predictions of the drives that were not used.
    outliers : int
        Number of samples beyond 6 standard deviations.
    rivals : tuple of ndarray of float, shape (k,)
        Other parameters that fit the drives as well, at the level of the intervals.
    starts : (int, int)
        Number of fits, and how many of them ended at the estimate.
    seconds : float
        Time that the computation took [s].
    missed : float
        How much farther than expected the worst drive is from the others' prediction of it [m]
        (RMS); 0 where that may be chance.
    friction_used : float
        Largest share of its friction limit that a wheel of the fitted vehicle used; NaN: not known.
    """

    hidden: tuple[Combination, ...]
    noise: Mapping[Sensor, NoiseLevel]
    whiteness: tuple[Whiteness, ...]
    drives: tuple[DriveFit, ...]
    held_out: tuple[HeldOut, ...]
    outliers: int
    rivals: tuple[FloatArray, ...]
    starts: tuple[int, int]
    seconds: float
    missed: float = 0.0
    friction_used: float = math.nan

    def only(self, names: Collection[str]) -> Self:
        """Return the result for some of the parameters, the rest of which are its `others`.

        Parameters
        ----------
        names : collection of str
            Names of the parameters that are asked for.
        """
        at = [i for i, name in enumerate(self.names) if name in names]
        return replace(
            super().only(names),
            hidden=tuple(h for h in self.hidden if any(name in names for name in h.weights)),
            rivals=tuple(rival[at] for rival in self.rivals),
        )

    def __repr__(self) -> str:
        width = max(map(len, self.parameters))
        drives = ", ".join(drive.name for drive in self.drives)
        lines = [f"Identification of {self.vehicle} from {drives}; {self.level:.0%} intervals"]
        for name, e in self.parameters.items():
            found = with_unit(f"{e.estimate:.4g} ({e.low:.4g} to {e.high:.4g})", e.unit)
            lines.append(f"  {name:{width}}  {found if e.identifiable else 'not shown'}")
        return "\n".join(lines)

    @property
    def coloured(self) -> tuple[Whiteness, ...]:
        """Channels whose residuals do not look white."""
        return coloured(self.whiteness)

    @property
    def white(self) -> bool:
        """Whether residuals look white; else the model lacks an effect, or a sensor drifts."""
        return not self.coloured
