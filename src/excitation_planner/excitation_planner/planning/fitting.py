"""Where a search on an area begins: the best maneuvers that fit it, found by few simulations each.

The most informative maneuvers that fit lie at the limit of what does, and on a small area most of
an operation box does not fit. Here a maneuver is judged, and its room is found, by eight vehicles
each; the search proper takes ten times as many. By how much a maneuver does not fit is a constraint
of local searches, which thus go along the limit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import cobyqa
import numpy as np
from scipy.optimize import NonlinearConstraint

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
)
from excitation_planner.design.noise import MeasurementNoise
from excitation_planner.design.prior import BoxPrior
from excitation_planner.design.search import corners
from excitation_planner.indices.sampling import sobol_sequence
from excitation_planner.maneuver import ManeuverFamily
from excitation_planner.planning.prediction import beside_parameters, replayed
from excitation_planner.planning.replay import driven_commands
from tricycle_core.errors import InfeasibleManeuver
from tricycle_core.quantities import FloatArray
from tricycle_sim.commands import Commands
from tricycle_sim.effects import Effect
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.layout import LANES

SCREENED = 24
"""Maneuvers per operation parameter that are tried first, beside corners of the box."""

LOCAL = 2
"""Local searches from the best of these ..."""

SEARCH_APART = 0.25
"""... that are this far apart on some axis, in ranges."""

FIRST_RADIUS, LAST_RADIUS = 0.15, 5e-3
"""Of their trust regions, in ranges."""

STARTS = 4
"""Maneuvers from which the search proper begins."""

APART = 0.03
"""Least distance between them on some axis, in ranges."""

FARTHEST = 3.0
"""Shortage beyond which one is as bad as another [m]."""

STEEPNESS = 3.0
"""Logarithm of the cost that a metre of shortage counts as, where a local search begins."""


@dataclass
class _Tried:
    """A maneuver that can be driven: point (l,) of the unit box, and what was found out about it.

    The shortage is that of a rough tube, or where it is known not to fit that of all vehicles [m].
    """

    u: FloatArray
    commands: Commands
    cost: float  # on the scale that is searched
    place: Placement | None = None
    shortage: float = math.inf
    fits: bool | None = None  # None: it is not known of all vehicles of the ranges


@dataclass
class FittingSearch:
    """Search of an operation box for the best maneuvers that fit an area.

    Attributes
    ----------
    vehicle : Vehicle
        With the ranges of its k unknown parameters.
    family : ManeuverFamily
        Of the maneuvers.
    room : Room
        What they have to fit.
    criterion : Criterion
        C, D or A.
    target : int
        Axis of the target, for C.
    noise : MeasurementNoise
        How the drive will be measured.
    prior : BoxPrior, optional
        What is known before; None: uniform.
    effects : sequence of Effect
        Beside the parameters.
    seed : int
        Of the maneuvers tried first, and of the vehicles that judge.
    simulations : int
        Taken so far.
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
    _tried: dict[bytes, _Tried | None] = field(default_factory=dict, init=False)
    _spread: float = field(
        default=0.0, init=False
    )  # room for vehicles that a rough tube leaves out

    def starts(self, budget: int) -> FloatArray:
        """Return the best maneuvers found, (s, l) in the unit box; none where nothing fits.

        Parameters
        ----------
        budget : int
            About as many simulations are taken at most.
        """
        dimensions = len(self.family.operation)
        for u in [*corners(dimensions, seed=self.seed), *self._sobol(dimensions)]:
            self._judged(u)
        for one in self._by_cost():
            self._place(one)
            if self._fits(one):
                break
        begun = list[FloatArray]()
        each = (budget - self.simulations) // (LOCAL * self._runs)
        for _ in range(LOCAL if each > dimensions + 1 else 0):
            apart = [one for one in self._by_cost() if _apart(one.u, begun, SEARCH_APART)]
            if not apart:
                break
            start = min(
                apart, key=lambda o: o.cost + STEEPNESS * np.clip(self._lacks(o), 0, FARTHEST)
            )
            begun.append(start.u)
            self._search_from(start.u, each)
            next(filter(self._fits, self._by_cost()), None)  # learns the spread
        chosen = list[FloatArray]()
        for one in self._by_cost():
            if self._lacks(one) <= 0.0 and _apart(one.u, chosen, APART) and len(chosen) < STARTS:
                chosen.append(one.u)
        return np.array(chosen).reshape(-1, dimensions)

    def _search_from(self, u: FloatArray, evaluations: int) -> None:
        """Go on from a point by COBYQA, the shortage as a constraint."""

        def tried(z: FloatArray) -> tuple[float, float]:
            point = np.clip(z, 0.0, 1.0)
            one = self._judged(point)
            if one is not None:
                self._place(one)
            if one is not None and math.isfinite(one.shortage):
                return one.cost, min(self._lacks(one), FARTHEST)
            # a little worse than the nearest one that can be driven
            others = [o for o in self._by_cost() if math.isfinite(o.shortage)]
            if not others:
                return 0.0, FARTHEST
            near = min(others, key=lambda o: float(np.linalg.norm(o.u - point)))
            return near.cost + 0.1, min(self._lacks(near) + 0.3, FARTHEST)

        cobyqa.minimize(
            lambda z: tried(z)[0],
            u,
            bounds=[(0.0, 1.0)] * len(u),
            constraints=[NonlinearConstraint(lambda z: tried(z)[1], -np.inf, 0.0)],
            options={
                "radius_init": FIRST_RADIUS,
                "radius_final": LAST_RADIUS,
                "maxfev": evaluations,
            },
        )

    def _judged(self, u: FloatArray) -> _Tried | None:
        """The maneuver at a point (l,), with its cost; None if it cannot be driven or judged."""
        key = u.tobytes()
        if key not in self._tried:
            self._tried[key] = self._judge(u)
        return self._tried[key]

    def _judge(self, u: FloatArray) -> _Tried | None:
        try:
            x = self.family.operation.from_unit(u)
            commands = driven_commands(self.vehicle, self.family, x)
        except InfeasibleManeuver:
            return None
        U, P = self._draw
        Y = replayed(self.vehicle, commands, self.noise.channels, P, self.effects)
        self.simulations += len(P) + 1  # one has tracked the path
        beside = beside_parameters(self.effects)
        F = information(U, Y, self.noise.of_trajectory, beside)
        if not np.isfinite(F).all():
            return None
        covariance = posterior_covariance(F, self.prior, beside)
        cost = float(information_costs(covariance, self.criterion, self.target).mean())
        return _Tried(u, commands, self.criterion.search_scale(cost))

    @cached_property
    def _draw(self) -> tuple[FloatArray, FloatArray]:
        """One vehicle of the ranges and a step in each parameter: in the unit box, and values."""
        unknown, beside = Box.of(dict(self.vehicle.unknown)), beside_parameters(self.effects)
        k = len(unknown)
        U = difference_points(k, 1, seed=self.seed, prior=self.prior, beside=beside)
        return U, np.hstack([unknown.from_unit(U[:, :k]), U[:, k:]])

    @property
    def _runs(self) -> int:
        """Simulations of a maneuver."""
        return len(self._draw[1]) + 1 + LANES

    def _sobol(self, dimensions: int) -> FloatArray:
        return sobol_sequence(SCREENED * dimensions, dimensions, seed=self.seed)

    def _by_cost(self) -> list[_Tried]:
        found = [one for one in self._tried.values() if one is not None]
        return sorted(found, key=lambda one: one.cost)

    def _lacks(self, one: _Tried) -> float:
        """Shortage of all vehicles, as far as it is known [m]; infinite where nothing is."""
        return one.shortage + (self._spread if one.fits is None else 0.0)

    def _place(self, one: _Tried) -> None:
        """Find the shortage, if that is not known; it stays infinite if it cannot be driven."""
        if one.place is not None:
            return
        self.simulations += LANES
        try:
            one.place = self.room.roughly_placed(self.vehicle, one.commands)
        except InfeasibleManeuver:
            one.place = Placement(0.0, 0.0, 0.0, -math.inf)
        one.shortage = self.room.needed - one.place.clearance

    def _fits(self, one: _Tried) -> bool:
        """Whether all vehicles of the ranges fit; where they do not, the spread is learnt."""
        if one.fits is None and one.place is not None and self._lacks(one) <= 0.0:
            self.simulations += VEHICLES
            try:
                shortage = self.room.lacks(self.vehicle, one.commands, one.place)
            except InfeasibleManeuver:
                shortage = math.inf
            one.fits = shortage <= 0.0
            if not one.fits:
                # no more room than that is looked for
                self._spread = min(max(self._spread, shortage - one.shortage), ALLOWANCE)
                one.shortage = shortage
        return bool(one.fits)


def _apart(u: FloatArray, others: Sequence[FloatArray], distance: float) -> bool:
    return all(np.abs(u - other).max() >= distance for other in others)
