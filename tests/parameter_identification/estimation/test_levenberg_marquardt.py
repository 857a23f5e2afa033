"""Minima of sums of squares that are not quadratic."""

import numpy as np
import pytest

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
        free=np.array([True]), rough=np.array([False]), samples=1000, tolerance=0.01,
    )  # fmt: skip
    assert found.cost < 81.0 * stiffness**2 / (1.0 + stiffness**2) + 0.2
