"""The URDF against the vehicle file and the joints that the bridge publishes."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import tricycle_bringup
from tricycle_bringup.urdf import tricycle_urdf
from tricycle_sim.vehicle import load_vehicle

VEHICLE = load_vehicle()
INSTALLED = Path(tricycle_bringup.__file__).parents[1] / "urdf" / "tricycle.urdf"


def joints(vehicle):
    robot = ElementTree.fromstring(tricycle_urdf(vehicle))
    return {joint.get("name"): joint for joint in robot.iter("joint")}


def origin(joint):
    return np.array(joint.find("origin").get("xyz").split(), dtype=float)


def test_the_installed_file_is_that_of_the_packaged_vehicle():
    # python -m tricycle_bringup.urdf > src/tricycle_bringup/urdf/tricycle.urdf
    assert INSTALLED.read_text() == tricycle_urdf(VEHICLE)


def test_it_has_the_joints_that_the_bridge_publishes():
    assert {"steering_motor_joint", "rear_wheel_joint"} <= set(joints(VEHICLE))


def test_every_link_hangs_on_base_link_once():
    robot = ElementTree.fromstring(tricycle_urdf(VEHICLE))
    links = [link.get("name") for link in robot.iter("link")]
    children = [child.get("link") for child in robot.iter("child")]
    assert {parent.get("link") for parent in robot.iter("parent")} == {"base_link"}
    assert sorted(["base_link", *children]) == sorted(links)


@pytest.mark.parametrize("vehicle", [VEHICLE, VEHICLE.replace(com_to_rear_axle=1.0, mass=60.0)])
def test_wheels_stand_on_the_ground_where_the_vehicle_file_has_them(vehicle):
    found = joints(vehicle)
    for name, x, y in (
        ("left_wheel_joint", vehicle.com_to_front_axle, vehicle.left_wheel_y),
        ("right_wheel_joint", vehicle.com_to_front_axle, vehicle.right_wheel_y),
        ("rear_wheel_joint", -vehicle.com_to_rear_axle, vehicle.rear_wheel_y),
    ):
        lowest = vehicle.tyre_radius - vehicle.com_height  # the axle, above the ground's -height
        assert origin(found[name]) == pytest.approx([x, y, lowest])


def test_front_wheels_turn_left_about_king_pins_tilted_back():
    for side in ("left", "right"):
        axis = joints(VEHICLE)[f"{side}_wheel_joint"].find("axis").get("xyz")
        x, y, z = map(float, axis.split())
        assert (np.arctan2(-x, z), y) == pytest.approx((VEHICLE.caster_angle, 0.0), abs=1e-5)
