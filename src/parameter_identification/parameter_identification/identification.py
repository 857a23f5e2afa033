"""Estimates of the unknown parameters from recorded drives, with honest confidence.

    drives = [read_measured_drive(bag, vehicle) for bag in bags]
    found = identify(drives, vehicle, profiles=True)
    found.parameters["cornering_stiffness"].estimate, found.intervals, found.white

Nonlinear least squares on all signals of all drives together, each signal weighted by its noise
(`noise_model`), bounded by the ranges of the vehicle file, from the best of a Sobol' sequence of
starts. Besides the parameters it estimates of every drive what is not known of it: start pose and
speed, the delay of each sensor's clock, the bias of the gyro.

A range is knowledge too: it enters as a Gaussian of the same mean and variance (1/12 of its square)
unless a `Prior` is given, e.g. that of an earlier identification (`Identification.posterior`).
What the drives do not show therefore keeps the middle and the width of its range, and is named in
`Identification.hidden`. Noise is estimated from the residuals; where they are correlated in time,
the correlation is part of the noise and widens the intervals.

Letters of shapes: `k` parameters, `n` variables with the nuisances of all drives, `m` samples.
"""

import itertools
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import chi2, norm
from threadpoolctl import threadpool_limits

from parameter_identification.drives.measured import MeasuredDrive, Sensor, Signal, StartPose
from parameter_identification.estimation.model import DriveModel, Prediction, restrict
from parameter_identification.estimation.noise import NoiseLevel
from parameter_identification.estimation.problem import Fit, Loss, Problem
from parameter_identification.estimation.profiles import ProfileCurve, profile
from parameter_identification.estimation.whiteness import Whiteness, all_white, whiteness
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray, Progress
from tricycle_sim.vehicle import Vehicle, constant_fields
from tricycle_sim.vehicle.batch import simulate

PRIOR_VARIANCE = 1.0 / 12.0  # of a uniform parameter, in its range
IDENTIFIABLE = 0.5  # of the prior's standard deviation: what the drives must at least reach
MIN_MOTION = 0.5  # m that a vehicle must have come from its start
ROUGH = 0.3  # of the cost: tolerance of fits of which most are discarded
NOISE_ROUNDS = 6  # of noise and fit in turns
SAME_VEHICLE = 2e-3  # m between a reference and the model that it was planned with
WIDER = 2.5  # times, ranges in which the parameters of a plan may lie
SAME_BASIN = 0.02  # of the ranges between minima that are one
SMALL_WEIGHT = 0.25  # of a parameter in a combination that is not worth its name
OUTLIER = 6.0  # standard deviations from which samples are counted as outliers


@dataclass(frozen=True, eq=False)
class Prior:
    """Gaussian knowledge of the parameters before the drives, by name.

    Attributes
    ----------
    names : (k,)
    mean : (k,) in their units
    covariance : (k, k)
    """

    names: tuple[str, ...]
    mean: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        k = len(self.names)
        if self.mean.shape != (k,) or self.covariance.shape != (k, k):
            raise IdentificationError(f"prior: needs mean ({k},) and covariance ({k}, {k})")
        if not np.all(np.linalg.eigvalsh(self.covariance) > 0):
            raise IdentificationError("prior: the covariance must be positive definite")


@dataclass(frozen=True, eq=False)
class Profile:
    """Profile likelihood of one parameter.

    Attributes
    ----------
    values : (g,) of the parameter, in its unit
    rise : (g,) of twice the negative log-likelihood above its minimum, all else refitted
    """

    values: FloatArray
    rise: FloatArray


