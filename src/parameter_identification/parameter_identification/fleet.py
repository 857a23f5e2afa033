"""Identification of a fleet: each vehicle from its own drives, then their population."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from parameter_identification.drives.recorded import TopicNames
from parameter_identification.estimation.population import FEWEST, Population, population
from parameter_identification.estimation.prior import UNIFORM_VARIANCE
from parameter_identification.estimation.results import Estimate
from parameter_identification.many_drives import ManyDrives, identify_many
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import Progress
from tricycle_sim.vehicle import Vehicle


@dataclass(frozen=True, eq=False)
class Fleet:
    """Vehicles and their populations.

    Attributes
    ----------
    vehicles : mapping of str to ManyDrives
        What the drives of each vehicle alone show.
    populations : mapping of str to Population
        By parameter, of the vehicles whose drives show it; a parameter that fewer than
        `estimation.population.FEWEST` vehicles show has none.
    """

    vehicles: Mapping[str, ManyDrives]
    populations: Mapping[str, Population]

    @property
    def odd(self) -> tuple[str, ...]:
        """Vehicles that are odd in a parameter, the oddest first."""
        members = [m for found in self.populations.values() for m in found.members if m.odd]
        farthest = sorted(members, key=lambda m: -abs(m.distance))
        return tuple(dict.fromkeys(m.vehicle for m in farthest))


def identify_fleet(
    bags: Mapping[str, Sequence[Path]],
    vehicle: Vehicle,
    *,
    folder: Path,
    executor: Executor | None = None,
    leave_out: bool = False,
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
        Where the drives are kept once they are read.
    executor : concurrent.futures.Executor, optional
        As of `identify_many`.
    leave_out : bool
        Whether bags that cannot be used are left out, instead of being an error.
    topics : TopicNames, optional
        Where names differ from the suite's.
    level : float
        Probability of the intervals.
    seed : int
        Of the starts.
    progress : callable, optional
        Called with the number of vehicles done and in all.

    Raises
    ------
    IdentificationError
        If there are fewer than `FEWEST` vehicles, or a bag cannot be used.
    """
    if len(bags) < FEWEST:
        raise IdentificationError(
            f"{len(bags)} vehicles ({', '.join(bags)}) are no fleet: {FEWEST} are needed"
        )
    found = {}
    for done, (name, own) in enumerate(bags.items(), start=1):
        found[name] = identify_many(
            own,
            vehicle,
            folder=folder,
            executor=executor,
            leave_out=leave_out,
            topics=topics,
            level=level,
            seed=seed,
        )
        if progress is not None:
            progress(done, len(bags))
    populations = {}
    for parameter in vehicle.unknown:
        shown = {
            name: each.parameters[parameter]
            for name, each in found.items()
            if each.parameters[parameter].identifiable
        }
        if len(shown) >= FEWEST:
            alone = np.array([_without_range(estimate) for estimate in shown.values()])
            populations[parameter] = population(list(shown), *alone.T, level=level)
    return Fleet(found, populations)


def _without_range(e: Estimate) -> tuple[float, float]:
    """Estimate and deviation without what the range has told: it would count for every vehicle."""
    low, high = e.range
    told = 1.0 / (UNIFORM_VARIANCE * (high - low) ** 2)
    precision = 1.0 / e.standard_deviation**2 - told
    value = (e.estimate / e.standard_deviation**2 - 0.5 * (low + high) * told) / precision
    return value, precision**-0.5
