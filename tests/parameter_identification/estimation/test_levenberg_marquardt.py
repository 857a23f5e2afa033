"""Minima of sums of squares that are not quadratic."""

import numpy as np
import pytest

from parameter_identification.estimation import levenberg_marquardt
from parameter_identification.estimation.levenberg_marquardt import minimum_of
from parameter_identification.estimation.quadratic import Quadratic


@pytest.mark.parametrize("stiffness", [3.0, 30.0, 1000.0])
def test_a_stiff_kink_does_not_end_the_search_before_it(stiffness):
    """One variable is drawn to 10, and from 1 on held back as by a stiff spring."""

    def quadratic(v):
        beyond = max(v[0] - 1.0, 0.0)
        columns = np.array([[1.0, v[0] - 10.0], [stiffness * (beyond > 0.0), stiffness * beyond]])
        return Quadratic.of_gram(v, columns.T @ columns)

    found = minimum_of(
        quadratic, np.zeros(1), (np.array([-100.0]), np.array([100.0])),
        free=np.array([True]), rough=np.array([False]), own=np.array([False]), drives=1,
        samples=1000, tolerance=0.01,
    )  # fmt: skip
    assert found.cost < 81.0 * stiffness**2 / (1.0 + stiffness**2) + 0.2


@pytest.mark.parametrize(
    ("steep", "steps", "own", "converged"),
    [
        (1.0, 50, False, True),
        (1.0, 3, False, False),
        (10.0, 50, False, False),
        (30.0, 50, False, False),
        (30.0, 50, True, True),  # where one variable is a drive's own, and follows the other
        (1000.0, 50, True, True),
    ],
)
def test_a_search_that_is_given_up_says_so(monkeypatch, steep, steps, own, converged):
    """In the curved valley of Rosenbrock's function: too few steps, and none of use."""

    def quadratic(v):
        x, y = v
        valley = steep * np.array([-2.0 * x, 1.0, y - x**2])
        columns = np.array([valley, [-1.0, 0.0, 1.0 - x]])
        return Quadratic.of_gram(v, columns.T @ columns)

    monkeypatch.setattr(levenberg_marquardt, "MAX_STEPS", steps)
    found = minimum_of(
        quadratic, np.array([-3.0, 9.0]), (np.full(2, -10.0), np.full(2, 10.0)),
        free=np.ones(2, dtype=bool), rough=np.zeros(2, dtype=bool), own=np.array([False, own]),
        drives=1, samples=1000, tolerance=0.01,
    )  # fmt: skip
    assert found.converged == converged
    assert (np.abs(found.at - 1.0).max() < 0.2) == converged
