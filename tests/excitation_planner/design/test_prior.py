"""What is no prior."""

import numpy as np
import pytest

from excitation_planner import BoxPrior
from excitation_planner.design.prior import UNIFORM_STD
from tricycle_core.errors import DesignError


@pytest.mark.parametrize(
    "covariance", [np.zeros((2, 2)), np.eye(3), np.array([[1.0, 2.0], [2.0, 1.0]])]
)
def test_an_impossible_prior_is_refused(covariance):
    with pytest.raises(DesignError, match="prior"):
        BoxPrior(np.array([0.5, 0.5]), covariance)


def test_the_standard_deviation_is_marginal_and_the_information_the_inverse():
    assert BoxPrior.uniform(2).std == pytest.approx(UNIFORM_STD)
    assert BoxPrior.uniform(2).information == pytest.approx(12.0 * np.eye(2))
    prior = BoxPrior(np.array([0.5, 0.5]), np.array([[0.04, 0.027], [0.027, 0.0225]]))
    assert prior.std == pytest.approx([0.2, 0.15])
    assert prior.covariance @ prior.information == pytest.approx(np.eye(2))
