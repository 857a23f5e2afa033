"""Designs on functions whose optimum is known, and what can go wrong on the way."""

import re
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from threading import Lock

import numpy as np
import pytest

from excitation_planner import Box, Design, Search, Verdict, design_excitation
from excitation_planner.design.problem import VERIFIED
from excitation_planner.indices.analytic import (
    MATH_MODEL_OPERATION,
    MATH_MODEL_UNKNOWN,
    math_model,
)
from tricycle_core.errors import DesignError, InfeasibleManeuver

OPERATION = {"a": (-1.0, 1.0), "b": (0.0, 2.0)}
UNKNOWN = {"p": (0.0, 1.0), "q": (0.0, 1.0), "r": (0.0, 1.0)}


def interior(x, P):
    """Main effect of q beside p grows with the distance of x from (0.3, 0.8)."""
    distance = (x[0] - 0.3) ** 2 + (x[1] - 0.8) ** 2
    return P[:, 0] + 0.2 * P[:, 0] * P[:, 2] + (0.1 + distance) * P[:, 1]


def best(f, target, **arguments):
    return design_excitation(
        f, OPERATION, UNKNOWN, target, **{"samples": 20, "budget": 1500, "workers": 1} | arguments
    )


def same(one: Design, other: Design) -> bool:
    return (
        np.array_equal(one.x, other.x)
        and one.cost == other.cost
        and [e.cost for e in one.history] == [e.cost for e in other.history]
    )


@pytest.mark.slow
def test_interior_optimum_is_found_and_verified():
    design = best(interior, "p")
    assert np.allclose(design.x, (0.3, 0.8), atol=0.05)
    # at the optimum: var p = 1.1²/12, var q = 0.1²/12, var r = 0.1²/12, var pr = 0.2²/144
    variances = np.array([1.1**2, 0.1**2, 0.1**2]) / 12
    interaction = 0.2**2 / 144
    exact = (interaction + variances[1:].sum()) / variances[0]
    assert design.cost == pytest.approx(exact, rel=0.01)
    assert design.predicted_cost == pytest.approx(design.cost, rel=0.01)
    assert design.cost_interval[0] <= design.cost <= design.cost_interval[1]
    assert design.verdict is Verdict.EXCITES
    assert design.sensitivity.names == ("p", "q", "r")
    assert design.simulations <= 1500


@pytest.mark.slow
def test_direct_finds_the_same_optimum():
    design = best(interior, "p", search=Search.DIRECT)
    assert np.allclose(design.x, (0.3, 0.8), atol=0.15)


@pytest.mark.slow
def test_a_target_that_cannot_be_excited_is_called_so():
    design = best(interior, "r")
    assert design.verdict is Verdict.CANNOT_EXCITE
    assert "largest other contribution: p" in design.explanation
    assert design.explanation.endswith("at most: choose another family for this parameter")


def test_a_budget_of_one_maneuver_is_no_reason_for_another_family():
    design = best(interior, "r", budget=200)
    assert len(design.history) == 1
    assert re.search(
        r"in 1 maneuver of this family its main index reached 0\.\d+ at most; the budget allows 1 "
        r"maneuver of the box only: raise it by 180 for 10$",
        design.explanation,
    )


@pytest.mark.slow
def test_noise_counts_as_one_more_contributor():
    design = best(interior, "p", noise_variance=10.0)
    assert design.verdict is Verdict.CANNOT_EXCITE
    assert "measurement noise" in design.explanation
    of_outputs = best(interior, "p", noise_variance=lambda m: 10.0 + 0.0 * m.mean())
    assert same(design, of_outputs)


@pytest.mark.slow
def test_the_seed_decides_and_nothing_else():
    here = best(interior, "p", seed=3)
    assert same(here, best(interior, "p", seed=3))
    with ThreadPoolExecutor(3) as threads:
        assert same(here, best(interior, "p", seed=3, executor=threads, workers=None))
    assert not same(here, best(interior, "p", seed=4))


@pytest.mark.slow
def test_worker_processes_give_the_same_design():
    def design(workers: int) -> Design:
        return design_excitation(
            math_model, MATH_MODEL_OPERATION, MATH_MODEL_UNKNOWN, "p3",
            samples=30, budget=1500, workers=workers,
        )  # fmt: skip

    assert same(design(1), design(2))


def _partly_infeasible(x, P):
    if x[0] > 0.2:
        raise InfeasibleManeuver("steering saturates")
    m = interior(x, P)
    m[::7] = np.nan
    return m


@pytest.mark.slow
def test_infeasible_maneuvers_and_failed_simulations_are_told_apart():
    design = best(_partly_infeasible, "p")
    assert design.x[0] <= 0.2
    assert design.x[1] == pytest.approx(0.8, abs=0.1)
    assert {e.infeasible for e in design.infeasible} == {"steering saturates"}
    assert design.failed > 0
    assert all(e.simulations == 0 for e in design.infeasible)


def _always_infeasible(x, P, lock=None):
    raise InfeasibleManeuver("wheel lifts")


def _raises(x, P):
    raise KeyError("gearbox")


