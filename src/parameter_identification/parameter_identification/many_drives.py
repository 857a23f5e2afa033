"""Identification from hundreds of drives, through any executor.

    with ProcessPoolExecutor() as executor:
        found = identify_many(bags, vehicle, folder=Path("work"), executor=executor)

What each drive has of its own is eliminated from it alone (`estimation.shares`), and what it says
of the common variables is summed: time and memory grow in proportion to the drives. A few drives,
evenly chosen, give the start and the noise, which is taken to be the same in all.

More drives make the standard deviations smaller, but not what the model lacks. Where the drives
scatter more than their noise explains, the deviations are therefore those of this scatter
(cluster-robust; Liang and Zeger, Biometrika 73, 1986); and the drives whose residuals are not white
are counted.
"""

import hashlib
import itertools
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from excitation_planner.design.prior import SHOWN
from parameter_identification.drives.kept import (
    beginning_of,
    content_key,
    is_kept,
    keep,
    load_kept,
    measured_in,
    positions_key,
)
from parameter_identification.drives.measured import Input, MeasuredDrive, read_measured_drive
from parameter_identification.drives.recorded import TopicNames
from parameter_identification.estimation.checks import check_motion, check_reference, check_signs
from parameter_identification.estimation.doubt import (
    CONTRADICTING,
    beyond_ranges,
    scatter_factors,
    with_prior_variance,
)
from parameter_identification.estimation.intervals import interval
from parameter_identification.estimation.prior import GaussianPrior, prior_in_ranges
from parameter_identification.estimation.quadratic import Quadratic
from parameter_identification.estimation.results import (
    EffectEstimate,
    Estimate,
    asked_for,
    common_truth,
    estimate_of,
)
from parameter_identification.estimation.shares import (
    DriveShare,
    Setting,
    first_fit,
    share_of,
    untold,
)
from parameter_identification.estimation.weighing import CERTAIN, Mixture
from parameter_identification.estimation.weighing import mixture as mixture_of
from parameter_identification.estimation.whiteness import SIGNIFICANCE
from tricycle_core.errors import ExcitationError, IdentificationError, naming
from tricycle_core.quantities import FloatArray, Progress
from tricycle_sim.effects import Effect, effects_of
from tricycle_sim.vehicle import Vehicle

LOOKED_AT = 8  # drives from which start and noise are found
TOGETHER = 4  # drives of one task of the executor
PASSES = 20  # over all drives, at most
TOLERANCE = 0.01  # of the cost: a step that lowers it by less is the last one
RATE = 0.5  # standard deviation of a rate's prior, in ranges per unit of time

NAMED = 3  # bags left out in a message

T = TypeVar("T")
R = TypeVar("R")


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
        10 drives. Far above 1 the drives contradict each other: the model lacks something.
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
    effects : tuple of EffectEstimate
        What all drives have in common beside the parameters; of deviations their sizes.
    others : mapping of str to Estimate
        Parameters that were not asked for, but estimated.
    fixed : mapping of str to float
        Parameters that were held at their nominal values: no interval counts an error in them.
    measured : frozenset of Input
        What moved as measured, not as the commands say.
    seed : int
        Of the starts.
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
    effects: tuple[EffectEstimate, ...] = ()
    others: Mapping[str, Estimate] = field(default_factory=dict)
    fixed: Mapping[str, float] = field(default_factory=dict)
    measured: frozenset[Input] = frozenset()
    seed: int = 0

    def only(self, names: Collection[str]) -> Self:
        """Return the result for some of the parameters, the rest of which are its `others`.

        Parameters
        ----------
        names : collection of str
            Of the parameters that are asked for.
        """
        return replace(self, **asked_for(self.parameters, self.covariance, names))

    @property
    def not_white(self) -> int:
        """Number of drives whose residuals are not white."""
        return sum(not drive.white for drive in self.drives)

    @property
    def white(self) -> bool:
        """Whether the drives that are not white are so few that they may be so by chance."""
        return few_coloured(self.not_white, len(self.drives))


def few_coloured(not_white: int, drives: int) -> bool:
    """Return whether the drives that are not white are so few that they may be so by chance.

    Parameters
    ----------
    not_white, drives : int
        Number of drives whose residuals are not white, and of all.
    """
    from scipy.stats import binom  # takes half a second to import

    return not_white <= int(binom.isf(0.001, drives, SIGNIFICANCE))


