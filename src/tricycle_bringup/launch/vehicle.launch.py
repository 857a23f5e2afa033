"""The vehicle: bridge to two real Arduinos, planner, maneuver driver and recorder.

ros2 launch tricycle_bringup vehicle.launch.py odom_topic:=/localization/odometry
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from tricycle_bringup.configuration import VEHICLE_CONFIG, bridge_parameters


def nodes(context: LaunchContext) -> list[Node]:
    value = {
        name: LaunchConfiguration(name).perform(context)
        for name in (
            *("vehicle_file", "steer_port", "drive_port", "odom_topic", "plan_file", "bag"),
        )
    }
    vehicle = {"vehicle_file": value["vehicle_file"]}
    ports = {"steer_port": value["steer_port"], "drive_port": value["drive_port"]}
    recorder = {"output": value["bag"], "record": bool(value["bag"])}

    def node(package: str, executable: str, *parameters: dict[str, object]) -> Node:
        return Node(
            package=package,
            executable=executable,
            parameters=[VEHICLE_CONFIG, *parameters],
            remappings=[("odom", value["odom_topic"])],
        )

    return [
        node("tricycle_bridge", "tricycle_bridge", bridge_parameters(value["vehicle_file"]), ports),
        node(
            "excitation_planner", "excitation_planner", vehicle, {"plan_file": value["plan_file"]}
        ),
        node("excitation_planner", "maneuver_driver"),
        node("trajectory_recorder", "trajectory_recorder", recorder),
    ]


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            DeclareLaunchArgument("vehicle_file", default_value="", description="vehicle YAML"),
            DeclareLaunchArgument("steer_port", default_value="/dev/tricycle_steer"),
            DeclareLaunchArgument("drive_port", default_value="/dev/tricycle_drive"),
            DeclareLaunchArgument(
                "odom_topic", default_value="odom", description="nav_msgs/Odometry of base_link"
            ),
            DeclareLaunchArgument("plan_file", default_value="plan.json"),
            DeclareLaunchArgument("bag", default_value="", description="empty: ~/start records"),
            OpaqueFunction(function=nodes),
        ]
    )
