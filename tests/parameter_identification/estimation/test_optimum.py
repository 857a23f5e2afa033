"""The best of several fits, and which others are rivals."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import least_squares

from parameter_identification.estimation.levenberg_marquardt import Fit
from parameter_identification.estimation.optimum import find_optimum
from parameter_identification.estimation.quadratic import Quadratic
from parameter_identification.estimation.variables import ProblemVariables

VALLEY = np.array([1.0, 1.0]) / np.sqrt(2.0)  # along it the cost hardly rises
INFORMATION = 1e4 * np.eye(2) - (1e4 - 4.0) * np.outer(VALLEY, VALLEY)


class Valleys:
    """Two parameters; a search ends where it comes into the nearest of some valleys."""

    k = n = 2
    variables = ProblemVariables(2, [[]], 0)

    def __init__(self, starts, bottoms):
        self.noise = {}
        self.starts, self.bottoms = map(np.array, (starts, bottoms))

    def candidates(self, count, seed):
        return list(self.starts)

    def minimise(self, start, free=None, *, tolerance=0.01):
        across = np.array([1.0, -1.0]) / np.sqrt(2.0)
        bottom = min(self.bottoms, key=lambda bottom: abs((start - bottom) @ across))
        at = start - across * ((start - bottom) @ across)
        return Fit(at, float((at - bottom) @ INFORMATION @ (at - bottom)))

    def quadratic(self, at):
        bottom = min(self.bottoms, key=lambda bottom: np.linalg.norm(at - bottom))
        return Quadratic(at, 0.0, INFORMATION @ (at - bottom), INFORMATION)

    def estimate_sizes(self, v): ...

    def estimate_noise(self, v, count): ...


@pytest.mark.parametrize(
    ("second", "rivals"),
    [
        ([0.6, 0.6], 0),  # farther along the same valley: its interval holds it
        ([0.2, 0.8], 1),  # another valley
    ],
)
def test_fits_along_one_valley_are_one_minimum_and_another_valley_is_a_rival(second, rivals):
    problem = Valleys([[0.5, 0.5], second], [[0.5, 0.5], [0.2, 0.8]])
    found = find_optimum(problem, starts=2, seed=0, level=0.95)
    np.testing.assert_allclose(found.fit.at, [0.5, 0.5])
    assert len(found.rivals) == rivals
    assert found.starts == (2, 2 - rivals)


class Weighed(Valleys):
    """Of two valleys the first is deeper until the noise is known."""

    depths = (0.0, 1.0)

    def minimise(self, start, free=None, *, tolerance=0.01):
        fit = super().minimise(start, free, tolerance=tolerance)
        second = np.linalg.norm(fit.at - self.bottoms[1]) < 1e-9
        return Fit(fit.at, fit.cost + self.depths[int(second)])

    def estimate_noise(self, v, count=None):
        self.depths = (100.0, 10.0)


def test_what_was_best_before_the_noise_was_known_is_no_rival():
    at = [[0.5, 0.5], [0.2, 0.8]]
    found = find_optimum(Weighed([at[0], *at], at), starts=3, seed=0, level=0.95)
    np.testing.assert_allclose(found.fit.at, at[1])
    assert found.rivals == ()
    assert found.starts == (3, 1)


class Deviating(Valleys):
    """A parameter that acts from 0.7 on, and a deviation that may do instead what it does."""

    k = 1
    variables = SimpleNamespace(of_deviations=np.array([False, True]))

    def minimise(self, start, free=None, *, tolerance=0.01):
        free = np.ones(2, dtype=bool) if free is None else free

        def point(some):
            v = start.copy()
            v[free] = some
            return v

        def residual(some):
            acts, deviation = point(some)
            lacking = 1.0 / (1.0 + np.exp(20.0 * (acts - 0.7)))
            return [100.0 * lacking - 10.0 * deviation, deviation, 5.0 * (acts - 0.2)]

        found = least_squares(residual, start[free])
        return Fit(point(found.x), 2.0 * found.cost)


def test_what_a_deviation_took_up_is_found_by_a_start_without_it():
    problem = Deviating([[0.2, 0.0]], [[0.9, 0.0]])
    taken_up = problem.minimise(problem.starts[0])
    found = find_optimum(problem, starts=1, seed=0, level=0.95)
    assert taken_up.at[1] > 9.0
    assert abs(found.fit.at[1]) < 1.0
    assert found.fit.cost < 0.5 * taken_up.cost
