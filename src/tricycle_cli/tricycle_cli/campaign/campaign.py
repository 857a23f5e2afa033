"""A campaign: plan, drive, identify, and plan again with what is known, until it is known enough.

Everything is in one folder: `campaign.json`, the state, written atomically after every step of
work; `plans/` and `bags/`, one per drive. After a kill the same call goes on where it was: a bag
that was being recorded is driven again, everything finished is kept.
"""

import dataclasses
import json
import math
import shutil
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from excitation_planner.design.criteria import Criterion
from excitation_planner.design.noise import MeasurementNoise
from excitation_planner.design.prior import BoxPrior
from excitation_planner.maneuver import ManeuverFamily
from excitation_planner.plan import Plan, load_plan, save_plan
from excitation_planner.planning import PlanRequest, plan_maneuver
from parameter_identification.drives.measured import MeasuredDrive, read_measured_drive
from parameter_identification.identification import identify
from parameter_identification.identification_file import document_of
from tricycle_core.documents import write_whole
from tricycle_core.errors import DesignError, PlanError
from tricycle_core.quantities import Progress
from tricycle_sim.vehicle import Vehicle

SCHEMA = 1
HALF_WIDTH = 1.96  # standard deviations of a 95 % interval

Drive = Callable[[Plan, Path, Progress], None]  # drives a plan, records the bag


@dataclass(frozen=True)
class CampaignRequest:
    """What is to be known, and how well.

    Attributes
    ----------
    vehicle
        With the ranges of its unknown parameters.
    families
        Maneuver families to choose from, for each drive anew.
    targets
        Unknown parameters to be known within `tolerance`.
    tolerance
        Half width of the 95 % interval, as a share of the estimate.
    most_drives
        After so many drives it ends, whatever is known.
    budget
        Simulations to plan one drive with, per family.
    seed
        Same seed, same plans from the same bags.
    noise : MeasurementNoise
        How the drives will be measured.
    true_seed
        Of the simulated vehicle's hidden parameters; None: the real vehicle.

    Raises
    ------
    PlanError
        If a target is no unknown parameter, or a number is impossible.
    """

    vehicle: Vehicle
    families: tuple[ManeuverFamily, ...]
    targets: tuple[str, ...]
    tolerance: float
    most_drives: int = 10
    budget: int = 6_000
    seed: int = 0
    noise: MeasurementNoise = MeasurementNoise()  # noqa: RUF009  (frozen)
    true_seed: int | None = None

    def __post_init__(self) -> None:
        if not self.targets or len(set(self.targets)) < len(self.targets):
            raise PlanError("targets: name each parameter once, and one at least")
        if not self.families:
            raise PlanError("a campaign needs a maneuver family")
        if not 0.0 < self.tolerance < 1.0:
            raise PlanError(f"tolerance {self.tolerance:g} must be above 0 and below 1 (100 %)")
        if self.most_drives < 1:
            raise PlanError(f"most drives {self.most_drives} must be 1 or more")
        for target in self.targets:
            self.plan_request(self.families[0], target, None, seed=0)  # checks the rest

    def plan_request(
        self, family: ManeuverFamily, target: str, prior: BoxPrior | None, *, seed: int
    ) -> PlanRequest:
        """The plan of one drive."""
        return PlanRequest(
            self.vehicle,
            family,
            target,
            criterion=Criterion.C,
            budget=self.budget,
            seed=seed,
            noise=self.noise,
            prior=prior,
        )

    def description(self) -> dict[str, Any]:
        """What must not change while a campaign goes on."""
        return {
            "vehicle": self.vehicle.name,
            "vehicle_hash": self.vehicle.fingerprint,
            "families": [family.name for family in self.families],
            "seed": self.seed,
            "noise_std": self.noise.noise_std,
            "yaw_rate_std": self.noise.yaw_rate_std,
            "drift_std": self.noise.drift_std,
            "true_seed": self.true_seed,
        }


