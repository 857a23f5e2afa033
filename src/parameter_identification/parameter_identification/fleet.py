"""Identification of a fleet: parameters of each vehicle, shared by all, or drawn from a population.

Each vehicle is first fitted to its own drives. Parameters that all vehicles share are then fitted
to all drives together: what a vehicle has for itself is eliminated from its drives (the second
arrow; the first one eliminates what a drive has for itself). What is left of every vehicle, an
estimate and its errors, makes the population of a parameter.

A parameter that changes has a level and a rate in each vehicle, linear in time, and both have a
population: the rates first, and with what it tells of every rate the levels at one time.
"""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np

from excitation_planner.design.prior import BoxPrior
from parameter_identification.drives.kept import times_of
from parameter_identification.drives.recorded import TopicNames
from parameter_identification.estimation.arrow import Arrow
from parameter_identification.estimation.intervals import check_level
from parameter_identification.estimation.population import MIN_VEHICLES, Member, Population
from parameter_identification.estimation.results import Estimate
from parameter_identification.estimation.unknown import check_unknown
from parameter_identification.fleet_fit import FleetFit, FleetPosterior
from parameter_identification.many_bags import NAMED, read_bags, some_of
from parameter_identification.many_drives import ManyDrives, begin, result_of
from parameter_identification.vehicle_fit import descend, drop_without_inputs
from parameter_identification.workers import Steps
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray, Progress
from tricycle_sim.effects import effects_of
from tricycle_sim.vehicle import Vehicle

DAY = 86400.0  # s
APART = 3600.0  # s, between a vehicle's first and last drive, from which a change can be told
MOST_POINTS = 24  # of a vehicle's estimates over time


@dataclass(frozen=True, eq=False)
class Fleet:
    """Vehicles and their populations.

    Attributes
    ----------
    vehicles : mapping of str to ManyDrives
        Result for each vehicle, by name; shared parameters are those of all.
    populations : mapping of str to Population
        By parameter, of the vehicles whose drives show it; a parameter that fewer than
        `estimation.population.MIN_VEHICLES` vehicles show has none. Of one that changes, at the
        time `when`.
    changes : mapping of str to Population
        By parameter, of its rate per day.
    shared : mapping of str to Estimate
        By parameter that is the same in all vehicles.
    own : tuple of str
        Parameters of which vehicles are not compared.
    beyond : mapping of str to tuple of str
        By vehicle that is not compared: the parameters that its drives pull beyond their ranges.
    when : float
        Middle of the times of all drives [s since 1970]; NaN where one is not known.
    left_out : tuple of str
        Bags that were not used, with the reason.
    level : float
        Probability of the intervals.
    """

    vehicles: Mapping[str, ManyDrives]
    populations: Mapping[str, Population]
    changes: Mapping[str, Population]
    shared: Mapping[str, Estimate]
    own: tuple[str, ...]
    beyond: Mapping[str, tuple[str, ...]]
    when: float
    left_out: tuple[str, ...]
    level: float

    @property
    def outliers(self) -> tuple[tuple[str, bool, Member], ...]:
        """Odd vehicles, the oddest first: parameter, whether its rate is odd, and the vehicle."""
        found = [(name, False, m) for name, p in self.populations.items() for m in p.members]
        found += [(name, True, m) for name, p in self.changes.items() for m in p.members]
        odd = [(name, rate, member) for name, rate, member in found if member.odd]
        return tuple(sorted(odd, key=lambda entry: -abs(entry[2].distance)))

    @property
    def drives(self) -> int:
        """Number of drives."""
        return sum(len(found.drives) for found in self.vehicles.values())

    @property
    def not_white(self) -> int:
        """Number of drives whose residuals are not white."""
        return sum(found.not_white for found in self.vehicles.values())

    @property
    def odd(self) -> tuple[str, ...]:
        """Vehicles that are odd in a parameter or in its rate, the oddest first."""
        return tuple(dict.fromkeys(member.vehicle for _, _, member in self.outliers))


