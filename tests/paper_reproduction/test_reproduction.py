"""The paper's numbers beside ours."""

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest

from excitation_planner.indices.analytic import MATH_MODEL_UNKNOWN, math_model
from paper_reproduction.comparison import Agreement, error_statistics
from paper_reproduction.first_stage import OurBudget, PaperBudget, faithful, fast
from paper_reproduction.math_model import exact_indices, figure_8_or_9, largest_error, table_1
from paper_reproduction.published import TABLE_1_X

SMALL = PaperBudget(initial=150, infill=10, monte_carlo=2**12, levels=3)


def test_error_statistics_of_a_known_error():
    true = np.array([0.0, 2.0])  # mean 1, deviation 1
    found = error_statistics(true + np.array([0.1, 0.3]), true)
    assert (found.output_mean, found.output_std) == (1.0, 1.0)
    assert found.raae == pytest.approx(0.2)
    assert found.rmae == pytest.approx(0.3)
    assert found.r2 == pytest.approx(1 - 0.05)
    assert found.mean == pytest.approx(0.2)
    assert found.std == pytest.approx(0.1)


@pytest.mark.slow
def test_both_ways_come_near_the_exact_indices():
    x = np.array(TABLE_1_X)
    f, exact = partial(math_model, x), exact_indices(x)
    paper = faithful(f, MATH_MODEL_UNKNOWN, budget=SMALL, validation=100)
    ours = fast(f, MATH_MODEL_UNKNOWN, samples=160, validation=100)
    assert paper.simulations == ours.simulations == 160
    assert largest_error(paper.indices, exact) < 0.1
    assert largest_error(ours.indices, exact) < 1e-3
    for stage in (paper, ours):
        assert error_statistics(*stage.validation).r2 > 0.999


def test_failed_simulations_are_no_samples_that_a_metamodel_is_trained_on():
    def f(P):
        m = math_model(np.array(TABLE_1_X), P)
        m[::20] = np.nan
        return m

    assert faithful(f, MATH_MODEL_UNKNOWN, budget=SMALL).simulations < 160
    assert fast(f, MATH_MODEL_UNKNOWN, samples=60).simulations < 60


@pytest.mark.slow
def test_table_1_holds_the_published_numbers():
    item = table_1()
    exact = [c for c in item.comparisons if "exact" in c.quantity]
    assert len(exact) == 8
    assert all(c.agreement is Agreement.REPRODUCED for c in exact)
    assert "8 reproduced" in item.verdict


@pytest.mark.slow
def test_optima_are_told_exactly_and_judged_over_many_draws():
    few = OurBudget(samples=40, design_runs=1000)
    with ThreadPoolExecutor(1) as executor:
        item = figure_8_or_9("p1", few, None, executor, lambda done, total: None)
    _, _, exact = item.data.optima["ours, x ≤ −0.5"]
    assert f"H = {exact:.5f} (estimated " in item.findings[1]
    # one draw of the points of the second stage agrees or not by chance
    kriging = item.comparisons[0]
    assert "of 16 draws of the 96 points" in kriging.ours
    assert kriging.agreement is Agreement.REPRODUCED
