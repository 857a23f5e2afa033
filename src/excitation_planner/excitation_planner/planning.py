"""From a vehicle, a family and a target to a plan."""

import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from excitation_planner.criteria import excitation_cost
from excitation_planner.design import InfeasibleManeuver, Verdict, design_excitation
from excitation_planner.maneuver import ManeuverFamily, PlanError
from excitation_planner.plan import Index, Plan, SearchHistory
from excitation_planner.replay import ReplayedTrajectoryError
from excitation_planner.sensitivity import Sensitivity, sensitivity
from tricycle_sim.vehicle import Vehicle

Floats = NDArray[np.float64]
Report = Callable[[int, int], None]

RANDOM_TRIES = 1000  # draws after which a family has no drivable maneuver


@dataclass(frozen=True)
class PlanRequest:
    """What is to be planned.

    Attributes
    ----------
    vehicle
        Nominal vehicle with the ranges of its unknown parameters.
    family
        Maneuver family, with its settings and operation box.
    target
        Unknown parameter to excite.
    samples
        Simulations per maneuver during the search.
    budget
        Largest number of simulations in all.
    seed
        Same seed, same plan.
    noise_std
        Standard deviation of the measured position per axis, m; 0 is the paper's cost.

    Raises
    ------
    PlanError
        If the target is not one of the vehicle's unknown parameters.
    """

    vehicle: Vehicle
    family: ManeuverFamily
    target: str
    samples: int = 100
    budget: int = 12_000
    seed: int = 0
    noise_std: float = 0.01

    def __post_init__(self) -> None:
        if self.target not in self.vehicle.unknown:
            raise PlanError(
                f"unknown target {self.target!r}; the unknown parameters of "
                f"{self.vehicle.name} are: {', '.join(self.vehicle.unknown)}"
            )
        if not 0.0 <= self.noise_std < 10.0:
            raise PlanError(f"noise_std = {self.noise_std:g} m must be from 0 to 10")

    def simulator(self) -> ReplayedTrajectoryError:
        """TE of this vehicle and family as a function of x and p."""
        return ReplayedTrajectoryError(self.vehicle, self.family)

    def noise_variance(self, te: Floats) -> float:
        """Variance of a measured TE, m^4, when the position noise is a constant offset.

        The worst case of slow noise of standard deviation sigma per axis:
        `4 sigma^2 (E[TE] + sigma^2)`, which bounds the mean deviation by its rms.

        Parameters
        ----------
        te
            (n,) TE of the samples, m^2.
        """
        return float(4.0 * self.noise_std**2 * (np.nanmean(te) + self.noise_std**2))


def plan_maneuver(
    request: PlanRequest, *, executor: Executor | None = None, progress: Report | None = None
) -> Plan:
    """Search the family for the maneuver that excites the target best.

    Parameters
    ----------
    request
        What is to be planned.
    executor
        Where simulations run; processes of this machine by default.
    progress
        Called with (simulations so far, budget).

    Returns
    -------
    plan
        The verified optimum. Its `verdict` says so when the family cannot excite the target.

    Raises
    ------
    PlanError, DesignError
        If the request cannot be met.
    """
    began = time.monotonic()
    design = design_excitation(
        request.simulator(),
        request.family.operation,
        dict(request.vehicle.unknown),
        request.target,
        noise_variance=request.noise_variance,
        samples=request.samples,
        budget=request.budget,
        seed=request.seed,
        executor=executor,
        progress=progress,
    )
    return _plan(
        request,
        design.x,
        design.sensitivity,
        cost=design.cost,
        predicted_cost=design.predicted_cost,
        simulations=design.simulations,
        verdict="" if design.verdict is Verdict.EXCITES else design.explanation,
        began=began,
        search=SearchHistory(
            np.array([tried.x for tried in design.history]),
            np.array([tried.cost for tried in design.history]),
        ),
    )


def plan_at(request: PlanRequest, x: Floats) -> Plan:
    """Plan the maneuver with operation parameters x (l,), as it is.

    Raises
    ------
    PlanError
        If the nominal vehicle cannot drive it.
    """
    began = time.monotonic()
    simulate = request.simulator()
    outputs: list[Floats] = []

    def simulate_and_keep(parameters: Floats) -> Floats:
        outputs.append(simulate(x, parameters))
        return outputs[-1]

    try:
        result = sensitivity(
            simulate_and_keep,
            dict(request.vehicle.unknown),
            samples=request.samples,
            seed=request.seed,
        )
    except InfeasibleManeuver as error:
        raise PlanError(f"{request.family.name}: {error}") from error
    return _plan(
        request,
        x,
        result,
        cost=excitation_cost(
            result.main,
            result.total,
            result.names.index(request.target),
            noise_share=request.noise_variance(np.concatenate(outputs)) / result.variance,
        ),
        predicted_cost=None,
        simulations=result.simulations,
        verdict="",
        began=began,
    )


def random_feasible_point(request: PlanRequest, rng: np.random.Generator) -> Floats:
    """Draw operation parameters (l,), uniform over what the nominal vehicle can drive.

    Raises
    ------
    PlanError
        If no draw can be driven.
    """
    simulate = request.simulator()
    box = request.family.operation
    for _ in range(RANDOM_TRIES):
        x = box.from_unit(rng.random(len(box)))
        try:
            simulate.nominal(x)
        except InfeasibleManeuver:
            continue
        return x
    raise PlanError(f"{request.family.name}: none of {RANDOM_TRIES} random maneuvers is drivable")


def _plan(
    request: PlanRequest,
    x: Floats,
    result: Sensitivity,
    *,
    cost: float,
    predicted_cost: float | None,
    simulations: int,
    verdict: str,
    began: float,
    search: SearchHistory | None = None,
) -> Plan:
    run = request.simulator().nominal(x)
    vehicle, family = request.vehicle, request.family

    def indices(values: Floats, intervals: Floats) -> dict[str, Index]:
        return {
            name: Index(float(value), float(low), float(high))
            for name, value, (low, high) in zip(result.names, values, intervals, strict=True)
        }

    return Plan(
        maneuver=family.name,
        operation=dict(zip(family.operation.names, (float(v) for v in x), strict=True)),
        target=request.target,
        unknown=dict(vehicle.unknown),
        main=indices(result.main, result.main_interval),
        total=indices(result.total, result.total_interval),
        variance=float(result.variance),
        cost=cost,
        predicted_cost=predicted_cost,
        leave_one_out_q2=float(result.leave_one_out_q2),
        simulations=simulations,
        seconds=time.monotonic() - began,
        seed=request.seed,
        noise_std=request.noise_std,
        feasible=True,
        verdict=verdict,
        vehicle=vehicle.name,
        vehicle_hash=vehicle.file_hash,
        tyre_radius=vehicle.tyre_radius,
        software=version("tricycle-excitation"),
        commands=run.commands,
        path=run.path,
        reference=run.reference,
        search=search,
    )
