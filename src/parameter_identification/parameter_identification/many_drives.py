"""Identification from hundreds of drives, through any executor.

    with ProcessPoolExecutor() as executor:
        found = identify_many(bags, vehicle, folder=Path("work"), executor=executor)

What each drive has of its own is eliminated from it alone (`estimation.shares`), and what it says
of the common variables is summed: time and memory grow in proportion to the drives. A few drives,
evenly chosen, give the start and the noise, which is taken to be the same in all.

More drives make the standard deviations smaller, but not what the model lacks. Where the drives
scatter more than their noise explains, the deviations are therefore those of this scatter
(cluster-robust; Liang and Zeger, Biometrika 73, 1986; of fewer than ten drives those of
`vehicle_scatter`); and the drives whose residuals are not white are counted.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from excitation_planner.design.prior import BoxPrior
from parameter_identification.drives.kept import load_kept, measured_in, times_of
from parameter_identification.drives.measured import Input, MeasuredDrive
from parameter_identification.drives.names import names_of
from parameter_identification.drives.recorded import TopicNames
from parameter_identification.estimation.estimates import estimates_of
from parameter_identification.estimation.interval_correction import corrected
from parameter_identification.estimation.intervals import check_level
from parameter_identification.estimation.mixture import Mixture, mixture_of
from parameter_identification.estimation.motion_model import lowest
from parameter_identification.estimation.prior import GaussianPrior, box_prior
from parameter_identification.estimation.results import (
    EffectEstimate,
    IdentifiedParameters,
    common_truth,
)
from parameter_identification.estimation.shares import DriveShare, FitSetting, first_fit
from parameter_identification.estimation.weighing import CERTAIN
from parameter_identification.estimation.whiteness import SIGNIFICANCE
from parameter_identification.many_bags import read_bags, some_of
from parameter_identification.vehicle_fit import (
    Variables,
    VehicleFit,
    descend,
    drop_without_inputs,
)
from parameter_identification.vehicle_scatter import scatter_of
from parameter_identification.workers import each
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray, Progress
from tricycle_sim.effects import Effect, effects_of
from tricycle_sim.vehicle import Vehicle

LOOKED_AT = 8  # drives from which start and noise are found
RATE = 0.5  # standard deviation of a rate's prior, in ranges per unit of time


@dataclass(frozen=True, kw_only=True, eq=False)
class ManyDrives(IdentifiedParameters):
    """Parameters from many drives; their intervals are those by linearisation.

    Its effects are those that all drives have in common, and of deviations their sizes.

    Attributes
    ----------
    drives : tuple of DriveShare
        Each drive's share of the cost at the estimate, in the order of the bags.
    left_out : tuple of str
        Bags that were not used, with the reason.
    """

    drives: tuple[DriveShare, ...]
    left_out: tuple[str, ...]

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
        Folder in which the drives are kept once read, by the content of their bags: the same call
        goes on where another one was ended.
    executor : concurrent.futures.Executor, optional
        Executor whose workers see bags and folder. The result is the same with any. Default: this
        process.
    prior : GaussianPrior, optional
        Knowledge before the drives. Parameters that it does not name keep their ranges.
    effects : sequence of str, optional
        Effects (of `EFFECTS`) that are estimated beside the parameters; those of each drive are
        eliminated together with the other unknowns of that drive.
    weighed : bool
        Whether the result is the average over the models with and without each effect that all
        drives have in common. Those of each drive act.
    leave_out : bool
        Whether bags that cannot be used are left out, instead of being an error.
    other_vehicle : bool
        Whether drives may have been planned for another vehicle, as with an earlier file of it.
    topics : TopicNames, optional
        Names of the topics, where they differ from the suite's.
    level : float
        Probability of the intervals.
    seed : int
        Seed of the starts.
    progress : callable, optional
        Called with the number of bags read and in all.

    Raises
    ------
    IdentificationError
        If a bag cannot be used, comes twice, none is left, a worker dies, or there is no minimum.
    """
    check_level(level)
    estimated = effects_of(vehicle, effects)
    files, left_out = read_bags(
        bags, vehicle, folder=folder, executor=executor, leave_out=leave_out, topics=topics,
        progress=progress, other_vehicle=other_vehicle,
    )  # fmt: skip
    if not files:
        raise IdentificationError(f"no drive: nothing to identify from{some_of(left_out)}")
    (fit,) = fits = begin([list(files.values())], vehicle, estimated, prior, seed, executor)
    left_out += drop_without_inputs(fits, files, executor, leave_out=leave_out)
    descend(fits, executor)
    average = None
    if weighed and fit.setting.shared:
        average = _weigh(fit)
    return result_of(fit, files, left_out, level, seed, average=average)


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
        Seed of the starts.
    executor : concurrent.futures.Executor, optional
        Default: this process.
    changing : sequence of str
        Parameters that change linearly in time.
    since : callable
        Time in units of the rates, of that in seconds since 1970.
    progress : callable, optional
        Called with the number of vehicles done and in all.
    """
    before = box_prior(vehicle, prior)
    jobs = [(own, vehicle, tuple(effects), before, seed, bool(changing)) for own in files]
    fits = []
    for own, (setting, at) in zip(files, each(executor, _begin, jobs), strict=True):
        shared, k, names = setting.shared, len(before.mean), list(vehicle.unknown)
        rates = tuple(names.index(name) for name in changing)
        precisions = np.append(np.ones(len(shared)), np.full(len(rates), RATE**-2))
        n = k + len(precisions)
        whole = np.diag(np.append(np.zeros(k), precisions))
        whole[:k, :k] = before.information
        free = np.full(len(rates), np.inf)
        times = [times_of(file) for file in own]
        late = min(time.steering_late for time in times)  # what each drive allows, all do
        variables = Variables(
            np.concatenate([np.zeros(k), [lowest(e, late) / e.std for e in shared], -free]),
            np.concatenate([np.ones(k), [e.high / e.std for e in shared], free]),
            np.append(before.mean, np.zeros(n - k)),
            whole,
            rates,
        )
        when = np.array([since(time.began) if rates else 0.0 for time in times])
        fits.append(VehicleFit(own, setting, variables, when, np.append(at, np.zeros(len(rates)))))
        if progress is not None:
            progress(len(fits), len(files))
    return fits


def _begin(
    job: tuple[Sequence[Path], Vehicle, tuple[Effect, ...], BoxPrior, int, bool],
) -> tuple[FitSetting, FloatArray]:
    """The best fit of a few drives, among them one with each sensor, and the sensors' noise."""
    files, vehicle, effects, prior, seed, changing = job
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
    return first_fit(list(drives.values()), vehicle, effects, prior, seed, changing=changing)


