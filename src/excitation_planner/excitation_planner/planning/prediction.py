"""Prediction of what a drive will teach: standard deviations of the parameters, before it.

n: samples, k: unknown parameters, e: effects, l: operation parameters, t: time points, c: measured
channels.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from excitation_planner.area.room import Room
from excitation_planner.box import Box
from excitation_planner.design.information import (
    LEAST_SIMULATED,
    difference_points,
    information,
    posterior_covariance,
    simulated_values,
)
from excitation_planner.design.noise import STANDSTILL, TrajectoryNoise
from excitation_planner.design.prior import NO_NUISANCES, BoxPrior, NuisanceParameters
from excitation_planner.maneuver import ManeuverFamily
from excitation_planner.plan import Plan
from excitation_planner.planning.replay import nominal_commands
from tricycle_core.errors import DesignError
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.effects import (
    DRIVE_DEAD_TIME,
    SERVO_DEAD_TIME,
    Effect,
    affected_constants,
    as_sensed,
    effects_of,
    with_effects,
)
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import CommandedBatch

PERIOD = 0.05
"""Time between points [s]: 20 Hz, as localisations give poses."""

BLOCK = 128
"""Vehicles simulated at a time, which bounds the memory."""

SENSED = ("x", "y", "yaw")
"""Columns of a motion that effects of sensors change."""

PREDICTION_DRAWS = 48
"""Parameter values over which a prediction is averaged."""


@dataclass(frozen=True)
class ReplayedTrajectories:
    """The simulator f(x, p) = whole trajectory of the information criteria.

    Calling it with operation parameters x (l,) and unknown parameters P (n, k + e), the effects in
    standard deviations of their priors, gives (n, t, c), a time point every `PERIOD`; NaN where a
    vehicle rolled over. It raises `InfeasibleManeuver` where the nominal vehicle cannot drive x.

    Attributes
    ----------
    vehicle : Vehicle
        Nominal vehicle with its unknown parameters.
    family : ManeuverFamily
        Family of the maneuvers.
    columns : tuple of str, length c
        The channels, by their names in `tricycle_sim.vehicle.batch.Trajectory`.
    room : Room, optional
        Area, footprint and position noise that the maneuvers must fit.
    effects : tuple of Effect
        Effects that are unknown besides the parameters.
    """

    vehicle: Vehicle
    family: ManeuverFamily
    columns: tuple[str, ...] = ("x", "y")
    room: Room | None = None
    effects: tuple[Effect, ...] = ()

    def __call__(self, x: FloatArray, parameters: FloatArray) -> FloatArray:
        """Trajectories (n, t, c) of the samples, with the standstill before them."""
        commands = nominal_commands(self.vehicle, self.family, x, self.room)
        return replayed(self.vehicle, commands, self.columns, parameters, self.effects)


def planned_effects(
    vehicle: Vehicle, names: Sequence[str], known: Mapping[str, float] | None = None
) -> tuple[Effect, ...]:
    """Return the effects that a plan counts; those with another value in each drive come last.

    The deviations are left out: a process in time has a variable at every instant.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle that is planned for.
    names : sequence of str
        Names from `tricycle_sim.effects.EFFECTS`.
    known : mapping of str to float, optional
        Standard deviations of some effects after earlier drives, in the effects' units.

    Raises
    ------
    VehicleError
        If a name is not one of an effect.
    """
    known = known or {}
    counted = [
        replace(e, std=min(e.std, known.get(e.option, math.inf)))
        for e in effects_of(vehicle, names)
        if not e.process
    ]
    return tuple(sorted(counted, key=lambda e: e.per_drive))


def nuisance_parameters(effects: Sequence[Effect]) -> NuisanceParameters:
    """Return the effects as nuisance parameters of a design.

    Parameters
    ----------
    effects : sequence of Effect
        Effects from `planned_effects`.
    """
    return NuisanceParameters(tuple(e.step for e in effects), sum(e.per_drive for e in effects))


def replayed(
    vehicle: Vehicle,
    commands: Commands,
    columns: tuple[str, ...],
    parameters: FloatArray,
    effects: Sequence[Effect] = (),
) -> FloatArray:
    """Return trajectories (n, t, c) of a drive, with the standstill before it.

    Parameters
    ----------
    vehicle : Vehicle
        Nominal vehicle with its unknown parameters.
    commands : Commands
        Commands of the drive.
    columns : tuple of str, length c
        Channels, by their names in `tricycle_sim.vehicle.batch.Trajectory`.
    parameters : ndarray of float, shape (n, k + e)
        Parameters of the samples; the e effects in standard deviations of their priors.
    effects : sequence of Effect
        Effects that are unknown besides the parameters.
    """
    every, rest = round(PERIOD / TICK), round(STANDSTILL / PERIOD)
    affected, n, k = with_effects(vehicle, effects), len(parameters), len(vehicle.unknown)
    batch = CommandedBatch(affected, commands)
    values = {e.name: e.std * parameters[:, k + i] for i, e in enumerate(effects)}
    constants = affected_constants(affected, vehicle.unknown, parameters[:, :k], effects, values)
    steering, drive = values.get(SERVO_DEAD_TIME), values.get(DRIVE_DEAD_TIME, np.zeros(n))
    motion = dict.fromkeys([*columns, *(SENSED if effects else ())])
    trajectories = np.empty((n, rest + len(batch.time[::every]), len(columns)))
    for later in np.unique(drive):  # which all vehicles of a batch have in common
        alike = np.flatnonzero(drive == later)
        for rows in np.split(alike, range(BLOCK, len(alike), BLOCK)):
            run = batch.run(
                constants[rows],
                tuple(motion),
                every=every,
                steering_delay=None if steering is None else steering[rows],
                drive_delay=float(later),
            )
            seen = run.columns
            if effects:
                of_rows = {name: value[rows] for name, value in values.items()}
                x, y, yaw = (seen[name] for name in SENSED)
                seen |= dict(zip(SENSED, as_sensed(x, y, yaw, of_rows), strict=True))
            for channel, name in enumerate(columns):
                trajectories[rows, rest:, channel] = seen[name]
            trajectories[rows[run.feasibility.rolled_over.happened], rest:] = np.nan
    trajectories[:, :rest] = trajectories[:, rest : rest + 1]
    return trajectories


def predicted_covariance(
    simulators: tuple[Callable[[FloatArray, FloatArray], FloatArray], ...],
    points: tuple[FloatArray, ...],
    unknown: Box,
    noise: TrajectoryNoise,
    *,
    seed: int,
    prior: BoxPrior | None = None,
    nuisances: NuisanceParameters = NO_NUISANCES,
) -> FloatArray:
    """Return the expected posterior covariance (k, k), in squared ranges, after several drives.

    Parameters
    ----------
    simulators : tuple of callable
        Simulator of each drive, from x (l,) and P (n, k + e) to trajectories (n, t, c).
    points : tuple of ndarray
        Operation parameters x (l,) of each drive.
    unknown : Box
        Ranges of the unknown parameters.
    noise : TrajectoryNoise
        Noise of the measurement.
    seed : int
        Seed of the parameter values over which the covariance is averaged.
    prior : BoxPrior, optional
        Knowledge of the parameters before the drives; None: uniform in the box.
    nuisances : NuisanceParameters
        Further uncertain inputs of the simulator (nuisance parameters).

    Raises
    ------
    DesignError
        If more than half of the vehicles drawn roll over.
    """
    k = len(unknown)
    U = difference_points(k, PREDICTION_DRAWS, seed=seed, prior=prior, nuisances=nuisances)
    P = simulated_values(unknown, U)
    F = np.zeros((PREDICTION_DRAWS, k + nuisances.shared, k + nuisances.shared))
    for f, x in zip(simulators, points, strict=True):
        F += information(U, f(x, P), noise, nuisances)
    F = F[np.isfinite(F).all(axis=(1, 2))]
    if len(F) < LEAST_SIMULATED * PREDICTION_DRAWS:
        drawn = f"{PREDICTION_DRAWS - len(F)} of {PREDICTION_DRAWS} vehicles drawn"
        raise DesignError(f"{drawn} roll over in this maneuver")
    covariance: FloatArray = posterior_covariance(F, prior, nuisances).mean(axis=0)
    return covariance


def predicted_progress(
    plan: Plan, vehicle: Vehicle, prior: BoxPrior | None = None
) -> tuple[FloatArray, FloatArray]:
    """Predict the standard deviations of the parameters in the course of one drive.

    After a drive that was planned alone with this prior it is the plan's `predicted_std`; the
    plan's effects are counted.

    Parameters
    ----------
    plan : Plan
        Plan of the drive.
    vehicle : Vehicle
        Vehicle with k unknown parameters.
    prior : BoxPrior, optional
        Knowledge of the parameters before the drive; None: uniform on the ranges.

    Returns
    -------
    time : ndarray of float, shape (s,)
        Time since the start event, every second, and the end [s].
    std : ndarray of float, shape (s, k)
        Standard deviations at these times, in the parameters' units.

    Raises
    ------
    DesignError
        If the plan has no measurement noise, or none of the vehicles drawn can be simulated.
    """
    if plan.noise.noise_std == 0.0:
        raise DesignError("a plan with noise_std 0 predicts nothing")
    unknown, noise = Box.of(vehicle.unknown), plan.noise.of_trajectory
    time = np.append(np.arange(0.0, plan.commands.duration, 1.0), plan.commands.duration)
    effects = planned_effects(vehicle, plan.effects)
    trajectories, nuisances = list[FloatArray](), nuisance_parameters(effects)

    def std(end: float) -> FloatArray:
        def until_then(_: FloatArray, parameters: FloatArray) -> FloatArray:
            if not trajectories:  # the parameters are always the same
                columns = plan.noise.channels
                trajectories.append(replayed(vehicle, plan.commands, columns, parameters, effects))
            return trajectories[0][:, : round((STANDSTILL + end) / PERIOD) + 1]

        covariance = predicted_covariance(
            (until_then,),
            (np.empty(0),),
            unknown,
            noise,
            seed=plan.seed + 2,
            prior=prior,
            nuisances=nuisances,
        )
        variance: FloatArray = np.diag(covariance)
        return np.sqrt(variance) * (np.array(unknown.high) - unknown.low)

    return time, np.array([std(end) for end in time.tolist()])
