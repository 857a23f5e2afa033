"""Kriging (Gaussian-process regression) as the paper uses it, fitted fast and reliably.

n: samples, k: unknown parameters. Inputs are meant to be scaled to the unit box.
"""

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import lapack
from scipy.optimize import minimize
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, WhiteKernel
from sklearn.utils.validation import check_X_y

from excitation_planner.box import FloatArray


class Kriging(GaussianProcessRegressor):
    """Gaussian-process regressor with constant mean, ARD-Gaussian kernel and fitted nugget.

    Differs from its base class in the fit alone: mean and variance are profiled out of the
    likelihood in closed form, length scales and nugget follow from its analytic gradient by
    L-BFGS-B from one start. Prediction, sampling and scoring are scikit-learn's.

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
        scale = y.std()
        if scale <= 1e-14 * np.abs(y).max():
            raise ValueError(f"the output is constant ({y[0]:g}): nothing to model")
        standardised = (y - y.mean()) / scale

        k = X.shape[1]
        log_bounds = np.log([self.length_scale_bounds] * k + [self.nugget_bounds])
        start = np.clip(np.log([1.0] * k + [1e-6]), log_bounds[:, 0], log_bounds[:, 1])
        theta = minimize(
            _profiled_likelihood,
            start,
            args=(X, standardised),
            jac=True,
            method="L-BFGS-B",
            bounds=log_bounds,
            options={"ftol": 1e-8, "maxiter": 100},
        ).x
        self.length_scale_: FloatArray = np.exp(theta[:k])
        self.nugget_ = float(np.exp(theta[k]))
        self.kernel_ = RBF(self.length_scale_) + WhiteKernel(self.nugget_)

        # the attributes that GaussianProcessRegressor predicts from (R&W Alg. 2.1)
        self.n_features_in_ = k
        self.X_train_ = X
        self.L_, self.inverse_, mean, variance = _profile(self.kernel_(X), standardised)
        self.mean_ = float(y.mean() + scale * mean)
        self.deviation_ = float(scale * np.sqrt(variance))
        self._y_train_mean, self._y_train_std = self.mean_, self.deviation_
        self.y_train_ = (y - self.mean_) / self.deviation_
        self.alpha_: FloatArray = self.inverse_ @ self.y_train_
        self.log_marginal_likelihood_value_ = float(
            -0.5 * self.y_train_ @ self.alpha_
            - np.log(np.diag(self.L_)).sum()
            - 0.5 * len(y) * np.log(2 * np.pi)
        )
        return self

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


def _profile(K: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, float, float]:
    """Cholesky factor and inverse of K (n, n), and mean and variance profiled for y (n,)."""
    factor, failed = lapack.dpotrf(K, lower=1, clean=1)
    if failed:
        raise np.linalg.LinAlgError("correlation matrix is not positive definite")
    triangle, _ = lapack.dpotri(factor, lower=1)
    inverse = triangle + np.tril(triangle, -1).T
    inverse_sum = inverse.sum(axis=1)
    mean = float(inverse_sum @ y / inverse_sum.sum())
    residual = y - mean
    return factor, inverse, mean, float(residual @ inverse @ residual) / len(y)


def _profiled_likelihood(
    theta: FloatArray, X: FloatArray, y: FloatArray
) -> tuple[float, FloatArray]:
    """Negative profiled log-likelihood and its gradient at theta = log (length scales, nugget)."""
    n, k = X.shape
    length_scale, nugget = np.exp(theta[:k]), np.exp(theta[k])
    R = RBF(length_scale)(X)
    try:
        factor, inverse, mean, variance = _profile(R + nugget * np.eye(n), y)
    except np.linalg.LinAlgError:
        return 1e25, np.zeros(k + 1)
    value = 0.5 * n * np.log(variance) + np.log(np.diag(factor)).sum()
    # d(-log L) = 1/2 tr[(K^-1 - b b'/s²) dK] with b = K^-1 (y - mean)   (R&W Eq. 5.9)
    b = inverse @ (y - mean)
    W = inverse - np.outer(b, b / variance)
    gradient = np.empty(k + 1)
    gradient[k] = 0.5 * nugget * np.trace(W)
    # dR/d log l_j = R (x_i - x_i')²/l_j²; the sum over i, i' needs no (n, n, k) array
    W *= R
    Z = (X - X.mean(axis=0)) / length_scale
    gradient[:k] = W.sum(axis=1) @ Z**2 - np.einsum("ij,ij->j", Z, W @ Z)
    return float(value), gradient