@dataclass(frozen=True, eq=False)
class _Average:
    """Over all subsets of the effects: their distribution, and how probable each effect is."""

    mixture: Mixture
    acts: tuple[float, ...]


def _weigh(fit: VehicleFit) -> _Average:
    """Average over effects that all drives have in common; go to the most probable ones."""
    here, variables = fit.quadratic, fit.variables
    first = len(fit.setting.vehicle.unknown)
    effects = range(first, first + len(fit.setting.shared))
    mixture = mixture_of(
        here.information,
        here.rhs,
        [[i] for i in effects],
        [effect.prior_probability for effect in fit.setting.shared],
        {i: variables.low[i] for i in effects if variables.low[i] > -CERTAIN},
    )
    fit.at = np.clip(mixture.means[0], variables.low, variables.high)
    return _Average(mixture, tuple((mixture.weights @ mixture.acting).tolist()))


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
    """Return the result for one vehicle.

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
        Seed of the starts.
    covariance : ndarray of float, shape (n, n), optional
        Covariance of the variables, where other vehicles tell of them too. Default: that of the
        fit.
    average : _Average, optional
        Over subsets of the effects.
    """
    quadratic, setting, at = fit.quadratic, fit.setting, fit.at
    if average is not None:
        covariance = average.mixture.covariance(at)
    elif covariance is None:
        covariance = quadratic.covariance()
    k, vehicle, bounds = len(setting.vehicle.unknown), setting.vehicle, fit.variables
    width = np.array([high - low for low, high in vehicle.unknown.values()])
    mixture = None if average is None else average.mixture
    drives, scatter = quadratic.shares, scatter_of(fit, level, covariance)
    correction = corrected(
        at,
        quadratic,
        covariance,
        scatter.factors,
        bounds.prior_covariance[:k, :k],
        (bounds.low, bounds.high),
        average=mixture,
        scatter=float(scatter.ratio[:k].max()),
        wrong=scatter.missed
        or not few_coloured(sum(not share.white for share in drives), len(drives)),
        converged=fit.converged,
    )
    covariance = correction.covariance
    std = np.sqrt(np.diag(covariance))
    estimates = estimates_of(
        vehicle, at[:k], std[:k], level,
        beyond=correction.beyond, widening=correction.widening, average=mixture,
    )  # fmt: skip
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
    names = names_of([bags[file] for file in fit.files])
    shares = [replace(s, name=name) for s, name in zip(quadratic.shares, names, strict=True)]
    return ManyDrives(
        parameters=estimates,
        covariance=covariance[:k, :k] * np.outer(width, width),
        scatter=correction.scatter,
        drives=tuple(shares),
        left_out=tuple(left_out),
        truth=common_truth(share.truth for share in quadratic.shares),
        vehicle=vehicle.name,
        vehicle_hash=vehicle.fingerprint,
        level=level,
        effects=tuple(effects),
        measured=setting.measured,
        converged=fit.converged,
        seed=seed,
    )
