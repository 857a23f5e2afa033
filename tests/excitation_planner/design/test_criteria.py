"""Costs by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from excitation_planner import Criterion
from excitation_planner.design.criteria import excitation_cost


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
    [(Criterion.H, 0.0, math.inf), (Criterion.C, 1e-9, 1.0), (Criterion.D, -30.0, -2.0)],
)
def test_search_scale_keeps_the_order(criterion, low, high):
    assert criterion.search_scale(low) < criterion.search_scale(high)
