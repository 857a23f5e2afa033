"""Prediction of what a drive will teach: standard deviations of the parameters, before it.

n: samples, k: unknown parameters, l: operation parameters, t: time points, c: measured channels.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from excitation_planner.area.room import Room
from excitation_planner.box import Box
from excitation_planner.design.information import (
    difference_points,
    information,
    posterior_covariance,
)
from excitation_planner.design.noise import TrajectoryNoise
from excitation_planner.design.prior import BoxPrior
from excitation_planner.maneuver import ManeuverFamily
from excitation_planner.plan import Plan
from excitation_planner.planning.replay import nominal_run
from tricycle_core.errors import DesignError
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import CommandedBatch

PERIOD = 0.05
"""Time between points [s]: 20 Hz, as localisations give poses."""

STANDSTILL = 1.0
"""Time before the start that is measured, too [s]: it gives start pose and gyro bias."""

BLOCK = 128
"""Vehicles simulated at a time, which bounds the memory."""

DRAWS = 48
"""Parameter values over which a prediction is averaged."""


@dataclass(frozen=True)
class ReplayedTrajectories:
    """The simulator f(x, p) = whole trajectory of the information criteria.

    Calling it with operation parameters x (l,) and unknown parameters P (n, k) gives (n, t, c), a
    time point every `PERIOD`; NaN where a vehicle rolled over. It raises `InfeasibleManeuver`
    where the nominal vehicle cannot drive x.

    Attributes
    ----------
    vehicle : Vehicle
        Nominal vehicle with its unknown parameters.
    family : ManeuverFamily
        Of the maneuvers.
    columns : tuple of str, length c
        The channels, by their names in `tricycle_sim.vehicle.batch.Trajectory`.
    room : Room, optional
        What the maneuvers have to fit.
    """

    vehicle: Vehicle
    family: ManeuverFamily
    columns: tuple[str, ...] = ("x", "y")
    room: Room | None = None

    def __call__(self, x: FloatArray, parameters: FloatArray) -> FloatArray:
        """Trajectories (n, t, c) of the samples, with the standstill before them."""
        commands = nominal_run(self.vehicle, self.family, x, self.room).commands
        return _replayed(self.vehicle, commands, self.columns, parameters)


def _replayed(
    vehicle: Vehicle, commands: Commands, columns: tuple[str, ...], parameters: FloatArray
) -> FloatArray:
    """Trajectories (n, t, c) of a drive, with the standstill before it."""
    every = round(PERIOD / TICK)
    rest = round(STANDSTILL / PERIOD)
    batch, blocks = CommandedBatch(vehicle, commands), []
    for first in range(0, len(parameters), BLOCK):
        run = batch.run(parameters[first : first + BLOCK], columns)
        Y = np.stack([run.columns[name][:, ::every] for name in columns], axis=-1)
        Y[run.feasibility.rolled_over.happened] = np.nan
        blocks.append(np.concatenate([np.repeat(Y[:, :1], rest, axis=1), Y], axis=1))
    return np.concatenate(blocks)


def predicted_covariance(
    simulators: tuple[Callable[[FloatArray, FloatArray], FloatArray], ...],
    points: tuple[FloatArray, ...],
    unknown: Box,
    noise: TrajectoryNoise,
    *,
    seed: int,
    prior: BoxPrior | None = None,
) -> FloatArray:
    """Return the expected posterior covariance (k, k), in squared ranges, after several drives.

    Parameters
    ----------
    simulators : tuple of callable
        Of each drive: x (l,), P (n, k) to trajectories (n, t, c).
    points : tuple of ndarray
        Operation parameters x (l,) of each drive.
    unknown : Box
        Ranges of the unknown parameters.
    noise : TrajectoryNoise
        Of the measurement.
    seed : int
        Of the parameter values over which is averaged.
    prior : BoxPrior, optional
        What is known before; None: uniform in the box.

    Raises
    ------
    DesignError
        If not one of the vehicles drawn can be simulated.
    """
    k = len(unknown)
    U = difference_points(k, DRAWS, seed=seed, prior=prior)
    P = unknown.from_unit(U)
    F = np.zeros((DRAWS, k, k))
    for f, x in zip(simulators, points, strict=True):
        F += information(U, f(x, P), noise)
    F = F[np.isfinite(F).all(axis=(1, 2))]
    if len(F) == 0:
        raise DesignError("every vehicle drawn rolled over in this maneuver")
    covariance: FloatArray = posterior_covariance(F, prior).mean(axis=0)
    return covariance


def predicted_progress(plan: Plan, vehicle: Vehicle) -> tuple[FloatArray, FloatArray]:
    """Predict what is known during one drive, from nothing but the ranges before it.

    After a drive that was planned alone it is the plan's `predicted_std`.

    Parameters
    ----------
    plan : Plan
        Of the drive.
    vehicle : Vehicle
        With k unknown parameters.

    Returns
    -------
    time : ndarray of float, shape (s,)
        Since the start event, every second and the end [s].
    std : ndarray of float, shape (s, k)
        Standard deviations then, in the parameters' units.

    Raises
    ------
    DesignError
        If the plan says nothing about the noise, or not one of the vehicles drawn can be simulated.
    """
    if plan.noise.noise_std == 0.0:
        raise DesignError("a plan with noise_std 0 predicts nothing")
    unknown, noise = Box.of(dict(vehicle.unknown)), plan.noise.of_trajectory
    time = np.append(np.arange(0.0, plan.commands.duration, 1.0), plan.commands.duration)
    replayed: list[FloatArray] = []

    def std(end: float) -> FloatArray:
        def until_then(_: FloatArray, parameters: FloatArray) -> FloatArray:
            if not replayed:  # the parameters are always the same
                columns = plan.noise.channels
                replayed.append(_replayed(vehicle, plan.commands, columns, parameters))
            return replayed[0][:, : round((STANDSTILL + end) / PERIOD) + 1]

        covariance = predicted_covariance(
            (until_then,), (np.empty(0),), unknown, noise, seed=plan.seed + 2
        )
        variance: FloatArray = np.diag(covariance)
        return np.sqrt(variance) * (np.array(unknown.high) - unknown.low)

    return time, np.array([std(end) for end in time.tolist()])
