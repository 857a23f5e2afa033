"""Deviating motions against the way and the angle that they must add, by quadrature."""

import numpy as np
import pytest

from parameter_identification.estimation.deviations import deviated
from tricycle_core.timing import TICK

RADIUS = 0.33
TIME = TICK * np.arange(1001)


def arc(speed, curvature):
    """Motions (5, 1, t) of a vehicle on a circle."""
    heading = curvature * speed * TIME
    x, y = np.sin(heading) / curvature, (1.0 - np.cos(heading)) / curvature
    rates = np.full_like(TIME, curvature * speed), np.full_like(TIME, speed / RADIUS)
    return np.array([x, y, heading, *rates])[:, np.newaxis]


def test_no_deviation_changes_nothing():
    motions = arc(1.5, 0.3)
    none = np.zeros((1, 5))
    found = deviated(motions, none, none)
    np.testing.assert_allclose(found, motions, atol=1e-9)


def test_a_faster_vehicle_goes_farther_and_one_that_turns_more_bends_by_so_much():
    share, extra = np.full((2, 3), 0.02), np.full((2, 3), 0.01)
    straight = arc(2.0, 1e-9)
    both = deviated(straight, share, extra)
    way = 1.02 * 2.0 * TIME
    for vehicle in both.swapaxes(0, 1):  # the second one deviates from the first motion too
        x, y, heading, *_ = vehicle
        assert heading == pytest.approx(0.01 * way, abs=1e-6)
        assert x == pytest.approx(np.sin(0.01 * way) / 0.01, abs=1e-4)
        assert y == pytest.approx((1.0 - np.cos(0.01 * way)) / 0.01, abs=1e-4)