@dataclass(frozen=True, eq=False)
class Variables:
    """The n variables of a vehicle: the c common ones of its drives, then the rates of some.

    Attributes
    ----------
    low, high : ndarray of float, shape (n,)
        Bounds.
    mean : ndarray of float, shape (n,)
        Of the prior.
    information : ndarray of float, shape (n, n)
        Of the prior.
    changing : tuple of int
        Parameters that have a rate, in the order of the rates.
    """

    low: FloatArray
    high: FloatArray
    mean: FloatArray
    information: FloatArray
    changing: tuple[int, ...] = ()

    @property
    def common(self) -> int:
        """Number c of variables that a drive has in common with the others."""
        return len(self.mean) - len(self.changing)

    def of_drive(self, since: float) -> FloatArray:
        """Return the matrix (c, n) that gives the common variables of a drive.

        Parameters
        ----------
        since : float
            Time of the drive, in units of the rates.
        """
        found = np.eye(self.common, len(self.mean))
        found[list(self.changing), self.common + np.arange(len(self.changing))] = since
        return found


@dataclass(frozen=True, eq=False)
class Sum(Quadratic):
    """What drives and prior say of variables (n,) near a point.

    Attributes
    ----------
    slopes : ndarray of float, shape (d, n)
        The gradient of each drive.
    shares : tuple of DriveShare
        Of each drive.
    """

    slopes: FloatArray
    shares: tuple[DriveShare, ...]


@dataclass(eq=False)
class VehicleFit:
    """The drives of one vehicle, and where their best fit is looked for.

    Attributes
    ----------
    files : sequence of Path
        Kept drives.
    setting : Setting
        How they are looked at.
    variables : Variables
        Of the vehicle.
    since : ndarray of float, shape (d,)
        Time of each drive, in units of the rates.
    at : ndarray of float, shape (n,)
        The point.
    here : Sum, optional
        What the drives say there, or close by.
    """

    files: Sequence[Path]
    setting: Setting
    variables: Variables
    since: FloatArray
    at: FloatArray
    here: Sum | None = field(default=None)

    @property
    def sum(self) -> Sum:
        """What the drives said last."""
        if self.here is None:
            raise ValueError("the drives were not looked at yet")
        return self.here

    def trial(self, length: float) -> tuple[FloatArray, float]:
        """Return the point (n,) of the next step, and by how much it lowers the quadratic cost.

        Parameters
        ----------
        length : float
            Share of the step that is made.
        """
        low, high = self.variables.low, self.variables.high
        step = length * self.sum.step(low, high)
        return np.clip(self.at + step, low, high), self.sum.decrease(step)


def look(
    fits: Sequence[VehicleFit], points: Sequence[FloatArray], executor: Executor | None
) -> list[Sum]:
    """Return what the drives of vehicles say at points; one pass over all of them.

    Parameters
    ----------
    fits : sequence of VehicleFit
        The vehicles.
    points : sequence of ndarray of float, shape (n,)
        Of their variables.
    executor : concurrent.futures.Executor, optional
        Default: this process.
    """
    jobs, designs = [], []
    for fit, point in zip(fits, points, strict=True):
        of_drives = [fit.variables.of_drive(since) for since in fit.since]
        designs.append(of_drives)
        c, drives = fit.variables.common, len(fit.files)
        low, high = fit.variables.low[:c], fit.variables.high[:c]
        places = [np.clip(design @ point, low, high) for design in of_drives]
        before: list[FloatArray | None] = [None] * drives
        if fit.here is not None:
            before = [share.own for share in fit.here.shares]
        for first in range(0, drives, TOGETHER):
            some = slice(first, first + TOGETHER)
            jobs.append((fit.setting, fit.files[some], places[some], before[some]))
    shares = itertools.chain.from_iterable(each(executor, _look, jobs))
    return [
        _summed(s.variables, point, of_drives, list(itertools.islice(shares, len(s.files))))
        for s, point, of_drives in zip(fits, points, designs, strict=True)
    ]


def _look(
    job: tuple[Setting, Sequence[Path], Sequence[FloatArray], Sequence[FloatArray | None]],
) -> list[DriveShare]:
    """What each of some drives says at its point; its own variables are searched from the last."""
    setting, files, places, before = job
    with threadpool_limits(1, user_api="blas"):
        return [
            share_of(setting, load_kept(file), place, own)
            for file, place, own in zip(files, places, before, strict=True)
        ]


