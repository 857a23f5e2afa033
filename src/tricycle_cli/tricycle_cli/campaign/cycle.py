"""The cycle of a campaign: plan, drive, identify, until the targets are known well enough.

Everything is in one folder: `campaign.json`, the state; `plans/` and `bags/`, one per drive. After
a kill the same call continues: a bag that was being recorded is driven again, all else is kept.
"""

import dataclasses
import fcntl
import os
import shutil
import weakref
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from excitation_planner.design.prior import UNIFORM_STD, BoxPrior
from excitation_planner.plan import Plan, load_plan, save_plan
from excitation_planner.planning import plan_maneuver, planned_for
from parameter_identification.drives.measured import MeasuredDrive
from parameter_identification.drives.measured_from_bag import read_measured_drive
from parameter_identification.drives.recorded import TopicNames
from parameter_identification.estimation.intervals import relative_half_width
from parameter_identification.estimation.prior import box_prior
from parameter_identification.identification import identify
from parameter_identification.identification_file import (
    IdentificationDocument,
    document_of,
    save_identification_file,
)
from tricycle_cli.campaign.request import CampaignRequest
from tricycle_cli.campaign.state_file import CampaignState, Step
from tricycle_cli.operation.enough import Enough
from tricycle_cli.operation.session import DrivePlan
from tricycle_core.documents import check_folder, encode
from tricycle_core.errors import DesignError, ExcitationError, PlanError
from tricycle_core.quantities import Progress
from tricycle_sim.effects import corrected, option_of
from tricycle_sim.vehicle import Vehicle

LOCK = "lock"
"""File in the folder of a campaign, locked by the process that is at work there."""


@dataclass(frozen=True)
class Knowledge:
    """Estimate of a parameter and its standard deviation, in its unit.

    Attributes
    ----------
    estimate : float
        Estimated value.
    std : float
        Standard deviation of the estimate.
    """

    estimate: float
    std: float

    @property
    def share(self) -> float:
        """Half width of the 95 % interval, as a share of the estimate."""
        return relative_half_width(self.estimate, self.std)


