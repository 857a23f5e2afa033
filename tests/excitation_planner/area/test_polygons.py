"""Distances to polygons are those of another library."""

import numpy as np
import shapely

from excitation_planner.area.polygons import signed_distance

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
