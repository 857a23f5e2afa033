"""What is no prior."""

import numpy as np
import pytest

from excitation_planner import BoxPrior
from tricycle_core.errors import DesignError


@pytest.mark.parametrize(
    "covariance", [np.zeros((2, 2)), np.eye(3), np.array([[1.0, 2.0], [2.0, 1.0]])]
)
def test_an_impossible_prior_is_refused(covariance):
    with pytest.raises(DesignError, match="prior"):
        BoxPrior(np.array([0.5, 0.5]), covariance)
