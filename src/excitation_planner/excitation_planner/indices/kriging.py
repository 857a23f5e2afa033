"""Kriging (Gaussian-process regression) as the paper uses it, fitted fast and reliably.

n: samples, k: unknown parameters. Inputs are meant to be scaled to the unit box.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any, Literal, Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack, solve_triangular
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

from tricycle_core.quantities import FloatArray

_STARTS = (0.15, 0.3, 0.6, 1.2, 2.4)  # length scales that the fit may start from
_POOR = 0.9  # share of the variance of samples left out, below which a fit is tried again
_WAVY, _STRAIGHT = (0.05, 0.08, 0.13, 0.2), 2.0  # those of one axis, and of the others, tried later
_NOISES = (1e-6, 0.1)  # nuggets of these later starts
_MOST_NOISE = 100.0  # nugget of their fit, as a share of the process variance
_AMPLITUDE_BOUND = 2.0  # of the coefficients of the amplitude
_AMPLITUDE_PRIOR = 0.25  # their standard deviation a priori
_SAMPLES_PER_HYPERPARAMETER = 5
_IMPOSSIBLE = 1e25  # negative log-likelihood of a matrix that cannot be factorised


class Kriging:
    """Gaussian-process regressor with constant mean, modulated ARD-Gaussian kernel, fitted nugget.

    The process is a stationary one times an amplitude, so that the output may vary more in one part
    of the box than in another. Mean and variance are profiled out of the likelihood in closed form;
    length scales, amplitude and nugget follow from its analytic gradient by L-BFGS-B.
    Source: Rasmussen and Williams (2006), Eqs. 2.23-2.24, 5.9; Sacks et al. (1989), Sec. 4.

    Parameters
    ----------
    length_scale_bounds : (float, float)
        Limits of every length scale, in units of the inputs.
    nugget_bounds : (float, float)
        Limits of the nugget, as a share of the process variance. Where the fit predicts less than
        90 % of the variance of samples left out, the output is noisy or has waves that the fit took
        for noise: it is tried again, from more starts and with a nugget of up to 100.

    Attributes
    ----------
    X_train_, y_train_ : ndarray of float, shape (n, k) and (n,)
        Samples; the outputs less the mean, divided by the process deviation.
    length_scale_ : ndarray of float, shape (k,)
        Fitted length scales, in units of the inputs.
    nugget_ : float
        Fitted nugget, as a share of the process variance.
    amplitude_ : ndarray of float, shape (2, k)
        Fitted coefficients c, d of the amplitude exp(sum of c_j t_j + d_j t_j²), t = 2u - 1.
    mean_, deviation_ : float
        Profiled mean and standard deviation of the stationary process, in units of the output.
    alpha_ : ndarray of float, shape (n,)
        Weights of the samples in the mean, for outputs divided by the process deviation.
    L_ : ndarray of float, shape (n, n)
        Lower Cholesky factor of the correlation matrix.
    inverse_ : ndarray of float, shape (n, n)
        Inverse of the correlation matrix.
    """

    def __init__(
        self,
        *,
        length_scale_bounds: tuple[float, float] = (0.05, 50.0),
        nugget_bounds: tuple[float, float] = (1e-12, 1e-3),
    ) -> None:
        self.length_scale_bounds = length_scale_bounds
        self.nugget_bounds = nugget_bounds

    def fit(self, X: ArrayLike, y: ArrayLike, *, start: Self | None = None) -> Self:
        """Fit hyperparameters and model.

        Parameters
        ----------
        X : array_like of float, shape (n, k)
            Inputs.
        y : array_like of float, shape (n,)
            Outputs.
        start : Kriging, optional
            A model with hyperparameters to start from, unless others are likelier.

        Raises
        ------
        ValueError
            If shapes do not fit, a number is not finite, or the output is constant.
        """
        X, y = _checked(X, y)
        standardised, k = (y - y.mean()) / y.std(), X.shape[1]
        # a constant amplitude where there are few samples: they would fit it to chance
        enough = len(X) > _SAMPLES_PER_HYPERPARAMETER * (3 * k + 1)
        bound = np.full(2 * k, _AMPLITUDE_BOUND if enough else 0.0)
        low, high = (
            np.concatenate([np.full(k, np.log(length_scale)), sign * bound, [np.log(nugget)]])
            for length_scale, nugget, sign in zip(
                self.length_scale_bounds, self.nugget_bounds, (-1, 1), strict=True
            )
        )
        # started from the likeliest of a few length scales, the same on all axes: a single start
        # takes a wavy function for noise
        starts = [
            _theta(np.full(k, length_scale), np.zeros(2 * k), 1e-6) for length_scale in _STARTS
        ]
        if start is not None:
            starts.append(_theta(start.length_scale_, start.amplitude_, start.nugget_))

        def likeliest(starts: list[FloatArray]) -> Any:
            return minimize(
                _objective,
                min(
                    np.clip(starts, low, high),
                    key=lambda theta: _likelihood(theta, X, standardised) + _prior(theta, k),
                ),
                args=(X, standardised),
                jac=True,
                method="L-BFGS-B",
                bounds=np.stack([low, high], axis=1),
                # with an amplitude, further steps take longer and make no index more accurate
                options={"ftol": 1e-5, "maxiter": 25} if enough else {"ftol": 1e-8, "maxiter": 100},
            )

        optimum = likeliest(starts)
        self._fit_at(optimum.x, X, y)
        if self.leave_one_out_q2() < _POOR:
            high[-1] = np.log(_MOST_NOISE)
            tried = [likeliest(_later_starts(k, nugget)) for nugget in _NOISES]
            self._fit_at(min([optimum, *tried], key=lambda result: result.fun).x, X, y)
        return self

    def _fit_at(self, theta: FloatArray, X: FloatArray, y: FloatArray) -> None:
        k = X.shape[1]
        self.fit_process(
            X,
            y,
            length_scale=np.exp(theta[:k]),
            amplitude=theta[k : 3 * k].reshape(2, k),
            nugget=float(np.exp(theta[3 * k])),
        )

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[False] = False) -> FloatArray: ...

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[True]) -> tuple[FloatArray, FloatArray]: ...

    def predict(
        self, X: ArrayLike, return_std: bool = False
    ) -> FloatArray | tuple[FloatArray, FloatArray]:
        """Return the mean (q,), and the standard deviation (q,) of the output where asked for.

        Parameters
        ----------
        X : array_like of float, shape (q, k)
            Inputs.
        return_std : bool
            Whether the standard deviation is returned as well; it contains the nugget.
        """
        X = np.asarray(X, dtype=float)
        covariance = self.covariances(X, self.X_train_)
        mean: FloatArray = self.deviation_ * (covariance @ self.alpha_) + self.mean_
        if not return_std:
            return mean
        v = solve_triangular(self.L_, covariance.T, lower=True, check_finite=False)
        known = np.einsum("ij,ij->j", v, v)
        variance = np.maximum(amplitudes(X, self.amplitude_) ** 2 + self.nugget_ - known, 0.0)
        return mean, np.sqrt(variance * self.deviation_**2)

    def fit_process(
        self,
        X: FloatArray,
        y: FloatArray,
        *,
        length_scale: FloatArray,
        amplitude: FloatArray,
        nugget: float,
    ) -> Self:
        """Fit mean and variance for given hyperparameters (R&W Alg. 2.1).

        Parameters
        ----------
        X : ndarray of float, shape (n, k)
            Inputs.
        y : ndarray of float, shape (n,)
            Outputs.
        length_scale : ndarray of float, shape (k,)
            Length scales, in units of the inputs.
        amplitude : ndarray of float, shape (2, k)
            Coefficients of the amplitude.
        nugget : float
            Nugget variance, as a share of the process variance.
        """
        self.length_scale_, self.amplitude_, self.nugget_ = length_scale, amplitude, nugget
        self.X_train_ = X
        shift, scale = y.mean(), y.std()
        self.L_, mean, variance, weights = _profile(
            _with_nugget(_covariance_matrix(X, length_scale, amplitude), nugget),
            (y - shift) / scale,
        )
        self.inverse_ = _inverse(self.L_)
        self.mean_ = float(shift + scale * mean)
        self.deviation_ = float(scale * np.sqrt(variance))
        self.y_train_ = (y - self.mean_) / self.deviation_
        self.alpha_: FloatArray = weights / np.sqrt(variance)
        return self

    def conditioned_on(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Return a model of other samples with these hyperparameters.

        Parameters
        ----------
        X : array_like of float, shape (n, k)
            Inputs.
        y : array_like of float, shape (n,)
            Outputs.
        """
        model = type(self)(
            length_scale_bounds=self.length_scale_bounds, nugget_bounds=self.nugget_bounds
        )
        return model.fit_process(
            np.asarray(X, dtype=float),
            np.asarray(y, dtype=float),
            length_scale=self.length_scale_,
            amplitude=self.amplitude_,
            nugget=self.nugget_,
        )

    def without(self, left_out: NDArray[np.bool_]) -> Self:
        """Return this model without some of its samples (n,), hyperparameters kept."""
        y = self.mean_ + self.deviation_ * self.y_train_
        return self.conditioned_on(self.X_train_[~left_out], y[~left_out])

    def covariances(self, A: FloatArray, B: FloatArray) -> FloatArray:
        """Return the covariances (a, b) of points with other points, as shares of deviation_².

        Parameters
        ----------
        A, B : ndarray of float, shape (a, k) and (b, k)
            Points.
        """
        squared = cdist(A / self.length_scale_, B / self.length_scale_, "sqeuclidean")
        a, b = amplitudes(A, self.amplitude_), amplitudes(B, self.amplitude_)
        found: FloatArray = a[:, None] * np.exp(-0.5 * squared) * b
        return found

    def leave_one_out(self) -> tuple[FloatArray, FloatArray]:
        """Return residuals (n,) and predicted deviations (n,) with each sample left out in turn.

        In closed form at the fitted hyperparameters, mean re-estimated (Dubrule 1983).
        """
        inverse_sum = self.inverse_.sum(axis=1)  # K^-1 1
        diagonal = np.diag(self.inverse_) - inverse_sum**2 / inverse_sum.sum()
        return self.deviation_ * self.alpha_ / diagonal, self.deviation_ / np.sqrt(diagonal)

    def leave_one_out_q2(self) -> float:
        """Return the share of the output's variance predicted with each sample left out."""
        residual, _ = self.leave_one_out()
        y = self.y_train_ * self.deviation_
        return float(1 - np.sum(residual**2) / np.sum((y - y.mean()) ** 2))


