"""The Foxglove layout: every panel is placed once, and shows topics that the nodes publish."""

import base64
import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

import tricycle_bringup
import tricycle_sim
from tricycle_bringup.layout import foxglove_layout
from tricycle_bringup.urdf import tricycle_urdf
from tricycle_sim.vehicle import load_vehicle

PACKAGED = (Path(tricycle_bringup.__file__).parent / "foxglove" / "tricycle.json").read_text()
LAYOUT = json.loads(PACKAGED)
VEHICLE = load_vehicle()
# /robot_description is robot_state_publisher's, /foxglove_script/* comes from the layout's own
# scripts; test_two_tricycles finds the others on live nodes
TOPICS = {
    *("/maneuver/path", "/maneuver/reference", "/maneuver/state", "/odom", "/ground_truth"),
    *("/imu", "/joint_commands", "/joint_states", "/diagnostics", "/robot_description"),
    *(
        "/maneuver/start",
        "/identification/estimates",
        "/maneuver/preflight",
        "/foxglove_script/pose",
        "/foxglove_script/tf",
    ),
    "/foxglove_script/maneuver_tf",
}


def panels(node):
    if isinstance(node, str):
        return [node]
    return panels(node["first"]) + panels(node["second"])


def test_every_configured_panel_is_placed_once():
    assert sorted(panels(LAYOUT["layout"])) == sorted(LAYOUT["configById"])


def test_panels_show_topics_that_exist():
    shown = set(re.findall(r'"(/\w+(?:/\w+)*)', json.dumps(LAYOUT)))
    assert shown
    assert shown <= TOPICS


def test_the_packaged_layout_has_the_model_of_the_packaged_vehicle():
    assert foxglove_layout(VEHICLE) == PACKAGED


def test_the_model_is_the_vehicles():
    longer = VEHICLE.replace(com_to_front_axle=1.1, tyre_radius=0.25)
    url = json.loads(foxglove_layout(longer))["configById"]["3D!tricycle"]["layers"]["model"]["url"]
    kind, _, data = url.partition(",")
    assert kind == "data:application/xml;base64"
    assert base64.b64decode(data).decode() == tricycle_urdf(longer)


@pytest.mark.parametrize(
    ("unknown", "shown", "label", "unit"),
    [
        (None, "front.cornering_stiffness", "front cornering stiffness", "N/rad"),
        ({"yaw_inertia": (0.001, 0.01)}, "yaw_inertia", "yaw inertia", "kg m^2"),
    ],
)
def test_the_standard_deviation_shown_is_of_a_parameter_of_the_vehicle(unknown, shown, label, unit):
    car = load_vehicle(Path(tricycle_sim.__file__).parent / "car_1_10.yaml")
    car = car if unknown is None else replace(car, unknown=unknown)
    panel = json.loads(foxglove_layout(car))["configById"]["Plot!learnt"]
    names = [re.search(r'key=="(.+?)"', path["value"])[1] for path in panel["paths"]]
    assert names == [f"{shown} std", f"{shown} planned std"]
    assert shown in car.unknown
    assert panel["paths"][0]["label"] == label
    assert panel["yAxisLabel"] == unit


def test_scripts_make_poses_and_transforms_of_what_is_published():
    outputs = set()
    for script in LAYOUT["userNodes"].values():
        (topic,) = re.findall(r'export const inputs = \["(.+?)"\]', script["sourceCode"])
        assert topic in TOPICS
        outputs |= set(re.findall(r'export const output = "(.+?)"', script["sourceCode"]))
    assert outputs == {topic for topic in TOPICS if topic.startswith("/foxglove_script/")}
