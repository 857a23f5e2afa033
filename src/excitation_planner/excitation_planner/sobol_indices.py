"""Sobol' indices of a Kriging mean, without sampling it; and the paper's Monte-Carlo estimator.

The mean is a sum of products over axes. Projected on products of orthonormal Legendre
polynomials it has coefficients that are linear in the Kriging weights, and every index is a sum of
their squares, so that 0 <= S <= ST <= 1 holds by construction. The textbook quadratic
form in the weights cancels catastrophically for smooth outputs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from excitation_planner.box import FloatArray, sobol_sequence
from excitation_planner.kriging import Kriging

_TERMS = 1000  # basis products kept per half of the axes: 10 degrees on each of 3 axes
_INTERVAL_TERMS = 300  # the same, for the intervals
_DEGREES = 32  # highest Legendre degree + 1 on any axis


@dataclass(frozen=True)
class Indices:
    """Sobol' indices of a function of k independent uniform parameters.

    Attributes
    ----------
    main : ndarray (k,)
        First-order indices S_i, the paper's MSI: share of the variance due to p_i alone.
    total : ndarray (k,)
        Total indices ST_i, the paper's TSI: share of the variance in which p_i takes part.
    variance : float
        Variance of the output, in its unit squared.
    """

    main: FloatArray
    total: FloatArray
    variance: float


@dataclass(frozen=True)
class _Half:
    """Products of Legendre polynomials over some of the axes.

    degrees (r, a): degree on each of the a axes; E (r, n): projection of the kernel at each sample.
    """

    degrees: NDArray[np.int_]
    E: FloatArray
    length_scale: FloatArray

    def prior_covariance(self) -> FloatArray:
        """Covariance (r, r) of the coefficients of a process with this kernel, unit variance."""
        B = np.ones((len(self.degrees), len(self.degrees)))
        for j, length_scale in enumerate(self.length_scale):
            nodes, weights, polynomials = _legendre()
            C = _axis_projection(nodes, length_scale)  # (degrees, nodes)
            per_axis = (C * weights) @ polynomials
            B *= per_axis[np.ix_(self.degrees[:, j], self.degrees[:, j])]
        return B


def sobol_indices(model: Kriging) -> Indices:
    """Sobol' indices of a fitted Kriging mean over the unit box (any k; measured up to 20).

    The axes are split in two halves, and the coefficients of all pairs of products are one matrix
    product. Up to k = 6 each half holds the full tensor of degrees as far as the length scales ask
    for it; beyond, those products that the kernel can excite most.
    """
    k = model.X_train_.shape[1]
    left, right = _halves(model, terms=_TERMS)
    squares = ((left.E * (model.deviation_ * model.alpha_)) @ right.E.T) ** 2
    return _indices(squares, left.degrees, right.degrees, k)


def index_deviations(model: Kriging) -> tuple[FloatArray, FloatArray]:
    """Standard deviations (k,), (k,) of main and total index, from the posterior of the model.

    To first order an index errs by a linear functional of the model's error: with
    coefficients c and S = sum_{A} c²/V, dS = 2 sum (1_A - S) c dc / V. The variance of such a
    functional is known in closed form.
    """
    k = model.X_train_.shape[1]
    left, right = _halves(model, terms=_INTERVAL_TERMS)
    c = (left.E * (model.deviation_ * model.alpha_)) @ right.E.T
    c[0, 0] = 0.0
    variance = float(np.sum(c**2))
    B_left, B_right = left.prior_covariance(), right.prior_covariance()
    deviations = np.empty((2, k))
    only_left, only_right = np.zeros_like(c), np.zeros_like(c)
    only_left[:, 0] = only_right[0] = 1.0
    i = 0
    for half, only in ((left, only_left), (right, only_right)):
        for j in range(half.degrees.shape[1]):
            has = half.degrees[:, j] > 0
            alone = has & ~np.delete(half.degrees, j, axis=1).any(axis=1)
            for row, members in enumerate(
                (_rows(alone, half is left) * only, _rows(has, half is left))
            ):
                index = np.sum(members * c**2) / variance
                W = 2.0 * (members - index) * c / variance
                prior = np.sum(W * (B_left @ W @ B_right))
                seen = np.sum(left.E * (W @ right.E), axis=0)
                known = seen @ model.inverse_ @ seen
                deviations[row, i] = model.deviation_ * np.sqrt(max(prior - known, 0.0))
            i += 1
    return deviations[0], deviations[1]


def _rows(mask: NDArray[np.bool_], along_left: bool) -> FloatArray:
    return (mask[:, None] if along_left else mask[None, :]).astype(float)


def _halves(model: Kriging, *, terms: int) -> tuple[_Half, _Half]:
    split = (model.X_train_.shape[1] + 1) // 2
    X, length_scale = model.X_train_, model.length_scale_
    return (
        _half(X[:, :split], length_scale[:split], terms),
        _half(X[:, split:], length_scale[split:], terms),
    )


def _half(X: FloatArray, length_scale: FloatArray, terms: int) -> _Half:
    """The largest Legendre products over the axes of X (n, a); the constant comes first."""
    n, a = X.shape
    degrees, size, E = np.zeros((1, a), dtype=int), np.ones(1), np.ones((1, n))
    for j in range(a):
        C = _axis_projection(X[:, j], length_scale[j])
        # how much of each degree the kernel holds bounds what the mean can hold of it
        share = np.abs(C).max(axis=1) / np.abs(C[0]).max()
        products = np.outer(size, share).ravel()
        # dropping the smallest after each axis keeps the overall largest: shares are at most ~1
        kept = np.sort(np.argsort(-products, kind="stable")[:terms])
        parent, degree = np.divmod(kept, len(share))
        degrees, size, E = degrees[parent], products[kept], E[parent] * C[degree]
        degrees[:, j] = degree
    return _Half(degrees, E, length_scale)


@lru_cache(maxsize=1)
def _legendre() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Nodes (q,), weights (q,) on [0, 1], orthonormal Legendre polynomials there (q, degrees)."""
    t, w = np.polynomial.legendre.leggauss(2 * _DEGREES)
    polynomials = np.asarray(np.polynomial.legendre.legvander(t, _DEGREES - 1), dtype=np.float64)
    return (t + 1) / 2, w / 2, polynomials * np.sqrt(2 * np.arange(_DEGREES) + 1)


