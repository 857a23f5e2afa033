"""Play a recorded bag with its clock.

ros2 launch tricycle_bringup replay.launch.py bag:=out/demo/bags/circle [rate:=1.0] [loop:=false]
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def nodes(context: LaunchContext) -> list[Node]:
    value = {name: LaunchConfiguration(name).perform(context) for name in ("bag", "rate", "loop")}
    parameters = {
        "bag": value["bag"],
        "rate": float(value["rate"]),
        "loop": value["loop"].lower() == "true",
    }
    return [Node(package="trajectory_recorder", executable="bag_replayer", parameters=[parameters])]


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag", description="rosbag2 directory"),
            DeclareLaunchArgument("rate", default_value="1.0", description="0: as fast as taken"),
            DeclareLaunchArgument(
                "loop", default_value="false", description="begin again at the end"
            ),
            OpaqueFunction(function=nodes),
        ]
    )
