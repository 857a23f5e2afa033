"""The ways that a vehicle may take to rest."""

import math

import numpy as np
import pytest

from excitation_planner.area.stops import longest_stop, stopping_path
from tricycle_core.stopping import Cause, stopping_distance


@pytest.mark.parametrize(
    ("slip", "curvature", "end"),
    [
        (0.0, 0.5, (2.0, 2.0, math.pi / 2)),  # a quarter of a circle of 2 m, to the left
        (0.0, -0.5, (2.0, -2.0, -math.pi / 2)),
        (0.0, 0.0, (math.pi, 0.0, 0.0)),
        (math.pi, 0.5, (-2.0, -2.0, math.pi / 2)),  # backwards
        (math.pi / 2, 0.5, (-2.0, 2.0, math.pi / 2)),  # to the left
    ],
)
def test_a_stop_ends_where_its_arc_does(
    slip: float, curvature: float, end: tuple[float, float, float]
) -> None:
    x, y, yaw = stopping_path(1.0, -1.0, 0.0, slip, math.pi, curvature)
    assert (x[0], y[0], yaw[0]) == (1.0, -1.0, 0.0)
    assert (x[-1] - 1.0, y[-1] + 1.0, yaw[-1]) == pytest.approx(end, abs=1e-12)


@pytest.mark.parametrize("speed", [0.0, 0.5, 4.8])
def test_no_published_stop_is_longer_than_the_longest(speed: float) -> None:
    longest = float(longest_stop(np.array(speed)))
    assert all(stopping_distance(cause, speed) <= longest for cause in Cause)
