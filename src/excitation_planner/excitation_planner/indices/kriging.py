"""Kriging (Gaussian-process regression) as the paper uses it, fitted fast and reliably.

n: samples, k: unknown parameters. Inputs are meant to be scaled to the unit box.
"""

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack
from scipy.optimize import minimize
from sklearn.base import clone
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, Sum, WhiteKernel
from sklearn.utils.validation import check_X_y

from tricycle_core.quantities import FloatArray

_STARTS = (0.15, 0.3, 0.6, 1.2, 2.4)  # length scales that the fit may start from
_IMPOSSIBLE = 1e25  # negative log-likelihood of a matrix that cannot be factorised


class Kriging(GaussianProcessRegressor):
    """Gaussian-process regressor with constant mean, ARD-Gaussian kernel and fitted nugget.

    Differs from its base class in the fit alone: mean and variance are profiled out of the
    likelihood in closed form, length scales and nugget follow from its analytic gradient by
    L-BFGS-B. Prediction, sampling and scoring are scikit-learn's.

    Parameters
    ----------
    length_scale_bounds : (float, float)
        Limits of every length scale, in units of the inputs.
    nugget_bounds : (float, float)
        Limits of the nugget, as a share of the process variance.

    Attributes
    ----------
    kernel_ : RBF + WhiteKernel
        Fitted correlation kernel (unit variance).
    alpha_ : ndarray (n,)
        Weights of the samples in the mean, for outputs scaled by the process deviation.
    inverse_ : ndarray (n, n)
        Inverse of the correlation matrix.
    length_scale_ : ndarray (k,)
    nugget_ : float
    mean_, deviation_ : float
        Profiled mean and standard deviation of the process, in units of the output.

    Source: Rasmussen and Williams (2006), Eqs. 2.23-2.24, 5.9; Sacks et al. (1989), Sec. 4.
    """

    def __init__(
        self,
        *,
        length_scale_bounds: tuple[float, float] = (0.05, 50.0),
        nugget_bounds: tuple[float, float] = (1e-12, 1e-3),
    ) -> None:
        super().__init__(optimizer=None)
        self.length_scale_bounds = length_scale_bounds
        self.nugget_bounds = nugget_bounds

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Fit to inputs X (n, k) and outputs y (n,).

        Raises
        ------
        ValueError
            NaN or infinite numbers, or a constant output: there is nothing to model.
        """
        X, y = check_X_y(X, y, y_numeric=True, ensure_min_samples=2)
        X, y = np.asarray(X, dtype=float), np.asarray(y, dtype=float)
        if y.std() <= 1e-14 * np.abs(y).max():
            raise ValueError(f"the output is constant ({y[0]:g}): nothing to model")
        standardised = (y - y.mean()) / y.std()

        k = X.shape[1]
        log_bounds = np.log([self.length_scale_bounds] * k + [self.nugget_bounds])
        # started from the likeliest of a few length scales, the same on all axes: a single start
        # takes a wavy function for noise
        starts = [
            np.clip(np.log([length_scale] * k + [1e-6]), log_bounds[:, 0], log_bounds[:, 1])
            for length_scale in _STARTS
        ]
        theta = minimize(
            _profiled_likelihood,
            min(starts, key=lambda theta: _profiled_likelihood(theta, X, standardised)[0]),
            args=(X, standardised),
            jac=True,
            method="L-BFGS-B",
            bounds=log_bounds,
            options={"ftol": 1e-8, "maxiter": 100},
        ).x
        kernel = RBF(np.exp(theta[:k])) + WhiteKernel(np.exp(theta[k]))
        return self._fit_process(X, y, kernel)

    def _fit_process(self, X: FloatArray, y: FloatArray, kernel: Sum) -> Self:
        """Mean, variance and weights for given hyperparameters (R&W Alg. 2.1)."""
        self.kernel_ = kernel
        self.length_scale_: FloatArray = np.atleast_1d(kernel.k1.length_scale)
        self.nugget_ = float(kernel.k2.noise_level)
        self.n_features_in_ = X.shape[1]
        self.X_train_ = X
        shift, scale = y.mean(), y.std()
        self.L_, mean, variance, weights = _profile(kernel(X), (y - shift) / scale)
        self.inverse_ = _inverse(self.L_)
        self.mean_ = float(shift + scale * mean)
        self.deviation_ = float(scale * np.sqrt(variance))
        self._y_train_mean, self._y_train_std = self.mean_, self.deviation_
        self.y_train_ = (y - self.mean_) / self.deviation_
        self.alpha_: FloatArray = weights / np.sqrt(variance)
        self.log_marginal_likelihood_value_ = float(
            -0.5 * self.y_train_ @ self.alpha_
            - np.log(np.diag(self.L_)).sum()
            - 0.5 * len(y) * np.log(2 * np.pi)
        )
        return self

    def conditioned_on(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Return a model of inputs X (n, k) and outputs y (n,) with these hyperparameters."""
        model: Self = clone(self)
        return model._fit_process(
            np.asarray(X, dtype=float), np.asarray(y, dtype=float), self.kernel_
        )

    def without(self, left_out: NDArray[np.bool_]) -> Self:
        """Return this model without some of its samples (n,), hyperparameters kept."""
        y = self.mean_ + self.deviation_ * self.y_train_
        return self.conditioned_on(self.X_train_[~left_out], y[~left_out])

    def leave_one_out(self) -> tuple[FloatArray, FloatArray]:
        """Residuals (n,) and predicted deviations (n,) with each sample left out in turn.

        In closed form at the fitted hyperparameters, mean re-estimated (Dubrule 1983).
        """
        inverse_sum = self.inverse_.sum(axis=1)  # K^-1 1
        diagonal = np.diag(self.inverse_) - inverse_sum**2 / inverse_sum.sum()
        return self.deviation_ * self.alpha_ / diagonal, self.deviation_ / np.sqrt(diagonal)

    def leave_one_out_q2(self) -> float:
        """Share of the output's variance predicted with each sample left out: 1 is perfect."""
        residual, _ = self.leave_one_out()
        y = self.y_train_ * self.deviation_
        return float(1 - np.sum(residual**2) / np.sum((y - y.mean()) ** 2))


