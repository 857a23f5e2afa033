"""Where to simulate next to make a Kriging model better."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

from excitation_planner.box import FloatArray, sobol_sequence
from excitation_planner.kriging import Kriging

_CANDIDATES = 1024


class Infill(StrEnum):
    """What an infill point is to reduce."""

    LARGEST_VARIANCE = "largest-variance"  # the paper's Algorithm 1
    INTEGRATED_VARIANCE = "integrated-variance"  # IMSE


def infill_points(
    model: Kriging, *, by: Infill, batch: int = 1, seed: int = 0, avoid: FloatArray | None = None
) -> FloatArray:
    """Return the next points (batch, k) of the unit box to simulate at.

    Parameters
    ----------
    avoid : ndarray (q, k), optional
        Points not in the model that count as known, e.g. those of failed simulations.

    The variance does not depend on outputs, so a batch is chosen one point after the other, each
    counted as known when the next one is looked for.
    """
    k = model.X_train_.shape[1]
    known = model.X_train_ if avoid is None else np.vstack([model.X_train_, avoid])
    candidates = np.vstack([sobol_sequence(_CANDIDATES, k, seed=seed), _corners(k)])
    chosen: list[FloatArray] = []
    for _ in range(batch):
        posterior = _Posterior(model, known)
        if by is Infill.LARGEST_VARIANCE:
            new = _largest_variance(posterior, candidates)
        else:
            new = _integrated_variance(posterior, candidates)
        chosen.append(new)
        known = np.vstack([known, new])
    return np.array(chosen)


def _corners(k: int) -> FloatArray:
    """Corners of the unit box; none above ten dimensions, where they would outnumber the rest."""
    if k > 10:
        return np.empty((0, k))
    corners: FloatArray = ((np.arange(2**k)[:, None] >> np.arange(k)) & 1).astype(float)
    return corners


class _Posterior:
    """Variance of a Kriging model given known points (n, k), as a share of the process variance."""

    def __init__(self, model: Kriging, known: FloatArray) -> None:
        self._length_scale = model.length_scale_
        self._known = known
        K = self._kernel(known, known) + model.nugget_ * np.eye(len(known))
        self._inverse = np.linalg.inv(np.linalg.cholesky(K))

    def _kernel(self, A: FloatArray, B: FloatArray) -> FloatArray:
        squared = cdist(A / self._length_scale, B / self._length_scale, "sqeuclidean")
        kernel: FloatArray = np.exp(-0.5 * squared)
        return kernel

    def variance(self, U: FloatArray) -> FloatArray:
        v = self._inverse @ self._kernel(self._known, U)
        share: FloatArray = 1.0 - np.einsum("na,na->a", v, v)
        return share

    def covariance(self, A: FloatArray, B: FloatArray) -> FloatArray:
        v_a = self._inverse @ self._kernel(self._known, A)
        v_b = self._inverse @ self._kernel(self._known, B)
        covariance: FloatArray = self._kernel(A, B) - v_a.T @ v_b
        return covariance

    def negative_variance(self, u: FloatArray) -> tuple[float, FloatArray]:
        """Minus the variance at u (k,) and its gradient."""
        kernel = self._kernel(self._known, u[None])[:, 0]
        v = self._inverse @ kernel
        weights = (self._inverse.T @ v) * kernel
        gradient = -2.0 * weights @ ((u - self._known) / self._length_scale**2)
        return float(v @ v - 1.0), gradient


def _largest_variance(posterior: _Posterior, candidates: FloatArray) -> FloatArray:
    """Point (k,) of largest variance: the four best candidates polished."""
    best = np.argsort(-posterior.variance(candidates), kind="stable")[:4]
    bounds = [(0.0, 1.0)] * candidates.shape[1]
    polished = [
        minimize(
            posterior.negative_variance, candidates[i], jac=True, method="L-BFGS-B", bounds=bounds
        )
        for i in best
    ]
    point: FloatArray = min(polished, key=lambda result: float(result.fun)).x
    return point


def _integrated_variance(posterior: _Posterior, candidates: FloatArray) -> FloatArray:
    """Candidate (k,) that lowers the variance integrated over the box most."""
    reference = candidates[:_CANDIDATES]  # the Sobol' part: uniform over the box
    covariance = posterior.covariance(candidates, reference)
    variance = np.maximum(posterior.variance(candidates), 1e-15)
    reduction = np.einsum("cr,cr->c", covariance, covariance) / variance
    point: FloatArray = candidates[np.argmax(reduction)]
    return point
