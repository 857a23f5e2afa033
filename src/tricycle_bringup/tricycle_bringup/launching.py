"""Common part of the launch files. The only module that imports `launch`; only they import it."""

import reprlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import Action, LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    OpaqueFunction,
    RegisterEventHandler,
)
from launch.events import matches_action
from launch.logging import get_logger
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from lifecycle_msgs.msg import Transition

from tricycle_bringup.configuration import bridge_parameters, driver_parameters
from tricycle_bringup.urdf import tricycle_urdf
from tricycle_core.documents import parse_yaml
from tricycle_core.errors import NodeError, did_you_mean
from tricycle_core.start import ending_with_parent
from tricycle_sim.vehicle import load_vehicle

Parameters = dict[str, object]

_KINDS: Mapping[type, tuple[Callable[[str], Any], str]] = {
    bool: (lambda text: {"true": True, "false": False}[text.lower()], "true or false"),
    int: (int, "a whole number"),
    float: (float, "a number"),
}
"""How the text of a launch argument becomes a value of its default's type; others stay text."""

_QUALITY = "qos_overrides."

# Absolute by convention; in a namespace each vehicle has its own, so that two share no clock.
_SHARED = ("clock", "diagnostics", "tf", "tf_static")

Argument = tuple[str | bool | int | float | None, str]

VEHICLE_ARGUMENTS: Mapping[str, Argument] = {
    "namespace": ("", "of all names"),
    "autostart": (True, "configure and activate the bridge"),
    "vehicle_file": ("", "vehicle YAML"),
    "payload": (0.0, "kg that the vehicle carries at most, besides what the file says"),
    "plan_file": ("plan.json", "of the planner, to read and write"),
    "bag": ("", "empty: ~/start records"),
    "identification": (False, "identify while driving, and compare with the plan"),
    "hold_timeout": (0.0, "s without maneuver/hold that end a run; 0: none has to be held"),
    "countdown": (0.0, "s from ~/start to the first command"),
    "bring_up_record": ("", "record of `tricycle plc check` that arming asks for; empty: none"),
    "params_file": ("", "parameter file of yours, for what no other argument sets"),
}
"""Launch arguments of `VehicleNodes`: default and description by name."""


def launch_description(
    arguments: Mapping[str, Argument],
    actions: Callable[[Mapping[str, Any]], list[Action]],
) -> LaunchDescription:
    """Return the description of a launch file.

    Parameters
    ----------
    arguments : mapping of str to (default, str)
        Default and description of each launch argument. The type of the default is that of the
        argument; a text without one (None) must be given.
    actions : callable
        Makes the actions from the values of the arguments.
    """

    def with_values(context: LaunchContext) -> list[Action]:
        _warn_of_misspelt(context.argv, arguments)
        texts = {name: LaunchConfiguration(name).perform(context) for name in arguments}
        return actions(
            {name: _value(name, text, arguments[name][0]) for name, text in texts.items()}
        )

    declared = [
        DeclareLaunchArgument(
            name, default_value=None if default is None else _text(default), description=description
        )
        for name, (default, description) in arguments.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=with_values)])


def _text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _value(name: str, text: str, default: object) -> Any:
    convert, wanted = _KINDS.get(type(default), (str, "a text"))
    try:
        return convert(text)
    except (KeyError, ValueError):
        raise ValueError(f"{name}:={text}: needs {wanted}") from None


def _warn_of_misspelt(given: Iterable[str], known: Iterable[str]) -> None:
    """Say which arguments that were given are nearly ours; launch passes over them in silence."""
    for name in {argument.partition(":=")[0] for argument in given}.difference(known):
        if question := did_you_mean(name, known):  # others may be an including file's
            get_logger("launch").warning(f"{name} is not a launch argument: {question}")


def process(package: str, executable: str) -> dict[str, object]:
    """Return arguments of `Node` for a process that ends with the launch, even a killed one.

    Parameters
    ----------
    package, executable : str
        Names of the package and its executable.
    """
    guard = LaunchConfiguration("launch-prefix", default=" ".join(ending_with_parent()))
    return {
        "package": package,
        "executable": executable,
        "exec_name": executable,  # or messages would begin with the prefix's name
        "prefix": guard,
    }


