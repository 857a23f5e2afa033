"""The Foxglove layout: every panel is placed once, and shows topics that the nodes publish."""

import base64
import json
import re
from pathlib import Path

import tricycle_bringup

SHARE = Path(tricycle_bringup.__file__).parents[1]
LAYOUT = json.loads((SHARE / "foxglove" / "tricycle.json").read_text())
# /robot_description is robot_state_publisher's, /foxglove_script/* comes from the layout's own
# scripts; test_two_tricycles finds the others on live nodes
TOPICS = {
    *("/maneuver/path", "/maneuver/reference", "/maneuver/state", "/odom", "/ground_truth"),
    *("/imu", "/joint_commands", "/joint_states", "/diagnostics", "/robot_description"),
    *("/maneuver/start", "/foxglove_script/pose", "/foxglove_script/tf"),
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


def test_the_model_is_the_urdf():
    """In the layout itself, because a bag holds no model."""
    url = LAYOUT["configById"]["3D!tricycle"]["layers"]["model"]["url"]
    kind, _, data = url.partition(",")
    assert kind == "data:application/xml;base64"
    assert base64.b64decode(data) == (SHARE / "urdf" / "tricycle.urdf").read_bytes()


def test_scripts_make_poses_and_transforms_of_what_is_published():
    outputs = set()
    for script in LAYOUT["userNodes"].values():
        (topic,) = re.findall(r'export const inputs = \["(.+?)"\]', script["sourceCode"])
        assert topic in TOPICS
        outputs |= set(re.findall(r'export const output = "(.+?)"', script["sourceCode"]))
    assert outputs == {topic for topic in TOPICS if topic.startswith("/foxglove_script/")}
