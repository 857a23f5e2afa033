"""Everything on this machine: simulated tricycle, emulated PLCs on ptys, and all nodes around them.

ros2 launch tricycle_bringup simulation.launch.py [true_seed:=1] [real_time_factor:=1.0]

A second tricycle: the same with namespace:=second.
"""

from collections.abc import Mapping
from typing import Any

from launch import Action, LaunchDescription

from tricycle_bringup.configuration import SIMULATION_CONFIG
from tricycle_bringup.launching import VEHICLE_ARGUMENTS, VehicleNodes, launch_description

ARGUMENTS = {
    **VEHICLE_ARGUMENTS,
    "namespace": ("", "of all names, and of its own /clock"),
    "true_seed": (-1, "of the hidden truth; -1: nominal"),
    "real_time_factor": (1.0, "0: as fast as it runs"),
    "plant": ("own", "what the boards drive: our own model, mujoco, or an installed one"),
    "plc": ("emulated", "or firmware, on simulated UNOs"),
    "firmware": ("build/firmware", "built by `make firmware`"),
}


def _actions(value: Mapping[str, Any]) -> list[Action]:
    nodes = VehicleNodes(SIMULATION_CONFIG, value)
    folder = f"/tmp/tricycle/{nodes.namespace}".rstrip("/")  # noqa: S108 - of links to the ptys
    ports: dict[str, object] = {"steer_port": f"{folder}/steer", "drive_port": f"{folder}/drive"}
    of_simulator = ("vehicle_file", "true_seed", "real_time_factor", "plant", "plc", "firmware")
    simulator = {name: value[name] for name in of_simulator}
    return [nodes.simulation(simulator, ports), *nodes.actions(ports)]


def generate_launch_description() -> LaunchDescription:
    return launch_description(ARGUMENTS, _actions)