def _axis_projection(u: FloatArray, length_scale: float) -> FloatArray:
    """Integrals over [0, 1] of kernel(t, u_n) times Legendre polynomial d: (degrees, n)."""
    t, w, polynomials = _legendre()
    kernel = np.exp(-0.5 * ((t[:, None] - u) / length_scale) ** 2)
    C: FloatArray = polynomials.T @ (w[:, None] * kernel)
    return C


def _indices(
    squares: FloatArray, left: NDArray[np.int_], right: NDArray[np.int_], k: int
) -> Indices:
    """Indices from squared coefficients (r_left, r_right) of products of these degrees."""
    squares[0, 0] = 0.0  # the mean
    variance = float(squares.sum())
    main, total = np.empty(k), np.empty(k)
    i = 0
    for degrees, only, every in (
        (left, squares[:, 0], squares.sum(axis=1)),
        (right, squares[0], squares.sum(axis=0)),
    ):
        for j in range(degrees.shape[1]):
            others = np.delete(degrees, j, axis=1)
            has = degrees[:, j] > 0
            main[i] = only[has & ~others.any(axis=1)].sum() / variance
            total[i] = every[has].sum() / variance
            i += 1
    return Indices(main=main, total=total, variance=variance)


def monte_carlo_indices(
    g: Callable[[FloatArray], FloatArray], k: int, *, samples: int, seed: int | None = None
) -> Indices:
    """Sobol' indices of g: (n, k) -> (n,) over the unit box by the paper's estimator (Eqs. 7-10).

    ``samples`` rows of P and Q, hence samples (k + 2) evaluations; ``seed=None`` is the paper's
    unscrambled sequence. Unlike `sobol_indices` it can leave [0, 1].
    """
    PQ = sobol_sequence(samples, 2 * k, seed=seed)
    P, Q = PQ[:, :k], PQ[:, k:]
    g_P, g_Q = g(P), g(Q)
    variance = float(np.mean(g_P**2) - np.mean(g_P) ** 2)  # Eq. 8
    main, total = np.empty(k), np.empty(k)
    for i in range(k):
        R = P.copy()
        R[:, i] = Q[:, i]
        g_R = g(R)
        main[i] = np.mean(g_Q * (g_R - g_P)) / variance  # Eq. 9
        total[i] = np.mean((g_P - g_R) ** 2) / (2 * variance)  # Eq. 10
    return Indices(main=main, total=total, variance=variance)
