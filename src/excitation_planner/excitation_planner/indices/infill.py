"""Infill: where to simulate next to improve a Kriging model."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from excitation_planner.choice import Choice
from excitation_planner.indices.kriging import Kriging, amplitudes
from excitation_planner.indices.sampling import all_corners, sobol_sequence, training_points
from excitation_planner.indices.sobol import effects
from tricycle_core.quantities import FloatArray

_CANDIDATES = 1024  # at least, twice the points that are asked for
_REFERENCE = 2048  # points of the integrals of the criterion by index variance


class Infill(Choice):
    """Criterion by which an infill point is chosen."""

    LARGEST_VARIANCE = "largest-variance"  # the paper's Algorithm 1
    INTEGRATED_VARIANCE = "integrated-variance"  # IMSE
    INDEX_VARIANCE = "index-variance"  # of the parts of the output that Sobol' indices are made of


def infill_points(
    model: Kriging,
    *,
    by: Infill,
    batch: int = 1,
    seed: int = 0,
    avoid: FloatArray | None = None,
    polish: bool = True,
) -> FloatArray:
    """Return the next points (batch, k) of the unit box to simulate at.

    The variance does not depend on outputs, so a batch is chosen one point after the other, each
    counted as known when the next one is looked for.

    Parameters
    ----------
    model : Kriging
        Metamodel, fitted on the unit box.
    by : Infill
        Criterion by which the points are chosen.
    batch : int
        Number of points.
    seed : int
        Seed of the candidates.
    avoid : ndarray of float, shape (q, k), optional
        Points not in the model that count as known, e.g. those of failed simulations.
    polish : bool
        Whether the largest variance is looked for beyond the candidates, which takes O(n³) per
        point: too long with thousands of samples.
    """
    k = model.X_train_.shape[1]
    known = model.X_train_ if avoid is None else np.vstack([model.X_train_, avoid])
    count = max(_CANDIDATES, 2 * batch)
    sobol = sobol_sequence(count, k, seed=seed)
    # above ten dimensions the corners would outnumber the other candidates
    at_corners = all_corners(k) if k <= 10 else np.empty((0, k))
    candidates = np.vstack([sobol, at_corners])
    if by is Infill.LARGEST_VARIANCE and polish:
        for _ in range(batch):
            new = _largest_variance(_Posterior(model, known), candidates)
            known = np.vstack([known, new])
        return known[-batch:]
    if by is Infill.INTEGRATED_VARIANCE:
        reference, weights = sobol[:_CANDIDATES], np.eye(_CANDIDATES)
    elif by is Infill.INDEX_VARIANCE:
        candidates = np.vstack([training_points(count, k, seed=seed), at_corners])
        reference = sobol_sequence(_REFERENCE, k, seed=seed + 1)
        # the error of a variance, of a main or of a total effect is to first order the integral of
        # the model's error, weighted with that effect
        weights = effects(model, reference)
    else:
        reference, weights = sobol[:1], np.zeros((1, 1))
    return candidates[
        _greedy(_Posterior(model, known), candidates, reference, weights, by=by, batch=batch)
    ]


def _greedy(
    posterior: _Posterior,
    candidates: FloatArray,
    reference: FloatArray,
    weights: FloatArray,
    *,
    by: Infill,
    batch: int,
) -> list[int]:
    """Candidates taken one after the other, by pivoted Cholesky factorisation of their covariance.

    ``weights`` (q, r) at the reference points (r, k) make linear functionals of the output; each
    candidate lowers the sum of their variances by the squares of its covariances with them.
    """
    v = posterior.whitened(candidates)
    variance = posterior.prior(candidates) - np.einsum("nc,nc->c", v, v)
    cross = posterior.kernel(candidates, reference) - v.T @ posterior.whitened(reference)
    covariance = cross @ weights.T  # (c, q)
    columns = np.empty((len(candidates), batch))
    chosen: list[int] = []
    for i in range(batch):
        left = np.maximum(variance, 1e-12)
        gain = left if by is Infill.LARGEST_VARIANCE else np.sum(covariance**2, axis=1) / left
        gain[chosen] = -1.0
        c = int(np.argmax(gain))
        deviation = np.sqrt(left[c] + posterior.nugget)
        column = posterior.kernel(candidates, candidates[c : c + 1])[:, 0] - v.T @ v[:, c]
        column = (column - columns[:, :i] @ columns[c, :i]) / deviation
        covariance -= np.outer(column, covariance[c] / deviation)
        variance -= column**2
        columns[:, i] = column
        chosen.append(c)
    return chosen


class _Posterior:
    """Variance of a Kriging model given known points (n, k), as a share of the process variance."""

    def __init__(self, model: Kriging, known: FloatArray) -> None:
        self._model = model
        self._known = known
        self.nugget = model.nugget_
        K = self.kernel(known, known) + model.nugget_ * np.eye(len(known))
        self._factor = np.linalg.cholesky(K)

    def kernel(self, A: FloatArray, B: FloatArray) -> FloatArray:
        return self._model.covariances(A, B)

    def whitened(self, U: FloatArray) -> FloatArray:
        """Covariances (n, u) with the known points, divided by their Cholesky factor."""
        v: FloatArray = solve_triangular(self._factor, self.kernel(self._known, U), lower=True)
        return v

    def prior(self, U: FloatArray) -> FloatArray:
        """Variance (u,) without any known point."""
        share: FloatArray = amplitudes(U, self._model.amplitude_) ** 2
        return share

    def variance(self, U: FloatArray) -> FloatArray:
        v = self.whitened(U)
        share: FloatArray = self.prior(U) - np.einsum("na,na->a", v, v)
        return share

    def negative_variance(self, u: FloatArray) -> tuple[float, FloatArray]:
        """Minus the variance at u (k,) and its gradient."""
        kernel = self.kernel(self._known, u[None])[:, 0]
        v = solve_triangular(self._factor, kernel, lower=True)
        weights = solve_triangular(self._factor, v, lower=True, trans="T") * kernel
        prior = float(self.prior(u[None])[0])
        c, d = self._model.amplitude_
        gradient = -2.0 * weights @ ((u - self._known) / self._model.length_scale_**2)
        gradient += 2.0 * (float(v @ v) - prior) * (2.0 * c + 4.0 * d * (2.0 * u - 1.0))
        return float(v @ v) - prior, gradient


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
