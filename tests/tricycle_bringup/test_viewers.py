"""RViz configuration and PlotJuggler layout: they show topics and fields that the nodes publish."""

from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

import tricycle_bringup
from trajectory_recorder.bag.topics import jazzy
from tricycle_core.frames import MANEUVER
from tricycle_core.joints import JOINTS

SHARE = Path(tricycle_bringup.__file__).parents[1]
TYPES = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/joint_commands": "sensor_msgs/msg/JointState",
    "/odom": "nav_msgs/msg/Odometry",
    "/ground_truth": "nav_msgs/msg/Odometry",
    "/imu": "sensor_msgs/msg/Imu",
    "/battery_state": "sensor_msgs/msg/BatteryState",
}


def test_rviz_shows_topics_of_the_suite_in_the_frame_of_the_maneuver():
    manager = yaml.safe_load((SHARE / "rviz" / "tricycle.rviz").read_text())[
        "Visualization Manager"
    ]
    assert manager["Global Options"]["Fixed Frame"] == MANEUVER
    topics = {
        display[key]["Value"]: display["Class"].rsplit("/", 1)[1]
        for display in manager["Displays"]
        for key in ("Topic", "Description Topic")
        if key in display
    }
    assert topics == {
        "/maneuver/path": "Path",
        "/maneuver/reference": "Path",
        "/odom": "Odometry",
        "/ground_truth": "Odometry",
        "/robot_description": "RobotModel",
    }


def fields(type_name):
    """Paths of the numbers of a message type."""
    for name, (_, kind) in jazzy().get_msgdef(type_name).fields:
        if isinstance(kind, str):
            yield from (f"{name}/{path}" for path in fields(kind))
        else:
            yield name


@pytest.mark.slow
def test_plotjuggler_shows_fields_that_exist():
    layout = ElementTree.parse(SHARE / "plotjuggler" / "tricycle.xml")
    curves = set()
    for curve in layout.iter("curve"):
        xy = {curve.get("curve_x"), curve.get("curve_y")} - {None}
        curves |= xy or {curve.get("name")}
    assert len(curves) > 10
    for curve in curves:
        topic = next(topic for topic in TYPES if curve.startswith(topic + "/"))
        path = curve.removeprefix(topic + "/")
        if TYPES[topic] == "sensor_msgs/msg/JointState":  # one group for each joint
            joint, quantity = path.split("/")
            assert joint in JOINTS
            assert quantity in ("position", "velocity")
        else:
            assert path in set(fields(TYPES[topic]))
