"""Families by name, their operation points, and paths that cannot be driven."""

from contextlib import nullcontext

import numpy as np
import pytest

from excitation_planner.maneuver.family import (
    PATH_SPACING,
    DrivenPath,
    check_speed,
    family_by_name,
    family_names,
    operation_point,
)
from excitation_planner.maneuver.paths import Circle
from tricycle_bridge.protocol.limits import MAX_SPEED
from tricycle_core.errors import PlanError


def test_hyphens_count_as_underscores():
    assert family_by_name("double-lane-change").name == "double_lane_change"


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"radius": 3.0}, "takes radius, speed"),
        ({"radius": 3.0, "speed": 0.8, "d1": 1.0}, "takes radius, speed"),
        ({"radius": 7.0, "speed": 0.8}, "radius = 7 is outside its range 2 to 6"),
        ({"radius": float("nan"), "speed": 0.8}, "radius = nan is outside"),
    ],
)
def test_wrong_operation_parameters_are_named(values, message):
    with pytest.raises(PlanError, match=message):
        operation_point(Circle(), values)


@pytest.mark.parametrize(
    ("speed", "allowed"),
    [(0.0, False), (1e-9, True), (MAX_SPEED, True), (MAX_SPEED + 1e-9, False), (np.nan, False)],
)
def test_a_speed_is_above_0_and_at_most_the_boards(speed, allowed):
    with nullcontext() if allowed else pytest.raises(PlanError, match="must be above 0"):
        check_speed(speed)


def test_unknown_family_lists_those_there_are():
    with pytest.raises(PlanError, match="circle, double_lane_change"):
        family_by_name("figure_eight")


def test_names_are_those_of_the_registered_classes():
    assert [family_by_name(name).name for name in family_names()] == list(family_names())


LINE = np.arange(100) * PATH_SPACING


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ((LINE, LINE[1:], 1.0, 1.0), "as many points"),
        ((2 * LINE, 0 * LINE, 1.0, 1.0), r"points 0\.02 m apart"),
        ((LINE, np.nan * LINE, 1.0, 1.0), r"points 0\.02 m apart"),
        ((LINE, 0 * LINE, 0.0, 1.0), "speed 0 m/s"),
        ((LINE, 0 * LINE, 5.0, 1.0), "speed 5 m/s"),
        ((LINE, 0 * LINE, 1.0, 3.0), "beyond its length, 3 m"),
    ],
)
def test_a_path_that_cannot_be_tracked_is_refused(path, message):
    with pytest.raises(PlanError, match=message):
        DrivenPath(*path)
