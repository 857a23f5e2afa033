"""Everything on this machine: simulated tricycle, emulated PLCs on ptys, and all nodes around them.

ros2 launch tricycle_bringup simulation.launch.py [true_seed:=1] [real_time_factor:=1.0]
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from tricycle_bringup.configuration import SIMULATION_CONFIG, bridge_parameters


def nodes(context: LaunchContext) -> list[Node]:
    value = {
        name: LaunchConfiguration(name).perform(context)
        for name in ("vehicle_file", "true_seed", "real_time_factor", "plan_file", "bag")
    }
    vehicle = {"vehicle_file": value["vehicle_file"]}
    simulator = {
        "true_seed": int(value["true_seed"]),
        "real_time_factor": float(value["real_time_factor"]),
    }
    recorder = {"output": value["bag"], "record": bool(value["bag"])}

    def node(package: str, executable: str, *parameters: dict[str, object]) -> Node:
        return Node(
            package=package, executable=executable, parameters=[SIMULATION_CONFIG, *parameters]
        )

    return [
        node("tricycle_sim", "tricycle_sim", vehicle, simulator),
        node("tricycle_bridge", "tricycle_bridge", bridge_parameters(value["vehicle_file"])),
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
            DeclareLaunchArgument(
                "true_seed", default_value="-1", description="of the hidden truth; -1: nominal"
            ),
            DeclareLaunchArgument("real_time_factor", default_value="1.0"),
            DeclareLaunchArgument("plan_file", default_value="plan.json"),
            DeclareLaunchArgument("bag", default_value="", description="empty: ~/start records"),
            OpaqueFunction(function=nodes),
        ]
    )
