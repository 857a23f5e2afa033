"""Points at which simulators are sampled."""

import numpy as np
import pytest
from scipy.stats import qmc

from excitation_planner import Box, DesignError
from excitation_planner.indices.direction_numbers import AXES
from excitation_planner.indices.sampling import parameter_samples, sobol_sequence, training_points


@pytest.mark.parametrize("points", [sobol_sequence, training_points])
def test_points_depend_on_the_seed_alone(points):
    first = points(100, 3, seed=0)
    assert first.shape == (100, 3)
    assert np.all((first >= 0) & (first <= 1))
    assert np.array_equal(first, points(100, 3, seed=0))
    assert not np.array_equal(first, points(100, 3, seed=1))


def test_unscrambled_sequence_starts_as_published():
    assert np.array_equal(sobol_sequence(3, 2, seed=None), [[0, 0], [0.5, 0.5], [0.75, 0.25]])


@pytest.mark.parametrize("k", [1, 2, 7, AXES, AXES + 1])
@pytest.mark.parametrize("seed", [None, 0, 3])
def test_sequence_is_that_of_scipy(k, seed):
    for exponent in (0, 1, 8):
        expected = qmc.Sobol(k, scramble=seed is not None, seed=seed).random_base2(exponent)
        assert np.array_equal(sobol_sequence(2**exponent, k, seed=seed), expected)
    assert np.array_equal(sobol_sequence(200, k, seed=seed), expected[:200])


def test_training_points_are_denser_at_the_faces():
    u = training_points(1024, 1)
    assert np.mean((u < 0.1) | (u > 0.9)) > 0.25


def test_a_metamodel_needs_two_samples_more_than_parameters():
    box = Box.of({"p": (0, 1), "q": (0, 1)})
    assert parameter_samples(box, 4, seed=0).shape == (4, 2)
    with pytest.raises(DesignError, match="samples = 3: 2 unknown parameters need 4"):
        parameter_samples(box, 3, seed=0)
