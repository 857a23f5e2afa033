"""Mirrored plans: the same drive to the other side, on the same ground."""

import numpy as np
import pytest
import shapely

from excitation_planner.area.area import Area, StartRegion
from excitation_planner.maneuver import Circle
from excitation_planner.plan import load_plan, save_plan
from excitation_planner.planning import PlanRequest, plan_at, planned_for
from excitation_planner.planning.mirror import mirrored
from tricycle_core.errors import InfeasibleManeuver, PlanError
from tricycle_sim.effects import corrected
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate

pytestmark = pytest.mark.slow

YARD = np.array([[0.0, 0.0], [12.0, 0.0], [12.0, 14.0], [0.0, 14.0]])


def plan_on(area):
    request = PlanRequest(
        load_vehicle(), Circle(duration=6.0), "cornering_stiffness", samples=20, area=area
    )
    return plan_at(request, np.array([2.5, 1.0]))


@pytest.fixture(scope="module")
def plan():
    return plan_on(Area(YARD))


def test_it_goes_to_the_other_side_and_stays_on_its_ground(plan, tmp_path):
    image = mirrored(plan, load_vehicle())
    assert image.id != plan.id
    # the packaged tricycle's wheels are not quite symmetric: nor are its drives
    np.testing.assert_allclose(image.reference.y, -plan.reference.y, atol=0.05)
    np.testing.assert_allclose(image.reference.yaw, -plan.reference.yaw, atol=0.02)
    np.testing.assert_allclose(image.curvature, -plan.curvature, atol=1e-3)
    ground = shapely.Polygon(YARD).buffer(-plan.area.margin)
    assert ground.contains(shapely.Polygon(image.stopping_zone[0]))
    save_plan(image, tmp_path / "mirrored.json")
    assert load_plan(tmp_path / "mirrored.json").id == image.id


def test_the_image_of_the_image_drives_as_the_plan_does(plan):
    vehicle = load_vehicle()
    again = mirrored(mirrored(plan, vehicle), vehicle)
    assert again.id == plan.id
    assert again.start_pose == plan.start_pose


def test_an_image_that_does_not_fit_is_refused(plan):
    x, y, heading = plan.start_pose
    only_here = StartRegion((x, x), (y, y), (heading, heading))
    left = shapely.Polygon(plan.stopping_zone[0]).buffer(1.5).exterior
    area = Area(np.asarray(left.coords)[:-1], start=only_here)
    with pytest.raises(InfeasibleManeuver, match=r"mirrored: needs .* m more room in the area"):
        mirrored(plan_on(area), load_vehicle())


def test_a_steering_that_is_steered_back_is_so_in_the_image():
    file = load_vehicle()
    found, _ = corrected(file, {"steering zero": 0.035})  # rad
    request = PlanRequest(found, Circle(duration=6.0), "cornering_stiffness", samples=20)
    plan = planned_for(plan_at(request, np.array([2.5, 1.0])), file)
    assert plan.commands.steering_motor_angle[0] == pytest.approx(-0.035, abs=1e-3)
    image = mirrored(plan, file)
    driven = simulate(found, image.commands, threads=1)
    np.testing.assert_allclose(driven.y[0], image.reference.y, atol=0.15)
    np.testing.assert_allclose(driven.y[0], -plan.reference.y, atol=0.15)


def test_a_plan_that_the_file_does_not_explain_has_no_image(plan):
    askew, _ = corrected(load_vehicle(), {"steering zero": 0.1})
    with pytest.raises(PlanError, match=r"mirrored: the vehicle file moves up to .* otherwise"):
        mirrored(plan, askew)