@dataclass(frozen=True)
class Step:
    """One drive.

    Attributes
    ----------
    target
        The parameter that it was planned for.
    plan, bag
        Files, relative to the campaign's folder.
    maneuver, operation, plan_id, duration
        Of the plan; s.
    predicted_std
        Expected standard deviation of each parameter after it, in its unit.
    driven
        Whether the bag is complete.
    identification
        What is known after it (`IdentificationDocument.to_json`); None: not yet identified.
    """

    target: str
    plan: str
    bag: str
    maneuver: str
    operation: Mapping[str, float]
    plan_id: str
    duration: float
    predicted_std: Mapping[str, float]
    driven: bool = False
    identification: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Knowledge:
    """Estimate and standard deviation of a parameter, in its unit."""

    estimate: float
    std: float

    @property
    def share(self) -> float:
        """Half width of the 95 % interval, as a share of the estimate."""
        return HALF_WIDTH * self.std / abs(self.estimate) if self.estimate else math.inf


class Campaign:
    """A campaign in a folder, begun or gone on with.

    Attributes
    ----------
    steps
        Drives so far; the last one may be unfinished.

    Raises
    ------
    PlanError
        If the folder holds a campaign with other settings, or its state cannot be read.
    """

    def __init__(self, folder: Path, request: CampaignRequest) -> None:
        self.folder, self.request = folder, request
        self.steps: tuple[Step, ...] = ()
        if self._state.exists():
            self.steps = self._read()
        elif folder.exists() and any(folder.iterdir()):
            raise PlanError(f"{folder}: holds something else; give a new folder for the campaign")
        else:
            folder.mkdir(parents=True, exist_ok=True)
            self._keep(())

    @property
    def _state(self) -> Path:
        return self.folder / "campaign.json"

    def _read(self) -> tuple[Step, ...]:
        try:
            kept = json.loads(self._state.read_text(encoding="utf-8"))
            if kept["schema"] != SCHEMA:
                raise PlanError(f"{self._state}: schema {kept['schema']}; this one reads {SCHEMA}")
            settings, steps = dict(kept["settings"]), tuple(Step(**s) for s in kept["steps"])
        except (ValueError, KeyError, TypeError) as error:
            if isinstance(error, PlanError):
                raise
            raise PlanError(f"{self._state}: not the state of a campaign: {error}") from error
        wanted = self.request.description()
        different = [name for name in wanted if settings.get(name) != wanted[name]]
        if different:
            raise PlanError(
                f"{self.folder}: is a campaign with other settings (different: "
                f"{', '.join(different)}); give another folder, or the same settings to go on"
            )
        return steps

    def _keep(self, steps: tuple[Step, ...]) -> None:
        document = {
            "schema": SCHEMA,
            "settings": self.request.description(),
            "steps": [dataclasses.asdict(step) for step in steps],
        }
        write_whole(self._state, json.dumps(document, indent=1) + "\n")
        self.steps = steps

    def known(self, after: int | None = None) -> dict[str, Knowledge]:
        """What is known of each parameter after so many drives; default: all identified ones."""
        vehicle = self.request.vehicle
        found = {
            name: Knowledge(vehicle.nominal[name], (high - low) / math.sqrt(12.0))
            for name, (low, high) in vehicle.unknown.items()
        }
        for step in self.steps[:after]:
            if step.identification is not None:
                parameters = step.identification["parameters"]
                found |= {
                    name: Knowledge(entry["estimate"], entry["standard_deviation"])
                    for name, entry in parameters.items()
                }
        return found

    def missing(self) -> tuple[str, ...]:
        """Targets that are not within the tolerance yet, the worst first."""
        known, tolerance = self.known(), self.request.tolerance
        order = sorted(self.request.targets, key=lambda name: -known[name].share)
        return tuple(name for name in order if known[name].share > tolerance)

    @property
    def finished(self) -> bool:
        """Whether no drive is left to be planned, driven or identified."""
        if self.steps and self.steps[-1].identification is None:
            return False
        return not self.missing() or len(self.steps) >= self.request.most_drives

    def plan(self, progress: Callable[[str], AbstractContextManager[Progress]]) -> Plan:
        """The plan of the next drive: made now, unless the last one is not done with.

        Parameters
        ----------
        progress
            Shows the progress of what it is told, e.g. `progress_bar`.
        """
        if self.steps and self.steps[-1].identification is None:
            return load_plan(self.folder / self.steps[-1].plan)
        number, target = len(self.steps) + 1, self.missing()[0]
        plans, problems = [], []
        for family in self.request.families:
            request = self.request.plan_request(
                family, target, self._prior(), seed=self.request.seed + number
            )
            try:
                with progress(f"planning {family.name} for {target}") as report:
                    plans.append(plan_maneuver(request, progress=report))
            except DesignError as error:
                problems.append(f"{family.name}: {error}")
        if not plans:
            raise PlanError(f"no family has a maneuver for {target}: {'; '.join(problems)}")
        plan = min(plans, key=lambda plan: plan.criterion_cost)
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
        """What the drives so far have taught, in ranges."""
        if not self.steps:
            return None
        found = self.steps[-1].identification
        assert found is not None  # a plan is made after an identification
        low, high = np.array([self.request.vehicle.unknown[name] for name in found["parameters"]]).T
        estimates = np.array([entry["estimate"] for entry in found["parameters"].values()])
        covariance = np.array(found["covariance"]) / np.outer(high - low, high - low)
        return BoxPrior((estimates - low) / (high - low), 0.5 * (covariance + covariance.T))

    def drive(self, drive: Drive, progress: Progress) -> None:
        """Drive the last plan, unless its bag is complete."""
        step = self.steps[-1]
        if step.driven:
            return
        bag = self.folder / step.bag
        if bag.exists():  # what a kill has left of it
            shutil.rmtree(bag)
        bag.parent.mkdir(exist_ok=True)
        drive(load_plan(self.folder / step.plan), bag, progress)
        self._keep((*self.steps[:-1], dataclasses.replace(step, driven=True)))

    def identify(
        self, read: Callable[[Path, Vehicle], MeasuredDrive] = read_measured_drive
    ) -> dict[str, Knowledge]:
        """Identify from all bags, unless that is done; returns what is known now."""
        step = self.steps[-1]
        if step.identification is None:
            vehicle = self.request.vehicle
            drives = [read(self.folder / s.bag, vehicle) for s in self.steps]
            found = identify(drives, vehicle, seed=self.request.seed)
            identified = dataclasses.replace(step, identification=document_of(found).to_json())
            self._keep((*self.steps[:-1], identified))
        return self.known()

    def report(self, truth: Mapping[str, float] | None = None) -> dict[str, Any]:
        """The campaign so far, as JSON's types.

        Parameters
        ----------
        truth
            Hidden true values, where they are known.
        """
        known, missing = self.known(), self.missing()
        return {
            "targets": {
                name: {
                    "estimate": known[name].estimate,
                    "standard_deviation": known[name].std,
                    "half_width": known[name].share,
                    "within_tolerance": name not in missing,
                    **({"truth": truth[name]} if truth else {}),
                }
                for name in self.request.targets
            },
            "tolerance": self.request.tolerance,
            "drives": len(self.steps),
            "driving_seconds": sum(step.duration for step in self.steps if step.driven),
            "steps": [
                {
                    "target": step.target,
                    "maneuver": step.maneuver,
                    "operation": dict(step.operation),
                    "plan": step.plan,
                    "bag": step.bag,
                    "predicted_std": {
                        name: step.predicted_std[name] for name in self.request.targets
                    },
                    "known": {
                        name: dataclasses.asdict(self.known(number)[name])
                        for name in self.request.targets
                    },
                }
                for number, step in enumerate(self.steps, start=1)
            ],
        }
