"""From a vehicle, maneuver families and a target to plans."""

import dataclasses
import time
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from excitation_planner.box import Box
from excitation_planner.design.criteria import Criterion, excitation_cost
from excitation_planner.design.excitation import Design, Verdict, design_excitation
from excitation_planner.design.information import ManeuverSet, Prior, TrajectoryNoise
from excitation_planner.design.search import Search
from excitation_planner.indices.sensitivity import Sensitivity, sensitivity
from excitation_planner.maneuver import ManeuverFamily
from excitation_planner.plan import Index, Plan, SearchHistory
from excitation_planner.planning.prediction import ReplayedTrajectories, predicted_covariance
from excitation_planner.planning.replay import ReplayedTrajectoryError, nominal_run
from tricycle_core import __version__
from tricycle_core.errors import InfeasibleManeuver, PlanError
from tricycle_core.quantities import FloatArray, Progress
from tricycle_sim.vehicle import Vehicle

DELAY_STD = 0.05  # s, of each sensor's clock, and
GYRO_BIAS_STD = 0.02  # rad/s: what identification does not take for granted either
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
        Unknown parameter to excite; the criteria D and A look at all of them.
    criterion
        What is minimised; H is the paper's.
    others
        Families of the maneuvers driven after the first, designed as one set with it.
    samples
        For H: simulations per maneuver during the search.
    budget
        Largest number of simulations in all.
    seed
        Same seed, same plan.
    noise_std
        Standard deviation of the measured position per axis, m; 0 is the paper's cost.
    yaw_rate_std
        Standard deviation of a yaw-rate gyro, rad/s; 0: there is none.
    drift_std, drift_time
        Standard deviation, m, and correlation time, s, of a slow drift of the position.
    start_position_std, start_heading_std
        How well the start pose is known, m per axis and rad. A design for an exactly known start
        pose (0) is a poor one when it is not.
    prior
        What earlier drives have taught; None: the ranges of the vehicle.
    search
        How the operation box is searched.

    Raises
    ------
    PlanError
        If the target is not one of the vehicle's unknown parameters, a noise is impossible, or the
        criterion cannot judge that.
    """

    vehicle: Vehicle
    family: ManeuverFamily
    target: str
    criterion: Criterion = Criterion.H
    others: tuple[ManeuverFamily, ...] = ()
    samples: int = 100
    budget: int = 12_000
    seed: int = 0
    noise_std: float = 0.01
    yaw_rate_std: float = 0.0
    drift_std: float = 0.0
    drift_time: float = 5.0
    start_position_std: float = 0.02
    start_heading_std: float = 0.0175
    prior: Prior | None = None
    search: Search = Search.ADAPTIVE

    def __post_init__(self) -> None:
        if self.target not in self.vehicle.unknown:
            raise PlanError(
                f"unknown target {self.target!r}; the unknown parameters of "
                f"{self.vehicle.name} are: {', '.join(self.vehicle.unknown)}"
            )
        for name, unit in (
            *(("noise_std", "m"), ("yaw_rate_std", "rad/s"), ("drift_std", "m")),
            *(("start_position_std", "m"), ("start_heading_std", "rad")),
        ):
            if not 0.0 <= getattr(self, name) < 10.0:
                raise PlanError(f"{name} = {getattr(self, name):g} {unit} must be from 0 to 10")
        if not 0.0 < self.drift_time < 1e4:
            raise PlanError(f"drift_time = {self.drift_time:g} s must be above 0")
        if self.criterion is Criterion.H:
            if self.others:
                raise PlanError("criterion h judges one maneuver; a set needs c, d or a")
        elif self.noise_std == 0.0:
            raise PlanError(f"criterion {self.criterion} needs noise_std above 0; h does without")

    @property
    def families(self) -> tuple[ManeuverFamily, ...]:
        """Families of the maneuvers, in the order in which they are driven."""
        return (self.family, *self.others)

    @property
    def trajectory_noise(self) -> TrajectoryNoise:
        """How a drive is measured: position, and yaw rate where there is a gyro."""
        position = (self.noise_std, self.noise_std)
        return TrajectoryNoise(
            std=(*position, self.yaw_rate_std) if self.yaw_rate_std else position,
            drift_std=self.drift_std,
            drift_time=self.drift_time,
            start_position_std=self.start_position_std,
            start_heading_std=self.start_heading_std,
            delay_std=DELAY_STD,
            bias_std=GYRO_BIAS_STD,
        )

    def trajectories(self) -> tuple[ReplayedTrajectories, ...]:
        """What is measured of each maneuver, as a function of x and p."""
        columns = ("x", "y", "yaw_rate") if self.yaw_rate_std else ("x", "y")
        return tuple(
            ReplayedTrajectories(self.vehicle, family, columns) for family in self.families
        )

    def simulator(self) -> ReplayedTrajectoryError:
        """TE of this vehicle and family as a function of x and p."""
        return ReplayedTrajectoryError(self.vehicle, self.family)

    def noise_variance(self, te: FloatArray) -> float:
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
    request: PlanRequest, *, executor: Executor | None = None, progress: Progress | None = None
) -> Plan:
    """Search the family for its best maneuver: `plan_set` of a single one."""
    (plan,) = plan_set(request, executor=executor, progress=progress)
    return plan


def plan_set(
    request: PlanRequest, *, executor: Executor | None = None, progress: Progress | None = None
) -> tuple[Plan, ...]:
    """Search the families for the maneuvers that are best by the criterion, driven as one set.

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
    plans
        The verified optimum, a plan per maneuver. Their `verdict` says so when the families cannot
        excite the target.

    Raises
    ------
    PlanError, DesignError
        If the request cannot be met.
    """
    began = time.monotonic()
    if request.criterion is Criterion.H:
        design = design_excitation(
            request.simulator(),
            request.family.operation,
            dict(request.vehicle.unknown),
            request.target,
            noise_variance=request.noise_variance,
            samples=request.samples,
            budget=request.budget,
            seed=request.seed,
            search=request.search,
            executor=executor,
            progress=progress,
        )
        return _plans(
            request, (_Maneuver(design.x, design.sensitivity, design.cost),), design, began
        )
    maneuvers = ManeuverSet(request.trajectories(), tuple(f.operation for f in request.families))
    design = design_excitation(
        maneuvers,
        maneuvers.operation,
        dict(request.vehicle.unknown),
        request.target,
        criterion=request.criterion,
        trajectory_noise=request.trajectory_noise,
        prior=request.prior,
        samples=request.samples,
        budget=request.budget,
        seed=request.seed,
        search=request.search,
        executor=executor,
        progress=progress,
    )
    # samples that the search has not seen, three times as many: as H is verified
    fresh = dataclasses.replace(request, samples=3 * request.samples, seed=request.seed + 1)
    judged = tuple(
        _judge(fresh, family, x)
        for family, x in zip(request.families, maneuvers.split(design.x), strict=True)
    )
    return _plans(request, judged, design, began)


def plan_at(request: PlanRequest, x: FloatArray) -> Plan:
    """Plan the maneuver with operation parameters x (l,), as it is.

    Raises
    ------
    PlanError
        If the nominal vehicle cannot drive it.
    """
    began = time.monotonic()
    try:
        judged = _judge(request, request.family, x)
    except InfeasibleManeuver as error:
        raise PlanError(f"{request.family.name}: {error}") from error
    (plan,) = _plans(dataclasses.replace(request, others=()), (judged,), None, began)
    return plan


def random_feasible_point(request: PlanRequest, rng: np.random.Generator) -> FloatArray:
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


@dataclass(frozen=True)
class _Maneuver:
    """Operation parameters (l,), the Sobol' indices of TE there, and H of the target."""

    x: FloatArray
    sensitivity: Sensitivity
    cost: float


