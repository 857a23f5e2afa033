"""The planner: searches maneuver families, and makes the plans of the maneuvers that it finds."""

import dataclasses
import time
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, Self

import numpy as np

from excitation_planner.area.polygons import rings_of
from excitation_planner.area.room import DoesNotFit, Room
from excitation_planner.area.tube import VEHICLES, crawl_curvature, footprint_of
from excitation_planner.box import Box
from excitation_planner.design.combinations import best_combinations
from excitation_planner.design.criteria import Criterion, excitation_cost
from excitation_planner.design.excitation import Design, Verdict, design_excitation
from excitation_planner.design.information import ManeuverSet, information_costs
from excitation_planner.design.problem import VERIFICATION, VERIFIED, Search
from excitation_planner.indices.sensitivity import Sensitivity, sensitivity
from excitation_planner.indices.threads import THREADPOOLS
from excitation_planner.maneuver import LedInFamily, ManeuverFamily, lead_in_of
from excitation_planner.plan import Index, Plan, SearchHistory
from excitation_planner.planning.fitting import FittingSearch
from excitation_planner.planning.prediction import (
    PREDICTION_DRAWS,
    ReplayedTrajectories,
    nuisance_parameters,
    planned_effects,
    predicted_covariance,
)
from excitation_planner.planning.remedy import closest_fit, nearest_that_fits
from excitation_planner.planning.replay import (
    ReplayedTrajectoryError,
    nominal_commands,
    nominal_run,
    replayed_errors,
)
from excitation_planner.planning.request import PlanRequest
from excitation_planner.planning.shaping import laws_of, shaping_constants
from tricycle_core import __version__
from tricycle_core.cores import usable_cores
from tricycle_core.errors import DesignError, InfeasibleManeuver, PlanError
from tricycle_core.quantities import FloatArray, Progress
from tricycle_sim.commands import Commands
from tricycle_sim.effects import Effect
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.layout import LANES

FITTING = 0.75
"""Share of a search's simulations that goes into finding maneuvers that fit an area."""

SIDE_BY_SIDE = 4
"""Threads at least: the maneuvers that the search asks for at a time share the cores evenly."""

KEPT_LOAD = 0.03
"""Least load of every wheel in what is searched on an area, as a share of the mean wheel load.

So a mirror image that the vehicle drives a little differently lifts no wheel either.
"""

ROOM_RUNS = LANES + 1 + VEHICLES
"""Simulations by which it is found whether a maneuver fits."""

RANDOM_TRIES = 1000
"""Draws after which a family has no drivable maneuver."""


@dataclass(frozen=True)
class _Maneuver:
    """Operation parameters (l,), the Sobol' indices of TE there, and H of the target."""

    x: FloatArray
    sensitivity: Sensitivity
    cost: float


def plan_maneuver(
    request: PlanRequest, *, executor: Executor | None = None, progress: Progress | None = None
) -> Plan:
    """Return the plan of the family's best maneuver: `plan_set` of a single one.

    Parameters
    ----------
    request : PlanRequest
        Vehicle, family, target and further settings of the plan.
    executor : Executor, optional
        Executor that runs the simulations; threads of this process by default.
    progress : callable, optional
        Called with (simulations of the search so far, budget).
    """
    (plan,) = plan_set(request, executor=executor, progress=progress)
    return plan


