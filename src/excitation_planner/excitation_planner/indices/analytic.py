"""Analytic test functions, whose Sobol' indices are known exactly.

Each takes points P (n, k) in its own box and returns values (n,).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from excitation_planner.box import Box
from excitation_planner.indices.sobol import Indices
from tricycle_core.quantities import FloatArray

MATH_MODEL_OPERATION = Box.of({f"x{i}": (-5.0, 0.0) for i in (1, 2, 3, 4)})
MATH_MODEL_UNKNOWN = Box.of({f"p{i}": (0.0, 1.0) for i in (1, 2, 3, 4)})
ISHIGAMI_UNKNOWN = Box.of({f"p{i}": (-np.pi, np.pi) for i in (1, 2, 3)})


def math_model(x: FloatArray, P: FloatArray) -> FloatArray:
    """Return the paper's math model (Eq. 13) with a1 = 1.

    At x = (-2, -0.5, -2, -0.5) the exact indices are S = (.0033, .0033, .2063, .2063) and
    ST = (.5798, .5798, .2220, .2220) (Table 1).

    Parameters
    ----------
    x : ndarray of float, shape (4,)
        Operation parameters.
    P : ndarray of float, shape (n, 4)
        Unknown parameters.
    """
    p1, p2, p3, p4 = P.T
    others = p3**2 + p4**2
    m: FloatArray = (
        1.0
        + np.exp(x[0] * ((p1 - 1) ** 2 + p2**2) + x[1] * others)
        + np.exp(x[2] * ((p2 - 1) ** 2 + p1**2) + x[3] * others)
    )
    return m


def ishigami(P: FloatArray, *, a: float = 7.0, b: float = 0.1) -> FloatArray:
    """Return sin p1 + a sin² p2 + b p3⁴ sin p1 (Ishigami and Homma, 1990).

    Parameters
    ----------
    P : ndarray of float, shape (n, 3)
        Points of `ISHIGAMI_UNKNOWN`.
    a, b : float
        Constants of the function.
    """
    m: FloatArray = np.sin(P[:, 0]) * (1 + b * P[:, 2] ** 4) + a * np.sin(P[:, 1]) ** 2
    return m


def ishigami_indices(*, a: float = 7.0, b: float = 0.1) -> Indices:
    """Return the exact indices of `ishigami`: S = (.3139, .4424, 0), ST = (.5576, .4424, .2437).

    Parameters
    ----------
    a, b : float
        Constants of the function.
    """
    v1 = 0.5 * (1 + b * np.pi**4 / 5) ** 2
    v2 = a**2 / 8
    v13 = b**2 * np.pi**8 * (1 / 18 - 1 / 50)
    variance = v1 + v2 + v13
    main = np.array([v1, v2, 0.0]) / variance
    total = np.array([v1 + v13, v2, v13]) / variance
    return Indices(main=main, total=total, variance=variance)


def g_function(P: FloatArray, a: FloatArray) -> FloatArray:
    """Return Sobol's G function: the product of (|4 p_i - 2| + a_i)/(1 + a_i).

    Parameters
    ----------
    P : ndarray of float, shape (n, k)
        Points of the unit box.
    a : ndarray of float, shape (k,)
        0: the parameter matters most.
    """
    m: FloatArray = np.prod((np.abs(4 * P - 2) + a) / (1 + a), axis=1)
    return m


def g_function_indices(a: FloatArray) -> Indices:
    """Return the exact indices of `g_function`.

    Parameters
    ----------
    a : ndarray of float, shape (k,)
        Constants of the function.
    """
    v = 1 / (3 * (1 + a) ** 2)  # variance of each factor, whose mean is 1
    variance = float(np.prod(1 + v) - 1)
    return Indices(
        main=v / variance, total=v * np.prod(1 + v) / (1 + v) / variance, variance=variance
    )


def quadrature_indices(
    f: Callable[[FloatArray], FloatArray], box: Box, *, nodes: int = 20
) -> Indices:
    """Return the Sobol' indices of f over a box by tensor Gauss-Legendre quadrature.

    Exact to round-off for smooth f; needs nodes^k evaluations, so for k up to 4 or 5.

    Parameters
    ----------
    f : callable
        Function from points (n, k) to outputs (n,).
    box : Box
        Ranges of the parameters.
    nodes : int
        Number of quadrature nodes per axis.
    """
    k = len(box)
    t, w = np.polynomial.legendre.leggauss(nodes)
    axis, weight = (t + 1) / 2, w / 2
    grid = np.stack(np.meshgrid(*[axis] * k, indexing="ij"), axis=-1).reshape(-1, k)
    m = f(box.from_unit(grid)).reshape([nodes] * k)

    def mean(values: FloatArray, axes: tuple[int, ...]) -> FloatArray:
        for j in sorted(axes, reverse=True):
            values = np.tensordot(values, weight, axes=(j, 0))
        return values

    everything = tuple(range(k))
    deviation = m - float(mean(m, everything))
    variance = float(mean(deviation**2, everything))
    main, total = np.empty(k), np.empty(k)
    for i in everything:
        rest = everything[:i] + everything[i + 1 :]
        main[i] = np.sum(weight * mean(deviation, rest) ** 2) / variance
        own_mean = np.expand_dims(mean(deviation, (i,)), i)
        total[i] = float(mean((deviation - own_mean) ** 2, everything)) / variance
    return Indices(main=main, total=total, variance=variance)
