"""The cost of a vehicle's drives, evaluated through an executor, and its minimisation.

Every pass over the drives goes through an executor. Each drive is reduced to its share
(`estimation.shares`), and the shares are summed with the prior; the variables of a vehicle are
those that its drives have in common, and the rates of parameters that change in time.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from threadpoolctl import threadpool_limits

from parameter_identification.drives.kept import load_kept
from parameter_identification.estimation.quadratic import Quadratic
from parameter_identification.estimation.shares import (
    DriveShare,
    FitSetting,
    missing_inputs,
    share_of,
)
from parameter_identification.workers import Steps, each
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray

DRIVES_PER_TASK = 4  # of the executor
PASSES = 20  # over all drives, at most
TOLERANCE = 0.01  # of the cost: a step that lowers it by less is the last one
UNEXPLAINED = 0.3  # by which a step would lower the cost, of which no part does: not a minimum
LOST = 0.1  # share of drives without a minimum of their own, beyond which nothing is known
SHORTENED = 0.3  # share of a step that is tried where the step does not lower the cost


@dataclass(frozen=True, eq=False)
class Variables:
    """The n variables of a vehicle: the c common ones of its drives, then the rates of some.

    Attributes
    ----------
    low, high : ndarray of float, shape (n,)
        Bounds.
    mean : ndarray of float, shape (n,)
        Mean of the prior.
    information : ndarray of float, shape (n, n)
        Inverse covariance of the prior.
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

    @property
    def prior_covariance(self) -> FloatArray:
        """Covariance (n, n) of the prior."""
        return np.asarray(np.linalg.inv(self.information), dtype=np.float64)

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
class VehicleCost(Quadratic):
    """The cost of a vehicle's drives and its prior near a point, to the second order.

    Attributes
    ----------
    slopes : ndarray of float, shape (d, n)
        The gradient of each drive.
    shares : tuple of DriveShare
        Share of each drive in the cost, by which it was computed.
    """

    slopes: FloatArray
    shares: tuple[DriveShare, ...]


@dataclass(eq=False)
class VehicleFit:
    """The drives of one vehicle, and the state of the search for their best fit.

    Attributes
    ----------
    files : sequence of Path
        Kept drives.
    setting : FitSetting
        Vehicle, effects and noise by which the drives are fitted.
    variables : Variables
        Variables of the vehicle.
    since : ndarray of float, shape (d,)
        Time of each drive, in units of the rates.
    at : ndarray of float, shape (n,)
        The point.
    here : VehicleCost, optional
        The cost there, or close by.
    """

    files: Sequence[Path]
    setting: FitSetting
    variables: Variables
    since: FloatArray
    at: FloatArray
    here: VehicleCost | None = field(default=None)

    @property
    def quadratic(self) -> VehicleCost:
        """The cost that was evaluated last."""
        if self.here is None:
            raise ValueError("the cost was not evaluated yet")
        return self.here

    @property
    def converged(self) -> bool:
        """Whether what each drive has of its own is a minimum, but for a few of many drives."""
        lost = sum(not share.converged for share in self.quadratic.shares)
        return lost <= LOST * len(self.files)

    @property
    def fits(self) -> "tuple[VehicleFit, ...]":
        """The vehicle itself, as the only one of its descent."""
        return (self,)

    def trial(self, length: float) -> tuple[list[FloatArray], float]:
        """Return the point (n,) of the next step, and by how much it lowers the quadratic cost.

        Parameters
        ----------
        length : float
            Share of the step that is made.
        """
        low, high = self.variables.low, self.variables.high
        step = length * self.quadratic.step(low, high)
        return [np.clip(self.at + step, low, high)], self.quadratic.decrease(step)

    def total(self, costs: Sequence[VehicleCost]) -> float:
        """Return the cost that is minimised.

        Parameters
        ----------
        costs : sequence of VehicleCost
            Cost of this vehicle, as the only item.
        """
        return costs[0].cost


class Descent(Protocol):
    """Vehicles whose common cost is minimised step by step."""

    @property
    def fits(self) -> Sequence[VehicleFit]:
        """The vehicles."""
        ...

    def trial(self, length: float) -> tuple[list[FloatArray], float]:
        """Return the point (n,) of each vehicle after a step, and the decrease of the cost by it.

        Parameters
        ----------
        length : float
            Share of the step that is made.
        """
        ...

    def total(self, costs: Sequence[VehicleCost]) -> float:
        """Return the cost that is minimised.

        Parameters
        ----------
        costs : sequence of VehicleCost
            Cost of each vehicle.
        """
        ...