def plan_set(
    request: PlanRequest, *, executor: Executor | None = None, progress: Progress | None = None
) -> tuple[Plan, ...]:
    """Return the plans of the maneuvers that are best by the criterion, driven as one set.

    Parameters
    ----------
    request : PlanRequest
        Vehicle, family, target and further settings of the plan.
    executor : Executor, optional
        Executor that runs the simulations; threads of this process by default.
    progress : callable, optional
        Called with (simulations of the search so far, budget).

    Returns
    -------
    plans : tuple of Plan
        The verified optimum, a plan per maneuver. `verdict` is not empty where the families cannot
        excite the target.

    Raises
    ------
    PlanError, DesignError
        If the request cannot be met.
    """
    began = time.monotonic()
    # threads: compiled code does not hold the interpreter, and processes take seconds to start; one
    # BLAS thread each, also beside the search
    threads = ThreadPoolExecutor(max(SIDE_BY_SIDE, usable_cores()))
    with THREADPOOLS.limit(limits=1), threads:
        try:
            design, points, tried = _searched(request, executor or threads, progress)
            covariance = threads.submit(_predicted_covariance, request, points)
            if request.criterion is Criterion.H:
                judged = [_Maneuver(design.x, design.sensitivity, design.cost)]
            else:
                # samples that the search has not seen, three times as many: as H is verified
                fresh = dataclasses.replace(
                    request, samples=3 * request.samples, seed=request.seed + 1
                )
                judged = list(threads.map(partial(_judge, fresh), request.families, points))
        except DesignError as error:
            if (room := _room(request)) is None:
                raise
            remedies = (closest_fit(request.vehicle, family, room) for family in request.families)
            reasons = filter(None, dict.fromkeys([str(error), *remedies]))
            raise PlanError("; ".join(reasons)) from error
        return _plans(request, judged, covariance.result(), design, began, tried)


def _searched(
    request: PlanRequest, executor: Executor, progress: Progress | None
) -> tuple[Design, list[FloatArray], SearchHistory]:
    """The design, the operation parameters (l,) of each maneuver, and what was tried on the way."""
    if request.criterion is Criterion.H:
        design = _searched_by_indices(request, executor, progress)
        return design, [design.x], _history(design)
    operations = tuple(family.operation for family in request.families)
    room, runs = _room(request, KEPT_LOAD), _Runs.of(request)
    maneuvers = ManeuverSet(_trajectories(request, room), operations)
    begin = _Beginning(request.budget)
    if request.search is Search.ADAPTIVE and request.others:
        begin = _best_combinations(request, maneuvers, runs)
    elif request.search is Search.ADAPTIVE and room is not None:
        begin = _best_on_area(request, room, runs, progress)
        if begin.starts is not None and len(begin.starts):  # they fit; nothing else is evaluated
            maneuvers = ManeuverSet(_trajectories(request, None), operations)

    def report(done: int, _: int) -> None:
        if progress is not None:
            progress(begin.taken + done, request.budget)

    design = design_excitation(
        maneuvers,
        maneuvers.operation,
        request.vehicle.unknown,
        request.target,
        criterion=request.criterion,
        trajectory_noise=request.noise.of_trajectory,
        prior=request.prior,
        nuisances=nuisance_parameters(_effects(request)),
        draws=runs.draws,
        samples=request.samples,
        budget=begin.budget,
        seed=request.seed,
        search=request.search,
        starts=begin.starts,
        executor=executor,
        progress=report,
    )
    design = dataclasses.replace(design, simulations=design.simulations + begin.taken)
    tried = _history(design)
    if begin.tried is not None:
        tried = SearchHistory(
            np.vstack([begin.tried.x, tried.x]), np.append(begin.tried.cost, tried.cost)
        )
    return design, maneuvers.split(design.x), tried


@dataclass(frozen=True)
class _Runs:
    """Simulations of a maneuver in a search by C, D or A, of `draws` vehicles, and to verify it."""

    draws: int
    maneuver: int
    verification: int

    @classmethod
    def of(cls, request: PlanRequest) -> Self:
        runs = request.draws * (len(request.vehicle.unknown) + 1 + len(_effects(request)))
        return cls(request.draws, runs, VERIFIED * (VERIFICATION * (runs + request.samples) + 1))


@dataclass(frozen=True)
class _Beginning:
    """Where a search begins: the budget that is left for it, and what was found out before.

    Starts (s, l) in the unit box; None: the search's own. `taken` simulations have found them.
    """

    budget: int
    starts: FloatArray | None = None
    taken: int = 0
    tried: SearchHistory | None = None


