"""Sensitivity of a simulator at one operating point: first stage of the method (Algorithm 1).

n: samples, k: unknown parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from excitation_planner.box import Bounds, Box
from excitation_planner.indices.figure import draw_indices
from excitation_planner.indices.infill import Infill, infill_points
from excitation_planner.indices.kriging import Kriging
from excitation_planner.indices.sampling import check_seed, parameter_samples
from excitation_planner.indices.sobol import Indices, sobol_indices
from excitation_planner.indices.threads import THREADPOOLS
from tricycle_core.errors import DesignError, InfeasibleManeuver
from tricycle_core.optional import optional, own_axes
from tricycle_core.quantities import FloatArray

_FOLDS = 5
_LARGEST = 1e150  # output: its square is finite, and the square of its inverse is not 0
# Half width of a 95 % interval, in root mean squares of what changes when a fifth of the samples is
# left out: benchmarks/sobol.py measures the coverage. Posterior deviations are far too small for
# smooth outputs.
_FOLD_HALF_WIDTH = 2.2


@dataclass(frozen=True)
class Sensitivity(Indices):
    """Sobol' indices of a simulator, with the metamodel that they come from.

    Attributes
    ----------
    names : tuple of str, length k
        The unknown parameters, in the order of all arrays.
    main_interval, total_interval : ndarray of float, shape (k, 2)
        95 % intervals of `main` and `total`: by how much they change without a fifth of the
        samples, and as if each parameter could explain all or none of what is unexplained.
    folds : tuple of Indices
        Indices without a fifth of the samples, each fifth in turn, of fewer than five without one;
        the intervals follow from them. All 0 where the other samples have the same output.
    unknown : Box
        Ranges of the unknown parameters.
    model : Kriging
        The metamodel, fitted on the unit box; `predict` takes parameters in their own units.
    leave_one_out_q2 : float
        Share of the output's variance that the metamodel predicts at samples left out.
    unexplained : float
        The rest of the variance, adjusted for the number of fitted hyperparameters.
    simulations : int
        Number of samples simulated.
    failed : int
        Number of samples that gave NaN or infinity and were left out.
    """

    names: tuple[str, ...]
    main_interval: FloatArray
    total_interval: FloatArray
    folds: tuple[Indices, ...]
    unknown: Box
    model: Kriging
    leave_one_out_q2: float
    unexplained: float
    simulations: int
    failed: int

    def __repr__(self) -> str:
        rows = zip(
            *(self.names, self.main, self.main_interval, self.total, self.total_interval),
            strict=True,
        )
        width = max(map(len, self.names))
        return "\n".join(
            [
                f"Sensitivity from {self.simulations} simulations, Q² = {self.leave_one_out_q2:.4f}"
                "; index and 95 % interval",
                *(
                    f"  {name:{width}}  S {s:.3f} ({a:.3f} to {b:.3f})"
                    f"  ST {st:.3f} ({c:.3f} to {d:.3f})"
                    for name, s, (a, b), st, (c, d) in rows
                ),
            ]
        )

    def to_dataframe(self) -> Any:
        """Return the indices as a pandas DataFrame, a row per unknown parameter.

        Raises
        ------
        ReportError
            If pandas is not installed.
        """
        return optional("pandas", "to_dataframe").DataFrame(
            {
                "main": self.main,
                "main_low": self.main_interval[:, 0],
                "main_high": self.main_interval[:, 1],
                "total": self.total,
                "total_low": self.total_interval[:, 0],
                "total_high": self.total_interval[:, 1],
            },
            index=list(self.names),
        )

    def plot(self, axes: Any = None) -> Any:
        """Draw the indices with their intervals; return the matplotlib Axes.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            Drawn on; default: those of a new figure.

        Raises
        ------
        ReportError
            If matplotlib is not installed.
        """
        axes = own_axes() if axes is None else axes
        draw_indices(
            axes, self.names, (self.main, self.main_interval), (self.total, self.total_interval)
        )
        return axes

    def predict(self, P: FloatArray) -> FloatArray:
        """Output (n,) that the metamodel predicts at parameters P (n, k)."""
        m: FloatArray = self.model.predict(self.unknown.to_unit(P))
        return m


def sensitivity(
    f: Callable[[FloatArray], FloatArray],
    unknown: Box | Bounds,
    *,
    samples: int = 200,
    seed: int = 0,
    infill: int = 0,
    infill_by: Infill = Infill.INTEGRATED_VARIANCE,
    batch: int = 1,
) -> Sensitivity:
    """Sobol' indices of f over the box of the unknown parameters.

    Parameters
    ----------
    f : callable
        Simulator: parameters P (n, k) to outputs (n,); NaN marks a failed simulation.
    unknown : Box or dict
        Unknown parameters ``{name: (low, high)}``, uniform and independent.
    samples : int
        Simulations to train the metamodel on, at least k + 2. Two thirds fill the box; the others
        go, in a second call of f, where by a first metamodel the indices gain most.
    seed : int
        Scrambles the sample points.
    infill : int
        Further simulations, chosen by ``infill_by``.
    infill_by : Infill
        Criterion by which infill points are chosen.
    batch : int
        How many of them are run at once before the metamodel is fitted again.

    Raises
    ------
    DesignError
        If samples are too few, f raises or gives the wrong shape, the output is constant, or too
        many simulations failed.

    Examples
    --------
    The Ishigami function; exact: S = (.314, .442, 0), ST = (.558, .442, .244).

    >>> from excitation_planner.indices.analytic import ISHIGAMI_UNKNOWN, ishigami
    >>> result = sensitivity(ishigami, ISHIGAMI_UNKNOWN, samples=400)
    >>> result.main.round(2), result.total.round(2)
    (array([0.31, 0.44, 0.  ]), array([0.56, 0.44, 0.24]))
    """
    unknown, infill_by = Box.of(unknown), Infill(infill_by)
    check_seed(seed)
    if batch < 1 or infill < 0:
        raise DesignError(f"infill = {infill}, batch = {batch}: 0 or more, in batches of 1 or more")
    with THREADPOOLS.limit(limits=1):
        filling = max(len(unknown) + 2, samples * 2 // 3)
        all_filling = parameter_samples(unknown, samples, seed=seed)
        U = all_filling[:filling]
        m = call_simulator(f, unknown.from_unit(U))
        model = None
        valid = np.isfinite(m)
        # an output that is constant so far may move elsewhere
        if filling < samples and valid.any() and is_constant(m[valid]):
            rest = all_filling[filling:]
            U, m = all_filling, np.concatenate([m, call_simulator(f, unknown.from_unit(rest))])
        while len(U) < samples + infill:
            first = len(U) < samples
            model = fit_metamodel(U, m, start=model)
            new = infill_points(
                model,
                by=Infill.INDEX_VARIANCE if first else infill_by,
                batch=samples - len(U) if first else min(batch, samples + infill - len(U)),
                seed=seed + len(U),
                avoid=U[~np.isfinite(m)],  # failed points stay failed
            )
            U = np.vstack([U, new])
            m = np.concatenate([m, call_simulator(f, unknown.from_unit(new))])
        return sensitivity_of_outputs(unknown, U, m, start=model)


def call_simulator(f: Callable[[FloatArray], FloatArray], P: FloatArray) -> FloatArray:
    """Return f(P) as floats (n,), its shape checked.

    Parameters
    ----------
    f : callable
        Simulator f(x, P).
    P : ndarray of float, shape (n, k)
        Unknown parameters.
    """
    try:
        returned = f(P)
    except (DesignError, InfeasibleManeuver):
        raise
    except Exception as error:
        raise DesignError(f"f raised {type(error).__name__}: {error}") from error
    m = real_outputs(returned)
    if m.shape != (len(P),):
        raise DesignError(
            f"f returned shape {m.shape} for {len(P)} samples; it must be ({len(P)},)"
        )
    return m


def real_outputs(returned: Any) -> FloatArray:
    """Return what a simulator gave as a contiguous array; NaN where it is masked.

    Sums over it do not depend on where it comes from then.

    Parameters
    ----------
    returned : array_like
        Real numbers.
    """
    try:
        numbers: Any = np.ma.asanyarray(returned)
    except (TypeError, ValueError) as error:
        raise DesignError(f"f must return real numbers: {error}") from error
    if numbers.dtype.kind not in "biuf":
        raise DesignError(f"f must return real numbers, NaN where it failed; not {numbers.dtype}")
    return np.asarray(np.ma.filled(numbers.astype(float), np.nan), order="C")


def sensitivity_of_outputs(
    unknown: Box, U: FloatArray, m: FloatArray, *, start: Kriging | None = None
) -> Sensitivity:
    """Return the sensitivity from outputs.

    Parameters
    ----------
    unknown : Box
        Unknown parameters.
    U : ndarray of float, shape (n, k)
        Points of the unit box.
    m : ndarray of float, shape (n,)
        Outputs at these points; NaN where the simulation failed.
    start : Kriging, optional
        Model with hyperparameters to start from, as in `fit_metamodel`.

    Raises
    ------
    DesignError
        As `check_outputs`.
    """
    with THREADPOOLS.limit(limits=1):
        model, failed = fit_metamodel(U, m, start=start), int(np.sum(~np.isfinite(m)))
        return sensitivity_of_model(unknown, model, sobol_indices(model), failed=failed)


def fit_metamodel(U: FloatArray, m: FloatArray, *, start: Kriging | None = None) -> Kriging:
    """Return the Kriging model of outputs, failed ones left out.

    Parameters
    ----------
    U : ndarray of float, shape (n, k)
        Points of the unit box.
    m : ndarray of float, shape (n,)
        Outputs there; NaN where failed.
    start : Kriging, optional
        Model of some of them, whose hyperparameters the fit may start from.

    Raises
    ------
    DesignError
        As `check_outputs`.
    """
    check_outputs(U, m)
    valid = np.isfinite(m)
    return Kriging().fit(U[valid], m[valid], start=start)


def check_outputs(U: FloatArray, m: FloatArray) -> None:
    """Refuse outputs that no metamodel can be fitted to.

    Parameters
    ----------
    U : ndarray of float, shape (n, k)
        Points of the unit box.
    m : ndarray of float, shape (n,)
        Outputs there; NaN where failed.

    Raises
    ------
    DesignError
        If too many simulations failed, or the output is constant.
    """
    valid = np.isfinite(m)
    if valid.sum() < U.shape[1] + 2:
        raise DesignError(
            f"{len(m) - valid.sum()} of {len(m)} simulations failed; "
            f"{U.shape[1] + 2} valid ones are needed for {U.shape[1]} unknown parameters"
        )
    most = np.abs(m[valid]).max()
    if most > _LARGEST:
        raise DesignError(f"an output is {most:g}: {_LARGEST:g} at most, choose another unit")
    if is_constant(m[valid]):
        raise DesignError(
            f"the output is constant ({m[valid][0]:g} in {valid.sum()} samples): none of the "
            "unknown parameters moves it"
        )
    if (spread := np.ptp(m[valid])) < 1.0 / _LARGEST:
        raise DesignError(
            f"the outputs differ by {spread:g}: {1.0 / _LARGEST:g} at least, choose another unit"
        )


def is_constant(m: FloatArray) -> bool:
    """Return whether outputs differ by no more than round-off.

    Parameters
    ----------
    m : ndarray of float, shape (n,)
        Outputs, finite.
    """
    return bool(np.ptp(m) <= 1e-12 * np.abs(m).max())


def sensitivity_of_model(
    unknown: Box, model: Kriging, indices: Indices, *, failed: int
) -> Sensitivity:
    """Return the sensitivity from a metamodel and its indices.

    Parameters
    ----------
    unknown : Box
        Unknown parameters.
    model : Kriging
        Metamodel on the unit box.
    indices : Indices
        Sobol' indices of the metamodel.
    failed : int
        Number of samples that were left out.
    """
    n, k = model.X_train_.shape
    count = min(_FOLDS, n)
    fold = np.arange(n) % count
    folds = tuple(_indices_without(model, fold == i) for i in range(count))
    q2 = model.leave_one_out_q2()
    # as in the adjusted R²: what is left out was seen when the hyperparameters were fitted
    spare = n - k - 2 - np.count_nonzero(model.amplitude_)
    unexplained = min((1.0 - q2) * n / spare, 1.0) if spare > 0 else 1.0
    main_half = fold_half_width(np.array([f.main for f in folds]) - indices.main)
    total_half = fold_half_width(np.array([f.total for f in folds]) - indices.total)
    return Sensitivity(
        main=indices.main,
        total=indices.total,
        variance=indices.variance,
        names=unknown.names,
        main_interval=_interval(indices.main, main_half, unexplained),
        total_interval=_interval(indices.total, total_half, unexplained),
        folds=folds,
        unknown=unknown,
        model=model,
        leave_one_out_q2=q2,
        unexplained=unexplained,
        simulations=n + failed,
        failed=failed,
    )


def _indices_without(model: Kriging, left_out: NDArray[np.bool_]) -> Indices:
    """Indices without some of the samples (n,); all 0 where the output is constant without them."""
    y = model.y_train_
    if np.ptp(y[~left_out]) <= 1e-12 * np.ptp(y):
        nothing = np.zeros(model.X_train_.shape[1])
        return Indices(main=nothing, total=nothing, variance=0.0)
    return sobol_indices(model.without(left_out))


def fold_half_width(changes: FloatArray) -> FloatArray:
    """Return the half width of a 95 % interval, by what folds change.

    Parameters
    ----------
    changes : ndarray of float, shape (folds, ...)
        Differences that leaving out a fold makes.
    """
    half: FloatArray = _FOLD_HALF_WIDTH * np.sqrt(np.mean(changes**2, axis=0))
    return half


def _interval(index: FloatArray, half: FloatArray, unexplained: float) -> FloatArray:
    """Intervals (k, 2) within [0, 1] of indices (k,) of what a metamodel explains."""
    none = (1.0 - unexplained) * index
    ends = np.stack([none - half, none + unexplained + half], axis=1)
    return np.asarray(np.clip(ends, 0.0, 1.0))
