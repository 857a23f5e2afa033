"""Errors of estimates by repetition: the fitted vehicle is simulated, measured and fitted.

What is done to measurements before the fit, such as smoothing a speed from positions, may err alike
in all drives. No term of the fit counts that; simulated drives that are treated in the same way
show it.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from parameter_identification.drives.measured import MeasuredDrive, Sensor
from parameter_identification.estimation.interval_correction import student_factor
from parameter_identification.estimation.noise import NoiseLevel
from parameter_identification.estimation.optimum import Optimum
from parameter_identification.estimation.problem import LeastSquares, Loss
from parameter_identification.estimation.results import in_range
from tricycle_core.quantities import FloatArray

REPEATS = 8

Redraw = Callable[
    [Mapping[str, float], Mapping[Sensor, NoiseLevel], np.random.Generator],
    Sequence[MeasuredDrive],
]
"""Drives as a vehicle with such parameters and sensors could have given them."""


def bootstrap_deviations(
    problem: LeastSquares,
    optimum: Optimum,
    redraw: Redraw,
    *,
    loss: Loss,
    level: float,
    seed: int,
    count: Callable[[], None],
) -> FloatArray:
    """Return the standard deviations (k,) that give intervals of a level, by repeating the fit.

    They are root mean squares of the estimates' errors, common errors included, about the
    parameters that the drives were redrawn with; and wider by Student's t, as the repeats are few.

    Parameters
    ----------
    problem : LeastSquares
        Problem of n variables, k of them parameters, set to the noise of the fit.
    optimum : Optimum
        The fit.
    redraw : callable
        Gives drives anew.
    loss : Loss
        Cost of a residual.
    level : float
        Probability of the intervals.
    seed : int
        Seed of the noise of the redrawn drives.
    count : callable
        Called after each repeat.

    References
    ----------
    B. Efron, R. J. Tibshirani, An Introduction to the Bootstrap, 1993, section 6.5.
    """
    like, at = problem.models[0], optimum.fit.at
    ranges = like.vehicle.unknown.items()
    parameters = {n: in_range(r, float(z)) for (n, r), z in zip(ranges, at, strict=False)}
    errors = np.empty((REPEATS, problem.k))
    for repeat in range(REPEATS):
        models = [
            like.of(drive)
            for drive in redraw(parameters, problem.noise, np.random.default_rng([seed, repeat]))
        ]
        with LeastSquares(models, problem.mean, problem.information, loss) as again:
            start = again.variables.beginning(at[: problem.k])
            # the drives were redrawn with these parameters
            again.set_weights(problem.noise, problem.sizes.by_name(), start)
            # without the range, which would cut errors off
            found = again.quadratic(again.minimise(start).at).minimum()
            errors[repeat] = found[: problem.k] - at[: problem.k]
        count()
    return np.asarray(student_factor(REPEATS, level) * np.sqrt(np.mean(errors**2, axis=0)))
