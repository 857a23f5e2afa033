"""Play a recorded bag with its clock.

ros2 launch tricycle_bringup replay.launch.py bag:=out/demo/bags/circle [rate:=1.0] [loop:=false]
"""

from collections.abc import Mapping

from launch import Action, LaunchDescription
from launch_ros.actions import Node

from tricycle_bringup.launching import launch_description

ARGUMENTS = {
    "bag": (None, "rosbag2 directory"),
    "rate": ("1.0", "0: as fast as taken"),
    "loop": ("false", "begin again at the end"),
}


def _actions(value: Mapping[str, str]) -> list[Action]:
    parameters = {
        "bag": value["bag"],
        "rate": float(value["rate"]),
        "loop": value["loop"].lower() == "true",
    }
    return [Node(package="trajectory_recorder", executable="bag_replayer", parameters=[parameters])]


def generate_launch_description() -> LaunchDescription:
    return launch_description(ARGUMENTS, _actions)
