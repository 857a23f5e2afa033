"""The vehicle: bridge to two real Arduinos, planner, maneuver driver and recorder.

ros2 launch tricycle_bringup vehicle.launch.py odom_topic:=/localization/odometry

The ports' default names come from udev: docs/how-to-vehicle-computer.md.
"""

from collections.abc import Mapping
from typing import Any

from launch import Action, LaunchDescription

from tricycle_bringup.configuration import VEHICLE_CONFIG
from tricycle_bringup.launching import VEHICLE_ARGUMENTS, VehicleNodes, launch_description

ARGUMENTS = {
    **VEHICLE_ARGUMENTS,
    "steer_port": ("/dev/tricycle_steer", "of the steer PLC"),
    "drive_port": ("/dev/tricycle_drive", "of the drive PLC"),
    "odom_topic": ("odom", "nav_msgs/Odometry of base_link"),
}


def _actions(value: Mapping[str, Any]) -> list[Action]:
    nodes = VehicleNodes(VEHICLE_CONFIG, value, (("odom", value["odom_topic"]),))
    return nodes.actions({name: value[name] for name in ("steer_port", "drive_port")})


def generate_launch_description() -> LaunchDescription:
    return launch_description(ARGUMENTS, _actions)
