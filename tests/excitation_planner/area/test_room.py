"""Where on an area a maneuver begins: its tube fits, and the vehicle can come back to the start."""

import math
from dataclasses import replace

import numpy as np
import pytest

from excitation_planner.area.area import Area
from excitation_planner.area.room import Room
from excitation_planner.area.tube import footprint_of
from excitation_planner.maneuver import DoubleLaneChange
from excitation_planner.planning.replay import nominal_run
from excitation_planner.way_back.pursuit import Chassis
from excitation_planner.way_back.route import RouteRequest, find_route
from tricycle_core.errors import PlanError
from tricycle_core.quantities import FloatArray
from tricycle_sim.vehicle import load_vehicle

VEHICLE = load_vehicle()
YARD = Area(np.array([[0.0, 0.0], [12.0, 0.0], [12.0, 25.0], [0.0, 25.0]]), margin=0.5)


@pytest.mark.parametrize("corners", [YARD.keep_in * 1e-5, YARD.keep_in * (0.06, 1.0)])
def test_an_area_that_the_vehicle_itself_does_not_fit_is_no_area(corners: FloatArray) -> None:
    across, along = np.ptp(corners, axis=0)
    with pytest.raises(PlanError) as caught:
        Room(replace(YARD, keep_in=corners), footprint_of(VEHICLE))
    assert str(caught.value) == (
        f"keep_in: is {across:g} m x {along:g} m large, too small for the vehicle, "
        "2.11 m x 0.82 m; its corners are in m"
    )


def test_three_deviations_of_the_localisation_are_kept_beside_the_margin() -> None:
    exact, noisy = (Room(YARD, footprint_of(VEHICLE), std).needed for std in (0.0, 0.1))
    assert exact > YARD.margin
    assert noisy - exact == pytest.approx(0.3)


def test_a_way_back_leads_to_the_start_of_a_maneuver_that_takes_most_of_the_yard() -> None:
    family, chassis = DoubleLaneChange(length=6.5, speed=1.82), Chassis()
    footprint, x = footprint_of(VEHICLE), np.array([0.18, 4.43])
    fit = Room(YARD, footprint, 0.01).fit(VEHICLE, nominal_run(VEHICLE, family, x).commands)
    assert fit.shortage < 0.0
    place = fit.placement
    goal = chassis.axle(place.x, place.y, place.heading)
    there = chassis.axle(8.26, 4.36, math.radians(-75.3))
    rear = footprint - np.array([chassis.unsteered_axle, 0.0])
    ground = tuple(YARD.within(YARD.margin))
    route = find_route(RouteRequest(there, goal, chassis.radius, ground, rear))
    np.testing.assert_allclose(route[-1].end[:2], goal[:2], atol=1e-6)