def _summed(
    variables: Variables,
    point: FloatArray,
    of_drives: Sequence[FloatArray],
    shares: Sequence[DriveShare],
) -> Sum:
    """The sum in the order of the drives, so that it is the same on every executor."""
    off = point - variables.mean
    pull = variables.information @ off
    slopes = np.array([d.T @ s.gradient for d, s in zip(of_drives, shares, strict=True)])
    information = variables.information + sum(
        d.T @ s.information @ d for d, s in zip(of_drives, shares, strict=True)
    )
    cost = float(off @ pull) + sum(share.cost for share in shares)
    return Sum(point, cost, pull + slopes.sum(axis=0), information, slopes, tuple(shares))


def descend(
    fits: Sequence[VehicleFit], executor: Executor | None, names: Sequence[str] = ()
) -> None:
    """Bring each vehicle to the best fit of its drives, all in the same passes.

    Parameters
    ----------
    fits : sequence of VehicleFit
        The vehicles.
    executor : concurrent.futures.Executor, optional
        Default: this process.
    names : sequence of str
        Of the vehicles, for the message.

    Raises
    ------
    IdentificationError
        If one has no minimum.
    """
    found = look(fits, [fit.at for fit in fits], executor)
    for fit, there in zip(fits, found, strict=True):
        fit.here = there
    lengths = dict.fromkeys(range(len(fits)), 1.0)
    for _ in range(PASSES):
        trials = {}
        for i in list(lengths):
            point, decrease = fits[i].trial(lengths[i])
            if decrease < TOLERANCE:
                fits[i].at = point
                del lengths[i]
            else:
                trials[i] = point
        if not trials:
            return
        found = look([fits[i] for i in trials], list(trials.values()), executor)
        for (i, point), there in zip(trials.items(), found, strict=True):
            if there.cost < fits[i].sum.cost:
                fits[i].at, fits[i].here, lengths[i] = point, there, 1.0
            else:
                lengths[i] *= 0.3
    whose = f"{', '.join(names[i] for i in lengths)}: " if names else ""
    raise IdentificationError(f"{whose}no minimum after {PASSES} passes over the drives")