def _profile(K: FloatArray, y: FloatArray) -> tuple[FloatArray, float, float, FloatArray]:
    """Cholesky factor of K (n, n); mean, variance and K^-1 (y - mean) (n,), profiled for y (n,).

    By triangular solves: the explicit inverse of an ill-conditioned K would not reproduce y.
    """
    factor, failed = lapack.dpotrf(K, lower=1, clean=1)
    if failed:
        raise np.linalg.LinAlgError("correlation matrix is not positive definite")
    solved, _ = lapack.dpotrs(factor, np.stack([np.ones_like(y), y], axis=1), lower=1)
    mean = float(solved[:, 1].sum() / solved[:, 0].sum())
    weights = solved[:, 1] - mean * solved[:, 0]
    return factor, mean, float((y - mean) @ weights) / len(y), weights


def _inverse(factor: FloatArray) -> FloatArray:
    """Inverse of the matrix with this lower Cholesky factor (n, n)."""
    triangle, _ = lapack.dpotri(factor, lower=1)
    inverse: FloatArray = triangle + np.tril(triangle, -1).T
    return inverse


def _profiled_likelihood(
    theta: FloatArray, X: FloatArray, y: FloatArray
) -> tuple[float, FloatArray]:
    """Negative profiled log-likelihood and its gradient at theta = log (length scales, nugget)."""
    n, k = X.shape
    length_scale, nugget = np.exp(theta[:k]), np.exp(theta[k])
    R = RBF(length_scale)(X)
    try:
        factor, _, variance, b = _profile(R + nugget * np.eye(n), y)
    except np.linalg.LinAlgError:
        return _IMPOSSIBLE, np.zeros(k + 1)
    if not variance > 0:  # lost to round-off
        return _IMPOSSIBLE, np.zeros(k + 1)
    value = 0.5 * n * np.log(variance) + np.log(np.diag(factor)).sum()
    # d(-log L) = 1/2 tr[(K^-1 - b b'/s²) dK] with b = K^-1 (y - mean)   (R&W Eq. 5.9)
    W = _inverse(factor) - np.outer(b, b / variance)
    gradient = np.empty(k + 1)
    gradient[k] = 0.5 * nugget * np.trace(W)
    # dR/d log l_j = R (x_i - x_i')²/l_j²; the sum over i, i' needs no (n, n, k) array
    W *= R
    Z = (X - X.mean(axis=0)) / length_scale
    gradient[:k] = W.sum(axis=1) @ Z**2 - np.einsum("ij,ij->j", Z, W @ Z)
    return float(value), gradient
