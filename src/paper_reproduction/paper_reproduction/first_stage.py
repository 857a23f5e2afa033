"""The first stage at one operating point, the paper's way and ours.

n: samples, k: unknown parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from excitation_planner.box import Box
from excitation_planner.indices.infill import Infill, infill_points
from excitation_planner.indices.kriging import Kriging
from excitation_planner.indices.sampling import sobol_sequence
from excitation_planner.indices.sensitivity import sensitivity
from excitation_planner.indices.sobol import Indices, monte_carlo_indices
from excitation_planner.indices.threads import THREADPOOLS
from paper_reproduction import published
from paper_reproduction.comparison import ErrorStatistics, error_statistics
from tricycle_core.quantities import FloatArray

_FITTED_ON = 500  # samples that the hyperparameters of a large model are fitted on
_BLOCK = 2000  # points predicted at once


@dataclass(frozen=True)
class PaperBudget:
    """Simulations by `--faithful` at each operating point of the tricycle.

    Attributes
    ----------
    initial, infill : int
        Simulations by Sobol' sequence and where the Kriging variance is largest (Algorithm 1).
        The paper stops the infill once the largest variance is at most 0.01 of the mean one, which
        cannot be: a largest value is never below the mean. So all of them are spent.
    monte_carlo : int
        Base samples N of Eqs. 7-10 on the metamodel; the paper does not say how many.
    levels : int
        Levels per axis of the second stage's full factorial; the paper does not give them.
    """

    initial: int = published.INITIAL_SAMPLES
    infill: int = published.INFILL_SAMPLES
    monte_carlo: int = 2**14
    levels: int = 5


@dataclass(frozen=True)
class OurBudget:
    """Simulations by our own method.

    Attributes
    ----------
    samples : int
        Simulations per operating point in the screening, in Fig. 13 and, on the math model, at the
        points that the second stage is trained on. Bars of indices have 300.
    validation : int
        Random points at which the metamodels of Figs. 5 and 13 predict as well.
    design_runs : int
        Simulations per design on the math model.
    search_samples : mapping of int to int
        Simulations per maneuver of a search on the tricycle, by the number of unknown parameters.
    maneuvers : int
        Number of maneuvers evaluated per search on the tricycle.
    """

    samples: int = 200
    validation: int = published.FIG_5_VALIDATION
    design_runs: int = 25_000
    search_samples: Mapping[int, int] = field(default_factory=lambda: {2: 40, 6: 100})
    maneuvers: int = 100


@dataclass(frozen=True)
class FirstStage:
    """Metamodel and indices at one operating point.

    Attributes
    ----------
    indices : Indices
        Sobol' indices of the metamodel.
    validation : ndarray of float, shape (2, v)
        Predicted and true outputs at random points.
    simulations : int
        Samples that the metamodel was trained on.
    """

    indices: Indices
    validation: FloatArray
    simulations: int


Function = Callable[[FloatArray], FloatArray]  # P (n, k) -> (n,)


def fast(
    f: Function, unknown: Box, *, samples: int, validation: int = 0, seed: int = 0
) -> FirstStage:
    """Return the first stage by our method: `sensitivity`.

    Parameters
    ----------
    f : callable
        Simulator, from points P (n, k) to outputs (n,).
    unknown : Box
        Unknown parameters.
    samples : int
        Simulations to train the metamodel on.
    validation : int
        Random points at which it predicts as well.
    seed : int
        Seed of the samples.
    """
    with THREADPOOLS.limit(limits=1):
        result = sensitivity(f, unknown, samples=samples, seed=seed)
        trained_on = result.simulations - result.failed
        return FirstStage(result, _validate(result.model, f, unknown, validation), trained_on)


def faithful(f: Function, unknown: Box, *, budget: PaperBudget, validation: int = 0) -> FirstStage:
    """Return the first stage by Algorithm 1 and Eqs. 7-10, as the paper has them.

    How it fits Kriging is not said: here by maximum likelihood on the first 500 samples, as good
    as on all of them and hours faster.

    Parameters
    ----------
    f : callable
        Simulator, from points P (n, k) to outputs (n,).
    unknown : Box
        Unknown parameters.
    budget : PaperBudget
        Budget of the paper's method.
    validation : int
        Random points at which the metamodel predicts as well.
    """
    k = len(unknown)
    with THREADPOOLS.limit(limits=1):
        U = sobol_sequence(budget.initial, k, seed=None)
        U, m = _without_failed(U, f(unknown.from_unit(U)))
        # thousands of samples of a smooth output need a nugget to be factorised at all
        fitted = Kriging(nugget_bounds=(1e-8, 1e-3)).fit(U[:_FITTED_ON], m[:_FITTED_ON])
        model = fitted.conditioned_on(U, m)
        if budget.infill:
            new = infill_points(
                model, by=Infill.LARGEST_VARIANCE, batch=budget.infill, polish=False
            )
            new, m_new = _without_failed(new, f(unknown.from_unit(new)))
            U, m = np.vstack([U, new]), np.concatenate([m, m_new])
            model = fitted.conditioned_on(U, m)
        indices = monte_carlo_indices(
            lambda V: in_blocks(model.predict, V), k, samples=budget.monte_carlo
        )
        return FirstStage(indices, _validate(model, f, unknown, validation), len(U))


@dataclass(frozen=True)
class Predictions:
    """Predicted and true outputs at validation points.

    Attributes
    ----------
    unit : str
        Unit of the outputs.
    validation : dict of str to ndarray, shape (2, v)
        Predicted and true outputs, by label.
    statistics : dict of str to ErrorStatistics
        Error statistics, by label.
    """

    unit: str
    validation: dict[str, FloatArray]
    statistics: dict[str, ErrorStatistics]


def predictions(stages: dict[str, FirstStage], unit: str) -> Predictions:
    """Return the error statistics of each first stage's validation.

    Parameters
    ----------
    stages : dict of str to FirstStage
        First stages, by label.
    unit : str
        Unit of the outputs.
    """
    return Predictions(
        unit,
        {label: stage.validation for label, stage in stages.items()},
        {label: error_statistics(*stage.validation) for label, stage in stages.items()},
    )


def _without_failed(U: FloatArray, m: FloatArray) -> tuple[FloatArray, FloatArray]:
    valid = np.isfinite(m)
    return U[valid], m[valid]


def _validate(model: Kriging, f: Function, unknown: Box, points: int) -> FloatArray:
    """Predicted and true outputs (2, points) at random points."""
    if not points:
        return np.empty((2, 0))
    U = np.random.default_rng(1).uniform(size=(points, len(unknown)))
    U, m = _without_failed(U, f(unknown.from_unit(U)))
    return np.array([in_blocks(model.predict, U), m])


def in_blocks(predict: Function, U: FloatArray) -> FloatArray:
    """Predict in blocks: all at once would need n times the samples in memory.

    Parameters
    ----------
    predict : callable
        Function from points (n, k) to outputs (n,).
    U : ndarray of float, shape (n, k)
        Points.
    """
    blocks = [predict(U[i : i + _BLOCK]) for i in range(0, len(U), _BLOCK)]
    return np.concatenate(blocks)
