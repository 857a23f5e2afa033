"""Effects that a fit needs although a motion linear in them does not say so."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime, least_squares

from parameter_identification.estimation.problem import Fit
from parameter_identification.estimation.quadratic import Quadratic
from parameter_identification.estimation.weighing import indispensable, refitted


def quadratic_of(residual, v):
    columns = np.column_stack([approx_fprime(v, residual, 1e-7), residual(v)])
    priors = np.append(np.full(len(v), 1e-6), 0.0)
    return Quadratic.of_gram(v, columns.T @ columns + np.diag(priors))


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
        def residual(some):
            v = start.copy()
            v[free] = some
            return self.residual(v)

        found, at = least_squares(residual, start[free]), start.copy()
        at[free] = found.x
        return Fit(at, 2.0 * found.cost)


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
