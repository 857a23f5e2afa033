"""Search of the operation box for the cheapest maneuver, as generators.

A search yields points X (b, l) of the unit box, receives their costs (b,), infinite where the
maneuver cannot be driven, and ends by returning. Who drives it decides where the costs come from:
an executor, a study on disk, or a function in the same process; the points of one batch are
independent of each other.
"""

from __future__ import annotations

from collections.abc import Generator
from enum import StrEnum

import numpy as np
from scipy.optimize import direct, minimize

from excitation_planner.box import FloatArray, sobol_sequence
from excitation_planner.kriging import Kriging

SearchSteps = Generator[FloatArray, FloatArray, None]

_STARTS = 4  # local searches side by side
_FIRST_RADIUS = 0.2
_LAST_RADIUS = 2e-3


class Search(StrEnum):
    """How the second stage looks for the cheapest maneuver."""

    ADAPTIVE = "adaptive"  # corners and Sobol' points, then trust regions from the best of them
    DIRECT = "direct"  # DIRECT on the cost itself
    ONE_SHOT_SOBOL = "one-shot-sobol"  # the paper: 2k Kriging models over a Sobol' sequence
    ONE_SHOT_FACTORIAL = "one-shot-factorial"  # the same over a c-level full factorial


def adaptive_search(l: int, *, points: int, seed: int) -> SearchSteps:  # noqa: E741
    """Corners and Sobol' points of the l-dimensional unit box, then trust regions from the best.

    Optima often lie on faces, which DIRECT never samples: hence the corners. A trust region that
    has converged makes room for a new one, from the best point far from all earlier starts.
    """
    X = np.vstack([_corners(l, seed=seed), sobol_sequence(16, l, seed=seed)])[:points]
    costs = yield X
    begun, regions = X[:0], list[_TrustRegion]()
    while len(X) < points:
        regions = _still_searching(regions)
        while len(regions) < _STARTS:
            start = _best_apart(X, costs, begun, apart=0.25)
            if start is None:
                break
            regions.append(_TrustRegion(X[start], float(costs[start])))
            begun = np.vstack([begun, X[start]])
        if not regions:
            return
        proposed = np.array([region.propose(X, costs) for region in regions])[: points - len(X)]
        new_costs = yield proposed
        for region, x, cost in zip(regions, proposed, new_costs, strict=False):
            region.update(x, float(cost))
        X, costs = np.vstack([X, proposed]), np.concatenate([costs, new_costs])


def direct_search(l: int, *, points: int) -> SearchSteps:  # noqa: E741
    """DIRECT on the cost itself, over a box widened by a quarter and clipped: it sees faces."""
    known: dict[bytes, float] = {}
    while True:
        missing: list[FloatArray] = []

        def cost(z: FloatArray, missing: list[FloatArray] = missing) -> float:
            x = np.clip(z, 0.0, 1.0)
            if x.tobytes() not in known:
                missing.append(x)
                raise _MissingError
            value = known[x.tobytes()]
            return value if np.isfinite(value) else 1e12

        # DIRECT calls back: it is run again from the start until it asks for something unknown
        try:
            direct(
                cost, [(-0.125, 1.125)] * l, maxfun=points, maxiter=points, vol_tol=0, len_tol=1e-4
            )
        except _MissingError:
            if len(known) == points:
                return
            costs = yield np.array(missing)
            known[missing[0].tobytes()] = float(costs[0])
        else:
            return


class _MissingError(Exception):
    """DIRECT has asked for a cost that is not known yet."""


def _corners(l: int, *, seed: int) -> FloatArray:  # noqa: E741
    """At most 16 corners of the unit box: all of them up to l = 4, a random choice beyond."""
    if l <= 4:
        numbers = np.arange(2**l)[:, None]
        corners: FloatArray = ((numbers >> np.arange(l)) & 1).astype(float)
        return corners
    return np.random.default_rng(seed).integers(0, 2, size=(16, l)).astype(float)


def _best_apart(
    X: FloatArray, costs: FloatArray, others: FloatArray, *, apart: float
) -> int | None:
    """Index of the cheapest point at least ``apart`` on some axis from each of the others."""
    for i in np.argsort(costs, kind="stable"):
        if not np.isfinite(costs[i]):
            return None
        if len(others) == 0 or np.abs(X[i] - others).max(axis=1).min() >= apart:
            return int(i)
    return None


class _TrustRegion:
    """Local search that minimises a Kriging model of the cost within a shrinking box."""

    def __init__(self, x: FloatArray, cost: float) -> None:
        self.x, self.cost = x, cost
        self.radius = _FIRST_RADIUS
        self._predicted = cost

    def propose(self, X: FloatArray, costs: FloatArray) -> FloatArray:
        l = len(self.x)  # noqa: E741
        usable = np.flatnonzero(np.isfinite(costs))
        distance = np.abs(X[usable] - self.x).max(axis=1)
        near = usable[np.argsort(distance, kind="stable")[: 12 * l]]
        y = costs[near]
        scale = max(1e-6, float(np.abs(X[near] - self.x).max()))
        low = np.clip(self.x - self.radius, 0.0, 1.0)
        high = np.clip(self.x + self.radius, 0.0, 1.0)
        if np.ptp(y) <= 1e-12:
            middle: FloatArray = (low + high) / 2
            return middle
        model = Kriging(length_scale_bounds=(0.2, 50.0)).fit((X[near] - self.x) / scale, y)

        def mean(x: FloatArray) -> FloatArray:
            value: FloatArray = model.predict((np.atleast_2d(x) - self.x) / scale)
            return value

        candidates = np.vstack([self.x[None], low + (high - low) * sobol_sequence(256, l)])
        start = candidates[np.argmin(mean(candidates))]
        best: FloatArray = minimize(
            lambda x: mean(x)[0], start, method="L-BFGS-B", bounds=list(zip(low, high, strict=True))
        ).x
        best = np.clip(best, low, high)
        if np.abs(X - best).max(axis=1).min() < 0.05 * self.radius:
            # nothing to learn where the cost is known: the candidate farthest from what is known
            gap = np.abs(candidates[:, None] - X[near]).max(axis=2).min(axis=1)
            best = candidates[np.argmax(gap)]
        self._predicted = float(mean(best)[0])
        return best

    def update(self, x: FloatArray, cost: float) -> None:
        gained, promised = self.cost - cost, self.cost - self._predicted
        if gained > 0:
            self.x, self.cost = x, cost
        if gained <= 0.1 * promised or promised <= 0:
            self.radius *= 0.5
        elif gained >= 0.7 * promised:
            self.radius = min(2 * self.radius, 2 * _FIRST_RADIUS)


def _still_searching(regions: list[_TrustRegion]) -> list[_TrustRegion]:
    """Regions that have neither converged nor run into a better one."""
    kept: list[_TrustRegion] = []
    for region in sorted(regions, key=lambda region: region.cost):
        clear = all(np.abs(region.x - other.x).max() > 0.05 for other in kept)
        if region.radius >= _LAST_RADIUS and clear:
            kept.append(region)
    return kept


def search_steps(search: Search, l: int, *, points: int, seed: int) -> SearchSteps:  # noqa: E741
    """Return the search of this name over l operation parameters, of at most ``points`` points."""
    if search is Search.DIRECT:
        return direct_search(l, points=points)
    return adaptive_search(l, points=points, seed=seed)
