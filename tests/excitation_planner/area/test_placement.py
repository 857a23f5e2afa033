"""The best start pose is the one that geometry gives in closed form."""

import numpy as np
import pytest
import shapely

from excitation_planner.area.area import Area, StartRegion
from excitation_planner.area.placement import _Sampled, at_pose, best_placement
from excitation_planner.area.polygons import signed_distance
from tricycle_core.poses import placed, seen_from

TUBE = shapely.box(-1.0, -1.0, 9.0, 2.0)  # 10 m along, 3 m across


def rectangle(width: float, height: float) -> np.ndarray:
    return np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])


def test_in_the_middle_of_a_rectangle_along_its_long_side() -> None:
    found = best_placement(TUBE, Area(rectangle(6.0, 20.0)))
    assert found.clearance == pytest.approx(1.5, abs=0.02)
    assert abs(np.sin(found.heading)) == pytest.approx(1.0, abs=0.01)


def test_what_is_too_long_lacks_what_is_missing() -> None:
    area = Area(rectangle(6.0, 8.0), start=StartRegion(heading=(np.pi / 2, np.pi / 2)))
    assert best_placement(TUBE, area).clearance == pytest.approx(-1.0, abs=0.02)


def test_a_given_start_pose_is_kept() -> None:
    start = StartRegion((3.0, 3.0), (2.0, 2.0), (np.pi / 2, np.pi / 2))
    found = best_placement(TUBE, Area(rectangle(6.0, 20.0), start=start))
    assert (found.x, found.y, found.heading) == (3.0, 2.0, np.pi / 2)
    assert found.clearance == pytest.approx(1.0, abs=1e-9)  # left of the start, 2 m of 3 m


def test_obstacles_are_kept_clear_of_also_within_the_tube() -> None:
    hole = np.array([[2.9, 9.9], [3.1, 9.9], [3.1, 10.1], [2.9, 10.1]])  # smaller than the tube
    found = best_placement(TUBE, Area(rectangle(6.0, 24.0), (hole,)))
    placed = at_pose(TUBE, found.x, found.y, found.heading)
    assert not placed.intersects(shapely.Polygon(hole))
    assert found.clearance == pytest.approx(1.5, abs=0.02)  # beside the hole it would be 1.4


def test_an_obstacle_may_stand_inside_a_ring() -> None:
    ring = shapely.Point(0.0, 5.0).buffer(6.0).difference(shapely.Point(0.0, 5.0).buffer(4.0))
    post = np.array([[6.5, 6.5], [7.5, 6.5], [7.5, 7.5], [6.5, 7.5]])
    found = best_placement(ring, Area(rectangle(14.0, 14.0), (post,)))
    assert found.clearance == pytest.approx(1.0, abs=0.02)


def test_clearances_are_those_of_the_distances_in_numpy() -> None:
    post = np.array([[2.0, 9.0], [3.0, 9.0], [3.0, 10.0], [2.0, 10.0]])
    area = Area(rectangle(6.0, 20.0), (post,))
    sampled = _Sampled.of(TUBE, area, by_hull=False)
    poses = np.random.default_rng(2).uniform([-2.0, -2.0, -4.0], [8.0, 22.0, 4.0], (50, 3))
    x, y, heading = poses.T
    expected = area.clearance(placed(sampled.outline, x, y, heading)).min(axis=-1)
    seen = seen_from(sampled.obstacles, x, y, heading)
    expected = np.minimum(expected, -signed_distance(seen, sampled.rings).max(axis=-1))
    np.testing.assert_allclose(sampled.clearance(poses), expected, rtol=0.0, atol=1e-12)
