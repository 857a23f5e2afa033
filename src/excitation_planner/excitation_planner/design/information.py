"""Fisher information of whole trajectories, for the criteria C, D and A.

n: simulations, k: unknown parameters, e: nuisance parameters, of which all maneuvers share s,
t: time points, c: measured channels. Parameters are counted in units of their ranges, in which a
uniform prior has variance 1/12.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import ndtri

from excitation_planner.box import Box
from excitation_planner.design.criteria import Criterion
from excitation_planner.design.noise import TrajectoryNoise
from excitation_planner.design.prior import (
    NO_NUISANCES,
    BoxPrior,
    NuisanceParameters,
)
from excitation_planner.indices.sampling import sobol_sequence
from tricycle_core.errors import DesignError
from tricycle_core.quantities import FloatArray

LEAST_SIMULATED = 0.5
"""Least share of the drawn vehicles that must not roll over: the rest alone looks too good."""

_STEP = 1e-3  # of the finite differences, in ranges


def difference_points(
    k: int,
    draws: int,
    *,
    seed: int,
    prior: BoxPrior | None = None,
    nuisances: NuisanceParameters = NO_NUISANCES,
) -> FloatArray:
    """Return points (draws (k + e + 1), k + e): each draw, and one step from it per axis.

    Parameters are in the unit box; nuisance parameters are 0 or one step.

    Parameters
    ----------
    k : int
        Number of unknown parameters.
    draws : int
        Number of draws.
    seed : int
        Seed of the draws.
    prior : BoxPrior, optional
        Distribution that is drawn from; None: uniform.
    nuisances : NuisanceParameters
        Further uncertain inputs of the simulator (nuisance parameters).
    """
    base = sobol_sequence(draws, k, seed=seed)
    if prior is not None:
        drawn = prior.mean + ndtri(base) @ np.asarray(np.linalg.cholesky(prior.covariance)).T
        base = np.clip(drawn, 0.0, 1.0)
    base = np.hstack([base, np.zeros((draws, len(nuisances.steps)))])
    step, axes = _steps(base, k, nuisances), base.shape[1]
    points = np.repeat(base[:, None], axes + 1, axis=1)
    for j in range(axes):
        points[:, j + 1, j] += step[:, j]
    return points.reshape(-1, axes)


def simulated_values(unknown: Box, U: FloatArray) -> FloatArray:
    """Return what a simulator takes (n, k + e) at points of the unit box.

    Parameters
    ----------
    unknown : Box
        Ranges of the k unknown parameters.
    U : ndarray of float, shape (n, k + e)
        Parameters in the unit box, then nuisance parameters.
    """
    k = len(unknown)
    return np.hstack([unknown.from_unit(U[:, :k]), U[:, k:]])


def _steps(base: FloatArray, k: int, nuisances: NuisanceParameters) -> FloatArray:
    steps: FloatArray = np.where(base < 0.5, _STEP, -_STEP)  # inwards
    steps[:, k:] = nuisances.steps
    return steps


def information(
    U: FloatArray,
    Y: FloatArray,
    noise: TrajectoryNoise,
    nuisances: NuisanceParameters = NO_NUISANCES,
) -> FloatArray:
    """Return the Fisher information (draws, k + s, k + s) in a measured trajectory.

    It is about the parameters and the nuisance parameters that all maneuvers share. An unknown
    start pose, correlated noise and the nuisance parameters of each maneuver alone reduce it.

    Parameters
    ----------
    U : ndarray of float, shape (draws (k + e + 1), k + e)
        Points from `difference_points`.
    Y : ndarray of float, shape (draws (k + e + 1), t, c)
        Trajectories at these points.
    noise : TrajectoryNoise
        Noise of the measurement.
    nuisances : NuisanceParameters
        Further uncertain inputs of the simulator (nuisance parameters).
    """
    axes = U.shape[1]
    k = axes - nuisances.own  # parameters and shared nuisances: their information is returned
    draws, (t, c) = len(U) // (axes + 1), Y.shape[1:]
    Y = Y.reshape(draws, axes + 1, t, c)
    steps = _steps(U.reshape(draws, axes + 1, axes)[:, 0], axes - len(nuisances.steps), nuisances)
    of_sensors, of_sensors_std = _of_sensors(Y[:, 0], noise)
    nuisance_std = np.append(np.ones(nuisances.own), of_sensors_std)

    J = np.empty((draws, t, axes + of_sensors.shape[-1]))  # of a channel
    F = np.zeros((draws, J.shape[-1], J.shape[-1]))
    for channel, std in enumerate(np.broadcast_to(np.asarray(noise.std, dtype=float), c)):
        differences = Y[:, 1:, :, channel] - Y[:, :1, :, channel]
        J[:, :, :axes] = np.moveaxis(differences / steps[:, :, None], 1, -1)
        J[:, :, axes:] = of_sensors[:, :, channel]
        whitened = J / std
        if noise.drift_std > 0 and channel < 2:
            lag = np.abs(np.subtract.outer(np.arange(t), np.arange(t))) * noise.period
            drift = (noise.drift_std / std) ** 2 * np.exp(-lag / noise.drift_time)
            factor = np.asarray(np.linalg.cholesky(np.eye(t) + drift))
            columns = np.moveaxis(whitened, 1, 0).reshape(t, -1)
            columns = solve_triangular(factor, columns, lower=True)
            whitened = np.moveaxis(columns.reshape(t, draws, -1), 0, 1)
        F += _products(whitened)

    # what is left about the parameters when the nuisances are unknown: the Schur complement
    F_pp, F_pn, F_nn = F[:, :k, :k], F[:, :k, k:], F[:, k:, k:]
    F_nn = F_nn + np.diag(nuisance_std**-2)
    left: FloatArray = F_pp - F_pn @ np.linalg.solve(F_nn, np.swapaxes(F_pn, 1, 2))
    return left


def _products(J: FloatArray) -> FloatArray:
    """Sums over time of the products of the columns of J (draws, t, m), (draws, m, m)."""
    F = np.zeros((len(J), J.shape[2], J.shape[2]))
    _compiled()(np.ascontiguousarray(J), F)
    return F


@cache
def _compiled() -> Callable[..., None]:
    """Return `_add_products` as machine code, five times as fast as `numpy.einsum`."""
    from tricycle_sim.compilation import compiled  # slow to import; criterion h does not need it

    # exact: another rounding leads the search to another maneuver
    add: Callable[..., None] = compiled(_add_products, exact=True)
    return add


def _add_products(J, F):  # type: ignore[no-untyped-def]  # pragma: no cover
    for draw in range(J.shape[0]):
        for t in range(J.shape[1]):
            for i in range(J.shape[2]):
                value = J[draw, t, i]
                for j in range(J.shape[2]):
                    F[draw, i, j] += value * J[draw, t, j]


def _of_sensors(Y: FloatArray, noise: TrajectoryNoise) -> tuple[FloatArray, FloatArray]:
    """Derivatives (draws, t, c, m) of Y (draws, t, c) by m of the sensors, and std (m,)."""
    posed = [0, 1] if noise.heading_channel is None else [0, 1, noise.heading_channel]
    others = [channel for channel in range(Y.shape[2]) if channel not in posed]
    columns: list[FloatArray] = []
    stds: list[float] = []

    def add(std: float, derivative: dict[int, FloatArray | float]) -> None:
        if std > 0.0:
            column = np.zeros_like(Y)
            for channel, values in derivative.items():
                column[:, :, channel] = values
            columns.append(column)
            stds.append(std)

    add(noise.start_position_std, {0: 1.0})
    add(noise.start_position_std, {1: 1.0})
    if noise.start_heading_std > 0.0:
        turned = {0: Y[:, :1, 1] - Y[:, :, 1], 1: Y[:, :, 0] - Y[:, :1, 0]}
        add(noise.start_heading_std, turned | dict.fromkeys(posed[2:], 1.0))
    if noise.delay_std > 0.0:
        rates = np.gradient(Y, noise.period, axis=1)
        add(noise.delay_std, {channel: -rates[:, :, channel] for channel in posed})
        for channel in others:
            add(noise.delay_std, {channel: -rates[:, :, channel]})
    for channel, bias_std in zip(others, np.broadcast_to(noise.bias_std, len(others)), strict=True):
        add(bias_std, {channel: 1.0})
    if not columns:
        return np.zeros((*Y.shape, 0)), np.zeros(0)
    return np.stack(columns, axis=-1), np.array(stds)


def posterior_covariance(
    F: FloatArray, prior: BoxPrior | None = None, nuisances: NuisanceParameters = NO_NUISANCES
) -> FloatArray:
    """Return the covariance (draws, k, k) of the parameters after drives, in squared ranges.

    Parameters
    ----------
    F : ndarray of float, shape (draws, k + s, k + s)
        Information in the drives, of each the same draws.
    prior : BoxPrior, optional
        Knowledge of the parameters before the drive; None: uniform.
    nuisances : NuisanceParameters
        Further uncertain inputs of the simulator (nuisance parameters).
    """
    k = F.shape[-1] - nuisances.shared
    known = np.eye(F.shape[-1])
    known[:k, :k] = (prior or BoxPrior.uniform(k)).information
    try:
        np.linalg.cholesky(F + known)  # what rounding has made indefinite has an inverse too
        covariance = np.asarray(np.linalg.inv(F + known), dtype=np.float64)
    except np.linalg.LinAlgError:
        raise DesignError(
            "parameters act alike in these drives, and their noise is so small that what was known "
            "before is lost in rounding"
        ) from None
    return covariance[:, :k, :k]


def information_costs(
    covariance: FloatArray, criterion: Criterion, target: int | None
) -> FloatArray:
    """Return the cost (draws,) of each posterior covariance; its mean is the criterion.

    Parameters
    ----------
    covariance : ndarray of float, shape (draws, k, k)
        Posterior covariances.
    criterion : Criterion
        Criterion: C, D or A.
    target : int or None
        Index of the parameter to excite, for C.
    """
    if criterion is Criterion.C:
        costs: FloatArray = covariance[:, target, target]
    elif criterion is Criterion.A:
        costs = np.trace(covariance, axis1=1, axis2=2)
    else:
        costs = np.array(np.linalg.slogdet(covariance)[1], dtype=np.float64)
    return costs


@dataclass(frozen=True)
class ManeuverSet:
    """Several maneuvers driven one after the other, as one simulator for `design_excitation`.

    Attributes
    ----------
    simulators : tuple of callable
        Simulator of each maneuver, from x (l_i,) and P (n, k) to trajectories (n, t_i, c).
    operations : tuple of Box
        Operation box of each maneuver. In `operation` their names are numbered: ``1.radius``,
        ``2.d1``.
    """

    simulators: tuple[Callable[[FloatArray, FloatArray], FloatArray], ...]
    operations: tuple[Box, ...]

    def __post_init__(self) -> None:
        if not len(self.simulators) == len(self.operations) > 0:
            raise DesignError("a set of maneuvers needs one operation box per simulator")

    @property
    def operation(self) -> Box:
        """Box of all operation parameters."""
        return Box.of(
            {
                f"{number}.{name}": limits
                for number, box in enumerate(self.operations, start=1)
                for name, limits in box.bounds().items()
            }
        )

    def __call__(self, x: FloatArray, P: FloatArray) -> tuple[FloatArray, ...]:
        """Trajectories of all maneuvers."""
        return tuple(f(part, P) for f, part in zip(self.simulators, self.split(x), strict=True))

    def split(self, x: FloatArray) -> list[FloatArray]:
        """Operation parameters (l_i,) of each maneuver."""
        return np.split(x, np.cumsum([len(box) for box in self.operations])[:-1])
