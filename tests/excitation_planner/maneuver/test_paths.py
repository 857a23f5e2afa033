"""Paths against their geometry: circles are circles, Bézier curves end where they should."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from excitation_planner.maneuver.family import (
    ACCELERATION,
    PATH_SPACING,
    SETTLING_TIME,
    family_by_name,
)
from excitation_planner.maneuver.paths import Circle, DoubleLaneChange, Slalom
from tricycle_core.errors import PlanError
from tricycle_sim.vehicle import load_vehicle

VEHICLE = load_vehicle()
REAR = -VEHICLE.com_to_rear_axle
PATHS = ["circle", "double_lane_change", "slalom"]


def curvature(path):
    heading = np.unwrap(np.arctan2(np.diff(path.y), np.diff(path.x)))
    return np.diff(heading) / PATH_SPACING


@given(radius=st.floats(2, 6), speed=st.floats(0.6, 1.0))
def test_circle_has_its_radius_after_a_run_in_long_enough_to_settle(radius, speed):
    path = Circle().drive(np.array([radius, speed]), VEHICLE)
    run_in = 0.5 * speed**2 / ACCELERATION + SETTLING_TIME * speed
    on_circle = path.x - (REAR + run_in) > 0.1
    distance = np.hypot(path.x - REAR - run_in, path.y - radius)[on_circle]
    assert path.x[0] == REAR
    assert np.allclose(distance, radius, atol=1e-4)
    assert path.length == pytest.approx(run_in + 20.0 * speed)


@given(d1=st.floats(0.5, 8), d2=st.floats(0.5, 8))
def test_lane_change_goes_out_by_its_width_and_comes_back(d1, d2):
    family = DoubleLaneChange()
    path = family.drive(np.array([d1, d2]), VEHICLE)
    assert path.y.max() == pytest.approx(family.width, abs=1e-3)
    assert path.y.min() > -1e-9
    assert path.y[-1] == pytest.approx(0.0, abs=1e-9)
    assert np.all(np.diff(path.x) > 0)


def test_lane_change_starts_with_the_end_curvature_of_its_bezier_curve():
    # (2/3) (W) / d1^2 is the curvature of a cubic Bézier curve at its first control point
    # where P1 - P0 = (d1, 0) and P2 is W to the side: kappa = (2/3) W / d1^2
    path = DoubleLaneChange().drive(np.array([4.0, 4.0]), VEHICLE)
    start = path.x > REAR + 0.5 * 4.0 / ACCELERATION + SETTLING_TIME * 2.0 + 0.1
    first = curvature(path)[np.argmax(start)]
    assert first == pytest.approx(2 / 3 * 2.0 / 4.0**2, rel=0.1)


def test_a_slalom_of_a_fraction_of_gates_ends_on_its_line():
    x = np.array([4.0, 0.5])
    path = Slalom(gates=3.5).drive(x, VEHICLE)
    assert path.length == pytest.approx(Slalom(gates=3).drive(x, VEHICLE).length + 2.0, abs=0.1)
    assert path.y[-1] == pytest.approx(0.0, abs=1e-9)
    assert np.abs(curvature(path)).max() < 1.5 * np.abs(curvature(Slalom().drive(x, VEHICLE))).max()


@given(spacing=st.floats(2, 6), offset=st.floats(0.1, 1))
def test_slalom_passes_its_gates_on_alternate_sides(spacing, offset):
    family = Slalom()
    path = family.drive(np.array([spacing, offset]), VEHICLE)
    run_in = 0.5 * family.speed**2 / ACCELERATION + SETTLING_TIME * family.speed
    gates = np.arange(1, family.gates + 1)
    passed = np.interp(REAR + run_in + gates * spacing, path.x, path.y)
    assert np.allclose(passed, offset * -((-1.0) ** gates), atol=2e-3)
    assert np.abs(path.y).max() < offset + 1e-3
    assert path.y[-1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", PATHS)
def test_points_are_evenly_spaced_and_go_on_beyond_the_end(name):
    family = family_by_name(name)
    path = family.drive(np.array(family.operation.high), VEHICLE)
    assert np.allclose(np.hypot(np.diff(path.x), np.diff(path.y)), PATH_SPACING, rtol=1e-3)
    assert path.x.size * PATH_SPACING > path.length + 2.0


def test_path_that_runs_backwards_is_refused():
    with pytest.raises(PlanError, match=r"length must be at least 8\.00 m"):
        DoubleLaneChange(length=6.0).drive(np.array([8.0, 8.0]), VEHICLE)
