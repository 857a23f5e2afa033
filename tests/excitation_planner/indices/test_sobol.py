"""Indices and effects of a Kriging mean against quadrature of the mean itself."""

import numpy as np
import pytest

from excitation_planner import Box, Kriging
from excitation_planner.indices.analytic import quadrature_indices
from excitation_planner.indices.sampling import training_points
from excitation_planner.indices.sobol import effects, sobol_indices

NODES, WEIGHTS = np.polynomial.legendre.leggauss(14)
NODES, WEIGHTS = (NODES + 1.0) / 2.0, WEIGHTS / 2.0  # on [0, 1]


def output(U):
    """Interactions within either half of the axes, and between the halves."""
    first = np.exp(1.5 * U[:, 0]) * (0.3 + U[:, 1])
    return first + U[:, 2] * U[:, 3] ** 2 + 0.5 * np.sin(3.0 * U[:, 1] * U[:, 2])


@pytest.fixture(scope="module", params=[30, 80])  # with so many samples the amplitude varies
def model(request):
    U = training_points(request.param, 4, seed=1)
    return Kriging(length_scale_bounds=(0.3, 2.0)).fit(U, output(U))


def test_indices_are_those_of_the_mean(model):
    box = Box.of({f"p{i}": (0.0, 1.0) for i in range(4)})
    exact, found = quadrature_indices(model.predict, box, nodes=14), sobol_indices(model)
    assert found.main == pytest.approx(exact.main, abs=1e-11)
    assert found.total == pytest.approx(exact.total, abs=1e-11)
    assert found.variance == pytest.approx(exact.variance, rel=1e-11)
    assert np.all(exact.total - exact.main > 1e-3)  # every axis interacts


def test_effects_are_means_over_the_other_axes(model):
    at = np.array([[0.1, 0.8, 0.3, 0.6], [0.9, 0.2, 0.5, 0.05]])
    grid = np.stack(np.meshgrid(*[NODES] * 4, indexing="ij"), axis=-1).reshape(-1, 4)
    weight = np.prod(np.stack(np.meshgrid(*[WEIGHTS] * 4, indexing="ij")), axis=0).ravel()
    mean = weight @ model.predict(grid)
    deviation, *parts = effects(model, at)
    assert deviation == pytest.approx(model.predict(at) - mean, abs=1e-8)
    for axis, (main, total) in enumerate(zip(parts[::2], parts[1::2], strict=True)):
        for point, own, whole in zip(at, main, total, strict=True):
            fixed = grid.copy()
            fixed[:, axis] = point[axis]
            assert own == pytest.approx(weight @ model.predict(fixed) - mean, abs=1e-8)
            line = np.tile(point, (len(NODES), 1))
            line[:, axis] = NODES
            without = WEIGHTS @ model.predict(line)
            assert whole == pytest.approx(model.predict(point[None])[0] - without, abs=1e-8)
