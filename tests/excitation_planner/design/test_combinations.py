"""The combinations that a search of a set begins with are the best of those that there are."""

import numpy as np
import pytest

from excitation_planner.box import Box
from excitation_planner.design.combinations import APART, best_combinations
from excitation_planner.design.criteria import Criterion
from excitation_planner.design.information import ManeuverSet
from excitation_planner.design.noise import TrajectoryNoise
from tricycle_core.errors import InfeasibleManeuver

UNKNOWN = Box.of({"a": (1.0, 2.0), "b": (1.0, 2.0)})
BOX = Box.of({"gain": (0.5, 3.0)})
TIME = np.linspace(0.0, 1.0, 20)


def shows(axis):
    """Maneuver of which the larger gain shows more of one parameter."""

    def simulate(x, P):
        return (x[0] * P[:, axis, None] * TIME)[..., None]

    return simulate


def found(*simulators, criterion=Criterion.D):
    maneuvers = ManeuverSet(simulators, (BOX,) * len(simulators))
    noise = TrajectoryNoise(std=0.1)
    return best_combinations(maneuvers, UNKNOWN, noise, criterion, 0, draws=4, seed=0)


def test_the_best_combination_comes_first_and_others_are_apart():
    points, simulations = found(shows(0), shows(1))
    assert points[0].tolist() == [1.0, 1.0]  # both gains as large as they may be
    assert simulations == 2 * 18 * 4 * 3  # families, maneuvers, draws, parameters and one
    apart = np.abs(points[:, None] - points).max(axis=-1)
    assert apart[~np.eye(len(points), dtype=bool)].min() >= APART


@pytest.mark.parametrize("criterion", [Criterion.C, Criterion.A, Criterion.D])
def test_what_a_family_cannot_show_does_not_count(criterion):
    points, _ = found(shows(0), shows(0), criterion=criterion)
    assert points[0].tolist() == [1.0, 1.0]


def test_what_another_family_shows_need_not_be_shown_twice():
    """Alone a drive of the first family should show both parameters, here only the other one."""

    def either(x, P):
        return np.stack([x[0] * P[:, :1] * TIME, (3.5 - x[0]) * P[:, 1:] * TIME], axis=-1)

    alone, _ = found(either)
    assert alone[0, 0] == pytest.approx(0.5, abs=0.1)
    points, _ = found(either, shows(1))
    assert points[0].tolist() == [1.0, 1.0]


def test_a_maneuver_is_not_better_for_the_vehicles_that_roll_over_in_it():
    def rolls_over_if_slow(x, P):
        Y = (1.0 + 0.1 * (x[0] > 1.75)) * P[:, :1, None] * TIME[:, None]
        if x[0] < 1.75:
            Y[P[:, 0] > 1.5] = np.nan  # two of four vehicles
        return Y

    points, _ = found(rolls_over_if_slow, criterion=Criterion.C)
    assert points[0, 0] > 0.5


def test_a_family_without_any_maneuver_leaves_nothing():
    def none(x, P):
        raise InfeasibleManeuver("too fast")

    points, _ = found(shows(0), none)
    assert points.shape == (0, 2)