def _best_combinations(request: PlanRequest, maneuvers: ManeuverSet, runs: _Runs) -> _Beginning:
    """Begin a set of maneuvers with the best combinations of single ones."""
    unknown = Box.of(request.vehicle.unknown)
    starts, simulations = best_combinations(
        maneuvers,
        unknown,
        request.noise.of_trajectory,
        request.criterion,
        unknown.index(request.target),
        draws=runs.draws,
        seed=request.seed,
        prior=request.prior,
        nuisances=nuisance_parameters(_effects(request)),
    )
    taken = simulations // len(request.families)  # a run of the set is one of each maneuver
    needed = runs.maneuver + runs.verification
    if request.budget - taken < needed:
        raise PlanError(
            f"budget = {request.budget} is too small: starts, an evaluation and the "
            f"verification take {taken + needed} runs"
        )
    return _Beginning(request.budget - taken, starts, taken)


def _best_on_area(
    request: PlanRequest, room: Room, runs: _Runs, progress: Progress | None
) -> _Beginning:
    """Begin with the best maneuvers that fit an area; on a small budget, none are looked for."""
    spare, with_room = request.budget - runs.verification, runs.maneuver + ROOM_RUNS
    if spare < 2 * with_room:
        return _Beginning(request.budget)

    def report(done: int, _: int) -> None:
        if progress is not None:
            progress(done, request.budget)

    target = list(request.vehicle.unknown).index(request.target)
    fitting = FittingSearch(
        *(request.vehicle, request.family, room, request.criterion, target),
        *(request.noise, request.prior, _effects(request), request.seed),
    )
    starts = fitting.starts(round(FITTING * spare), progress=report)
    maneuvers = len(starts)
    if not maneuvers:  # the search looks for the room of each maneuver then
        maneuvers = max(1, (spare - fitting.simulations) // with_room)
    budget = runs.verification + maneuvers * runs.maneuver
    return _Beginning(budget, starts, fitting.simulations, SearchHistory(*fitting.history()))


def _searched_by_indices(
    request: PlanRequest, executor: Executor, progress: Progress | None
) -> Design:
    """The design by the criterion H: that of one maneuver."""
    return design_excitation(
        ReplayedTrajectoryError(request.vehicle, request.family, _room(request, KEPT_LOAD)),
        request.family.operation,
        request.vehicle.unknown,
        request.target,
        noise_variance=request.noise.of_trajectory_error,
        samples=request.samples,
        budget=request.budget,
        seed=request.seed,
        search=request.search,
        executor=executor,
        progress=progress,
    )


def _history(design: Design) -> SearchHistory:
    return SearchHistory(
        np.array([evaluation.x for evaluation in design.history]),
        np.array([evaluation.cost for evaluation in design.history]),
    )


def _room(request: PlanRequest, kept_load: float = 0.0) -> Room | None:
    if request.area is None:
        return None
    footprint, position_std = footprint_of(request.vehicle), request.noise.position_std
    return Room(request.area, footprint, position_std, kept_load)


def plan_at(request: PlanRequest, x: FloatArray) -> Plan:
    """Return the plan of a given maneuver.

    Parameters
    ----------
    request : PlanRequest
        Settings of the plan; nothing is searched.
    x : ndarray of float, shape (l,)
        Operation parameters.

    Raises
    ------
    PlanError
        If the nominal vehicle cannot drive it.
    """
    began = time.monotonic()
    try:
        nominal_commands(request.vehicle, request.family, x, _room(request))
        judged = _judge(request, request.family, x)
    except InfeasibleManeuver as error:
        reason = str(error)
        if isinstance(error, DoesNotFit) and (room := _room(request)) is not None:
            reason = nearest_that_fits(request.vehicle, request.family, room, x)
        raise PlanError(f"{request.family.name}: {reason}") from error
    request = dataclasses.replace(request, others=())
    (plan,) = _plans(request, [judged], _predicted_covariance(request, [x]), None, began)
    return plan


def random_feasible_point(request: PlanRequest, rng: np.random.Generator) -> FloatArray:
    """Return random operation parameters (l,), uniform over what the nominal vehicle can drive.

    Parameters
    ----------
    request : PlanRequest
        Has vehicle and family.
    rng : numpy.random.Generator
        Source of the draws.

    Raises
    ------
    PlanError
        If no draw can be driven.
    """
    simulate = ReplayedTrajectoryError(request.vehicle, request.family, _room(request))
    box = request.family.operation
    for _ in range(RANDOM_TRIES):
        x = box.from_unit(rng.random(len(box)))
        try:
            simulate.nominal(x)
        except InfeasibleManeuver:
            continue
        return x
    raise PlanError(f"{request.family.name}: none of {RANDOM_TRIES} random maneuvers is drivable")


def _effects(request: PlanRequest) -> tuple[Effect, ...]:
    return planned_effects(request.vehicle, request.effects, request.known_effects)


def _trajectories(request: PlanRequest, room: Room | None) -> tuple[ReplayedTrajectories, ...]:
    """Return the measured trajectories as a function of x and p; a maneuver must fit the room."""
    vehicle, channels = request.vehicle, request.noise.channels
    return tuple(
        ReplayedTrajectories(vehicle, family, channels, room, _effects(request))
        for family in request.families
    )


def _judge(request: PlanRequest, family: ManeuverFamily, x: FloatArray) -> _Maneuver:
    """Indices of TE and H of the maneuver x (l,), which is known to fit."""
    run, outputs = nominal_run(request.vehicle, family, x), list[FloatArray]()

    def simulate_and_keep(parameters: FloatArray) -> FloatArray:
        outputs.append(replayed_errors(request.vehicle, run, parameters, threads=None))
        return outputs[-1]

    result = sensitivity(
        simulate_and_keep,
        request.vehicle.unknown,
        samples=request.samples,
        seed=request.seed,
    )
    noise_variance = request.noise.of_trajectory_error(np.concatenate(outputs))
    noise_share = noise_variance / result.variance
    target = result.names.index(request.target)
    cost = excitation_cost(result.main, result.total, target, noise_share=noise_share)
    return _Maneuver(x, result, cost)


def _predicted_covariance(request: PlanRequest, points: list[FloatArray]) -> FloatArray | None:
    """Covariance (k, k) after drives with operation parameters (l,), in squared ranges.

    None without noise.
    """
    if request.noise.noise_std == 0.0:
        return None
    return predicted_covariance(
        _trajectories(request, None),  # they fit
        tuple(points),
        Box.of(request.vehicle.unknown),
        request.noise.of_trajectory,
        seed=request.seed + 2,
        prior=request.prior,
        nuisances=nuisance_parameters(_effects(request)),
    )


def _plans(
    request: PlanRequest,
    maneuvers: list[_Maneuver],
    covariance: FloatArray | None,
    design: Design | None,
    began: float,
    tried: SearchHistory | None = None,
) -> tuple[Plan, ...]:
    """A plan per maneuver of a set; `design` is how they were found, None if they were given."""
    vehicle = request.vehicle
    room = _room(request)
    predicted_std: dict[str, float] = {}
    criterion_cost = maneuvers[0].cost if design is None else design.cost
    if covariance is not None:
        unknown = Box.of(vehicle.unknown)
        std = np.sqrt(np.diag(covariance)) * (np.array(unknown.high) - unknown.low)
        predicted_std = dict(zip(unknown.names, std.tolist(), strict=True))
        if design is None and request.criterion is not Criterion.H:
            target = unknown.index(request.target)
            (criterion_cost,) = information_costs(covariance[None], request.criterion, target)
    columns = np.cumsum([0, *(len(maneuver.x) for maneuver in maneuvers)])
    plans = []
    for number, (family, maneuver) in enumerate(zip(request.families, maneuvers, strict=True)):
        run, result = nominal_run(vehicle, family, maneuver.x), maneuver.sensitivity
        searched = None
        if tried is not None:
            searched = dataclasses.replace(
                tried, x=tried.x[:, columns[number] : columns[number + 1]]
            )
        plans.append(
            Plan(
                maneuver=family.name,
                operation=dict(zip(family.operation.names, maneuver.x.tolist(), strict=True)),
                ranges=family.operation.bounds(),
                target=request.target,
                criterion=request.criterion,
                number=number + 1,
                drives=len(maneuvers),
                unknown=dict(vehicle.unknown),
                main=_indices(result.names, result.main, result.main_interval),
                total=_indices(result.names, result.total, result.total_interval),
                variance=float(result.variance),
                cost=maneuver.cost,
                criterion_cost=float(criterion_cost),
                predicted_cost=None if design is None else design.predicted_cost,
                predicted_std=predicted_std,
                leave_one_out_q2=float(result.leave_one_out_q2),
                simulations=_simulations(request, design, result),
                seconds=time.monotonic() - began,
                seed=request.seed,
                noise=request.noise,
                effects=tuple(e.option for e in _effects(request)),
                feasible=True,
                verdict=(
                    ""
                    if design is None or design.verdict is Verdict.EXCITES
                    else design.explanation
                ),
                vehicle=vehicle.name,
                vehicle_hash=vehicle.fingerprint,
                constants=shaping_constants(vehicle),
                parts=laws_of(vehicle),
                tyre_radius=vehicle.driven_radius,
                software=__version__,
                commands=run.commands,
                path=run.path,
                reference=run.reference,
                search=searched,
                lead_in=lead_in_of(run.commands, vehicle)
                if isinstance(family, LedInFamily)
                else 0.0,
                **({} if room is None else on_area(room, vehicle, run.commands)),
            )
        )
    return tuple(plans)


def _simulations(request: PlanRequest, design: Design | None, indices: Sensitivity) -> int:
    """Simulations of a maneuver in all: of the search, of the indices of TE, of the prediction."""
    taken = 0 if design is None else design.simulations
    if design is None or request.criterion is not Criterion.H:  # else the search gave the indices
        taken += indices.simulations
    if request.noise.noise_std > 0.0:
        taken += PREDICTION_DRAWS * (len(request.vehicle.unknown) + len(_effects(request)) + 1)
    return taken


def on_area(room: Room, vehicle: Vehicle, commands: Commands) -> dict[str, Any]:
    """Return the fields of a plan that say where on the area it is driven.

    Parameters
    ----------
    room : Room
        Area, footprint and position noise that the maneuver fits.
    vehicle : Vehicle
        Vehicle with the ranges of its unknown parameters.
    commands : Commands
        Commands of the maneuver.

    Raises
    ------
    DoesNotFit
        If the maneuver does not fit; the message says what is lacking.
    InfeasibleManeuver
        If a vehicle of the ranges rolls over.
    """
    fit = room.fit(vehicle, commands)
    if fit.shortage > 0.0:
        raise DoesNotFit(f"needs {fit.shortage:.2f} m more room in the area")
    placement = fit.placement
    return {
        "area": room.area,
        "start_pose": (placement.x, placement.y, placement.heading),
        "clearance": placement.clearance,
        "tube": rings_of(fit.drive),
        "stopping_zone": rings_of(fit.whole),
        "footprint": room.footprint,
        "curvature": crawl_curvature(vehicle, commands.steering_motor_angle),
    }


def _indices(names: tuple[str, ...], values: FloatArray, intervals: FloatArray) -> dict[str, Index]:
    return {
        name: Index(float(value), float(low), float(high))
        for name, value, (low, high) in zip(names, values, intervals, strict=True)
    }