@pytest.mark.parametrize(
    ("f", "arguments", "message"),
    [
        (_always_infeasible, {}, "no maneuver can be driven and judged: wheel lifts"),
        (
            _always_infeasible,
            {"budget": 220},
            r"\(2 of 2\); the budget allows 2 maneuvers of the box only: raise it by 160 for 10$",
        ),
        (_raises, {}, "f raised KeyError: 'gearbox', at a = -1, b = 0"),
        (lambda x, P: P, {}, r"f returned \(20, 3\) for 20 samples"),
        (lambda x, P: (P[:, 0], P), {}, r"f returned \(20,\) and \(20, 3\) for 20 samples; .* one"),
        (lambda x, P: (), {}, "f returned nothing for 20 samples"),
        (interior, {"noise_variance": lambda m: -1.0}, "noise variance -1"),
        (interior, {"noise_variance": "3"}, "noise variance '3'"),
        (interior, {"starts": np.zeros((2, 3))}, r"starts have shape \(2, 3\): \(starts, 2\)"),
        (interior, {"samples": 20.5}, "samples = 20.5"),
        (interior, {"search": "one-shot-factorial", "budget": 240}, "5 are needed for two levels"),
        (lambda x, P: np.ones(len(P)), {}, "the output is constant"),
        (lambda x, P: np.full(len(P), np.nan), {}, "20 of 20 simulations failed"),
        (
            lambda x, P: ["stiff"] * len(P),
            {},
            "f must return real numbers, NaN where it failed; not ",
        ),
        (
            lambda x, P: P[:, 0] + 1j,
            {},
            "f must return real numbers, NaN where it failed; not complex128",
        ),
        (interior, {"budget": 2e3}, r"budget = 2000\.0: a whole number is needed"),
        (interior, {"seed": -1}, "seed = -1: must be a whole number, 0 or more"),
        (interior, {"samples": 4}, "samples = 4"),
        (interior, {"budget": 190}, "budget = 190 is too small"),
        (interior, {"noise_variance": -1.0}, "noise variance -1"),
        (interior, {"criterion": "i"}, "unknown criterion 'i'; one of: 'h', 'c', 'd', 'a'"),
        (interior, {"search": "best"}, "unknown search 'best'; one of: 'adaptive', 'direct', "),
        (partial(_always_infeasible, lock=Lock()), {"workers": 2}, "cannot be sent to another"),
    ],
)
def test_mistakes_are_named(f, arguments, message):
    with pytest.raises(DesignError, match=message):
        best(f, "p", **arguments)


def test_unknown_target_lists_the_parameters_there_are():
    with pytest.raises(DesignError, match="unknown parameter 'z'; one of: p, q, r"):
        best(interior, "z")


@pytest.mark.slow
def test_a_maneuver_that_is_asked_for_again_is_not_simulated_again():
    simulated = []

    def noted(x, P):
        simulated.append((tuple(x), len(P)))
        return interior(x, P)

    design = best(noted, "p", workers=1)
    assert len(set(simulated)) == len(simulated) < len(design.history) + VERIFIED
    assert design.simulations == sum(runs for _, runs in simulated)
    costs = {tuple(e.x): e.cost for e in design.history}
    assert all(costs[tuple(e.x)] == e.cost for e in design.history)


@pytest.mark.slow
def test_progress_counts_runs_up_to_the_budget():
    calls = []
    design = best(interior, "p", progress=lambda done, total: calls.append((done, total)))
    assert calls[-1] == (design.simulations, 1500)
    assert calls == sorted(calls)


def test_boxes_are_taken_as_they_are():
    design = design_excitation(
        partial(interior),
        Box.of(OPERATION),
        Box.of(UNKNOWN),
        "p",
        samples=20,
        budget=400,
        workers=1,
    )
    assert len(design.x) == 2


def test_a_simulator_that_changes_its_inputs_gives_the_same_design():
    def in_place(x, P):
        x += 1.0
        P *= 2.0
        return interior(x - 1.0, P / 2.0)

    arguments = {"samples": 10, "budget": 300}
    assert same(best(in_place, "p", **arguments), best(interior, "p", **arguments))


def test_noise_that_vanishes_is_no_noise_of_a_one_shot_search():
    arguments = {"search": "one-shot-sobol", "samples": 10, "budget": 300}
    vanishing = best(interior, "p", noise_variance=lambda m: 0.0, **arguments)
    assert same(vanishing, best(interior, "p", **arguments))


def test_a_metamodel_that_misses_most_of_the_output_decides_nothing():
    design = design_excitation(
        lambda x, P: x[0] * np.sin(40 * np.pi * P[:, 0]) + P[:, 1],
        {"x": (0.5, 1.0)},
        {"a": (0, 1), "b": (0, 1)},
        "b",
        noise_variance=0.01,
        workers=1,
        samples=20,
        budget=1000,
    )
    assert design.verdict is Verdict.UNDECIDED
    assert "simulate more samples" in design.explanation
    exact = (0.5 * design.x[0] ** 2 + 0.01) / (1 / 12)
    assert design.cost_interval[0] < exact < design.cost_interval[1]


@pytest.mark.parametrize(
    ("starts", "message"),
    [([[0.5]], "starts have shape"), ([[np.nan, 0.5]], "points of the unit box")],
)
def test_starts_outside_of_the_box_are_refused(starts, message):
    with pytest.raises(DesignError, match=message):
        design_excitation(
            lambda x, P: P[:, 0],
            {"x": (0, 1), "y": (0, 1)},
            {"a": (0, 1)},
            "a",
            noise_variance=0.01,
            starts=starts,
        )
