"""Identification from hundreds of drives, through any executor.

    with ProcessPoolExecutor() as executor:
        found = identify_many(bags, vehicle, folder=Path("work"), executor=executor)

Every drive has start pose, clocks and bias of its own, and all share the parameters: the
information matrix has the shape of an arrow. Each drive is therefore looked at alone, its own
variables are eliminated (Schur complement), and what it says of the common ones, a small matrix,
is summed. Time and memory grow in proportion to the drives. A few drives, evenly chosen, give the
start and the noise, which is taken to be the same in all.

What a model lacks does not become less with more drives, and the deviations do. They are therefore
those of the drives' own scatter (cluster-robust; Liang and Zeger, Biometrika 73, 1986), where it is
larger than the noise explains, and the drives whose residuals are not white are counted.
"""

import hashlib
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.stats import binom, norm
from threadpoolctl import threadpool_limits

from excitation_planner.design.prior import SHOWN
from parameter_identification.drives.kept import content_key, keep, kept
from parameter_identification.drives.measured import (
    MeasuredDrive,
    Sensor,
    read_measured_drive,
)
from parameter_identification.drives.recorded import TopicNames
from parameter_identification.estimation.checks import check_motion, check_vehicle
from parameter_identification.estimation.model import DriveModel
from parameter_identification.estimation.noise import NoiseLevel
from parameter_identification.estimation.optimum import find_optimum
from parameter_identification.estimation.prior import GaussianPrior, prior_in_ranges
from parameter_identification.estimation.problem import LeastSquares, Loss
from parameter_identification.estimation.results import Estimate
from parameter_identification.estimation.validation import whiteness_of_residuals
from parameter_identification.estimation.whiteness import SIGNIFICANCE, all_white
from tricycle_core.errors import ExcitationError, IdentificationError
from tricycle_core.quantities import FloatArray, Progress
from tricycle_sim.vehicle import Vehicle

LOOKED_AT = 8  # drives from which start and noise are found
TOGETHER = 4  # drives of one task of the executor
PASSES = 20  # over all drives, at most
TOLERANCE = 0.01  # of the cost: a step that promises less is the last one
SCATTER = 20  # drives from which their scatter is an estimate

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, eq=False)
class DriveShare:
    """What one drive says of the k common variables at a point, its own ones eliminated.

    Attributes
    ----------
    name : str
        Of the drive.
    samples : int
        Numbers measured.
    cost : float
        Squared residuals over their variances.
    information : ndarray of float, shape (k, k)
        Of the common variables, in their ranges.
    gradient : ndarray of float, shape (k,)
        Half the slope of the cost.
    own : ndarray of float, shape (q,)
        The drive's own variables.
    white : bool
        Whether the residuals are.
    truth : mapping of str to float
        True parameters, where the drive was simulated.
    """

    name: str
    samples: int
    cost: float
    information: FloatArray
    gradient: FloatArray
    own: FloatArray
    white: bool
    truth: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class ManyDrives:
    """Parameters of a vehicle from many drives.

    Attributes
    ----------
    parameters : mapping of str to Estimate
        With linear intervals.
    covariance : ndarray of float, shape (k, k)
        Of the estimates, in their units.
    scatter : float
        Largest ratio of a deviation by the drives' scatter to that by the noise; NaN for less than
        `SCATTER` drives. Far above 1 the drives contradict each other: the model lacks something.
    drives : tuple of DriveShare
        At the estimate, in the order of the bags.
    left_out : tuple of str
        Bags that were not used, with the reason.
    truth : mapping of str to float
        True values that all bags hold alike, where the drives were simulated.
    vehicle, vehicle_hash : str
        Name and hash of the vehicle file.
    level : float
        Probability of the intervals.
    """

    parameters: Mapping[str, Estimate]
    covariance: FloatArray
    scatter: float
    drives: tuple[DriveShare, ...]
    left_out: tuple[str, ...]
    truth: Mapping[str, float]
    vehicle: str
    vehicle_hash: str
    level: float

    @property
    def not_white(self) -> int:
        """Number of drives whose residuals are not white."""
        return sum(not drive.white for drive in self.drives)

    @property
    def white(self) -> bool:
        """Whether no more drives are not white than one expects of a model that lacks nothing."""
        return self.not_white <= int(binom.isf(0.001, len(self.drives), SIGNIFICANCE))


@dataclass(frozen=True, eq=False)
class _Point:
    """Where drives are looked at."""

    vehicle: Vehicle
    z: FloatArray  # parameters in their ranges
    noise: Mapping[Sensor, NoiseLevel]


@dataclass(frozen=True, eq=False)
class _Sum:
    """What all drives and the prior say at a point."""

    cost: float
    information: FloatArray  # (k, k)
    gradient: FloatArray  # (k,)
    shares: tuple[DriveShare, ...]

    def step(self, z: FloatArray) -> FloatArray:
        """The step to the minimum of the quadratic cost within the ranges."""
        factor = np.linalg.cholesky(self.information)
        wanted = np.linalg.solve(factor, -self.gradient)
        step: FloatArray = np.linalg.solve(factor.T, wanted)
        if np.any((z + step < 0.0) | (z + step > 1.0)):
            step = lsq_linear(factor.T, wanted, (-z, 1.0 - z), method="bvls").x
        return step


