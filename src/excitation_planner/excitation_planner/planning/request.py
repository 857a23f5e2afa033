"""The request of a plan: data without computation, which command line and node read quickly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from excitation_planner.box import Box
from excitation_planner.design.criteria import Criterion
from excitation_planner.design.noise import MeasurementNoise
from excitation_planner.design.prior import BoxPrior, NuisanceParameters
from excitation_planner.design.problem import DRAWS, DesignProblem, Search
from excitation_planner.maneuver import ManeuverFamily
from excitation_planner.planning.shaping import check_motor
from tricycle_core.errors import PlanError
from tricycle_sim.effects import check_effects, effects_of
from tricycle_sim.vehicle import Vehicle

if TYPE_CHECKING:
    from excitation_planner.area.area import Area

LEAST_DRAWS = 6
"""Vehicles over which a criterion is averaged, however many effects each is simulated with."""


@dataclass(frozen=True)
class PlanRequest:
    """Vehicle, maneuver family, target and settings of a plan.

    Attributes
    ----------
    vehicle : Vehicle
        Nominal vehicle with the ranges of its unknown parameters.
    family : ManeuverFamily
        Maneuver family, with its settings and operation box.
    target : str
        Unknown parameter to excite; the criteria D and A count all of them.
    criterion : Criterion
        Criterion that is minimised; H is the paper's.
    others : tuple of ManeuverFamily
        Families of the maneuvers driven after the first, designed as one set with it.
    samples : int
        For H: number of simulations per maneuver during the search.
    budget : int
        Largest number of simulations of the search. To judge and to predict what it has found takes
        a few hundred more.
    seed : int
        Seed; the same seed gives the same plan.
    noise : MeasurementNoise
        How the drive will be measured.
    prior : BoxPrior, optional
        Knowledge from earlier drives; None: uniform on the vehicle's ranges.
    search : Search
        How the operation box is searched.
    area : Area, optional
        Ground that all vehicles of the ranges stay on, with a margin.
    effects : tuple of str
        Names from `tricycle_sim.effects.EFFECTS`: errors of the vehicle file that the criteria C, D
        and A and the predicted deviations count.
    known_effects : mapping of str to float
        Standard deviations of some effects after earlier drives, in the effects' units.

    Raises
    ------
    PlanError
        If the target is not one of the vehicle's unknown parameters, or the criterion cannot judge
        this request.
    """

    vehicle: Vehicle
    family: ManeuverFamily
    target: str
    criterion: Criterion = Criterion.H
    others: tuple[ManeuverFamily, ...] = ()
    samples: int = 100
    budget: int = 12_000
    seed: int = 0
    noise: MeasurementNoise = MeasurementNoise()  # noqa: RUF009  (frozen)
    prior: BoxPrior | None = None
    search: Search = Search.ADAPTIVE
    area: Area | None = None
    effects: tuple[str, ...] = ()
    known_effects: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_motor(self.vehicle)
        if self.target not in self.vehicle.unknown:
            raise PlanError(
                f"unknown target {self.target!r}; the unknown parameters of "
                f"{self.vehicle.name} are: {', '.join(self.vehicle.unknown)}"
            )
        check_effects(self.effects)
        if self.criterion is Criterion.H:
            if self.effects:
                raise PlanError("criterion h counts no effects; c, d and a do")
            if self.others:
                raise PlanError("criterion h judges one maneuver; a set needs c, d or a")
        elif self.noise.noise_std == 0.0:
            raise PlanError(f"criterion {self.criterion} needs noise_std above 0; h does without")

    @property
    def families(self) -> tuple[ManeuverFamily, ...]:
        """Families of the maneuvers, in the order in which they are driven."""
        return (self.family, *self.others)

    @property
    def draws(self) -> int:
        """Vehicles over which the criteria C, D and A are averaged.

        As many simulations of a maneuver as without effects, but a few vehicles at least.
        """
        alone = len(self.vehicle.unknown) + 1
        return max(LEAST_DRAWS, DRAWS * alone // (alone + self._effects))

    @property
    def _effects(self) -> int:
        return sum(not effect.process for effect in effects_of(self.vehicle, self.effects))

    def check_budget(self) -> None:
        """Raise if the budget pays for no search: planning says so only when all is loaded.

        Raises
        ------
        DesignError
            If it is too small for one maneuver and the verification.
        """
        DesignProblem(
            operation=self.family.operation,
            unknown=Box.of(dict(self.vehicle.unknown)),
            target=self.target,
            criterion=self.criterion,
            noise_variance=self.noise.of_trajectory_error,
            trajectory_noise=self.noise.of_trajectory,
            samples=self.samples,
            draws=self.draws,
            budget=self.budget,
            seed=self.seed,
            search=self.search,
            nuisances=NuisanceParameters((1.0,) * self._effects),
        )
