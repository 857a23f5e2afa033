"""The vehicle: bridge to two real Arduinos, planner, maneuver driver and recorder.

ros2 launch tricycle_bringup vehicle.launch.py odom_topic:=/localization/odometry

The ports' default names come from udev: docs/how-to-vehicle-computer.md.
"""

from launch import Action, LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from tricycle_bringup.configuration import VEHICLE_CONFIG
from tricycle_bringup.launching import enclave, managed_bridge, own_names, state_publisher


def nodes(context: LaunchContext) -> list[Action]:
    value = {
        name: LaunchConfiguration(name).perform(context)
        for name in (
            *("namespace", "autostart", "vehicle_file", "steer_port", "drive_port"),
            *("odom_topic", "plan_file", "bag"),
        )
    }
    vehicle_file, namespace = value["vehicle_file"], value["namespace"].strip("/")
    names = [*own_names(namespace), ("odom", value["odom_topic"])]
    ports = {"steer_port": value["steer_port"], "drive_port": value["drive_port"]}
    recorder = {"output": value["bag"], "record": bool(value["bag"])}

    def node(package: str, executable: str, *parameters: dict[str, object]) -> Node:
        return Node(
            package=package,
            executable=executable,
            namespace=namespace,
            parameters=[VEHICLE_CONFIG, *parameters],
            remappings=names,
            ros_arguments=enclave(executable),
        )

    return [
        *managed_bridge(
            [VEHICLE_CONFIG, ports],
            vehicle_file=vehicle_file,
            namespace=namespace,
            remappings=names,
            autostart=value["autostart"].lower() == "true",
        ),
        node(
            "excitation_planner",
            "excitation_planner",
            {"vehicle_file": vehicle_file, "plan_file": value["plan_file"]},
        ),
        node("excitation_planner", "maneuver_driver"),
        node("trajectory_recorder", "trajectory_recorder", recorder),
        *state_publisher(
            VEHICLE_CONFIG, vehicle_file=vehicle_file, namespace=namespace, remappings=names
        ),
    ]


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="of all names"),
            DeclareLaunchArgument(
                "autostart", default_value="true", description="configure and activate the bridge"
            ),
            DeclareLaunchArgument("vehicle_file", default_value="", description="vehicle YAML"),
            DeclareLaunchArgument(
                "steer_port", default_value="/dev/tricycle_steer", description="of the steer PLC"
            ),
            DeclareLaunchArgument(
                "drive_port", default_value="/dev/tricycle_drive", description="of the drive PLC"
            ),
            DeclareLaunchArgument(
                "odom_topic", default_value="odom", description="nav_msgs/Odometry of base_link"
            ),
            DeclareLaunchArgument(
                "plan_file",
                default_value="plan.json",
                description="of the planner, to read and write",
            ),
            DeclareLaunchArgument("bag", default_value="", description="empty: ~/start records"),
            OpaqueFunction(function=nodes),
        ]
    )
