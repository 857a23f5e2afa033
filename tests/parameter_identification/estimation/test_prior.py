"""Priors in their units and in the ranges."""

import numpy as np
import pytest
from simulated_drives import NAMES, VEHICLE

from parameter_identification.estimation.prior import GaussianPrior, box_prior
from tricycle_core.errors import IdentificationError


def test_a_range_is_a_gaussian_of_its_variance():
    prior = box_prior(VEHICLE, None)
    np.testing.assert_array_equal(prior.mean, 0.5)
    np.testing.assert_allclose(prior.information, 12.0 * np.eye(len(NAMES)))


def test_a_prior_replaces_the_ranges_of_its_parameters():
    prior = GaussianPrior(("yaw_inertia", "mass"), np.array([35.0, 1.0]), np.diag([25.0, 1.0]))
    known = box_prior(VEHICLE, prior)
    mean, information = known.mean, known.information
    i = NAMES.index("yaw_inertia")
    low, high = VEHICLE.unknown["yaw_inertia"]
    assert mean[i] == pytest.approx((35.0 - low) / (high - low))
    assert information[i, i] == pytest.approx((high - low) ** 2 / 25.0)
    others = np.delete(np.arange(len(NAMES)), i)
    np.testing.assert_allclose(np.diag(information)[others], 12.0)
    assert known.std[i] == pytest.approx(5.0 / (high - low))


def test_a_prior_must_be_one():
    with pytest.raises(IdentificationError, match="positive definite"):
        GaussianPrior(("yaw_inertia",), np.array([50.0]), np.array([[0.0]]))
    with pytest.raises(IdentificationError, match=r"needs mean \(1,\)"):
        GaussianPrior(("yaw_inertia",), np.array([50.0, 1.0]), np.array([[1.0]]))
    with pytest.raises(IdentificationError, match="named twice: yaw_inertia, yaw_inertia"):
        GaussianPrior(("yaw_inertia", "yaw_inertia"), np.array([50.0, 40.0]), np.eye(2))
    misspelt = GaussianPrior(("yaw_intertia",), np.array([50.0]), np.eye(1))
    with pytest.raises(IdentificationError, match="prior: yaw_intertia: tricycle has no such"):
        box_prior(VEHICLE, misspelt)
