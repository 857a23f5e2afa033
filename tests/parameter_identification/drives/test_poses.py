"""Poses in local coordinates."""

import math

import pytest

from parameter_identification.drives.poses import Datum, east_north
from tricycle_core.errors import JudgeError


def test_east_north_of_one_degree_at_the_equator() -> None:
    east, north = east_north(0.0, 1.0, 0.0, Datum(0.0, 0.0))
    assert east == pytest.approx(6_378_137 * math.sin(math.radians(1)), rel=1e-12)
    assert north == 0.0
    # a short arc of the meridian at 45°: radius of curvature a(1-e²)/(1-e²/2)^1.5
    _, north = east_north(45.001, 0.0, 0.0, Datum(45.0, 0.0))
    radius = 6_378_137 * (1 - 6.694_379_990_14e-3) / (1 - 6.694_379_990_14e-3 / 2) ** 1.5
    assert north == pytest.approx(radius * math.radians(0.001), rel=1e-6)
    with pytest.raises(JudgeError, match="latitude is -90 to 90"):
        Datum(91.0, 0.0)