@dataclass(frozen=True)
class Estimate:
    """What is known of a parameter after the drives; all in its unit.

    Attributes
    ----------
    unit : of all numbers
    estimate, standard_deviation : of the parameter
    low, high : interval, from the profile likelihood where it was made, else `linear`
    linear : interval by linearisation at the estimate
    range : of the vehicle file
    identifiable : whether the drives at least halved the prior's standard deviation
    profile : where it was asked for
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


@dataclass(frozen=True)
class Combination:
    """A direction of the parameters that the drives do not show.

    Attributes
    ----------
    weights : share of each parameter, in ranges, largest first; small ones are left out
    remaining : standard deviation along it that is left of the prior's, 0.5 to 1
    """

    weights: Mapping[str, float]
    remaining: float

    def __str__(self) -> str:
        if len(self.weights) == 1:
            return next(iter(self.weights))
        return " ".join(f"{weight:+.2f} {name}" for name, weight in self.weights.items())


@dataclass(frozen=True, eq=False)
class DriveFit:
    """A drive before and after, for reports.

    Attributes
    ----------
    name : of the drive
    nuisances : name to estimate, standard deviation and unit
    before : predictions of the nominal vehicle from the same start
    after : predictions with the estimates
    weights : (m,) by sensor, of the samples; below 1 where their stamps or the robust loss say so
    """

    name: str
    nuisances: Mapping[str, tuple[float, float, str]]
    before: Mapping[Sensor, Prediction]
    after: Mapping[Sensor, Prediction]
    weights: Mapping[Sensor, FloatArray]


@dataclass(frozen=True)
class HeldOut:
    """How well a drive that was not used is predicted.

    Attributes
    ----------
    name : of the drive
    rms_nominal, rms_estimated : distance of measured and predicted positions, m; start pose and
        delays fitted, parameters not
    noise : what the noise alone would give, m
    """

    name: str
    rms_nominal: float
    rms_estimated: float
    noise: float


@dataclass(frozen=True, eq=False)
class Identification:
    """What drives tell about the parameters.

    Attributes
    ----------
    vehicle : name of the vehicle file
    vehicle_hash : of it
    parameters : estimate by name
    covariance : (k, k) of the estimates, in their units
    fixed : parameters that were not to be identified, at their nominal values
    hidden : combinations that the drives do not show; they keep what the ranges say
    noise : by sensor
    whiteness : by channel of each drive
    drives : of each drive, for reports
    held_out : drives that were predicted
    outliers : samples beyond 6 standard deviations
    rivals : other parameters (k,) that fit the drives as well, at the level of the intervals
    starts : fits that were begun, and how many of them ended at the estimate
    truth : where the drives say it
    level : of the intervals
    seed, seconds : of the computation
    """

    vehicle: str
    vehicle_hash: str
    parameters: Mapping[str, Estimate]
    covariance: FloatArray
    fixed: Mapping[str, float]
    hidden: tuple[Combination, ...]
    noise: Mapping[Sensor, NoiseLevel]
    whiteness: tuple[Whiteness, ...]
    drives: tuple[DriveFit, ...]
    held_out: tuple[HeldOut, ...]
    outliers: int
    rivals: tuple[FloatArray, ...]
    starts: tuple[int, int]
    truth: Mapping[str, float]
    level: float
    seed: int
    seconds: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, (k,)."""
        return tuple(self.parameters)

    @property
    def estimates(self) -> FloatArray:
        """Estimates (k,) in their units."""
        return np.array([e.estimate for e in self.parameters.values()])

    @property
    def standard_deviations(self) -> FloatArray:
        """Standard deviations (k,)."""
        return np.array([e.standard_deviation for e in self.parameters.values()])

    @property
    def intervals(self) -> FloatArray:
        """Lower and upper ends, (k, 2)."""
        return np.array([(e.low, e.high) for e in self.parameters.values()])

    @property
    def correlation(self) -> FloatArray:
        """Correlation (k, k) of the estimates."""
        std = np.sqrt(np.diag(self.covariance))
        correlation: FloatArray = self.covariance / np.outer(std, std)
        return correlation

    @property
    def identifiable(self) -> dict[str, bool]:
        """Whether the drives show each parameter."""
        return {name: e.identifiable for name, e in self.parameters.items()}

    @property
    def white(self) -> bool:
        """Whether residuals look white; else the model lacks something, or a sensor drifts."""
        return all_white(self.whiteness)

    def posterior(self) -> Prior:
        """What is known now, as the prior of the next identification."""
        return Prior(self.names, self.estimates, self.covariance)

    def to_json(self) -> dict[str, Any]:
        """All of it as JSON's types, without samples."""
        return {
            "vehicle": self.vehicle,
            "vehicle_hash": self.vehicle_hash,
            "drives": [drive.name for drive in self.drives],
            "level": self.level,
            "parameters": {
                name: {
                    "estimate": e.estimate,
                    "low": e.low,
                    "high": e.high,
                    "unit": e.unit,
                    "standard_deviation": e.standard_deviation,
                    "linear": list(e.linear),
                    "range": list(e.range),
                    "identifiable": e.identifiable,
                    "profile": None
                    if e.profile is None
                    else {
                        "values": e.profile.values.tolist(),
                        "rise": e.profile.rise.tolist(),
                    },
                    **({"truth": self.truth[name]} if name in self.truth else {}),
                }
                for name, e in self.parameters.items()
            },
            "covariance": self.covariance.tolist(),
            "correlation": self.correlation.tolist(),
            "fixed": dict(self.fixed),
            "hidden": [{"weights": dict(c.weights), "remaining": c.remaining} for c in self.hidden],
            "noise": {
                sensor.value: {**vars(level), "unit": sensor.unit}
                for sensor, level in self.noise.items()
            },
            "white": self.white,
            "whiteness": [
                {
                    key: None if isinstance(value, float) and math.isnan(value) else value
                    for key, value in vars(test).items()
                }
                for test in self.whiteness
            ],
            "nuisances": {
                drive.name: {
                    name: {"estimate": value, "standard_deviation": std, "unit": unit}
                    for name, (value, std, unit) in drive.nuisances.items()
                }
                for drive in self.drives
            },
            "held_out": [vars(drive) for drive in self.held_out],
            "outliers": self.outliers,
            "rivals": [dict(zip(self.names, p.tolist(), strict=True)) for p in self.rivals],
            "starts": {"begun": self.starts[0], "agreed": self.starts[1]},
            "seed": self.seed,
            "seconds": self.seconds,
        }


