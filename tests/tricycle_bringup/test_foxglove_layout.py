"""The Foxglove layout: every panel is placed once, and shows topics that the nodes publish."""

import json
import re
from pathlib import Path

import tricycle_bringup

LAYOUT = json.loads(
    (Path(tricycle_bringup.__file__).parents[1] / "foxglove" / "tricycle.json").read_text()
)
# /robot_description is robot_state_publisher's; test_two_tricycles finds the others on live nodes
TOPICS = {
    *("/maneuver/path", "/maneuver/reference", "/maneuver/state", "/odom", "/ground_truth"),
    *("/imu", "/joint_commands", "/joint_states", "/diagnostics", "/robot_description"),
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
