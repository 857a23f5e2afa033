"""Everything on this machine: simulated tricycle, emulated PLCs on ptys, and all nodes around them.

ros2 launch tricycle_bringup simulation.launch.py [true_seed:=1] [real_time_factor:=1.0]

A second tricycle: the same with namespace:=second.
"""

from collections.abc import Mapping

from launch import Action, LaunchDescription

from tricycle_bringup.configuration import SIMULATION_CONFIG
from tricycle_bringup.launching import VEHICLE_ARGUMENTS, VehicleNodes, launch_description

ARGUMENTS = {
    **VEHICLE_ARGUMENTS,
    "namespace": ("", "of all names, and of its own /clock"),
    "true_seed": ("-1", "of the hidden truth; -1: nominal"),
    "real_time_factor": ("1.0", "0: as fast as it runs"),
    "plant": ("own", "what the boards drive: our own model, mujoco, or an installed one"),
    "plc": ("emulated", "or firmware, on simulated UNOs"),
    "firmware": ("build/firmware", "built by `make firmware`"),
}


def _actions(value: Mapping[str, str]) -> list[Action]:
    nodes = VehicleNodes(SIMULATION_CONFIG, value)
    folder = f"/tmp/tricycle/{nodes.namespace}".rstrip("/")  # noqa: S108 - of links to the ptys
    ports: dict[str, object] = {"steer_port": f"{folder}/steer", "drive_port": f"{folder}/drive"}
    simulator: dict[str, object] = {
        "vehicle_file": value["vehicle_file"],
        "true_seed": int(value["true_seed"]),
        "real_time_factor": float(value["real_time_factor"]),
        "plant": value["plant"],
        "plc": value["plc"],
        "firmware": value["firmware"],
    }
    return [nodes.simulation(simulator, ports), *nodes.actions(ports)]


def generate_launch_description() -> LaunchDescription:
    return launch_description(ARGUMENTS, _actions)