def _judge(request: PlanRequest, family: ManeuverFamily, x: FloatArray) -> _Maneuver:
    """Indices of TE and H of the maneuver x (l,)."""
    simulate = ReplayedTrajectoryError(request.vehicle, family)
    outputs: list[FloatArray] = []

    def simulate_and_keep(parameters: FloatArray) -> FloatArray:
        outputs.append(simulate(x, parameters))
        return outputs[-1]

    result = sensitivity(
        simulate_and_keep,
        dict(request.vehicle.unknown),
        samples=request.samples,
        seed=request.seed,
    )
    noise_share = request.noise_variance(np.concatenate(outputs)) / result.variance
    target = result.names.index(request.target)
    cost = excitation_cost(result.main, result.total, target, noise_share=noise_share)
    return _Maneuver(x, result, cost)


def _predicted_std(request: PlanRequest, maneuvers: tuple[_Maneuver, ...]) -> dict[str, float]:
    """Standard deviations after the drives, in the parameters' units; nothing without noise."""
    if request.noise_std == 0.0:
        return {}
    unknown = Box.of(dict(request.vehicle.unknown))
    covariance = predicted_covariance(
        request.trajectories(),
        tuple(maneuver.x for maneuver in maneuvers),
        unknown,
        request.trajectory_noise,
        seed=request.seed + 2,
        prior=request.prior,
    )
    std = np.sqrt(np.diag(covariance)) * (np.array(unknown.high) - unknown.low)
    return dict(zip(unknown.names, std.tolist(), strict=True))