def identify_fleet(
    bags: Mapping[str, Sequence[Path]],
    vehicle: Vehicle,
    *,
    folder: Path,
    shared: Sequence[str] = (),
    own: Sequence[str] = (),
    changing: Sequence[str] = (),
    effects: Sequence[str] = (),
    executor: Executor | None = None,
    leave_out: bool = False,
    other_vehicle: bool = False,
    topics: TopicNames | None = None,
    level: float = 0.95,
    seed: int = 0,
    progress: Progress | None = None,
) -> Fleet:
    """Estimate the unknown parameters of several vehicles of one kind.

    Parameters
    ----------
    bags : mapping of str to sequence of Path
        Drives of each vehicle, by its name.
    vehicle : Vehicle
        Known constants and ranges, the same for all.
    folder : Path
        Folder in which the drives are kept once they are read.
    shared : sequence of str, optional
        Parameters that are the same in all vehicles.
    own : sequence of str, optional
        Parameters of which nothing is concluded from one vehicle to another. Those that are neither
        are drawn from a population.
    changing : sequence of str, optional
        Parameters that change linearly in time, among those drawn from a population. The first and
        the last drive of at least `MIN_VEHICLES` vehicles must be at least `APART` apart.
    effects : sequence of str, optional
        Effects (of `EFFECTS`) that are estimated beside the parameters of each vehicle. All act.
    executor : concurrent.futures.Executor, optional
        Executor, as for `identify_many`.
    leave_out : bool
        Whether bags that cannot be used are left out, instead of being an error.
    other_vehicle : bool
        Whether drives may have been planned for another vehicle, as for `identify_many`.
    topics : TopicNames, optional
        Names of the topics, where they differ from the suite's.
    level : float
        Probability of the intervals.
    seed : int
        Seed of the starts.
    progress : callable, optional
        Called with the number of bags read, vehicles begun and drives fitted, again in each pass
        over them, and that of all as far as it is known.

    Raises
    ------
    IdentificationError
        If there are fewer than `MIN_VEHICLES` vehicles, a bag cannot be used, or a parameter is not
        one, or is named twice, or the times of the drives show no change.
    """
    check_level(level)
    _check_names(vehicle, shared, own, changing)
    (steps := Steps(progress)).expect(2 * sum(map(len, bags.values())) + len(bags))
    files, known, left_out = _usable_drives(
        bags, vehicle, folder=folder, executor=executor, leave_out=leave_out, topics=topics,
        steps=steps, other_vehicle=other_vehicle,
    )  # fmt: skip
    when, unit = _times(files, known, changing)
    fits = begin(
        list(files.values()),
        vehicle,
        effects_of(vehicle, effects),
        None,
        seed,
        executor,
        changing=changing,
        since=lambda time: (time - when) / unit,
        steps=steps,
    )
    left_out += drop_without_inputs(fits, known, executor, leave_out=leave_out)
    descend(fits, executor, list(files), steps=steps)
    names = list(vehicle.unknown)
    fleet = FleetFit(fits, sorted(names.index(name) for name in shared))
    fleet.descend(executor, steps)
    posterior = fleet.posterior(level)
    alike = posterior.shared(level)
    vehicles = {}
    for i, (name, fit) in enumerate(zip(files, fits, strict=True)):
        one = result_of(fit, known, (), level, seed, covariance=posterior.covariance(i))
        vehicles[name] = replace(one, parameters={**one.parameters, **alike})
    beyond = {name: pulled for i, name in enumerate(files) if (pulled := posterior.pulled(i))}
    populated = [name for name in names if name not in (*shared, *own)]
    populations, changes = _populations(
        posterior, list(files), populated, changing, unit / DAY, level
    )
    return Fleet(
        vehicles=vehicles,
        populations=populations,
        changes=changes,
        shared=alike,
        own=tuple(own),
        beyond=beyond,
        when=when,
        left_out=tuple(left_out),
        level=level,
    )


def _usable_drives(
    bags: Mapping[str, Sequence[Path]],
    vehicle: Vehicle,
    *,
    folder: Path,
    executor: Executor | None,
    leave_out: bool,
    topics: TopicNames | None,
    steps: Steps,
    other_vehicle: bool,
) -> tuple[dict[str, list[Path]], dict[Path, Path], list[str]]:
    """Kept drives by vehicle, the kept drive of each bag, and why bags are left out."""
    if len(bags) < MIN_VEHICLES:
        raise IdentificationError(
            f"a fleet needs at least {MIN_VEHICLES} vehicles; given: {', '.join(bags) or 'none'}"
        )
    every = [bag for drives in bags.values() for bag in drives]
    if len(set(every)) < len(every):
        twice = next(bag for bag in every if every.count(bag) > 1)
        raise IdentificationError(f"{twice} is given twice")
    known, left_out = read_bags(
        every, vehicle, folder=folder, executor=executor, leave_out=leave_out, topics=topics,
        steps=steps, other_vehicle=other_vehicle,
    )  # fmt: skip
    files = {
        name: usable
        for name, drives in bags.items()
        if (usable := [known[bag] for bag in drives if bag in known])
    }
    if len(files) < MIN_VEHICLES:
        raise IdentificationError(
            f"a fleet needs at least {MIN_VEHICLES} vehicles; with drives that can be used: "
            f"{', '.join(files) or 'none'}{some_of(left_out)}"
        )
    return files, known, left_out


