"""The search on an area: the best maneuvers that fit it, found by few simulations each.

The most informative maneuvers that fit lie at the limit of what fits, and on a small area most of
an operation box does not fit. Here the cost of a maneuver is that of a few vehicles, and the room
that it needs is found by eight, unless enough cheaper maneuvers are known to fit. Cost and shortage
are interpolated between the maneuvers tried so far; tried next are the cheapest that should fit, at
several distances from those.

Source: Regis (2014), Constrained optimization by radial basis function interpolation for
high-dimensional expensive black-box problems with infeasible initial points; Regis and Shoemaker
(2013) for the candidates.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from excitation_planner.area.placement import Placement
from excitation_planner.area.room import ALLOWANCE, Room
from excitation_planner.area.tube import VEHICLES
from excitation_planner.box import Box
from excitation_planner.design.criteria import Criterion
from excitation_planner.design.information import (
    difference_points,
    information,
    information_costs,
    posterior_covariance,
    simulated_values,
)
from excitation_planner.design.noise import MeasurementNoise
from excitation_planner.design.prior import BoxPrior
from excitation_planner.indices.sampling import corners, sobol_sequence
from excitation_planner.maneuver import ManeuverFamily
from excitation_planner.planning.prediction import nuisance_parameters, replayed
from excitation_planner.planning.replay import driven_commands
from tricycle_core.errors import InfeasibleManeuver
from tricycle_core.quantities import FloatArray, Progress
from tricycle_sim.commands import Commands
from tricycle_sim.effects import Effect
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.layout import LANES

JUDGING = 16
"""Simulations that judge a maneuver: of as many vehicles as this allows, one at least."""

SCREENED = 4
"""Maneuvers per operation parameter that are tried first, beside corners of the box."""

FEWEST = 20
"""Maneuvers per operation parameter that are tried in all, whatever the budget ..."""

MOST = 400
"""... and most of all; more teach little, and the surrogates' cost grows with their cube."""

CANDIDATES = 400
"""Points among which the next ones are chosen, random in the box, and as many beside the best."""

STEPS = (0.02, 0.06, 0.2)
"""Standard deviations of the latter, in ranges."""

MOVED = 0.6
"""Share of the operation parameters in which they differ from the best."""

DISTANCES = (0.3, 0.1, 0.03, 0.01)
"""Distances of the next points from all others on some axis, in ranges: one point for each."""

LEARNT = 3
"""Turns after which it is looked whether all vehicles of the ranges fit the best maneuver."""

PATIENCE = 1 / 3
"""Share of the budget without a better maneuver after which the search ends."""

BETTER = 0.01
"""Difference on the scale that is searched from which a maneuver is better."""

STARTS = 4
"""Maneuvers that are handed out, and those beside which candidates lie."""

FURTHER = 8
"""Maneuvers whose room is looked for after the best that fits, to hand out others beside it."""

APART = 0.03
"""Least distance between them on some axis, in ranges."""


@dataclass
class _Tried:
    """A maneuver that can be driven: point (l,) of the unit box, and what was found out about it.

    The shortage [m] is that of a rough tube; once the maneuver is known not to fit, that of all
    vehicles. It is NaN before the room was looked for, infinite where one of the rough tube's
    vehicles cannot drive it.
    """

    u: FloatArray
    commands: Commands
    criterion: float  # its value
    cost: float  # that on the scale that is searched
    shortage: float = math.nan
    place: Placement | None = None
    fits: bool | None = None  # None: it is not known of all vehicles of the ranges

    @property
    def drivable(self) -> bool:
        """As far as it is known."""
        return self.shortage != math.inf