@dataclass(frozen=True)
class VehicleNodes:
    """The nodes of one vehicle, simulated or real.

    Attributes
    ----------
    config : str
        Parameter file of all nodes.
    value : mapping
        Values of the launch arguments, those of `VEHICLE_ARGUMENTS` among them.
    remappings : tuple of (str, str)
        Remappings of names in all nodes, besides those that the namespace needs.
    """

    config: str
    value: Mapping[str, Any]
    remappings: tuple[tuple[str, str], ...] = ()

    @property
    def namespace(self) -> str:
        """Namespace without slashes around it."""
        return str(self.value["namespace"]).strip("/")

    def node(self, package: str, executable: str, *parameters: Parameters, **more: object) -> Node:
        """Return the launch action of a node.

        Parameters
        ----------
        package, executable : str
            Names of the package and its executable.
        *parameters : dict
            Parameters in addition to those of the parameter file.
        **more : object
            Further arguments of `Node`.
        """
        return Node(
            parameters=self._sources(executable, *parameters),
            **self._common(package, executable),
            **more,
        )

    def simulation(self, *parameters: Parameters) -> Node:
        """Return the simulation; where it ends, all of the launch does, so that bags are closed.

        Parameters
        ----------
        *parameters : dict
            Parameters in addition to those of the parameter file.
        """
        name = "tricycle_sim"
        return self.node(name, name, *parameters, on_exit=_shut_down_after(name))

    def actions(self, ports: Parameters) -> list[Action]:
        """Return all nodes; the monitor if asked for, the model if it can be published.

        Parameters
        ----------
        ports : dict
            Parameters `steer_port` and `drive_port` of the bridge.
        """
        vehicle, plan = self.value["vehicle_file"], self.value["plan_file"]
        bag = self.value["bag"]
        files: Parameters = {"vehicle_file": vehicle, "plan_file": plan}
        driver = driver_parameters(vehicle) | {"recording_needed": bool(bag)}
        driver |= self._asked("hold_timeout", "countdown")
        monitors = []
        if self.value["identification"]:
            monitors = [self.node("parameter_identification", "identification_monitor", files)]
        return [
            *self._bridge(ports),
            self.node("excitation_planner", "excitation_planner", files),
            self.node("excitation_planner", "maneuver_driver", driver),
            self.node(
                "trajectory_recorder",
                "trajectory_recorder",
                {"output": bag, "record": bool(bag)},
            ),
            *monitors,
            *self._state_publisher(),
        ]

    def _asked(self, *names: str) -> Parameters:
        """Launch arguments that are parameters of the same name, as far as they were given.

        What was not may be set in the user's parameter file.
        """
        return {name: self.value[name] for name in names if self.value[name]}

    def _sources(self, executable: str, *parameters: Parameters) -> list[object]:
        """Where the parameters of a node come from: files first; raises where two would differ."""
        given = self.value["params_file"]
        if given:
            set_here = {name for part in parameters for name in part}
            if twice := sorted(set_here & _of_node(given, executable).keys()):
                raise NodeError(
                    f"params_file:={given}: {', '.join(twice)} of {executable}: set by a launch "
                    "argument or the vehicle file; take it out of one of them"
                )
        files = [self.config, *([given] if given else [])]
        return [*files, *self._overrides(executable, files), *parameters]

    def _overrides(self, executable: str, files: Iterable[str]) -> list[Parameters]:
        """Quality of service in parameter files, by the names of topics in the namespace."""
        if not self.namespace:
            return []
        of_topics = f"{_QUALITY}/"
        found: Parameters = {
            name.replace(_QUALITY, f"{_QUALITY}/{self.namespace}", 1): value
            for file in files
            for name, value in _of_node(file, executable).items()
            if name.startswith(of_topics)
        }
        return [found] if found else []

    def _common(self, package: str, executable: str) -> dict[str, object]:
        """Arguments of every node; without SROS2 its enclave does nothing."""
        own = [(f"/{name}", name) for name in _SHARED] if self.namespace else []
        return {
            **process(package, executable),
            "namespace": self.namespace,
            "remappings": [*own, *self.remappings],
            "ros_arguments": ["--enclave", f"/tricycle/{executable}"],
        }

    def _bridge(self, ports: Parameters) -> list[Action]:
        """The bridge with its lifecycle: configured when it is up, activated when it is configured.

        Where the bridge ends, all of the launch does: a vehicle without it is to be started anew.
        Without `autostart` the transitions are left to another lifecycle manager.
        """
        name = "tricycle_bridge"
        own = bridge_parameters(self.value["vehicle_file"])
        own["payload"] = self.value["payload"]
        own |= self._asked("bring_up_record")
        bridge = LifecycleNode(
            name=name,
            parameters=self._sources(name, ports, own, {"autostart": False}),
            on_exit=_shut_down_after(name),
            **self._common(name, name),
        )
        if not self.value["autostart"]:
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

    def _state_publisher(self) -> list[Action]:
        """robot_state_publisher with the vehicle's URDF; nothing where it is not installed."""
        name = "robot_state_publisher"
        try:
            get_package_prefix(name)
        except PackageNotFoundError:
            return []
        file = self.value["vehicle_file"]
        model = tricycle_urdf(load_vehicle(Path(file) if file else None))
        return [self.node(name, name, {"robot_description": model})]


def _of_node(file: str, executable: str) -> dict[str, Any]:
    """Parameters that a file has for a node, by their whole names, whatever its namespace."""
    try:
        content = Path(file).read_bytes()
    except OSError as error:  # launch itself would go on without the file
        raise NodeError(f"parameter file {file}: {error.strerror}") from None
    return dict(_parameters(parse_yaml(content, file, NodeError), executable, file, ""))


def _parameters(entry: object, executable: str, file: str, name: str) -> Iterator[tuple[str, Any]]:
    """Parameters for a node in an entry of a file; as in ROS, a namespace has entries."""
    if not isinstance(entry, dict):
        is_now = "nothing" if entry is None else reprlib.repr(entry)
        raise NodeError(
            f"parameter file {file}: {f'{name}: ' if name else ''}is {is_now}, must be a mapping "
            "as `/**/maneuver_driver: {ros__parameters: {max_deviation: 1.5}}`"
        )
    for key, inner in entry.items():
        if key != "ros__parameters":
            yield from _parameters(inner, executable, file, f"{name}/{key}".removeprefix("/"))
        elif inner is not None and not isinstance(inner, dict):
            raise NodeError(
                f"parameter file {file}: {name}: ros__parameters is {reprlib.repr(inner)}, must be "
                "a mapping of names to values"
            )
        elif not name:
            raise NodeError(
                f"parameter file {file}: ros__parameters: must be below the name of a node, or /**"
            )
        elif name.rpartition("/")[2] in (executable, "*", "**"):
            yield from _dotted(inner or {})


def _dotted(values: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Parameters by their whole names, which mappings in mappings make."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _dotted(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _shut_down_after(name: str) -> list[Action]:
    """Return what ends the launch, with status 1, when a node has ended."""

    def shut_down(context: LaunchContext) -> None:
        if not context.is_shutdown:
            raise RuntimeError(f"{name} has ended")  # `Shutdown` would end with status 0

    return [OpaqueFunction(function=shut_down)]
