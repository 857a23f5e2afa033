"""Effects in which the motion is not linear: what a fit needs, and where the searches end."""

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.optimize import approx_fprime, least_squares

from parameter_identification.estimation.deviation_sizes import DeviationSizes
from parameter_identification.estimation.levenberg_marquardt import Fit
from parameter_identification.estimation.nuisance import Nuisance
from parameter_identification.estimation.optimum import Optimum
from parameter_identification.estimation.quadratic import Quadratic
from parameter_identification.estimation.variables import ProblemVariables
from parameter_identification.estimation.weighing import indispensable, refitted, weigh_effects


def quadratic_of(residual, v):
    columns = np.column_stack([approx_fprime(v, residual, 1e-7), residual(v)])
    priors = np.append(np.full(len(v), 1e-6), 0.0)
    return Quadratic.of_gram(v, columns.T @ columns + np.diag(priors))


def minimum_of(residual, start, free):
    def with_others(some):
        v = start.copy()
        v[free] = some
        return v

    found = least_squares(lambda some: residual(with_others(some)), start[free])
    return Fit(with_others(found.x), 2.0 * found.cost)


class Bent:
    """What is measured is linear in each of two variables, and in a third one, not in all."""

    def __init__(self, bend):
        self.bend = bend

    def residual(self, v):
        p, effect, other = v
        seen = np.array([2.0, 2.0 - self.bend, 0.0])
        is_so = np.array(
            [p + effect, (1.0 - self.bend) * (p + effect) + self.bend * p * effect, other]
        )
        return 100.0 * (is_so - seen)

    def quadratic(self, v):
        return quadratic_of(self.residual, v)

    def minimise(self, start, free, *, tolerance):
        return minimum_of(self.residual, start, free)


@pytest.mark.parametrize(("bend", "kept"), [(0.0, []), (1.0, ["effect"])])
def test_an_effect_is_kept_where_the_fit_without_it_is_worse_than_linear(bend, kept):
    near_linear, places = Fit(np.array([1.0, 1.0, 0.2]), 0.0), {"effect": [1], "other": [2]}
    acts = np.array([True, False, False])
    fit, free, indispensable = refitted(Bent(bend), near_linear, acts, places)
    assert indispensable == kept
    assert free.tolist() == [True, bool(kept), False]
    assert fit.cost == pytest.approx(0.0, abs=1e-3)


class Saturating:
    """An effect beside a parameter, which changes nothing any more from 1 on."""

    low, high = np.full(2, -9.0), np.full(2, 9.0)

    def residual(self, v):
        p, effect = v
        return 100.0 * np.array([p + min(effect, 1.0) - 2.0, p - 1.0])

    def quadratic(self, v):
        return quadratic_of(self.residual, v)


@pytest.mark.parametrize(("effect", "held"), [(0.9, []), (2.0, ["effect"])])
def test_an_effect_without_which_the_cost_is_more_than_linear_is_indispensable(effect, held):
    problem, free = Saturating(), np.ones(2, dtype=bool)
    here = problem.quadratic(np.array([1.0, effect]))
    assert indispensable(problem, here, free, {"effect": [1]}) == held
    assert indispensable(problem, here, np.array([True, False]), {"effect": [1]}) == []


@dataclass(frozen=True)
class Possible:
    name: str
    prior_probability: float
    parts: tuple = ()


class Curved:
    """Readings that are quadratic in two effects, beside a parameter with a wide normal prior."""

    n, k = 3, 1
    low, high = np.full(3, -9.0), np.full(3, 9.0)
    noise = MappingProxyType({})
    std, prior_probability = 0.15, 0.3

    def __init__(self, slopes, curvatures, seen):
        self.variables = ProblemVariables(1, [[Nuisance("", "1", 0.0, 1.0)] * 2], 0)
        self.variables.constant_effects = {
            Possible("first", self.prior_probability): [1],
            Possible("second", self.prior_probability): [2],
        }
        self.sizes = DeviationSizes(self.variables)
        self.slopes, self.curvatures, self.seen = map(np.array, (slopes, curvatures, seen))

    def residual(self, v):
        squares = np.array([v[1] ** 2, v[2] ** 2, v[1] * v[2]])
        read = np.tensordot(self.slopes, v, 1) + np.tensordot(self.curvatures, squares, 1)
        seen = self.seen.reshape(-1, *np.ones(v.ndim - 1, dtype=int))
        return np.concatenate([(read - seen) / self.std, v[:1] / 3.0, v[1:]])

    def quadratic(self, v):
        return quadratic_of(self.residual, v)

    def minimise(self, start, free, *, tolerance=0.0):
        return minimum_of(self.residual, start, free)

    def each(self, function, *of):
        return map(function, *of)

    def log_determinant(self, v):
        return 0.0

    def estimate_noise(self, v):
        """It is known."""

    def set_weights(self, noise, sizes, v):
        """They never change."""


def probabilities(problem):
    """That each effect acts, by the integrals of all four densities."""
    parameter, effect = np.linspace(-9.0, 9.0, 121), np.linspace(-5.0, 5.0, 81)
    evidence = np.zeros((2, 2))
    for first, second in np.ndindex(2, 2):
        of_first, of_second = (effect if acts else np.zeros(1) for acts in (first, second))
        v = np.array(np.meshgrid(parameter, of_first, of_second, indexing="ij"))
        density = np.exp(-0.5 * np.sum(problem.residual(v) ** 2, axis=0))
        for acts in (second, first):
            density = simpson(density, x=effect) if acts else density[..., 0]
        before = (problem.prior_probability / np.sqrt(2.0 * np.pi)) ** (first + second)
        evidence[first, second] = (
            before
            * (1.0 - problem.prior_probability) ** (2 - first - second)
            * simpson(density, x=parameter)
        )
    evidence /= evidence.sum()
    return {"first": evidence[1].sum(), "second": evidence[:, 1].sum()}


@pytest.mark.parametrize(
    ("slopes", "curvatures", "seen"),
    [
        (
            [[0.13, -0.13, 0.64], [0.1, -0.54, 0.36], [1.3, 0.95, -0.7], [-1.27, -0.62, 0.04]],
            [[-0.7, -0.07, -0.37], [-0.22, -0.16, -0.09], [0.12, 0.31, -0.04], [0.41, -0.2, 0.11]],
            [-1.16, -1.0, 2.42, -1.27],
        ),
        (
            [[0.04, -1.72, -0.33], [-0.25, 0.6, -0.38], [-0.24, -0.75, -0.77], [0.59, 0.86, 1.86]],
            [[0.1, 0.03, 0.22], [0.42, -0.08, -0.77], [-0.13, -0.1, 0.31], [-0.14, 0.07, 0.48]],
            [0.52, 0.4, 0.61, -1.65],
        ),
    ],
)
def test_effects_that_explain_as_well_are_averaged_wherever_a_search_ends(slopes, curvatures, seen):
    problem = Curved(slopes, curvatures, seen)
    start = problem.minimise(np.zeros(3), np.ones(3, dtype=bool))
    _, _, acts = weigh_effects(problem, Optimum(start, np.eye(3), (), (1, 1)))
    expected = probabilities(problem)
    assert acts == pytest.approx(expected, abs=0.15)
    assert 0.3 < acts["first"] < 0.7  # from all effects alone: 1.00 and 0.86
