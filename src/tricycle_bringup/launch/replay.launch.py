"""Play a recorded bag with its clock.

ros2 launch tricycle_bringup replay.launch.py bag:=bags/first [rate:=2.0] [topics:=/odom,/imu]
"""

import re
from collections.abc import Mapping
from typing import Any

from launch import Action, LaunchDescription
from launch_ros.actions import Node

from tricycle_bringup.launching import launch_description, process

ARGUMENTS = {
    "bag": (None, "rosbag2 directory, .mcap or .db3 file"),
    "rate": (1.0, "recorded s per s; 0: as fast as taken"),
    "start": (0.0, "recorded s to skip"),
    "duration": (0.0, "recorded s to play; 0: to the end"),
    "topics": ("*", "names to play, with commas between; * and ? match anything"),
    "exclude": ("", "names not to play, of those"),
    "loop": (False, "begin again at the end"),
    "paused": (False, "wait for ~/resume or ~/step"),
    "clock": (True, "publish /clock, unless the bag holds it"),
}


def _actions(value: Mapping[str, Any]) -> list[Action]:
    lists = {name: re.split(r" *, *", value[name]) for name in ("topics", "exclude")}
    parameters = {**value, **lists}
    return [Node(parameters=[parameters], **process("trajectory_recorder", "bag_replayer"))]


def generate_launch_description() -> LaunchDescription:
    return launch_description(ARGUMENTS, _actions)