def _checked(X: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Samples (n, k) and outputs (n,) as arrays; ValueError where nothing can be fitted to them."""
    X, y = np.asarray(X, dtype=float), np.asarray(y, dtype=float)
    if X.ndim != 2 or y.shape != (len(X),) or len(X) < 2:
        raise ValueError(f"X must be (n, k) and y (n,), n >= 2; they are {X.shape}, {y.shape}")
    if not (np.isfinite(X).all() and np.isfinite(y).all()):
        raise ValueError("X and y must not contain NaN or infinite numbers")
    if y.std() <= 1e-14 * np.abs(y).max():
        raise ValueError(f"the output is constant ({y[0]:g}): nothing to model")
    return X, y


def _theta(length_scale: FloatArray, amplitude: FloatArray, nugget: float) -> FloatArray:
    """Hyperparameters (3 k + 1,) as the fit varies them, see `profiled_likelihood`."""
    return np.concatenate([np.log(length_scale), amplitude.ravel(), [np.log(nugget)]])


def amplitudes(U: FloatArray, amplitude: FloatArray) -> FloatArray:
    """Return the amplitude (n,) of a process.

    Parameters
    ----------
    U : ndarray of float, shape (n, k)
        Points.
    amplitude : ndarray of float, shape (2, k)
        Coefficients of the amplitude.
    """
    t = 2.0 * U - 1.0
    found: FloatArray = np.exp(t @ amplitude[0] + t**2 @ amplitude[1])
    return found


def _covariance_matrix(
    X: FloatArray, length_scale: FloatArray, amplitude: FloatArray
) -> FloatArray:
    """Covariances (n, n) of points X (n, k) with each other."""
    matrix = np.empty((len(X), len(X)))
    fill, _ = _compiled()
    fill(X / length_scale, amplitudes(X, amplitude), matrix)
    return matrix


@cache
def _compiled() -> tuple[Callable[..., None], Callable[..., float]]:
    """Return `_fill_covariances` and `_add_derivatives` as machine code."""
    from tricycle_sim.compilation import compiled  # takes a while

    return compiled(_fill_covariances), compiled(_add_derivatives)


def _fill_covariances(Z, a, R):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Fill R (n, n) for points Z (n, k) in units of the length scales, and amplitudes a (n,)."""
    for i in range(len(Z)):
        R[i, i] = a[i] * a[i]
        for j in range(i):
            squared = 0.0
            for axis in range(Z.shape[1]):
                squared += (Z[i, axis] - Z[j, axis]) ** 2
            R[i, j] = R[j, i] = a[i] * a[j] * math.exp(-0.5 * squared)


def _add_derivatives(  # type: ignore[no-untyped-def]  # pragma: no cover
    Z, R, inverse, b, variance, by_scale, sums
):
    """Sums over the elements of W = K^-1 - b b'/s² and of W R, in one pass; returns tr W.

    With R from `_fill_covariances`, the lower triangle of K^-1 stored by columns; adds to by_scale
    (k,) the derivatives by the logarithms of the length scales, to sums (n,) the rows of W R.
    """
    n, trace = len(Z), 0.0
    for i in range(n):
        w = inverse[i, i] - b[i] * b[i] / variance
        trace += w
        sums[i] += w * R[i, i]
        for j in range(i + 1, n):
            w = (inverse[j, i] - b[i] * b[j] / variance) * R[i, j]
            sums[i] += w
            sums[j] += w
            for axis in range(Z.shape[1]):
                by_scale[axis] += w * (Z[i, axis] - Z[j, axis]) ** 2
    return trace


def _with_nugget(R: FloatArray, nugget: float) -> FloatArray:
    """Covariances (n, n) with a nugget, in a new array as LAPACK stores it."""
    K = R.copy(order="F")
    K.reshape(-1, order="F")[:: len(K) + 1] += nugget
    return K


def _profile(K: FloatArray, y: FloatArray) -> tuple[FloatArray, float, float, FloatArray]:
    """Cholesky factor of K (n, n); mean, variance and K^-1 (y - mean) (n,), profiled for y (n,).

    By triangular solves: the explicit inverse of an ill-conditioned K would not reproduce y. K is
    overwritten.
    """
    factor, failed = lapack.dpotrf(K, lower=1, clean=1, overwrite_a=1)
    if failed:
        raise np.linalg.LinAlgError("correlation matrix is not positive definite")
    solved, _ = lapack.dpotrs(factor, np.stack([np.ones_like(y), y], axis=1), lower=1)
    mean = float(solved[:, 1].sum() / solved[:, 0].sum())
    weights = solved[:, 1] - mean * solved[:, 0]
    return factor, mean, float((y - mean) @ weights) / len(y), weights


def _inverse(factor: FloatArray) -> FloatArray:
    """Inverse of the matrix with this lower Cholesky factor (n, n)."""
    triangle, _ = lapack.dpotri(factor, lower=1)  # zeros above the diagonal, as in the factor
    inverse: FloatArray = np.add(triangle, triangle.T, order="F")
    inverse.reshape(-1, order="F")[:: len(inverse) + 1] *= 0.5
    return inverse


def _later_starts(k: int, nugget: float) -> list[FloatArray]:
    """Hyperparameters (3 k + 1,) of an output that varies along one axis faster than on others."""
    starts = []
    for axis in range(k):
        for length_scale in _WAVY:
            lengths = np.full(k, _STRAIGHT)
            lengths[axis] = length_scale
            starts.append(_theta(lengths, np.zeros(2 * k), nugget))
    return starts


def _prior(theta: FloatArray, k: int) -> float:
    """Negative logarithm of the amplitude's prior density, without its constant."""
    coefficients = theta[k : 3 * k]
    return 0.5 * float(coefficients @ coefficients) / _AMPLITUDE_PRIOR**2


def _objective(theta: FloatArray, X: FloatArray, y: FloatArray) -> tuple[float, FloatArray]:
    """Negative profiled log-likelihood less the log of the amplitude's prior, and its gradient."""
    value, gradient = profiled_likelihood(theta, X, y)
    k = X.shape[1]
    gradient[k : 3 * k] += theta[k : 3 * k] / _AMPLITUDE_PRIOR**2
    return value + _prior(theta, k), gradient


def profiled_likelihood(
    theta: FloatArray, X: FloatArray, y: FloatArray
) -> tuple[float, FloatArray]:
    """Return the negative profiled log-likelihood, without its constant, and gradient (3 k + 1,).

    Parameters
    ----------
    theta : ndarray of float, shape (3 k + 1,)
        Logarithms of the length scales, coefficients of the amplitude, logarithm of the nugget.
    X : ndarray of float, shape (n, k)
        Inputs.
    y : ndarray of float, shape (n,)
        Outputs.
    """
    k = X.shape[1]
    found = _evaluated(theta, X, y)
    if found is None:
        return _IMPOSSIBLE, np.zeros(3 * k + 1)
    value, R, factor, variance, b = found
    # d(-log L) = 1/2 tr[W dK], W = K^-1 - b b'/s² with b = K^-1 (y - mean)   (R&W Eq. 5.9)
    inverse, _ = lapack.dpotri(factor, lower=1)
    gradient, sums, t = np.zeros(3 * k + 1), np.zeros(len(X)), 2.0 * X - 1.0
    _, add = _compiled()
    # dR/d log l_j = R (x_i - x_i')²/l_j²
    trace = add(X / np.exp(theta[:k]), R, inverse, b, variance, gradient[:k], sums)
    # dR/dc_j = R (t_i + t_i'), dR/dd_j = R (t_i² + t_i'²)
    gradient[k : 2 * k] = sums @ t
    gradient[2 * k : 3 * k] = sums @ t**2
    gradient[3 * k] = 0.5 * np.exp(theta[3 * k]) * trace
    return value, gradient


def _likelihood(theta: FloatArray, X: FloatArray, y: FloatArray) -> float:
    """`profiled_likelihood` without its gradient, which takes most of the time."""
    found = _evaluated(theta, X, y)
    return _IMPOSSIBLE if found is None else found[0]


def _evaluated(
    theta: FloatArray, X: FloatArray, y: FloatArray
) -> tuple[float, FloatArray, FloatArray, float, FloatArray] | None:
    """Negative profiled log-likelihood, correlations without nugget, and of `_profile` the rest.

    None where the matrix cannot be factorised.
    """
    n, k = X.shape
    R = _covariance_matrix(X, np.exp(theta[:k]), theta[k : 3 * k].reshape(2, k))
    try:
        factor, _, variance, b = _profile(_with_nugget(R, np.exp(theta[3 * k])), y)
    except np.linalg.LinAlgError:
        return None
    if not variance > 0:  # lost to round-off
        return None
    value = 0.5 * n * np.log(variance) + np.log(np.diag(factor)).sum()
    return float(value), R, factor, variance, b
