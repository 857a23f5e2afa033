"""The wheel's speed against odometry."""

import math

import pytest

from tricycle_bridge.measurements.odometry_watch import OdometryWatch


def watched(wheel, odom, *, seconds=1.0, until=math.inf):
    """The watch after both were seen for a time; odometry is silent from `until` on."""
    watch = OdometryWatch()
    for k in range(round(seconds / 0.01)):
        now = 100.0 + 0.01 * k
        if now < until:
            watch.add_odometry(odom, now)
        watch.compare(wheel, now)
    return watch


@pytest.mark.parametrize(
    ("wheel", "odom"), [(1.0, 1.0), (0.0, 0.3), (1.0, 1.5), (4.8, 4.0), (-1.0, -1.2)]
)
def test_small_differences_are_no_problem(wheel, odom):
    assert watched(wheel, odom).problem is None


@pytest.mark.parametrize(
    ("wheel", "odom", "problem"),
    [
        (0.5, 1.02, "the wheel says 0.50 m/s, odom 1.02 m/s: hall sensor miscounts?"),
        (0.0, -0.6, "the wheel says 0.00 m/s, odom -0.60 m/s: hall sensor miscounts?"),
        (1.0, -1.0, "the wheel says 1.00 m/s, odom -1.00 m/s: hall sensor miscounts?"),
    ],
)
def test_lost_pulses_and_a_wrong_direction_are_named(wheel, odom, problem):
    assert watched(wheel, odom, seconds=0.19).problem is None
    assert watched(wheel, odom, seconds=0.25).problem == problem


@pytest.mark.parametrize("period", [0.1, 0.25, 0.5])
def test_a_difference_is_found_at_every_rate_of_odometry(period):
    watch = OdometryWatch()
    for k in range(100):
        now = 0.01 * k
        if k % round(period / 0.01) == 0:
            watch.add_odometry(3.0, now)
        watch.compare(0.5, now)
    assert watch.problem is not None


def test_a_difference_must_last():
    watch = OdometryWatch()
    for k in range(300):
        now = 0.01 * k
        watch.add_odometry(2.0, now)
        watch.compare(0.5 if k % 18 else 2.0, now)
        assert watch.problem is None


@pytest.mark.parametrize("odom", [math.nan, math.inf])
def test_what_is_not_known_is_not_watched(odom):
    assert not watched(1.0, odom).watching(101.0)
    assert watched(0.0, odom).problem is None
    assert watched(None, 2.0).problem is None
    assert watched(0.0, 2.0, seconds=1.5, until=100.15).problem is None  # silent for a second
