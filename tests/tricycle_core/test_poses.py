"""Poses in the plane against SciPy's rotations and an integrated arc."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from tricycle_core.poses import along_arc, placed, seen_from

POINTS = np.array([[1.0, 0.0], [0.0, 2.0], [-0.4, 0.3]])
POSES = np.array([[0.0, 3.0, -2.0], [0.0, 4.0, 1.0], [0.0, np.pi / 2, -2.5]])


def test_points_on_a_body_are_turned_as_scipy_turns_them() -> None:
    moved = placed(POINTS, *POSES)
    for found, (x, y, heading) in zip(moved, POSES.T, strict=True):
        turned = Rotation.from_euler("z", heading).apply(np.pad(POINTS, ((0, 0), (0, 1))))
        np.testing.assert_allclose(found, turned[:, :2] + [x, y], atol=1e-12)


def test_a_body_sees_its_own_points_where_they_are_on_it() -> None:
    for pose in POSES.T:
        np.testing.assert_allclose(seen_from(placed(POINTS, *pose), *pose), POINTS, atol=1e-12)


@pytest.mark.parametrize(("curvature", "way"), [(0.4, 3.0), (-0.7, 2.0), (0.4, -3.0), (0.0, 2.0)])
def test_an_arc_is_the_integral_of_its_course(curvature: float, way: float) -> None:
    def slopes(s: float, _: object) -> tuple[float, float]:
        return np.cos(0.3 + curvature * s), np.sin(0.3 + curvature * s)

    expected = solve_ivp(slopes, (0.0, way), [1.0, -2.0], rtol=1e-10, atol=1e-12).y[:, -1]
    x, y, turn = along_arc(1.0, -2.0, 0.3, curvature, np.array(way))
    assert (float(x), float(y)) == pytest.approx(tuple(expected), abs=1e-8)
    assert float(turn) == pytest.approx(curvature * way)