@dataclass
class FittingSearch:
    """Search of an operation box for the best maneuvers that fit an area.

    Attributes
    ----------
    vehicle : Vehicle
        Vehicle with the ranges of its k unknown parameters.
    family : ManeuverFamily
        Family of the maneuvers.
    room : Room
        Area, footprint and position noise that the maneuvers must fit.
    criterion : Criterion
        Criterion: C, D or A.
    target : int
        Index of the parameter to excite, for C.
    noise : MeasurementNoise
        How the drive will be measured.
    prior : BoxPrior, optional
        Knowledge of the parameters before the drive; None: uniform.
    effects : sequence of Effect
        Effects that are unknown besides the parameters.
    seed : int
        Seed of the maneuvers tried, and of the vehicles that evaluate them.
    simulations : int
        Number of simulations so far.
    """

    vehicle: Vehicle
    family: ManeuverFamily
    room: Room
    criterion: Criterion
    target: int
    noise: MeasurementNoise
    prior: BoxPrior | None = None
    effects: Sequence[Effect] = ()
    seed: int = 0
    simulations: int = field(default=0, init=False)
    _points: list[FloatArray] = field(default_factory=list, init=False)  # all that were tried
    # what was found of them; None: they cannot be driven
    _tried: list[_Tried | None] = field(default_factory=list, init=False)
    # room for vehicles that a rough tube leaves out
    _spread: float = field(default=0.0, init=False)

    def starts(self, budget: int, *, progress: Progress | None = None) -> FloatArray:
        """Return the best maneuvers found, (s, l) in the unit box; none where nothing fits.

        Parameters
        ----------
        budget : int
            About as many simulations are taken at most.
        progress : callable, optional
            Called with (simulations so far, budget).
        """
        dimensions, rng = len(self.family.operation), np.random.default_rng(self.seed)
        screened = sobol_sequence(SCREENED * dimensions, dimensions, seed=self.seed)
        new = np.vstack([corners(dimensions, seed=self.seed), screened])
        _, first = np.unique(new, axis=0, return_index=True)
        new = new[np.sort(first)]  # corners are drawn where there are many
        least, since = math.inf, 0
        for turn in itertools.count():
            for u in new:
                self._try(u)
            if turn == 0:  # the surrogate of the shortage needs some all over the box
                for one in self._found:
                    self._may_fit(one)
            best = self._best()
            if progress is not None:
                progress(self.simulations, budget)
            if best and best[0].cost < least - BETTER:
                least, since = best[0].cost, self.simulations
            if best and turn % LEARNT == 0:
                self._fits(best[0])
            tried = len(self._points)
            enough = self.simulations >= budget
            enough |= bool(best) and self.simulations - since >= PATIENCE * budget
            enough &= tried >= FEWEST * dimensions
            if enough or tried >= MOST or not len(new := self._next(rng)):
                break
        chosen, further = list[FloatArray](), 0
        for one in self._by_cost():
            if len(chosen) == STARTS or further == FURTHER:
                break
            if _apart(one.u, chosen):
                further += bool(chosen)
                if self._fits(one):
                    chosen.append(one.u)
        return np.array(chosen).reshape(-1, dimensions)

    def history(self) -> tuple[FloatArray, FloatArray]:
        """Return operation parameters (s, l) and criterion (s,) of all maneuvers tried so far.

        The criterion, of a few vehicles, is infinite where a maneuver cannot be driven or is known
        not to fit.
        """
        points = np.array(self._points).reshape(-1, len(self.family.operation))
        values = [
            math.inf if one is None or one.shortage > 0.0 else one.criterion for one in self._tried
        ]
        return self.family.operation.from_unit(points), np.array(values)

    def _next(self, rng: np.random.Generator) -> FloatArray:
        """Points (b, l) to be tried next."""
        from scipy.interpolate import RBFInterpolator  # slow to import; most plans do not need it
        from scipy.spatial.distance import cdist

        dimensions = len(self.family.operation)
        found = self._found
        placed = [one for one in found if math.isfinite(one.shortage)]
        U, Z = (
            np.array([one.u for one in some]).reshape(-1, dimensions) for some in (found, placed)
        )
        random = rng.random((CANDIDATES, dimensions))
        if not len(Z) or np.linalg.matrix_rank(Z - Z[0]) < dimensions:
            return random[: len(DISTANCES)]
        shortage = np.array([self._lacks(one) for one in placed])
        best = Z[_ranked(np.array([one.cost for one in placed]), shortage)[:STARTS]]
        steps = rng.choice(STEPS, (CANDIDATES, 1)) * rng.standard_normal(random.shape)
        steps *= rng.random(random.shape) < MOVED
        beside = np.clip(best[rng.integers(len(best), size=CANDIDATES)] + steps, 0.0, 1.0)
        candidates = np.vstack([random, beside])
        distance = cdist(candidates, np.array(self._points), "chebyshev")
        # beside what cannot be driven there is more of it
        drivable = np.array([one is not None and one.drivable for one in self._tried])
        kept = drivable[np.argmin(distance, axis=1)]
        candidates, distance = candidates[kept], distance[kept].min(axis=1)
        costs = RBFInterpolator(U, [one.cost for one in found], kernel="cubic")
        shortages = RBFInterpolator(Z, shortage, kernel="cubic")
        ranked = _ranked(costs(candidates), shortages(candidates))
        chosen = list[FloatArray]()
        for least in DISTANCES:
            far = ranked[distance[ranked] >= least]
            if len(far):
                chosen.append(candidates[far[0]])
                distance = np.minimum(distance, np.abs(candidates - chosen[-1]).max(axis=1))
        return np.array(chosen).reshape(-1, dimensions)

    def _try(self, u: FloatArray) -> None:
        """Judge the maneuver at a point (l,)."""
        self._points.append(u)
        self._tried.append(self._judged(u))

    def _judged(self, u: FloatArray) -> _Tried | None:
        """The maneuver at a point (l,); None if it cannot be driven or judged."""
        U, P = self._draws
        try:
            x = self.family.operation.from_unit(u)
            commands = driven_commands(self.vehicle, self.family, x)
            self.simulations += len(P) + 1  # one has tracked the path
            Y = replayed(self.vehicle, commands, self.noise.channels, P, self.effects)
            nuisances = nuisance_parameters(self.effects)
            F = information(U, Y, self.noise.of_trajectory, nuisances)
        except InfeasibleManeuver:
            return None
        if not np.isfinite(F).all():
            return None
        covariance = posterior_covariance(F, self.prior, nuisances)
        cost = float(information_costs(covariance, self.criterion, self.target).mean())
        return _Tried(u, commands, cost, self.criterion.search_scale(cost))

    @cached_property
    def _draws(self) -> tuple[FloatArray, FloatArray]:
        """Vehicles of the ranges and steps in each parameter: in the unit box, and values."""
        unknown, nuisances = Box.of(self.vehicle.unknown), nuisance_parameters(self.effects)
        k = len(unknown)
        draws = max(1, JUDGING // (k + len(nuisances.steps) + 1))
        U = difference_points(k, draws, seed=self.seed, prior=self.prior, nuisances=nuisances)
        return U, simulated_values(unknown, U)

    @property
    def _found(self) -> list[_Tried]:
        """Maneuvers tried that can be driven."""
        return [one for one in self._tried if one is not None and one.drivable]

    def _by_cost(self) -> list[_Tried]:
        return sorted(self._found, key=lambda one: one.cost)

    def _lacks(self, one: _Tried) -> float:
        """Shortage of all vehicles, as far as it is known [m]."""
        return one.shortage + (self._spread if one.fits is None else 0.0)

    def _best(self) -> list[_Tried]:
        """The cheapest that may fit: of dearer ones the room is not looked for."""
        return list(itertools.islice(filter(self._may_fit, self._by_cost()), STARTS))

    def _may_fit(self, one: _Tried) -> bool:
        """Whether a few vehicles fit; their room is looked for where it was not yet."""
        if math.isnan(one.shortage):
            self.simulations += LANES
            try:
                one.place = self.room.roughly_placed(self.vehicle, one.commands)
                one.shortage = self.room.needed - one.place.clearance
            except InfeasibleManeuver:
                one.shortage = math.inf
        # whatever the spread: that of another maneuver may be larger
        return one.shortage <= 0.0

    def _fits(self, one: _Tried) -> bool:
        """Whether all vehicles of the ranges fit; where they do not, the spread is learnt."""
        if one.fits is None and self._may_fit(one) and one.place is not None:
            self.simulations += VEHICLES
            try:
                shortage = self.room.lacks(self.vehicle, one.commands, one.place)
            except InfeasibleManeuver:
                shortage = ALLOWANCE
            one.fits = shortage <= 0.0
            if not one.fits:
                # no more room than that is looked for
                self._spread = min(max(self._spread, shortage - one.shortage), ALLOWANCE)
                one.shortage = shortage
        return bool(one.fits)


def _ranked(cost: FloatArray, shortage: FloatArray) -> NDArray[np.intp]:
    """Order (n,) of maneuvers: those that fit by cost, then the others by shortage."""
    return np.lexsort((cost, np.maximum(shortage, 0.0)))


def _apart(u: FloatArray, others: Sequence[FloatArray]) -> bool:
    return all(np.abs(u - other).max() >= APART for other in others)