def _populations(
    posterior: FleetPosterior,
    vehicles: Sequence[str],
    parameters: Sequence[str],
    changing: Sequence[str],
    days: float,
    level: float,
) -> tuple[dict[str, Population], dict[str, Population]]:
    """Populations of parameters, and of their rates per day; `days` are the unit of rates."""
    fit = posterior.fits[0]
    ranges = fit.setting.vehicle.unknown
    populations, changes = {}, {}
    for parameter in parameters:
        low, high = ranges[parameter]
        at = [list(ranges).index(parameter)]
        if parameter in changing:
            at.append(fit.variables.common + list(changing).index(parameter))
        evidence = posterior.without_prior(at)
        showing = [name for name, shown in zip(vehicles, evidence.shown, strict=True) if shown]
        if len(showing) < MIN_VEHICLES:
            continue
        if parameter in changing:
            per_day = (high - low) / days
            changes[parameter] = evidence.population(showing, 1, (0.0, per_day), level)
            evidence = evidence.with_rates(changes[parameter], per_day, level)
        populations[parameter] = evidence.population(showing, 0, (low, high - low), level)
    return populations, changes


def _check_names(
    vehicle: Vehicle, shared: Sequence[str], own: Sequence[str], changing: Sequence[str]
) -> None:
    check_unknown(vehicle, (*shared, *own, *changing))
    for names in (shared, own, changing):
        if twice := [name for name in names if list(names).count(name) > 1]:
            raise IdentificationError(f"{twice[0]} is named twice")
    for name in shared:
        if name in own:
            raise IdentificationError(f"{name} cannot be shared by all vehicles and their own")
    for name in changing:
        if name in shared or name in own:
            raise IdentificationError(
                f"{name}: changes are those of a population; it cannot be shared or own too"
            )


def _times(
    files: Mapping[str, Sequence[Path]], known: Mapping[Path, Path], changing: Sequence[str]
) -> tuple[float, float]:
    """Middle of the drives' times [s], and how far the farthest is from it, the unit of rates."""
    times = {name: [times_of(file).began for file in drives] for name, drives in files.items()}
    every = np.concatenate(list(times.values()))
    when = float(np.mean(every))
    if changing and math.isnan(when):
        bags = {file: bag for bag, file in known.items()}
        began = zip(chain(*files.values()), every, strict=True)
        timeless = [str(bags[file]) for file, time in began if math.isnan(time)]
        more = ", …" if len(timeless) > NAMED else ""
        raise IdentificationError(
            f"{', '.join(changing)}: the time at which each drive began is needed, and not known "
            f"of {', '.join(timeless[:NAMED])}{more}"
        )
    apart = [name for name, own in times.items() if np.ptp(own) >= APART]
    if changing and len(apart) < MIN_VEHICLES:
        raise IdentificationError(
            f"{', '.join(changing)}: needs drives at different times, by {APART / 60.0:.0f} min or "
            f"more, of at least {MIN_VEHICLES} vehicles; so are those of: "
            f"{', '.join(apart) or 'none'}"
        )
    return when, float(np.abs(every - when).max())


@dataclass(frozen=True, eq=False)
class Course:
    """Estimates of a parameter over time, each from the drives of one time.

    Attributes
    ----------
    times : ndarray of float, shape (p,)
        Increasing [s since 1970].
    values, deviations : ndarray of float, shape (p,)
        In the parameter's unit.
    """

    times: FloatArray
    values: FloatArray
    deviations: FloatArray


def course(found: ManyDrives, parameter: str) -> Course:
    """Return the estimates of a parameter by each drive, the others being those of all drives.

    Others that change do so at the rate that was found.
    Of more than `MOST_POINTS` drives those that follow each other are taken together.

    Parameters
    ----------
    found : ManyDrives
        Result for a vehicle of a fleet.
    parameter : str
        Name of the parameter.
    """
    low, high = found.parameters[parameter].range
    i, k = list(found.parameters).index(parameter), len(found.parameters)
    shares = sorted(found.drives, key=lambda share: share.began)
    count = min(len(shares), MOST_POINTS)
    groups = [g.tolist() for g in np.array_split(np.arange(len(shares)), count)]
    c = len(shares[0].at)
    at = np.array([np.mean([shares[d].at for d in g], axis=0) for g in groups])
    information = np.array([sum(shares[d].information for d in g) for g in groups])
    gradient = np.array([sum(shares[d].gradient for d in g) for g in groups])
    information[:, i, i] = np.maximum(information[:, i, i], 1e-300)
    # every group has its own value; the others are off by the same in all groups
    rest = np.flatnonzero(np.arange(c) != i)
    prior, before = np.eye(c), BoxPrior.uniform(k)
    prior[:k, :k] = before.information
    prior = prior[np.ix_(rest, rest)]
    mean = np.append(before.mean, np.zeros(c - k))[rest]
    prior_gradient = prior @ (at.mean(axis=0)[rest] - mean)
    arrow = Arrow(information, gradient, rest, prior, prior_gradient)
    free = np.full_like(at, np.inf)
    values = (at + arrow.step(-free, free))[:, i]
    of_rest, own, sensitivity = arrow.covariances()
    sensitivity = sensitivity[:, 0]
    variances = own[:, 0, 0] + np.einsum("gi,ij,gj->g", sensitivity, of_rest, sensitivity)
    return Course(
        np.array([np.mean([shares[d].began for d in g]) for g in groups]),
        low + (high - low) * values,
        (high - low) * np.sqrt(variances),
    )
