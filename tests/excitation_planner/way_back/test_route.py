"""A route joins two poses by arcs that the vehicle has room on."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from excitation_planner.area.area import Area
from excitation_planner.area.stops import RUN_OUT, longest_stop
from excitation_planner.way_back.pursuit import CREEPING_SPEED, DECELERATION, WALKING_SPEED
from excitation_planner.way_back.route import FreeGround, RouteRequest, find_route
from tricycle_core.errors import PlanError
from tricycle_core.poses import placed

FOOTPRINT = np.array([[1.8, 0.5], [1.8, -0.5], [-0.4, -0.5], [-0.4, 0.5]])
YARD = Area(
    np.array([[0.0, 0.0], [25.0, 0.0], [25.0, 12.0], [0.0, 12.0]]),
    keep_out=(np.array([[11.0, 0.0], [13.0, 0.0], [13.0, 4.0], [11.0, 4.0]]),),
)
RADIUS = 3.0
HEADINGS = st.floats(-math.pi, math.pi)
LEFT = st.tuples(st.floats(3.5, 7.0), st.floats(3.5, 8.5), HEADINGS)
RIGHT = st.tuples(st.floats(17.0, 21.5), st.floats(3.5, 8.5), HEADINGS)


def request(start, goal, area=YARD):
    return RouteRequest(start, goal, RADIUS, tuple(area.within(area.margin)), FOOTPRINT)


def assert_joined(route, start, goal):
    pose = start
    for arc in route:
        np.testing.assert_allclose(arc.start[:2], pose[:2], atol=1e-6)
        assert abs(math.remainder(arc.start[2] - pose[2], math.tau)) < 1e-6
        assert abs(arc.curvature) <= 1.0 / RADIUS + 1e-9
        pose = arc.end
    np.testing.assert_allclose(pose[:2], goal[:2], atol=1e-6)
    assert abs(math.remainder(pose[2] - goal[2], math.tau)) < 1e-6
    assert route[-1].curvature == 0.0


def assert_on_the_ground(route):
    ground = shapely.Polygon(YARD.keep_in).difference(shapely.Polygon(YARD.keep_out[0]))
    for arc in route:
        for s in np.linspace(0.0, arc.length, 50):
            x, y, heading = arc.at(s)
            footprint = shapely.Polygon(placed(FOOTPRINT, x, y, heading))
            assert ground.buffer(-YARD.margin).contains(footprint)


@given(start=LEFT, goal=RIGHT)
@settings(max_examples=12)
def test_the_footprint_stays_on_the_ground_all_along(start, goal):
    route = find_route(request(start, goal))
    assert_joined(route, start, goal)
    assert_on_the_ground(route)
    assert route == find_route(request(start, goal))


CORNER = 23.6, 3.5, math.radians(-111.0)
"""Where 1.5 m straight in, forwards or backwards, are not on the ground."""

BESIDE_THE_BORDER = 23.6, 3.2, math.radians(-90.0)
"""Out of here the vehicle has to turn in several moves."""


@pytest.mark.slow
@pytest.mark.parametrize("start", [(4.0, 7.5, 2.2), BESIDE_THE_BORDER])
@pytest.mark.parametrize("goal", [CORNER, (9.0, 6.5, 1.5)])
def test_out_of_a_corner_and_into_one(start, goal):
    route = find_route(request(start, goal))
    assert_joined(route, start, goal)
    assert_on_the_ground(route)
    assert all(abs(arc.length) > 0.01 for arc in route), "for none of them does it turn its wheels"


def test_without_a_ground_it_goes_anywhere() -> None:
    start, goal = (0.0, 0.0, 0.0), (0.0, 1.0, math.pi)
    assert_joined(find_route(RouteRequest(start, goal, RADIUS)), start, goal)


ALLEY = Area(np.array([[0.0, 0.0], [25.0, 0.0], [25.0, 3.0], [0.0, 3.0]]))


@pytest.mark.slow
def test_where_there_is_no_room_to_turn_it_says_so() -> None:
    with pytest.raises(PlanError, match=r"no way back to the start: .* no room to turn"):
        find_route(request((6.0, 1.5, 0.0), (15.0, 1.5, math.pi), ALLEY))


def test_a_search_that_is_abandoned_ends_within_a_path() -> None:
    asked = []

    def abandoned() -> bool:
        asked.append(len(asked))
        return len(asked) > 20

    with pytest.raises(PlanError, match="abandoned"):
        find_route(request((6.0, 1.5, 0.0), (15.0, 1.5, math.pi), ALLEY), abandoned)
    assert len(asked) == 21


def test_a_thin_wall_is_not_driven_through() -> None:
    wall = np.array([[12.0, 0.2], [12.02, 0.2], [12.02, 2.8], [12.0, 2.8]])
    open_ground, walled = (
        FreeGround(
            request((5.0, 1.5, 0.0), (20.0, 1.5, 0.0), Area(ALLEY.keep_in, walls, margin=0.0))
        )
        for walls in ((), (wall,))
    )
    along = np.linspace(11.0, 13.0, 41)
    poses = along, np.full(41, 1.5), np.zeros(41)
    assert open_ground.holds(*poses).all()
    across = (along - 0.4 < 12.02) & (along + 1.8 > 12.0)
    assert not walled.holds(*poses)[across].any()


@pytest.mark.parametrize(
    ("start", "goal", "lack"),
    [
        ((6.0, 1.5, 0.0), (15.0, 1.5, 0.4), r"no 0.75 m straight ahead of it or behind it"),
        ((6.0, 1.03, 0.0), (15.0, 1.5, 0.0), r"the vehicle is not 0.05 m inside the ground"),
    ],
)
def test_what_is_lacking_at_an_end_is_said_at_once(start, goal, lack):
    with pytest.raises(PlanError, match=rf"no way back to the start: .*{lack}"):
        find_route(request(start, goal, ALLEY))


def test_the_run_out_is_enough_from_every_speed_that_the_pursuit_has_before_an_end():
    speed = np.linspace(CREEPING_SPEED, WALKING_SPEED, 100)
    left = np.where(speed > CREEPING_SPEED, speed**2 / (2.0 * DECELERATION), 0.0)
    assert np.max(longest_stop(speed) - left) <= RUN_OUT