def _plans(
    request: PlanRequest, maneuvers: tuple[_Maneuver, ...], design: Design | None, began: float
) -> tuple[Plan, ...]:
    """A plan per maneuver of a set; `design` is how they were found, None if they were given."""
    predicted_std = _predicted_std(request, maneuvers)
    vehicle = request.vehicle
    columns = np.cumsum([0, *(len(maneuver.x) for maneuver in maneuvers)])
    plans = []
    for number, (family, maneuver) in enumerate(zip(request.families, maneuvers, strict=True)):
        run, result = nominal_run(vehicle, family, maneuver.x), maneuver.sensitivity
        searched = None
        if design is not None:
            tried = np.array([evaluation.x for evaluation in design.history])
            searched = SearchHistory(
                tried[:, columns[number] : columns[number + 1]],
                np.array([evaluation.cost for evaluation in design.history]),
            )
        plans.append(
            Plan(
                maneuver=family.name,
                operation=dict(zip(family.operation.names, maneuver.x.tolist(), strict=True)),
                target=request.target,
                criterion=request.criterion,
                number=number + 1,
                drives=len(maneuvers),
                unknown=dict(vehicle.unknown),
                main=_indices(result.names, result.main, result.main_interval),
                total=_indices(result.names, result.total, result.total_interval),
                variance=float(result.variance),
                cost=maneuver.cost,
                criterion_cost=maneuver.cost if design is None else design.cost,
                predicted_cost=None if design is None else design.predicted_cost,
                predicted_std=predicted_std,
                leave_one_out_q2=float(result.leave_one_out_q2),
                simulations=result.simulations if design is None else design.simulations,
                seconds=time.monotonic() - began,
                seed=request.seed,
                noise_std=request.noise_std,
                yaw_rate_std=request.yaw_rate_std,
                drift_std=request.drift_std,
                drift_time=request.drift_time,
                start_position_std=request.start_position_std,
                start_heading_std=request.start_heading_std,
                feasible=True,
                verdict=(
                    ""
                    if design is None or design.verdict is Verdict.EXCITES
                    else design.explanation
                ),
                vehicle=vehicle.name,
                vehicle_hash=vehicle.fingerprint,
                tyre_radius=vehicle.tyre_radius,
                software=__version__,
                commands=run.commands,
                path=run.path,
                reference=run.reference,
                search=searched,
            )
        )
    return tuple(plans)


def _indices(names: tuple[str, ...], values: FloatArray, intervals: FloatArray) -> dict[str, Index]:
    return {
        name: Index(float(value), float(low), float(high))
        for name, value, (low, high) in zip(names, values, intervals, strict=True)
    }
