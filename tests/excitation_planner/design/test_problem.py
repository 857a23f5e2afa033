"""Problems: how many runs they take, and what is refused."""

import dataclasses

import numpy as np
import pytest

from excitation_planner import Box, BoxPrior, Criterion, DesignError, Search, TrajectoryNoise
from excitation_planner.design.evaluation import parameter_points
from excitation_planner.design.problem import DesignProblem

UNKNOWN = Box.of({"p": (0.0, 1.0), "q": (10.0, 20.0)})
PROBLEM = DesignProblem(
    operation=Box.of({"x": (0.0, 1.0)}),
    unknown=UNKNOWN,
    target="q",
    criterion=Criterion.H,
    noise_variance=0.0,
    trajectory_noise=TrajectoryNoise(),
    samples=20,
    draws=3,
    budget=1000,
    seed=0,
    search=Search.ADAPTIVE,
)


@pytest.mark.parametrize("criterion", Criterion)
@pytest.mark.parametrize("verification", [False, True])
def test_as_many_runs_are_counted_as_points_are_simulated(criterion, verification):
    problem = dataclasses.replace(PROBLEM, criterion=criterion)
    U = parameter_points(problem, verification=verification)
    assert U.shape == (problem.runs(verification=verification), 2)
    assert np.all((U >= 0) & (U <= 1))


def test_the_verification_is_kept_in_reserve():
    assert PROBLEM.target_index == 1
    assert PROBLEM.points == (1000 - 3 * 60) // 20


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"target": "r"}, "unknown parameter 'r'"),
        ({"target": None}, "criterion h needs a target: p, q"),
        ({"noise_variance": -1.0}, "noise variance -1"),
        ({"samples": 3}, "samples = 3: 2 unknown parameters need 4"),
        ({"draws": 0}, "draws = 0"),
        ({"budget": 100}, "an evaluation and the verification take 200 runs"),
        ({"prior": BoxPrior(np.array([0.5]), np.eye(1))}, "prior: must be about p, q"),
    ],
)
def test_a_problem_that_cannot_be_solved_is_refused(changes, message):
    with pytest.raises(DesignError, match=message):
        dataclasses.replace(PROBLEM, **changes)
