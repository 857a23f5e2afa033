"""What the launch files share. The only module that imports `launch`; nothing else imports it."""

from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import Action, LaunchContext
from launch.actions import EmitEvent, OpaqueFunction, RegisterEventHandler, Shutdown
from launch.events import matches_action
from launch_ros.actions import LifecycleNode, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from lifecycle_msgs.msg import Transition

from tricycle_bringup.configuration import bridge_parameters
from tricycle_bringup.urdf import tricycle_urdf
from tricycle_sim.vehicle import load_vehicle

Remappings = list[tuple[str, str]]
Parameters = list[str | dict[str, object]]

# Absolute by convention; in a namespace each vehicle has its own, so that two share no clock.
_SHARED = ("clock", "diagnostics", "tf", "tf_static")


def own_names(namespace: str) -> Remappings:
    """Remappings that give a vehicle in a namespace its own clock, diagnostics and transforms."""
    return [(f"/{name}", name) for name in _SHARED] if namespace else []


def enclave(executable: str) -> list[str]:
    """ROS arguments that give a node its SROS2 enclave; without SROS2 they do nothing."""
    return ["--enclave", f"/tricycle/{executable}"]


def managed_bridge(
    parameters: Parameters,
    *,
    vehicle_file: str,
    namespace: str,
    remappings: Remappings,
    autostart: bool,
) -> list[Action]:
    """The bridge with its lifecycle: configured when it is up, activated when it is configured.

    Where the bridge ends, all of the launch does: a vehicle without it is to be started anew.

    Parameters
    ----------
    parameters
        Besides those that follow from the vehicle file.
    autostart
        False leaves the transitions to another lifecycle manager.
    """
    bridge = LifecycleNode(
        package="tricycle_bridge",
        executable="tricycle_bridge",
        name="tricycle_bridge",
        namespace=namespace,
        parameters=[*parameters, bridge_parameters(vehicle_file), {"autostart": False}],
        remappings=remappings,
        ros_arguments=enclave("tricycle_bridge"),
        on_exit=[OpaqueFunction(function=_shut_down)],
    )
    if not autostart:
        return [bridge]

    def change(transition: int) -> EmitEvent:
        return EmitEvent(
            event=ChangeState(
                lifecycle_node_matcher=matches_action(bridge), transition_id=transition
            )
        )

    configured = OnStateTransition(
        target_lifecycle_node=bridge,
        start_state="configuring",
        goal_state="inactive",
        entities=[change(Transition.TRANSITION_ACTIVATE)],
    )
    return [
        RegisterEventHandler(configured),
        bridge,
        change(Transition.TRANSITION_CONFIGURE),
    ]


def _shut_down(context: LaunchContext) -> list[Action]:
    return [] if context.is_shutdown else [Shutdown(reason="tricycle_bridge has ended")]


def state_publisher(
    config: str, *, vehicle_file: str, namespace: str, remappings: Remappings
) -> list[Action]:
    """robot_state_publisher with the URDF of the vehicle file; nothing where it is not installed.

    Parameters
    ----------
    config
        Parameter file of all nodes.
    """
    try:
        get_package_prefix("robot_state_publisher")
    except PackageNotFoundError:
        return []
    vehicle = load_vehicle(Path(vehicle_file) if vehicle_file else None)
    return [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            namespace=namespace,
            parameters=[config, {"robot_description": tricycle_urdf(vehicle)}],
            remappings=remappings,
            ros_arguments=enclave("robot_state_publisher"),
        )
    ]
