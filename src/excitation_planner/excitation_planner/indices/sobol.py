"""Sobol' indices of a Kriging mean, without sampling it; and the paper's Monte-Carlo estimator.

The mean is a sum of products over axes. Projected on products of orthonormal Legendre
polynomials it has coefficients that are linear in the Kriging weights, and every index is a sum of
their squares, so that 0 <= S <= ST <= 1 holds by construction. The textbook quadratic
form in the weights cancels catastrophically for smooth outputs.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from excitation_planner.indices.kriging import Kriging, amplitudes
from excitation_planner.indices.sampling import sobol_sequence
from tricycle_core.quantities import FloatArray

_TERMS = 1000  # basis products kept per half of the axes: 10 degrees on each of 3 axes
_NEGLIGIBLE = 1e-7  # coefficient, as a share of the output's deviation, that is left out
_DEGREES = 32  # highest Legendre degree + 1 on an axis, a multiple of it for short length scales
_WAVES = 4.0  # degrees times length scale, at least


@dataclass(frozen=True)
class Indices:
    """Sobol' indices of a function of k independent uniform parameters.

    Attributes
    ----------
    main : ndarray of float, shape (k,)
        First-order indices S_i, the paper's MSI: share of the variance due to p_i alone.
    total : ndarray of float, shape (k,)
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


def sobol_indices(model: Kriging) -> Indices:
    """Return the Sobol' indices of a fitted Kriging mean (any k; measured up to 20).

    The axes are split in two halves, and the coefficients of all pairs of products are one matrix
    product. Each half holds the products of degrees that the kernel can excite most, `_TERMS` at
    most: more than a smooth output of up to six parameters has.

    Parameters
    ----------
    model : Kriging
        Metamodel, fitted on the unit box.
    """
    k = model.X_train_.shape[1]
    weights = model.deviation_ * model.alpha_
    left, right = _halves(model, weights)
    squares = ((left.E * weights) @ right.E.T) ** 2
    return _indices(squares, left.degrees, right.degrees, k)


def effects(model: Kriging, U: FloatArray) -> FloatArray:
    """Return the parts (1 + 2k, u) of the Kriging mean that the indices are made of.

    The deviation from its average; for each parameter its main effect, and all it takes part in.

    Parameters
    ----------
    model : Kriging
        Metamodel, fitted on the unit box.
    U : ndarray of float, shape (u, k)
        Points of the unit box.
    """
    k = model.X_train_.shape[1]
    weights = model.deviation_ * model.alpha_
    # kernel, and its average over the box, on each axis
    along = [_axis_kernel(model, j, U[:, j]) for j in range(k)]
    average = [_axis_projection(model, j)[0] for j in range(k)]
    mean = np.prod(average, axis=0) @ weights
    deviation = np.prod(along, axis=0) @ weights - mean
    found = [deviation]
    for j in range(k):
        rest = [axis for axis in range(k) if axis != j]
        main = (along[j] * np.prod([average[i] for i in rest], axis=0)) @ weights - mean
        without = (np.prod([along[i] for i in rest], axis=0) * average[j]) @ weights - mean
        found += [main, deviation - without]
    return np.array(found)


def _halves(model: Kriging, weights: FloatArray) -> tuple[_Half, _Half]:
    k = model.X_train_.shape[1]
    projections = [_axis_projection(model, j) for j in range(k)]
    bound = np.abs(weights).sum() * math.prod(float(np.abs(C[0]).max()) for C in projections)
    least = _NEGLIGIBLE * model.deviation_ * float(model.y_train_.std()) / bound
    split = (k + 1) // 2
    n = len(weights)
    return _half(projections[:split], n, least), _half(projections[split:], n, least)


def _half(projections: list[FloatArray], n: int, least: float) -> _Half:
    """The largest Legendre products over some axes, from their projections (degrees, n).

    The constant comes first; what may be less than the share `least` of it is left out.
    """
    degrees, size = np.zeros((1, len(projections)), dtype=int), np.ones(1)
    E = np.ones((1, n))
    for j, C in enumerate(projections):
        # how much of each degree the kernel holds bounds what the mean can hold of it
        share = np.minimum(np.abs(C).max(axis=1) / np.abs(C[0]).max(), 1.0)
        products = np.outer(size, share).ravel()
        # dropping the smallest after each axis keeps the overall largest: shares are at most 1
        kept = _largest(products, _TERMS)
        kept = kept[products[kept] >= min(least, 1.0)]
        parent, degree = np.divmod(kept, len(share))
        degrees, size, E = degrees[parent], products[kept], E[parent] * C[degree]
        degrees[:, j] = degree
    return _Half(degrees, E)


def _largest(values: FloatArray, count: int) -> NDArray[np.intp]:
    """Indices of the largest values in ascending order; of equal values the first are kept."""
    if len(values) <= count:
        return np.arange(len(values))
    smallest = np.partition(values, -count)[-count]
    above = np.flatnonzero(values > smallest)
    equal = np.flatnonzero(values == smallest)[: count - len(above)]
    return np.sort(np.concatenate([above, equal]))


@lru_cache(maxsize=8)
def _legendre(degrees: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Nodes (q,), weights (q,) on [0, 1], orthonormal Legendre polynomials there (q, degrees)."""
    t, w = np.polynomial.legendre.leggauss(2 * degrees)
    polynomials = np.asarray(np.polynomial.legendre.legvander(t, degrees - 1), dtype=np.float64)
    return (t + 1) / 2, w / 2, polynomials * np.sqrt(2 * np.arange(degrees) + 1)


def _axis_kernel(model: Kriging, j: int, t: FloatArray) -> FloatArray:
    """Factor (q, n) of the kernel along axis j between inputs t (q,) and the samples."""
    u, amplitude = model.X_train_[:, j], model.amplitude_[:, j : j + 1]
    kernel: FloatArray = np.exp(-0.5 * ((t[:, None] - u) / model.length_scale_[j]) ** 2)
    kernel *= amplitudes(t[:, None], amplitude)[:, None]
    kernel *= amplitudes(u[:, None], amplitude)
    return kernel


def _axis_projection(model: Kriging, j: int) -> FloatArray:
    """Integrals over [0, 1] of the kernel on axis j times Legendre polynomial d: (degrees, n)."""
    multiple = math.ceil(_WAVES / (_DEGREES * model.length_scale_[j]))
    t, w, polynomials = _legendre(_DEGREES * multiple)
    C: FloatArray = polynomials.T @ (w[:, None] * _axis_kernel(model, j, t))
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
    """Return the Sobol' indices of g over the unit box by the paper's estimator (Eqs. 7-10).

    Unlike those of `sobol_indices` they can leave [0, 1].

    Parameters
    ----------
    g : callable
        Points (n, k) to outputs (n,).
    k : int
        Number of parameters.
    samples : int
        N, base samples: N (k + 2) evaluations of g.
    seed : int, optional
        ``None`` is the paper's unscrambled sequence.
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
