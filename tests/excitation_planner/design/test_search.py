"""Searches driven by hand, on costs whose minimum is known."""

import threading
from dataclasses import dataclass

import numpy as np
import pytest

from excitation_planner import Criterion, Search, design_excitation
from excitation_planner.design.criteria import excitation_cost
from excitation_planner.design.search import adaptive_search, direct_search, modelled_cost
from tricycle_core.errors import DesignError


@dataclass
class Cost:
    cost: float


def drive(steps, f):
    """Every point that the search asks for, with its cost."""
    X, costs = [], []
    try:
        batch = next(steps)
        while True:
            found = [f(x) for x in batch]
            X += list(batch)
            costs += found
            batch = steps.send([Cost(c) for c in found])
    except StopIteration:
        return np.array(X), np.array(costs)


def bowl(centre):
    return lambda x: float(np.sum((x - centre) ** 2))


@pytest.mark.parametrize(
    "centre", [[0.3, 0.6], [0.0, 0.37], [1.0, 0.0], [0.21, 0.83, 0.55], [0.4] * 6]
)
def test_adaptive_search_finds_interior_faces_and_corners(centre):
    steps = adaptive_search(len(centre), points=160, seed=0, criterion=Criterion.H)
    X, costs = drive(steps, bowl(np.array(centre)))
    assert len(X) <= 160
    assert np.all((X >= 0) & (X <= 1))
    assert np.allclose(X[costs.argmin()], centre, atol=0.02)


def test_direct_search_reaches_faces():
    X, costs = drive(direct_search(2, points=150, criterion=Criterion.H), bowl([0.0, 0.4]))
    assert len(X) <= 150
    assert X[costs.argmin()] == pytest.approx([0.0, 0.4], abs=0.02)
    assert X[costs.argmin()][0] == 0.0  # on the face itself, which DIRECT does not sample


@pytest.mark.parametrize("seed", range(5))
def test_an_optimum_at_the_limit_of_what_can_be_driven_is_found(seed):
    """The limit is a quarter circle; the least distance of the target from it is known."""
    target = np.array([0.9, 0.8])

    def f(x):
        return np.inf if np.hypot(*x) > 0.7 else float(np.hypot(*(x - target)))

    _, costs = drive(adaptive_search(2, points=100, seed=seed, criterion=Criterion.H), f)
    assert costs.min() == pytest.approx(np.hypot(*target) - 0.7, rel=0.05)


def test_infeasible_points_do_not_stop_the_search():
    def f(x):
        return np.inf if x[0] < 0.5 else bowl([0.5, 0.5])(x)

    for steps in (
        adaptive_search(2, points=100, seed=0, criterion=Criterion.H),
        direct_search(2, points=100, criterion=Criterion.H),
    ):
        X, costs = drive(steps, f)
        assert np.allclose(X[costs.argmin()], [0.5, 0.5], atol=0.05)


def test_nothing_feasible_ends_after_the_screening():
    X, _ = drive(adaptive_search(2, points=100, seed=0, criterion=Criterion.H), lambda _: np.inf)
    assert len(X) == 20


def test_an_abandoned_search_leaves_no_thread_waiting():
    before = set(threading.enumerate())
    steps = adaptive_search(2, points=100, seed=0, criterion=Criterion.H)
    X = next(steps)
    steps.send([Cost(bowl([0.3, 0.3])(x)) for x in X])
    searching = set(threading.enumerate()) - before
    assert searching
    steps.close()
    for thread in searching:
        thread.join(timeout=5)
    assert not any(thread.is_alive() for thread in searching)


def test_the_cost_of_modelled_indices_is_that_of_the_indices():
    X = np.linspace(0.0, 1.0, 9)[:, None]

    def indices(x):
        main = np.array([0.2 + 0.5 * x, 0.3 - 0.2 * x**2])
        return main, main + 0.1 * x, np.exp(2.0 * x - 3.0)

    main, total, share = (np.array(rows) for rows in zip(*map(indices, X[:, 0]), strict=True))
    quiet = modelled_cost(X, main, total, target=0)
    noisy = modelled_cost(X, main, total, target=0, noise_share=share)
    for x in (0.06, 0.44, 0.93):
        main_there, total_there, share_there = indices(x)
        exact = excitation_cost(main_there, total_there, 0)
        assert quiet(np.array([x])) == pytest.approx(exact, rel=1e-3)
        exact = excitation_cost(main_there, total_there, 0, noise_share=share_there)
        assert noisy(np.array([x])) == pytest.approx(exact, rel=1e-3)


def test_modelled_indices_stay_in_their_order():
    """A total index below the main one, and a main index below 0, are a model's errors."""
    X = np.array([[0.0], [1.0]])
    cost = modelled_cost(X, np.array([[0.5, 0.2]] * 2), np.array([[0.4, 0.3]] * 2), target=0)
    assert cost(np.array([0.3])) == pytest.approx(0.2 / 0.5)
    cost = modelled_cost(X, np.array([[-0.1, 0.2]] * 2), np.array([[0.4, 0.3]] * 2), target=0)
    assert 1e5 < cost(np.array([0.3])) < np.inf


def f(x, P):
    return P[:, 0] + (0.1 + (x[0] - 0.4) ** 2 + (x[1] - 0.6) ** 2) * P[:, 1]


@pytest.mark.slow
@pytest.mark.parametrize("search", [Search.ONE_SHOT_SOBOL, Search.ONE_SHOT_FACTORIAL])
@pytest.mark.parametrize("noise_variance", [0.0, 1e-3])
def test_the_papers_one_shot_search_models_the_indices(search, noise_variance):
    box = {"a": (0.0, 1.0), "b": (0.0, 1.0)}
    design = design_excitation(
        f,
        box,
        box,
        "a",
        search=search,
        noise_variance=noise_variance,
        samples=10,
        budget=490,
        workers=1,
    )
    assert np.allclose(design.x, (0.4, 0.6), atol=0.06)


def test_one_shot_needs_points_and_the_criterion_h():
    box = {"a": (0.0, 1.0)}
    for arguments, message in [
        ({"samples": 10, "budget": 110}, "the budget allows 2 points"),
        ({"criterion": Criterion.C}, "needs criterion h"),
    ]:
        with pytest.raises(DesignError, match=message):
            design_excitation(
                f, box, box, "a", search=Search.ONE_SHOT_SOBOL, workers=1, **arguments
            )
