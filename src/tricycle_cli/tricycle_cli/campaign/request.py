"""Request for a campaign: the parameters to be known, and how to plan and identify."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from excitation_planner.area.area import Area
from excitation_planner.design.criteria import Criterion
from excitation_planner.design.noise import MeasurementNoise
from excitation_planner.maneuver import LedInFamily, ManeuverFamily
from excitation_planner.planning import PlanRequest
from tricycle_core.errors import PlanError
from tricycle_sim.vehicle import Vehicle

if TYPE_CHECKING:
    from excitation_planner.design.prior import BoxPrior


WAY_BACK = "way_back"
"""Folder, in that of the campaign, for the bag of the way back from the last drive."""


@dataclass(frozen=True)
class Settings:
    """Settings that must stay the same throughout a campaign.

    Attributes
    ----------
    vehicle, vehicle_hash : str
        Name and hash of the vehicle file.
    families : tuple of str
        Names of the maneuver families.
    seed : int
        Seed of the plans.
    noise : MeasurementNoise
        Measurement that is planned for.
    true_seed : int, optional
        Seed of the simulated vehicle's hidden true parameters; None: the real vehicle.
    ranges : mapping of str to (float, float)
        Range of each operation parameter, by ``FAMILY.NAME``.
    area : Area, optional
        Ground that the drives stay on.
    lead_in : float, optional
        Straight before the families' own run-ins [m]; None: no lead-in.
    effects, plan_effects : tuple of str
        As in `CampaignRequest`.
    weighed : bool
        As in `CampaignRequest`.
    """

    vehicle: str
    vehicle_hash: str
    families: tuple[str, ...]
    seed: int
    noise: MeasurementNoise
    true_seed: int | None
    ranges: Mapping[str, tuple[float, float]]
    area: Area | None = None
    lead_in: float | None = None
    effects: tuple[str, ...] = ()
    weighed: bool = False
    plan_effects: tuple[str, ...] = ()


@dataclass(frozen=True)
class CampaignRequest:
    """Parameters to be known with which tolerance, and how to plan, drive and identify.

    Attributes
    ----------
    vehicle : Vehicle
        Vehicle with the ranges of its unknown parameters.
    families : tuple of ManeuverFamily
        Maneuver families to choose from, for each drive anew.
    targets : tuple of str
        Unknown parameters to be known within `tolerance`.
    tolerance : float
        Half width of the 95 % interval, as a share of the estimate.
    most_drives : int
        Number of drives after which the campaign ends in any case.
    budget : int
        Largest number of simulations of the search for a maneuver, per family.
    seed : int
        Seed; the same seed and bags give the same plans.
    noise : MeasurementNoise
        How each drive will be measured.
    true_seed : int, optional
        Seed of the simulated vehicle's hidden true parameters; None: the real vehicle.
    area : Area, optional
        Ground that the drives stay on.
    effects : tuple of str
        Effects that are estimated in addition to the parameters, from `EFFECTS`.
    weighed : bool
        Whether results are averaged over all subsets of the effects.
    plan_effects : tuple of str
        Effects that plans count as unknown, from `EFFECTS`.

    Raises
    ------
    PlanError
        If a target is not an unknown parameter, or a number is impossible.
    """

    vehicle: Vehicle
    families: tuple[ManeuverFamily, ...]
    targets: tuple[str, ...]
    tolerance: float
    most_drives: int = 10
    budget: int = 6_000
    seed: int = 0
    noise: MeasurementNoise = field(default_factory=MeasurementNoise)
    true_seed: int | None = None
    area: Area | None = None
    effects: tuple[str, ...] = ()
    weighed: bool = False
    plan_effects: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.targets or len(set(self.targets)) < len(self.targets):
            raise PlanError("targets: name each parameter once, and one at least")
        if not self.families:
            raise PlanError("a campaign needs a maneuver family")
        if not 0.0 < self.tolerance < 1.0:
            raise PlanError(
                f"tolerance {self.tolerance:g} must be above 0 and below 1; 5 % is 5% or 0.05"
            )
        if self.most_drives < 1:
            raise PlanError(f"most drives {self.most_drives} must be 1 or more")
        if self.budget < 1:
            raise PlanError(f"budget {self.budget} must be 1 or more: the simulations of a search")
        for target in self.targets:
            self.plan_request(self.families[0], target, None, seed=0)  # checks the rest

    def plan_request(
        self,
        family: ManeuverFamily,
        target: str,
        prior: BoxPrior | None,
        *,
        vehicle: Vehicle | None = None,
        seed: int,
        known_effects: Mapping[str, float] | None = None,
    ) -> PlanRequest:
        """Return the request of the plan of one drive.

        Parameters
        ----------
        family : ManeuverFamily
            Family of the maneuver.
        target : str
            Unknown parameter to excite.
        prior : BoxPrior, optional
            Knowledge from earlier drives; None: uniform on the vehicle's ranges.
        vehicle : Vehicle, optional
            Vehicle with the effects that are known; default: that of the campaign.
        seed : int
            Seed of the search.
        known_effects : mapping of str to float, optional
            Standard deviations of effects after earlier drives, in their units.
        """
        return PlanRequest(
            vehicle or self.vehicle,
            family,
            target,
            criterion=Criterion.C,
            budget=self.budget,
            seed=seed,
            noise=self.noise,
            prior=prior,
            area=self.area,
            effects=self.plan_effects,
            known_effects=known_effects or {},
        )

    def settings(self) -> Settings:
        """Return the settings that must stay the same throughout a campaign."""
        return Settings(
            vehicle=self.vehicle.name,
            vehicle_hash=self.vehicle.fingerprint,
            families=tuple(family.name for family in self.families),
            seed=self.seed,
            noise=self.noise,
            true_seed=self.true_seed,
            ranges={
                f"{family.name}.{name}": limits
                for family in self.families
                for name, limits in family.operation.bounds().items()
            },
            area=self.area,
            lead_in=next((f.length for f in self.families if isinstance(f, LedInFamily)), None),
            effects=self.effects,
            weighed=self.weighed,
            plan_effects=self.plan_effects,
        )