def identify(
    drives: Sequence[MeasuredDrive],
    vehicle: Vehicle,
    *,
    parameters: Sequence[str] | None = None,
    prior: Prior | None = None,
    held_out: Sequence[MeasuredDrive] = (),
    loss: Loss = Loss.SQUARED,
    starts: int = 4,
    level: float = 0.95,
    profiles: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> Identification:
    """Estimate unknown parameters from drives.

    Parameters
    ----------
    drives : one or more, of the same vehicle
    vehicle : its file: known constants, nominal values and ranges
    parameters : names of those to identify; the others keep their nominal values. Default: all
    prior : what is known before; default: the ranges. Names it does not hold keep their ranges
    held_out : drives to be predicted with the estimates
    loss : of the residuals
    starts : fits from different starts; a wrong basin must not win
    level : probability of the intervals
    profiles : intervals by profile likelihood, which takes a few times as long
    seed : of the starts
    progress : called with the profiles done and in all

    Raises
    ------
    IdentificationError
        If there is no drive, one comes twice, there is no such parameter, too little motion, or a
        drive was planned for another vehicle.
    """
    begun = time.perf_counter()
    if not drives:
        raise IdentificationError("no drive: nothing to identify from")
    names = tuple(vehicle.unknown) if parameters is None else tuple(parameters)
    known = restrict(vehicle, names)
    for a, b in itertools.combinations((*drives, *held_out), 2):
        if _same_positions(a, b):
            raise IdentificationError(f"{a.name} and {b.name} are the same drive")
    for drive in (*drives, *held_out):
        _check_motion(drive)
        _check_vehicle(drive, vehicle)
    # matrices here are small: threads of BLAS would only get in the way of ours
    with threadpool_limits(1, user_api="blas"):
        return _identify(
            drives, vehicle, known, prior, held_out, loss, starts, level, profiles, seed, progress,
            begun,
        )  # fmt: skip


def _identify(
    drives: Sequence[MeasuredDrive],
    vehicle: Vehicle,
    known: Vehicle,
    prior: Prior | None,
    held_out: Sequence[MeasuredDrive],
    loss: Loss,
    starts: int,
    level: float,
    profiles: bool,
    seed: int,
    progress: Progress | None,
    begun: float,
) -> Identification:
    """See `identify`; `known` is the vehicle with only the wanted parameters unknown."""
    mean, information = _prior_in_ranges(known, prior)
    models = [DriveModel(known, drive) for drive in drives]
    problem = Problem(models, mean, information, loss)
    fits = [problem.minimise(start, tolerance=ROUGH) for start in problem.candidates(starts, seed)]
    best = min(fits, key=lambda fit: fit.cost)
    for _ in range(NOISE_ROUNDS):
        before = problem.noise
        problem.estimate_noise(best.at)
        best = problem.minimise(best.at)
        if _same_noise(before, problem.noise):
            break
    best, rivals, agreed = _compare(problem, fits, best, level)
    inverse: FloatArray = np.asarray(
        np.linalg.inv(problem.gram(best.at)[:-1, :-1]), dtype=np.float64
    )
    curves: dict[int, ProfileCurve] = {}
    for i in range(problem.k if profiles else 0):
        curves[i] = profile(problem, best, inverse, i, level)
        if progress is not None:
            progress(i + 1, problem.k)
    estimates = _estimates(known, problem, best, inverse, rivals, curves, level)
    width = models[0].width
    predictions = problem.predictions(best.at)
    fits_of_drives = tuple(_drive_fits(problem, best, inverse, predictions))
    problem.close()
    return Identification(
        vehicle=vehicle.name,
        vehicle_hash=vehicle.fingerprint,
        parameters=estimates,
        covariance=inverse[: problem.k, : problem.k] * np.outer(width, width),
        fixed={n: v for n, v in vehicle.nominal.items() if n not in known.unknown},
        hidden=_hidden(problem, inverse, tuple(known.unknown)),
        noise=problem.noise,
        whiteness=tuple(
            whiteness(
                model.drive.name,
                name,
                p.time,
                p.residual[:, c] + p.values[:, c],
                r * np.sqrt(problem.weights(drive)[p.sensor]),
            )
            for drive, (model, found) in enumerate(zip(models, predictions, strict=True))
            for p in found
            for c, (name, r) in enumerate(zip(p.sensor.channels, p.residual.T, strict=True))
        ),
        drives=fits_of_drives,
        held_out=tuple(_hold_out(known, problem, best, drive, loss) for drive in held_out),
        outliers=problem.outliers(predictions, OUTLIER),
        rivals=tuple(models[0].parameters(z) for z in rivals),
        starts=(len(fits), agreed),
        truth=dict(drives[0].truth) if _same_truth(drives) else {},
        level=level,
        seed=seed,
        seconds=time.perf_counter() - begun,
    )


def _same_positions(a: MeasuredDrive, b: MeasuredDrive) -> bool:
    """Whether two drives are one: counted twice it would look better than it is."""
    return np.array_equal(a.signals[Sensor.POSITION].values, b.signals[Sensor.POSITION].values)


def _check_motion(drive: MeasuredDrive) -> None:
    position = drive.signals[Sensor.POSITION].values
    if len(position) < 20:
        raise IdentificationError(f"{drive.name}: {len(position)} positions are too few")
    start = np.median(position[: min(10, len(position) // 2)], axis=0)
    reach = float(np.quantile(np.hypot(*(position - start).T), 0.98))
    if reach < MIN_MOTION:
        raise IdentificationError(
            f"{drive.name}: the vehicle comes {reach:.2f} m from its start: too little motion to "
            f"identify anything, {MIN_MOTION} m are needed"
        )


def _check_vehicle(drive: MeasuredDrive, vehicle: Vehicle) -> None:
    """Raise if no parameters give the trajectory that the drive was planned with.

    They may lie outside the ranges: a vehicle file may know more than the one of the plan did.
    """
    reference = drive.reference
    if reference is None or not vehicle.unknown:
        return
    motion = simulate(vehicle, drive.commands, threads=1)
    nominal = (np.interp(reference.time, motion.time, row[0]) for row in (motion.x, motion.y))
    position = np.column_stack([reference.x, reference.y])
    if np.hypot(*(position - np.column_stack(list(nominal))).T).max() < SAME_VEHICLE:
        return
    planned = MeasuredDrive(
        drive.name,
        drive.commands,
        {Sensor.POSITION: Signal(reference.time, position)},
        start=StartPose(0.0, 0.0, 0.0, position_std=1e-6, heading_std=1e-6),
    )
    wide = {name: (low / WIDER, high * WIDER) for name, (low, high) in vehicle.unknown.items()}
    anyhow = replace(vehicle, unknown=wide)
    mean, information = _prior_in_ranges(anyhow, None)
    problem = Problem([DriveModel(anyhow, planned)], mean, information, Loss.SQUARED)
    problem.noise = {Sensor.POSITION: NoiseLevel(0.1 * SAME_VEHICLE)}
    fits = [problem.minimise(start) for start in problem.candidates(6, seed=0)]
    ((found,),) = problem.predictions(min(fits, key=lambda fit: fit.cost).at)
    problem.close()
    distance = float(np.sqrt(np.mean(np.sum(found.residual**2, axis=1))))
    if distance > SAME_VEHICLE:
        raise IdentificationError(
            f"{drive.name}: planned for another vehicle: whatever its unknown parameters, "
            f"{vehicle.name} comes no closer than {distance:.2g} m (rms) to the plan's reference; "
            "give the vehicle file of the drive"
        )


def _same_truth(drives: Sequence[MeasuredDrive]) -> bool:
    return all(drive.truth == drives[0].truth for drive in drives)


def _drive_fits(
    problem: Problem,
    best: Fit,
    inverse: FloatArray,
    predictions: Sequence[Sequence[Prediction]],
) -> list[DriveFit]:
    """Each drive with the nominal vehicle, from the same start, and with the estimates."""
    nominal = best.at.copy()
    model = problem.models[0]
    nominal[: problem.k] = (model.vehicle.nominal_point() - model.low) / model.width
    std = np.sqrt(np.diag(inverse))
    fits, first = [], problem.k
    for drive, (model, before, after) in enumerate(
        zip(problem.models, problem.predictions(nominal), predictions, strict=True)
    ):
        nuisances = {
            n.name: (n.mean + n.std * float(best.at[at]), n.std * float(std[at]), n.unit)
            for at, n in enumerate(model.nuisances, start=first)
        }
        first += len(nuisances)
        fits.append(
            DriveFit(
                name=model.drive.name,
                nuisances=nuisances,
                before={p.sensor: p for p in before},
                after={p.sensor: p for p in after},
                weights=problem.weights(drive),
            )
        )
    return fits


def _hold_out(
    vehicle: Vehicle, problem: Problem, best: Fit, drive: MeasuredDrive, loss: Loss
) -> HeldOut:
    """Predict a drive with the nominal and the estimated parameters, its nuisances fitted."""
    k, model = problem.k, DriveModel(vehicle, drive)
    alone = Problem([model], problem.mean, problem.information, loss)
    alone.noise |= {
        sensor: problem.noise[sensor] for sensor in alone.noise if sensor in problem.noise
    }
    free = np.arange(alone.n) >= k
    rms = []
    for z in ((vehicle.nominal_point() - model.low) / model.width, best.at[:k]):
        fit = alone.minimise(np.concatenate([z, np.zeros(alone.n - k)]), free)
        (predictions,) = alone.predictions(fit.at)
        position = next(p for p in predictions if p.sensor is Sensor.POSITION)
        rms.append(float(np.sqrt(np.mean(np.sum(position.residual**2, axis=1)))))
    noise = alone.noise[Sensor.POSITION]
    alone.close()
    return HeldOut(
        drive.name, rms[0], rms[1], math.sqrt(2.0) * math.hypot(noise.white, noise.drift)
    )


def _prior_in_ranges(vehicle: Vehicle, prior: Prior | None) -> tuple[FloatArray, FloatArray]:
    """Mean (k,) and information (k, k) of the parameters in their ranges."""
    names = tuple(vehicle.unknown)
    low, high = np.array(list(vehicle.unknown.values())).T
    mean, covariance = np.full(len(names), 0.5), PRIOR_VARIANCE * np.eye(len(names))
    if prior is not None:
        given = [i for i, name in enumerate(names) if name in prior.names]
        taken = [prior.names.index(names[i]) for i in given]
        width = (high - low)[given]
        mean[given] = (prior.mean[taken] - low[given]) / width
        part = prior.covariance[np.ix_(taken, taken)] / np.outer(width, width)
        covariance[np.ix_(given, given)] = part
    return mean, np.asarray(np.linalg.inv(covariance), dtype=np.float64)


def _same_noise(a: Mapping[Sensor, NoiseLevel], b: Mapping[Sensor, NoiseLevel]) -> bool:
    """Whether another round would change nothing that matters."""
    return all(
        abs(math.log(a[s].white / b[s].white)) < 0.02
        and abs(a[s].drift - b[s].drift) < 0.05 * b[s].white
        for s in a
    )


def _compare(
    problem: Problem, fits: Sequence[Fit], best: Fit, level: float
) -> tuple[Fit, list[FloatArray], int]:
    """Refit other basins with the final noise: the best of all, its rivals (k,), and the agreement.

    A rival is a different minimum whose cost is within what the interval allows.
    """
    allowed = float(chi2.ppf(level, 1))
    k, agreed = problem.k, 0
    rivals: list[FloatArray] = []
    for fit in fits:
        if _near(fit, best, k):
            agreed += 1
            continue
        again = problem.minimise(fit.at, tolerance=ROUGH)
        if _near(again, best, k):
            agreed += 1
        elif again.cost < best.cost:
            best, rivals = again, [*rivals, best.at[:k]]
        elif again.cost < best.cost + allowed:
            rivals.append(again.at[:k])
    return best, rivals, agreed


def _near(a: Fit, b: Fit, k: int) -> bool:
    return bool(np.all(np.abs(a.at[:k] - b.at[:k]) < SAME_BASIN))


def _estimates(
    vehicle: Vehicle,
    problem: Problem,
    best: Fit,
    inverse: FloatArray,
    rivals: Sequence[FloatArray],
    curves: Mapping[int, ProfileCurve],
    level: float,
) -> dict[str, Estimate]:
    units = {constant.name: constant.metadata["unit"] for constant in constant_fields()}
    prior_std = np.sqrt(np.diag(np.linalg.inv(problem.information)))
    model = problem.models[0]
    quantile = float(norm.ppf(0.5 + 0.5 * level))
    std = np.sqrt(np.diag(inverse))[: problem.k]
    found = {}
    for i, (name, limits) in enumerate(vehicle.unknown.items()):
        z = best.at[i]
        ends = np.clip([z - quantile * std[i], z + quantile * std[i]], 0.0, 1.0)
        linear = tuple(float(v) for v in limits[0] + ends * model.width[i])
        low, high = linear
        profiled = None
        if i in curves:
            low, high = (float(limits[0] + end * model.width[i]) for end in curves[i].interval)
            profiled = Profile(limits[0] + curves[i].z * model.width[i], curves[i].rise)
        others = [limits[0] + rival[i] * model.width[i] for rival in rivals]
        found[name] = Estimate(
            unit=units[name],
            estimate=float(limits[0] + z * model.width[i]),
            standard_deviation=float(std[i] * model.width[i]),
            low=min([low, *others]),
            high=max([high, *others]),
            linear=(linear[0], linear[1]),
            range=limits,
            identifiable=bool(std[i] <= IDENTIFIABLE * prior_std[i]) and not rivals,
            profile=profiled,
        )
    return found


def _hidden(problem: Problem, inverse: FloatArray, names: Sequence[str]) -> tuple[Combination, ...]:
    """Directions whose standard deviation the drives left above half of the prior's.

    Eigenvectors of the posterior covariance in units of the prior's.
    """
    k = problem.k
    root = np.linalg.cholesky(problem.information)  # information = root rootᵀ
    share, vectors = np.linalg.eigh(root.T @ inverse[:k, :k] @ root)
    found = []
    for variance, vector in zip(share[::-1], vectors.T[::-1], strict=True):
        if variance < IDENTIFIABLE**2:
            break
        direction = np.linalg.solve(root.T, vector)
        direction /= np.linalg.norm(direction)
        direction *= np.sign(direction[np.argmax(np.abs(direction))])
        order = [i for i in np.argsort(-np.abs(direction)) if abs(direction[i]) > SMALL_WEIGHT]
        weights = {names[i]: float(direction[i]) for i in order}
        found.append(Combination(weights, float(min(1.0, math.sqrt(variance)))))
    return tuple(found)