def drop_without_inputs(
    fits: Sequence[VehicleFit],
    files: Mapping[Path, Path],
    executor: Executor | None,
    *,
    leave_out: bool,
) -> list[str]:
    """Drop drives without an input that moves as measured in others of their vehicle; return why.

    Parameters
    ----------
    fits : sequence of VehicleFit
        The vehicles.
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
    found = each(
        executor, _missing_inputs, [(fit.setting, file) for fit in needing for file in fit.files]
    )
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


def _missing_inputs(job: tuple[FitSetting, Path]) -> str:
    setting, file = job
    return missing_inputs(setting, load_kept(file))


def evaluate(
    fits: Sequence[VehicleFit],
    points: Sequence[FloatArray],
    executor: Executor | None,
    steps: Steps,
) -> list[VehicleCost]:
    """Return the cost of vehicles near points, by one pass over all their drives.

    Parameters
    ----------
    fits : sequence of VehicleFit
        The vehicles.
    points : sequence of ndarray of float, shape (n,)
        Point of each vehicle's variables near which its cost is wanted.
    executor : concurrent.futures.Executor, optional
        Default: this process.
    steps : Steps
        Takes a step for each drive.
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
        for first in range(0, drives, DRIVES_PER_TASK):
            some = slice(first, first + DRIVES_PER_TASK)
            jobs.append((fit.setting, fit.files[some], places[some], before[some]))
    steps.expect(sum(len(fit.files) for fit in fits))

    def shares_of(evaluated: Iterator[list[DriveShare]]) -> Iterator[DriveShare]:
        for some in evaluated:
            steps.did(len(some))
            yield from some

    shares = shares_of(each(executor, _evaluate, jobs))
    return [
        _summed(s.variables, point, of_drives, list(itertools.islice(shares, len(s.files))))
        for s, point, of_drives in zip(fits, points, designs, strict=True)
    ]


def _evaluate(
    job: tuple[FitSetting, Sequence[Path], Sequence[FloatArray], Sequence[FloatArray | None]],
) -> list[DriveShare]:
    """The shares of some drives at their points; each drive's own variables start at the last."""
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
) -> VehicleCost:
    """The sum in the order of the drives, so that it is the same on every executor."""
    off = point - variables.mean
    prior_gradient = variables.information @ off
    slopes = np.array([d.T @ s.gradient for d, s in zip(of_drives, shares, strict=True)])
    information = variables.information + sum(
        d.T @ s.information @ d for d, s in zip(of_drives, shares, strict=True)
    )
    cost = float(off @ prior_gradient) + sum(share.cost for share in shares)
    return VehicleCost(
        point, cost, prior_gradient + slopes.sum(axis=0), information, slopes, tuple(shares)
    )


def descend(
    descents: Sequence[Descent],
    executor: Executor | None,
    names: Sequence[str] = (),
    *,
    steps: Steps | None = None,
) -> None:
    """Bring the vehicles of each descent to their least cost, all in the same passes.

    Parameters
    ----------
    descents : sequence of Descent
        They have no vehicle in common.
    executor : concurrent.futures.Executor, optional
        Default: this process.
    names : sequence of str
        Names of the descents, for the message.
    steps : Steps, optional
        Takes a step for each drive in each pass over them.

    Raises
    ------
    IdentificationError
        If the minimum of one is not found.
    """
    steps = steps or Steps()
    every = [fit for descent in descents for fit in descent.fits]
    costs = evaluate(every, [fit.at for fit in every], executor, steps)
    for fit, cost in zip(every, costs, strict=True):
        fit.here = cost
    lengths = dict.fromkeys(range(len(descents)), 1.0)
    for _ in range(PASSES):
        trials = {}
        for i in list(lengths):
            points, decrease = descents[i].trial(lengths[i])
            if decrease < TOLERANCE:
                if lengths[i] < 1.0 and descents[i].trial(1.0)[1] > UNEXPLAINED:
                    raise IdentificationError(
                        f"{names[i] + ': ' if names else ''}no minimum found: no step lowers the "
                        "cost, although its slope says so"
                    )
                for fit, point in zip(descents[i].fits, points, strict=True):
                    fit.at = point
                del lengths[i]
            else:
                trials[i] = points
        if not trials:
            return
        moved = [fit for i in trials for fit in descents[i].fits]
        evaluated = iter(evaluate(moved, list(itertools.chain(*trials.values())), executor, steps))
        for i, points in trials.items():
            descent, costs = descents[i], list(itertools.islice(evaluated, len(points)))
            if descent.total(costs) < descent.total([fit.quadratic for fit in descent.fits]):
                lengths[i] = 1.0
                for fit, point, cost in zip(descent.fits, points, costs, strict=True):
                    fit.at, fit.here = point, cost
            else:
                lengths[i] *= SHORTENED
    whose = f"{', '.join(names[i] for i in lengths)}: " if names else ""
    raise IdentificationError(f"{whose}no minimum after {PASSES} passes over the drives")