def identify_many(
    bags: Sequence[Path],
    vehicle: Vehicle,
    *,
    folder: Path,
    executor: Executor | None = None,
    prior: GaussianPrior | None = None,
    effects: Sequence[str] = (),
    weighed: bool = False,
    leave_out: bool = False,
    other_vehicle: bool = False,
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
    effects : sequence of str, optional
        Of `EFFECTS`: estimated beside the parameters; those of each drive are eliminated with what
        else it has of its own.
    weighed : bool
        Whether the result is the average over the models with and without each effect that all
        drives have in common. Those of each drive act.
    leave_out : bool
        Whether bags that cannot be used are left out, instead of being an error.
    other_vehicle : bool
        Whether drives may have been planned for another vehicle, as with an earlier file of it.
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
    beside = effects_of(vehicle, effects)
    files, left_out = read_bags(
        bags, vehicle, folder=folder, executor=executor, leave_out=leave_out, topics=topics,
        progress=progress, other_vehicle=other_vehicle,
    )  # fmt: skip
    if not files:
        raise IdentificationError(f"no drive: nothing to identify from{some_of(left_out)}")
    (fit,) = fits = begin([list(files.values())], vehicle, beside, prior, seed, executor)
    left_out += drop_untold(fits, files, executor, leave_out=leave_out)
    descend(fits, executor)
    average = None
    if weighed and fit.setting.shared:
        average = _weigh(fit)
    return result_of(fit, files, left_out, level, seed, average=average)


def some_of(left_out: Sequence[str]) -> str:
    """Return the first reasons why bags were not used, as the end of a message; empty for none.

    Parameters
    ----------
    left_out : sequence of str
        All of them.
    """
    more = "; …" if len(left_out) > NAMED else ""
    return f". Left out: {'; '.join(left_out[:NAMED])}{more}" if left_out else ""


def read_bags(
    bags: Sequence[Path],
    vehicle: Vehicle,
    *,
    folder: Path,
    executor: Executor | None,
    leave_out: bool,
    topics: TopicNames | None,
    progress: Progress | None,
    other_vehicle: bool = False,
) -> tuple[dict[Path, Path], list[str]]:
    """Keep the drives of bags; return the file of each that can be used, and why others cannot.

    Parameters
    ----------
    bags : sequence of Path
        One drive each.
    vehicle : Vehicle
        That drove.
    folder : Path
        Where the drives are kept.
    executor : concurrent.futures.Executor, optional
        Default: this process.
    leave_out : bool
        Whether bags that cannot be used are left out, instead of being an error.
    topics : TopicNames, optional
        Where names differ from the suite's.
    progress : callable, optional
        Called with the number of bags read and in all.
    other_vehicle : bool
        As that of `identify_many`.

    Raises
    ------
    IdentificationError
        If a bag cannot be used, or comes twice.
    """
    folder.mkdir(parents=True, exist_ok=True)
    known: dict[Path, Path] = {}  # file by bag
    measured: dict[str, Path] = {}  # bag by what was measured
    left_out: list[str] = []
    jobs = [(bag, vehicle, folder, topics, other_vehicle) for bag in bags]
    for done, (bag, (file, reason)) in enumerate(
        zip(bags, each(executor, _read, jobs), strict=True), start=1
    ):
        if not reason and (key := positions_key(file)) in measured:
            reason = f"{bag} and {measured[key]} are the same drive"
        if reason and not leave_out:
            raise IdentificationError(reason)
        if reason:
            left_out.append(reason)
        else:
            known[bag], measured[key] = file, bag
        if progress is not None:
            progress(done, len(bags))
    return known, left_out


def begin(
    files: Sequence[Sequence[Path]],
    vehicle: Vehicle,
    effects: Sequence[Effect],
    prior: GaussianPrior | None,
    seed: int,
    executor: Executor | None,
    *,
    changing: Sequence[str] = (),
    since: Callable[[float], float] = lambda _: 0.0,
    progress: Progress | None = None,
) -> list[VehicleFit]:
    """Return where vehicles are searched from: the best fit of a few of their drives.

    Parameters
    ----------
    files : sequence of sequence of Path
        Kept drives of each vehicle.
    vehicle : Vehicle
        Known constants and ranges.
    effects : sequence of Effect
        Estimated beside the parameters.
    prior : GaussianPrior, optional
        Knowledge before the drives.
    seed : int
        Of the starts.
    executor : concurrent.futures.Executor, optional
        Default: this process.
    changing : sequence of str
        Parameters that change linearly in time.
    since : callable
        Time in units of the rates, of that in seconds since 1970.
    progress : callable, optional
        Called with the number of vehicles done and in all.
    """
    mean, information = prior_in_ranges(vehicle, prior)
    jobs = [(own, vehicle, tuple(effects), (mean, information), seed) for own in files]
    found = []
    for own, (setting, at) in zip(files, each(executor, _begin, jobs), strict=True):
        shared, k, names = setting.shared, len(mean), list(vehicle.unknown)
        rates = tuple(names.index(name) for name in changing)
        precisions = np.append(np.ones(len(shared)), np.full(len(rates), RATE**-2))
        n = k + len(precisions)
        whole = np.diag(np.append(np.zeros(k), precisions))
        whole[:k, :k] = information
        free = np.full(len(rates), np.inf)
        variables = Variables(
            np.concatenate([np.zeros(k), [e.low / e.std for e in shared], -free]),
            np.concatenate([np.ones(k), [e.high / e.std for e in shared], free]),
            np.append(mean, np.zeros(n - k)),
            whole,
            rates,
        )
        times = (
            np.array([since(beginning_of(file)) for file in own]) if rates else np.zeros(len(own))
        )
        found.append(
            VehicleFit(own, setting, variables, times, np.append(at, np.zeros(len(rates))))
        )
        if progress is not None:
            progress(len(found), len(files))
    return found


def _begin(
    job: tuple[Sequence[Path], Vehicle, tuple[Effect, ...], tuple[FloatArray, FloatArray], int],
) -> tuple[Setting, FloatArray]:
    """The best fit of a few drives, among them one with each sensor, and the sensors' noise."""
    files, vehicle, effects, prior, seed = job
    chosen = {files[i] for i in np.linspace(0, len(files) - 1, LOOKED_AT).round().astype(int)}
    drives: dict[Path, MeasuredDrive] = {file: load_kept(file) for file in files if file in chosen}
    # where the servo is of another kind, the other drives are of no use
    steering = {
        file: drive for file, drive in drives.items() if Input.STEERING in drive.measured_throughout
    }
    drives = steering or drives
    known = set().union(*map(measured_in, drives))
    for file in files:
        if not known >= (more := measured_in(file)):
            drives[file] = load_kept(file)
            known |= more
    return first_fit(list(drives.values()), vehicle, effects, prior, seed)


def drop_untold(
    fits: Sequence[VehicleFit],
    files: Mapping[Path, Path],
    executor: Executor | None,
    *,
    leave_out: bool,
) -> list[str]:
    """Drop drives that do not tell what moves as measured in others of their vehicle; return why.

    Parameters
    ----------
    fits : sequence of VehicleFit
        From `begin`.
    files : mapping of Path to Path
        Kept drive of each bag.
    executor : concurrent.futures.Executor, optional
        Default: this process.
    leave_out : bool
        Whether they are dropped, instead of being an error.

    Raises
    ------
    IdentificationError
        If there is one that is not to be dropped.
    """
    bags = {file: bag for bag, file in files.items()}
    reasons = []
    needing = [fit for fit in fits if fit.setting.measured]
    found = each(executor, _untold, [(fit.setting, file) for fit in needing for file in fit.files])
    for fit in needing:
        told = []
        for file, reason in zip(fit.files, itertools.islice(found, len(fit.files)), strict=True):
            told.append(not reason)
            if reason:
                reasons.append(f"{bags[file]}: {reason}")
        fit.files = list(itertools.compress(fit.files, told))
        fit.since = fit.since[told]
    if reasons and not leave_out:
        raise IdentificationError(reasons[0])
    return reasons


def _untold(job: tuple[Setting, Path]) -> str:
    setting, file = job
    return untold(setting, load_kept(file))


def each(executor: Executor | None, work: Callable[[T], R], jobs: Iterable[T]) -> Iterator[R]:
    """Yield results in the order of the jobs.

    Parameters
    ----------
    executor : concurrent.futures.Executor, optional
        Default: this process.
    work : callable
        What is done to a job.
    jobs : iterable
        One argument each.

    Raises
    ------
    IdentificationError
        If a worker dies.
    """
    try:
        yield from map(work, jobs) if executor is None else executor.map(work, jobs)
    except Exception as error:
        # dask gives a task to other workers first, and then raises an error of its own
        of_dask = type(error).__module__.startswith("distributed.")
        if not (of_dask or isinstance(error, BrokenExecutor)):
            raise
        raise IdentificationError(
            "a worker died; was memory short? The same call goes on with the drives that were read"
        ) from error


def _read(job: tuple[Path, Vehicle, Path, TopicNames | None, bool]) -> tuple[Path, str]:
    """Keep the drive of a bag; return its file and "", or the bag and why it cannot be used."""
    bag, vehicle, folder, topics, other_vehicle = job
    drive = None
    try:
        file = folder / f"{content_key(bag, vehicle)}.npz"
        if topics is not None:
            own = hashlib.sha256(repr(topics).encode()).hexdigest()[:8]
            file = file.with_name(f"{file.stem}-{own}.npz")
        if other_vehicle:
            file = file.with_name(f"{file.stem}-other.npz")
        if not is_kept(file):
            drive = read_measured_drive(bag, vehicle, topics=topics)
            check_motion(drive)
            if not other_vehicle:
                check_reference(drive, vehicle)
            check_signs([drive], vehicle)
    except (ExcitationError, OSError) as error:
        return bag, naming(error, bag)
    if drive is not None:
        keep(drive, file)
    return file, ""


def growth_of(fit: VehicleFit, level: float) -> tuple[FloatArray, FloatArray]:
    """Return the two factors (n,) of `scatter_factors` for the drives' scatter.

    Parameters
    ----------
    fit : VehicleFit
        At the best fit.
    level : float
        Probability of the intervals.
    """
    return scatter_factors(fit.sum.covariance(), fit.sum.slopes, fit.variables.information, level)


def beyond_of(
    fit: VehicleFit, factors: FloatArray, average: "_Average | None" = None
) -> NDArray[np.bool_]:
    """Return which parameters (k,) the drives pull beyond their ranges.

    Parameters
    ----------
    fit : VehicleFit
        At the best fit.
    factors : ndarray of float, shape (n,)
        Those of `growth_of` for intervals.
    average : _Average, optional
        Over subsets of the effects.
    """
    here, k = fit.sum, len(fit.setting.vehicle.unknown)
    free, std = here.minimum(), np.sqrt(np.diag(here.covariance()))
    if average is not None:
        free, std = average.mixture.mean, average.mixture.standard_deviations
    std = factors * std
    low, high = fit.variables.low, fit.variables.high
    return beyond_ranges(*(values[:k] for values in (fit.at, free, std, low, high)))


@dataclass(frozen=True, eq=False)
class _Average:
    """Over all subsets of the effects: their distribution, and how probable each effect is."""

    mixture: Mixture
    acts: tuple[float, ...]


def _weigh(fit: VehicleFit) -> _Average:
    """Average over effects that all drives have in common; go to the most probable ones."""
    here, variables = fit.sum, fit.variables
    first = len(fit.setting.vehicle.unknown)
    effects = range(first, first + len(fit.setting.shared))
    mixture = mixture_of(
        here.information,
        here.pull,
        [[i] for i in effects],
        [effect.chance for effect in fit.setting.shared],
        {i: variables.low[i] for i in effects if variables.low[i] > -CERTAIN},
    )
    fit.at = np.clip(mixture.means[0], variables.low, variables.high)
    return _Average(mixture, tuple((mixture.weights @ mixture.acting).tolist()))


def _names_of(bags: Sequence[Path]) -> list[str]:
    """Names of bags, with as many of the folders that they are in as tell them apart."""
    names: list[str] = []
    for folders in range(1 + max(len(bag.parts) for bag in bags)):
        first = [max(len(bag.parts) - 1 - folders, 0) for bag in bags]
        names = ["/".join((*b.parts[i:-1], b.stem)) for b, i in zip(bags, first, strict=True)]
        if len(set(names)) == len(names):
            break
    return names


def result_of(
    fit: VehicleFit,
    files: Mapping[Path, Path],
    left_out: Sequence[str],
    level: float,
    seed: int,
    *,
    covariance: FloatArray | None = None,
    average: _Average | None = None,
) -> ManyDrives:
    """Return what was found of a vehicle.

    Parameters
    ----------
    fit : VehicleFit
        At the best fit.
    files : mapping of Path to Path
        Kept drive of each bag, by which the drives are named: it may be kept of a bag of before.
    left_out : sequence of str
        Bags that were not used, with the reason.
    level : float
        Probability of the intervals.
    seed : int
        Of the starts.
    covariance : ndarray of float, shape (n, n), optional
        Of the variables, where other vehicles tell of them too.
    average : _Average, optional
        Over subsets of the effects.
    """
    here, setting, at = fit.sum, fit.setting, fit.at
    growth, factors = growth_of(fit, level)
    if average is not None:
        covariance = average.mixture.covariance(at)
    elif covariance is None:
        covariance = here.covariance()
    k, vehicle = len(setting.vehicle.unknown), setting.vehicle
    width = np.array([high - low for low, high in vehicle.unknown.values()])
    before = np.asarray(np.linalg.inv(fit.variables.information), dtype=np.float64)[:k, :k]
    beyond = beyond_of(fit, factors, average)
    bounds, drives = fit.variables, here.shares
    white = few_coloured(sum(not share.white for share in drives), len(drives))
    if not white or growth[:k].max() > CONTRADICTING:
        at_an_end = (at <= bounds.low + 1e-9) | (at >= bounds.high - 1e-9)
        beyond |= at_an_end[:k].any()  # as in `doubt_of`
    by_noise = np.sqrt(np.diag(covariance))
    covariance = with_prior_variance(covariance * np.outer(factors, factors), before, beyond)
    std = np.sqrt(np.diag(covariance))
    estimates = {}
    for i, name in enumerate(vehicle.unknown):
        z, own, widening = float(at[i]), float(std[i]), float(std[i] / by_noise[i])
        ends = interval(
            *(i, z, own, level),
            beyond=bool(beyond[i]),
            average=None if average is None else average.mixture,
            widening=widening,
        )
        shown = own <= SHOWN * math.sqrt(before[i, i])
        estimates[name] = estimate_of(vehicle, name, z, own, ends, shown=shown)
    acts = [None] * len(setting.shared) if average is None else average.acts
    effects = [
        EffectEstimate(e.name, e.unit, e.std * float(v), e.std * float(s), e.std, acts=known)
        for e, v, s, known in zip(setting.shared, at[k:], std[k:], acts, strict=False)
    ]
    effects += [
        EffectEstimate(e.name, e.unit, 0.0, e.std * setting.sizes[e.name], e.std)
        for e in setting.effects
        if e.process and e.name in setting.sizes
    ]
    bags = {file: bag for bag, file in files.items()}
    names = _names_of([bags[file] for file in fit.files])
    shares = [replace(s, name=name) for s, name in zip(here.shares, names, strict=True)]
    return ManyDrives(
        estimates,
        covariance[:k, :k] * np.outer(width, width),
        float(growth[:k].max()),
        tuple(shares),
        tuple(left_out),
        common_truth(share.truth for share in here.shares),
        vehicle.name,
        vehicle.fingerprint,
        level,
        tuple(effects),
        measured=setting.measured,
        seed=seed,
    )