class Campaign:
    """A campaign in a folder, begun or continued.

    Parameters
    ----------
    folder : Path
        New, or that of an earlier campaign with the same settings.
    request : CampaignRequest
        Parameters to be known, and how to plan and identify.

    Attributes
    ----------
    steps : tuple of Step
        Drives so far; the last one may be unfinished.
    left_out : tuple of str
        Families that had no maneuver for the last plan, with the reason.
    topics : TopicNames
        Names by which the bags are read.

    Raises
    ------
    PlanError
        If the folder holds a campaign with other settings, its state cannot be read, or another
        process is at work in it.
    """

    def __init__(self, folder: Path, request: CampaignRequest) -> None:
        self.folder, self.request = folder, request
        self.steps: tuple[Step, ...] = ()
        self.left_out: tuple[str, ...] = ()
        self.topics = TopicNames()
        if not self._state.exists():
            check_folder(folder)
            if folder.exists() and any(file.name != LOCK for file in folder.iterdir()):
                raise PlanError(
                    f"{folder}: holds something else; give a new folder for the campaign"
                )
            folder.mkdir(parents=True, exist_ok=True)
        self._lock()
        if self._state.exists():
            self.steps = self._read()
            self._drop_unneeded()
        else:
            self._keep(())

    def _lock(self) -> None:
        """Keep other campaigns out of the folder as long as this object lives."""
        lock = os.open(self.folder / LOCK, os.O_WRONLY | os.O_CREAT, 0o666)
        weakref.finalize(self, os.close, lock)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise PlanError(
                f"{self.folder}: another campaign is at work in this folder; wait for its end, or "
                "give another folder"
            ) from None

    @property
    def _state(self) -> Path:
        return self.folder / "campaign.json"

    def _read(self) -> tuple[Step, ...]:
        state = CampaignState.read(self._state)
        wanted, kept = map(encode, (self.request.settings(), state.settings))
        for values in (wanted, kept):
            values |= values.pop("noise")
        different = [name for name in wanted if kept[name] != wanted[name]]
        if different:
            raise PlanError(
                f"{self.folder}: is a campaign with other settings (different: "
                f"{', '.join(different)}); give another folder, or the same settings to go on"
            )
        unknown = set(self.request.vehicle.unknown)
        for step in state.steps:
            found = step.identification
            parameters = unknown if found is None else found.parameters.keys()
            if not (step.predicted_std.keys() >= {*self.request.targets} and parameters <= unknown):
                raise PlanError(
                    f"{self._state}: drive {step.bag}: needs predicted_std of every target, and "
                    f"estimates of parameters of {self.request.vehicle.name} only"
                )
        self.topics = state.topics
        return state.steps

    def _keep(self, steps: tuple[Step, ...]) -> None:
        CampaignState(self.request.settings(), steps, self.topics).write(self._state)
        self.steps = steps

    def _drop_unneeded(self) -> None:
        """Delete a plan that was not driven and is no longer needed, with its recording."""
        step = self.steps[-1] if self.steps else None
        if step is None or step.driven or step.identification is not None:
            return
        request = self.request
        within = step.target in request.targets and len(self.steps) <= request.most_drives
        if within and self.missing():
            return
        self._keep(self.steps[:-1])
        (self.folder / step.plan).unlink(missing_ok=True)
        if (bag := self.folder / step.bag).exists():
            shutil.rmtree(bag)

    def read_by(self, topics: TopicNames) -> None:
        """Read the bags by these names from now on, also when the campaign is opened again.

        Parameters
        ----------
        topics : TopicNames
            Names in the bags.
        """
        if topics != self.topics:
            self.topics = topics
            self._keep(self.steps)

    def known(self, after: int | None = None) -> dict[str, Knowledge]:
        """Return what is known of each parameter.

        Parameters
        ----------
        after : int, optional
            Number of drives; default: all identified ones.
        """
        vehicle = self.request.vehicle
        found = {
            name: Knowledge(vehicle.nominal[name], UNIFORM_STD * (high - low))
            for name, (low, high) in vehicle.unknown.items()
        }
        for step in self.steps[:after]:
            if step.identification is not None:
                found |= {
                    name: Knowledge(entry.estimate, entry.standard_deviation)
                    for name, entry in step.identification.parameters.items()
                    if entry.standard_deviation is not None
                }
        return found

    def missing(self) -> tuple[str, ...]:
        """Return the targets that are not within the tolerance yet, the worst first."""
        known, tolerance = self.known(), self.request.tolerance
        order = sorted(self.request.targets, key=lambda name: -known[name].share)
        return tuple(name for name in order if known[name].share > tolerance)

    @property
    def finished(self) -> bool:
        """Whether no drive is left to be planned, driven or identified."""
        if self.steps and self.steps[-1].identification is None:
            return False
        return not self.missing() or len(self.steps) >= self.request.most_drives

    @property
    def driven(self) -> bool:
        """Whether the last drive is recorded to its end, but not identified."""
        step = self.steps[-1] if self.steps else None
        return (
            step is not None
            and step.identification is None
            and step.driven
            and (self.folder / step.bag).exists()
        )

    def plan(self, progress: Callable[[str], AbstractContextManager[Progress]]) -> Plan:
        """Return the plan of the next drive; it is made unless that of the last one is still open.

        Parameters
        ----------
        progress : callable
            Shows the progress of the work described by its argument, e.g. `progress_bar`.

        Raises
        ------
        PlanError
            If no family has a maneuver for the target, or the bag of an earlier drive is missing.
        """
        bags = [self.folder / step.bag for step in self.steps if step.identification is not None]
        if missing := [str(bag) for bag in bags if not bag.exists()]:
            raise PlanError(
                f"{', '.join(missing)}: missing, and all bags are identified from: put it back, or "
                "begin a campaign in a new folder"
            )
        if self.steps and self.steps[-1].identification is None:
            return load_plan(self.folder / self.steps[-1].plan)
        number, target = len(self.steps) + 1, self.missing()[0]
        plans, problems = [], []
        vehicle = self._found_vehicle()
        for family in self.request.families:
            request = self.request.plan_request(
                family,
                target,
                self._prior(),
                vehicle=vehicle,
                seed=self.request.seed + number,
                known_effects=self._known_effects(),
            )
            try:
                with progress(f"planning {family.name} for {target}") as report:
                    plans.append(plan_maneuver(request, progress=report))
            except (DesignError, PlanError) as error:
                problems.append(f"{family.name}: {error}")
        if not plans:
            raise PlanError(f"no family has a maneuver for {target}: {'; '.join(problems)}")
        self.left_out = tuple(problems)
        plan = min(plans, key=lambda plan: plan.criterion_cost)
        plan = planned_for(plan, self.request.vehicle)
        step = Step(
            target=target,
            plan=f"plans/{number:02d}.json",
            bag=f"bags/{number:02d}",
            maneuver=plan.maneuver,
            operation=dict(plan.operation),
            plan_id=plan.id,
            duration=plan.commands.duration,
            predicted_std=dict(plan.predicted_std),
        )
        save_plan(plan, self.folder / step.plan)
        self._keep((*self.steps, step))
        return plan

    def _prior(self) -> BoxPrior | None:
        """The Gaussian prior of the next plan, in ranges; None before the first drive."""
        if not self.steps:
            return None
        found = self.steps[-1].identification
        if found is None:
            raise PlanError("a campaign plans after the identification of the last drive")
        return box_prior(self.request.vehicle, found.posterior())

    @property
    def _found(self) -> IdentificationDocument | None:
        """Identification from all drives so far; None before the first one."""
        return self.steps[-1].identification if self.steps else None

    def _found_vehicle(self) -> Vehicle:
        """The vehicle as all drives so far have shown it, with its effects."""
        vehicle, found = self.request.vehicle, self._found
        if found is None:
            return vehicle
        nominal = {name: entry.estimate for name, entry in found.parameters.items()}
        effects = {e.name: e.estimate for e in found.effects if not e.drive}
        return corrected(vehicle.replace(**nominal), effects)[0]

    def _known_effects(self) -> dict[str, float]:
        """Standard deviations of what all drives have in common beside the parameters."""
        effects = self._found.effects if self._found is not None else ()
        return {
            option_of(e.name): e.standard_deviation
            for e in effects
            if not e.drive and e.standard_deviation > 0.0
        }

    def drive(self, drive: DrivePlan, progress: Progress, *, stop_early: bool = False) -> None:
        """Drive the last plan, unless that was done and its bag is there.

        Parameters
        ----------
        drive : DrivePlan
            Drives a plan and records the bag.
        progress : callable
            Called with the time driven and the duration [ms].
        stop_early : bool
            Whether the drive ends as soon as every target is within the tolerance, as far as is
            seen while it drives.
        """
        step = self.steps[-1]
        if self.driven:
            return
        if step.driven:  # its bag was moved away
            step = dataclasses.replace(step, driven=False)
            self._keep((*self.steps[:-1], step))
        bag = self.folder / step.bag
        if bag.exists():  # what a kill has left of it
            shutil.rmtree(bag)
        bag.parent.mkdir(exist_ok=True)
        plan = self.folder / step.plan
        drive(load_plan(plan), bag, progress, self._enough(plan) if stop_early else None)
        self._keep((*self.steps[:-1], dataclasses.replace(step, driven=True)))

    def _enough(self, plan: Path) -> Enough:
        """Return when the last drive has taught enough, after what those before it did."""
        known = self.folder / "known.json" if len(self.steps) > 1 else None
        if known is not None and (found := self.steps[-2].identification) is not None:
            save_identification_file(found, known)
        return Enough(plan, known, self.request.targets, self.request.tolerance)

    def identify(
        self,
        read: Callable[[Path, Vehicle], MeasuredDrive] | None = None,
        progress: Progress | None = None,
    ) -> dict[str, Knowledge]:
        """Identify from all bags, unless that is done, and return the knowledge of the parameters.

        Parameters
        ----------
        read : callable, optional
            Reads the drive of a bag for a vehicle; default: `read_measured_drive`, by `topics`.
        progress : callable, optional
            Progress callback, as in `parameter_identification.identification.identify`.

        Raises
        ------
        PlanError
            If the bag of the last drive holds no usable drive, or it determines nothing; the bag is
            kept.
        """
        step = self.steps[-1]
        read = read or partial(read_measured_drive, topics=self.topics)
        if step.identification is None:
            vehicle = self.request.vehicle
            drives = [read(self.folder / s.bag, vehicle) for s in self.steps[:-1]]
            request = self.request
            try:  # those before it were identified from, so it is the last one that cannot be used
                drives.append(read(self.folder / step.bag, vehicle))
                identification = identify(
                    drives,
                    vehicle,
                    effects=request.effects,
                    weighed=request.weighed,
                    other_vehicle=True,  # plans count on the effects of the drives before
                    seed=request.seed,
                    progress=progress,
                )
            except ExcitationError as error:
                bag = self.folder / step.bag
                raise PlanError(
                    f"{error}; the bag is kept: give the same command again, where needed with the "
                    f"names of its topics (--pose ...); or move {bag} away, and it is driven again"
                ) from error
            identified = dataclasses.replace(
                step,
                identification=document_of(identification),
                duration=drives[-1].commands.duration,  # it may have ended early
            )
            self._keep((*self.steps[:-1], identified))
        return self.known()
