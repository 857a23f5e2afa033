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
from excitation_planner.planning.replay import nominal_run
from tricycle_core.errors import DesignError
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
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
        every = round(PERIOD / TICK)
        rest = round(STANDSTILL / PERIOD)
        batch, blocks = CommandedBatch(self.vehicle, commands), []
        for first in range(0, len(parameters), BLOCK):
            run = batch.run(parameters[first : first + BLOCK], self.columns)
            Y = np.stack([run.columns[name][:, ::every] for name in self.columns], axis=-1)
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