def identify_many(
    bags: Sequence[Path],
    vehicle: Vehicle,
    *,
    folder: Path,
    executor: Executor | None = None,
    prior: GaussianPrior | None = None,
    leave_out: bool = False,
    topics: TopicNames | None = None,
    level: float = 0.95,
    seed: int = 0,
    progress: Progress | None = None,
) -> ManyDrives:
    """Estimate the unknown parameters of one vehicle from many bags.

    Parameters
    ----------
    bags : sequence of Path
        One drive each.
    vehicle : Vehicle
        Known constants and ranges.
    folder : Path
        Where the drives are kept once they are read, by the content of their bags: the same call
        goes on where another one was ended.
    executor : concurrent.futures.Executor, optional
        Its workers see bags and folder. The result is the same on each. Default: this process.
    prior : GaussianPrior, optional
        Knowledge before the drives. Parameters that it does not name keep their ranges.
    leave_out : bool
        Whether bags that cannot be used are left out, instead of being an error.
    topics : TopicNames, optional
        Where names differ from the suite's.
    level : float
        Probability of the intervals.
    seed : int
        Of the starts.
    progress : callable, optional
        Called with the number of bags read and in all.

    Raises
    ------
    IdentificationError
        If a bag cannot be used, comes twice, none is left, a worker dies, or there is no minimum.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files: dict[Path, Path] = {}  # bag by file
    left_out: list[str] = []
    jobs = [(bag, vehicle, folder, topics) for bag in bags]
    for done, (bag, (file, reason)) in enumerate(
        zip(bags, _each(executor, _read, jobs), strict=True), start=1
    ):
        if not reason and file in files:
            reason = f"{bag} and {files[file]} are the same drive"
        if reason and not leave_out:
            raise IdentificationError(reason)
        if reason:
            left_out.append(reason)
        else:
            files[file] = bag
        if progress is not None:
            progress(done, len(bags))
    usable = list(files)
    if not usable:
        raise IdentificationError("no drive: nothing to identify from")

    prior_mean, prior_information = prior_in_ranges(vehicle, prior)
    point = _begin(usable, vehicle, (prior_mean, prior_information), seed)
    own: list[FloatArray | None] = [None] * len(usable)

    def look(point: _Point) -> _Sum:
        blocks = [
            (point, usable[first : first + TOGETHER], own[first : first + TOGETHER])
            for first in range(0, len(usable), TOGETHER)
        ]
        off = point.z - prior_mean
        pull = prior_information @ off
        shares = tuple(itertools.chain.from_iterable(_each(executor, _look, blocks)))
        # in the order of the bags, so that the sum is the same on every executor
        return _Sum(
            float(off @ pull) + sum(share.cost for share in shares),
            prior_information + sum(share.information for share in shares),
            pull + sum(share.gradient for share in shares),
            shares,
        )

    here, shorter = look(point), 1.0
    for _ in range(PASSES):
        step = shorter * here.step(point.z)
        promise = -float(step @ (2.0 * here.gradient + here.information @ step))
        if promise < TOLERANCE:
            break
        own = [share.own for share in here.shares]
        trial = _Point(vehicle, np.clip(point.z + step, 0.0, 1.0), point.noise)
        there = look(trial)
        if there.cost < here.cost:
            point, here, shorter = trial, there, 1.0
        else:
            shorter *= 0.3
    else:
        raise IdentificationError(f"no minimum after {PASSES} passes over the drives")
    z = np.clip(point.z + step, 0.0, 1.0)
    return _result(vehicle, z, here, prior_information, left_out, level)


def _each(executor: Executor | None, work: Callable[[T], R], jobs: Iterable[T]) -> Iterator[R]:
    """Results in the order of the jobs."""
    try:
        yield from map(work, jobs) if executor is None else executor.map(work, jobs)
    except BrokenExecutor as error:
        raise IdentificationError(
            "a worker died; was memory short? The same call goes on with the drives that were read"
        ) from error


def _read(job: tuple[Path, Vehicle, Path, TopicNames | None]) -> tuple[Path, str]:
    """Keep the drive of a bag; return the file, and why there is none."""
    bag, vehicle, folder, topics = job
    try:
        file = folder / f"{content_key(bag, vehicle)}.npz"
        if topics is not None:
            own = hashlib.sha256(repr(topics).encode()).hexdigest()[:8]
            file = file.with_name(f"{file.stem}-{own}.npz")
        if not file.exists():
            drive = read_measured_drive(bag, vehicle, topics=topics)
            check_motion(drive)
            check_vehicle(drive, vehicle)
            keep(drive, file)
    except (ExcitationError, OSError) as error:
        return bag, str(error) if str(bag) in str(error) else f"{bag}: {error}"
    return file, ""


def _begin(
    files: Sequence[Path], vehicle: Vehicle, prior: tuple[FloatArray, FloatArray], seed: int
) -> _Point:
    """The best fit of a few drives, with every sensor that any drive has, and their noise."""
    chosen = {files[i] for i in np.linspace(0, len(files) - 1, LOOKED_AT).round().astype(int)}
    drives = {file: kept(file) for file in files if file in chosen}
    known = {sensor for drive in drives.values() for sensor in drive.signals}
    for file in files:
        if known >= set(Sensor):
            break
        if file not in drives and not known >= set((drive := kept(file)).signals):
            drives[file] = drive
            known |= set(drive.signals)
    models = [DriveModel(vehicle, drive) for drive in drives.values()]
    with (
        threadpool_limits(1, user_api="blas"),
        LeastSquares(models, *prior, Loss.SQUARED) as problem,
    ):
        best = find_optimum(problem, starts=4, seed=seed, level=0.95)
        return _Point(vehicle, best.fit.at[: problem.k], dict(problem.noise))


def _look(job: tuple[_Point, Sequence[Path], Sequence[FloatArray | None]]) -> list[DriveShare]:
    """What each of some drives says at a point; searches begin at its own variables of before."""
    point, files, before = job
    with threadpool_limits(1, user_api="blas"):
        return [_share(point, kept(file), own) for file, own in zip(files, before, strict=True)]


def _share(point: _Point, drive: MeasuredDrive, own: FloatArray | None) -> DriveShare:
    model, k = DriveModel(point.vehicle, drive), len(point.z)
    nothing = np.zeros((k, k))  # the prior counts once, not for every drive
    with LeastSquares([model], point.z, nothing, Loss.SQUARED) as problem:
        problem.noise = {sensor: point.noise[sensor] for sensor in problem.noise}
        at = np.append(point.z, np.zeros(problem.n - k) if own is None else own)
        problem.weigh(at)
        free: NDArray[np.bool_] = np.arange(problem.n) >= k
        at = problem.minimise(at, free).at
        gram = problem.gram(at)
        white = all_white(whiteness_of_residuals(problem, problem.predictions(at)))
        samples = problem.samples_in_all
    across, alone, slope = gram[:k, k:-1], gram[k:-1, k:-1], gram[:-1, -1]
    eliminated = np.linalg.solve(alone, np.column_stack([across.T, slope[k:]]))
    return DriveShare(
        drive.name,
        samples,
        float(gram[-1, -1] - slope[k:] @ eliminated[:, -1]),
        gram[:k, :k] - across @ eliminated[:, :-1],
        slope[:k] - across @ eliminated[:, -1],
        at[k:] - eliminated[:, -1],
        white,
        drive.truth,
    )


def _result(
    vehicle: Vehicle,
    z: FloatArray,
    found: _Sum,
    prior: FloatArray,
    left_out: Sequence[str],
    level: float,
) -> ManyDrives:
    covariance: FloatArray = np.asarray(np.linalg.inv(found.information), dtype=np.float64)
    scatter, count = math.nan, len(found.shares)
    if count >= SCATTER:
        slopes = np.array([share.gradient for share in found.shares])
        slopes = slopes - slopes.mean(axis=0)  # where a parameter ends at its range, there is one
        middle = slopes.T @ slopes * count / (count - 1) + prior
        robust = covariance @ middle @ covariance
        larger = np.sqrt(np.diag(robust) / np.diag(covariance))
        scatter = float(larger.max())
        growth = np.maximum(larger, 1.0)
        covariance = covariance * np.outer(growth, growth)
    low, high = np.array(list(vehicle.unknown.values())).T
    width = high - low
    std, quantile = np.sqrt(np.diag(covariance)), float(norm.ppf(0.5 + 0.5 * level))
    shown = std <= SHOWN * np.sqrt(np.diag(np.linalg.inv(prior)))
    estimates = {}
    for i, (name, limits) in enumerate(vehicle.unknown.items()):
        ends = np.clip([z[i] - quantile * std[i], z[i] + quantile * std[i]], 0.0, 1.0)
        linear = (float(low[i] + ends[0] * width[i]), float(low[i] + ends[1] * width[i]))
        estimates[name] = Estimate(
            unit=vehicle.unit(name),
            estimate=float(low[i] + z[i] * width[i]),
            standard_deviation=float(std[i] * width[i]),
            low=linear[0],
            high=linear[1],
            linear=linear,
            range=limits,
            identifiable=bool(shown[i]),
        )
    scaled = covariance * np.outer(width, width)
    truth = found.shares[0].truth
    alike = all(share.truth == truth for share in found.shares)
    return ManyDrives(
        estimates,
        scaled,
        scatter,
        found.shares,
        tuple(left_out),
        truth if alike else {},
        vehicle.name,
        vehicle.fingerprint,
        level,
    )
