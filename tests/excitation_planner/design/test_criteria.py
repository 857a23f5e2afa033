"""Costs by hand."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from excitation_planner import Criterion
from excitation_planner.design.criteria import excitation_cost
from excitation_planner.design.evaluation import cost_interval
from excitation_planner.indices.sobol import Indices


def test_cost_by_hand():
    main, total = np.array([0.5, 0.2, 0.1]), np.array([0.6, 0.3, 0.3])
    # (0.6 - 0.5)/0.5 + (0.8 - 0.5)/0.5
    assert excitation_cost(main, total, 0) == pytest.approx(0.8)
    assert excitation_cost(main, total, 0, noise_share=0.25) == pytest.approx(1.3)
    assert excitation_cost(np.array([1.0, 0.0]), np.array([1.0, 0.0]), 0) == 0.0
    assert excitation_cost(np.array([0.0, 1.0]), np.array([0.0, 1.0]), 0) == math.inf


@given(st.lists(st.floats(0.01, 1.0), min_size=2, max_size=6), st.floats(0, 10))
def test_less_noise_is_never_worse(weights, noise_share):
    main = np.array(weights) / sum(weights)
    quiet = excitation_cost(main, main, 0)
    assert 0 <= quiet <= excitation_cost(main, main, 0, noise_share=noise_share) + 1e-12


@pytest.mark.parametrize(
    ("criterion", "low", "high"),
    [
        (Criterion.H, 0.0, math.inf),
        (Criterion.C, 1e-9, 1.0),
        (Criterion.D, -30.0, -2.0),
        (Criterion.A, 1e-9, 1.0),
    ],
)
def test_search_scale_keeps_the_order(criterion, low, high):
    assert criterion.search_scale(low) < criterion.search_scale(high)


def test_costs_with_a_pole_are_searched_by_their_logarithm():
    """A tenth of the variance is the same step wherever the search is."""
    for criterion in (Criterion.C, Criterion.A):
        steps = np.diff([criterion.search_scale(10.0**-n) for n in range(4)])
        assert steps == pytest.approx(-math.log(10.0))
    assert Criterion.D.search_scale(-3.0) == -3.0


def test_the_interval_of_a_cost_reaches_to_what_the_unexplained_could_make_of_it():
    main, total, share, unexplained = np.array([0.5, 0.3]), np.array([0.6, 0.4]), 0.2, 0.1
    # without one fifth the output varies half as much, and the noise has twice the share
    folds = [Indices(main, total, variance) for variance in (2.0, 2.0, 1.0, 2.0, 2.0)]
    result = SimpleNamespace(
        main=main, total=total, variance=2.0, folds=folds, unexplained=unexplained
    )
    low, high = cost_interval(result, 0, noise_share=share)

    def cost(unexplained_by):
        """Cost if a parameter explained alone what the metamodel does not explain."""
        rest = unexplained * np.eye(2)[unexplained_by]
        explained = 1.0 - unexplained
        return excitation_cost(
            explained * main + rest, explained * total + rest, 0, noise_share=explained * share
        )

    changes = [0.0, 0.0, share / main[0], 0.0, 0.0]  # of the cost, by the folds
    half = 2.2 * np.sqrt(np.mean(np.square(changes)))
    assert low == pytest.approx(cost(0) - half)
    assert high == pytest.approx(cost(1) + half)
