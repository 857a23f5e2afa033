"""Distances to polygons are those of another library."""

import numpy as np
import shapely

from excitation_planner.area.polygons import placed, signed_distance

OUTLINE = np.array([[0.0, 0.0], [8.0, -1.0], [9.0, 6.0], [4.0, 3.0], [1.0, 7.0]])
HOLE = np.array([[2.0, 1.0], [2.0, 2.0], [3.0, 2.0], [3.0, 1.0]])


def test_signed_distance_is_that_of_shapely() -> None:
    polygon = shapely.Polygon(OUTLINE, [HOLE])
    points = np.random.default_rng(1).uniform(-3.0, 11.0, (500, 2))
    distance = signed_distance(points, (OUTLINE, HOLE))
    places = shapely.points(points)
    np.testing.assert_allclose(np.abs(distance), shapely.distance(places, polygon.boundary))
    np.testing.assert_array_equal(distance > 0.0, shapely.contains(polygon, places))
    np.testing.assert_allclose(distance, signed_distance(points, (OUTLINE[::-1], HOLE[::-1])))


def test_points_on_a_body_at_many_poses() -> None:
    moved = placed(np.array([[1.0, 0.0], [0.0, 2.0]]), [0.0, 3.0], [0.0, 4.0], [0.0, np.pi / 2])
    np.testing.assert_allclose(
        moved, [[[1.0, 0.0], [0.0, 2.0]], [[3.0, 5.0], [1.0, 4.0]]], atol=1e-12
    )
