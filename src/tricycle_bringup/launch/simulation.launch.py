"""Everything on this machine: simulated tricycle, emulated PLCs on ptys, and all nodes around them.

ros2 launch tricycle_bringup simulation.launch.py [true_seed:=1] [real_time_factor:=1.0]

A second tricycle: the same with namespace:=second.
"""

from launch import Action, LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from tricycle_bringup.configuration import SIMULATION_CONFIG
from tricycle_bringup.launching import enclave, managed_bridge, own_names, state_publisher


def nodes(context: LaunchContext) -> list[Action]:
    value = {
        name: LaunchConfiguration(name).perform(context)
        for name in (
            *("namespace", "autostart", "vehicle_file", "true_seed", "real_time_factor"),
            *("plan_file", "bag", "plc", "firmware"),
        )
    }
    vehicle_file, namespace = value["vehicle_file"], value["namespace"].strip("/")
    names = own_names(namespace)
    folder = f"/tmp/tricycle/{namespace}".rstrip("/")  # noqa: S108 - of links to the ptys
    ports = {"steer_port": f"{folder}/steer", "drive_port": f"{folder}/drive"}
    simulator = {
        "true_seed": int(value["true_seed"]),
        "real_time_factor": float(value["real_time_factor"]),
        "plc": value["plc"],
        "firmware": value["firmware"],
    }
    recorder = {"output": value["bag"], "record": bool(value["bag"])}
    vehicle = {"vehicle_file": vehicle_file}

    def node(package: str, executable: str, *parameters: dict[str, object]) -> Node:
        return Node(
            package=package,
            executable=executable,
            namespace=namespace,
            parameters=[SIMULATION_CONFIG, *parameters],
            remappings=names,
            ros_arguments=enclave(executable),
        )

    return [
        node("tricycle_sim", "tricycle_sim", vehicle, simulator, ports),
        *managed_bridge(
            [SIMULATION_CONFIG, ports],
            vehicle_file=vehicle_file,
            namespace=namespace,
            remappings=names,
            autostart=value["autostart"].lower() == "true",
        ),
        node(
            "excitation_planner", "excitation_planner", vehicle, {"plan_file": value["plan_file"]}
        ),
        node("excitation_planner", "maneuver_driver"),
        node("trajectory_recorder", "trajectory_recorder", recorder),
        *state_publisher(
            SIMULATION_CONFIG, vehicle_file=vehicle_file, namespace=namespace, remappings=names
        ),
    ]


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "namespace", default_value="", description="of all names, and of its own /clock"
            ),
            DeclareLaunchArgument(
                "autostart", default_value="true", description="configure and activate the bridge"
            ),
            DeclareLaunchArgument("vehicle_file", default_value="", description="vehicle YAML"),
            DeclareLaunchArgument(
                "true_seed", default_value="-1", description="of the hidden truth; -1: nominal"
            ),
            DeclareLaunchArgument(
                "real_time_factor", default_value="1.0", description="0: as fast as it runs"
            ),
            DeclareLaunchArgument(
                "plc", default_value="emulated", description="or firmware, on simulated UNOs"
            ),
            DeclareLaunchArgument(
                "firmware", default_value="build/firmware", description="built by `make firmware`"
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
