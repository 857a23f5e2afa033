"""Runs launch files with stand-ins for `launch` and `launch_ros` that record what is built."""

import logging
import runpy
import sys
import tomllib
import types
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
LAUNCH_FOLDER = ROOT / "src" / "tricycle_bringup" / "launch"
LAUNCH_FILES = sorted(path.name for path in LAUNCH_FOLDER.iterdir())
NODES = {
    "excitation_planner": "excitation_planner.planner_node:ExcitationPlanner",
    "maneuver_driver": "excitation_planner.maneuver_driver_node:ManeuverDriver",
    "tricycle_bridge": "tricycle_bridge.bridge_node:BridgeNode",
    "tricycle_sim": "tricycle_sim.sim_node:TricycleSim",
    "trajectory_recorder": "trajectory_recorder.recorder_node:TrajectoryRecorder",
    "bag_replayer": "trajectory_recorder.replayer_node:BagReplayer",
    "identification_monitor": (
        "parameter_identification.identification_monitor_node:IdentificationMonitor"
    ),
}


def project_scripts():
    """Executables and the functions they call."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]


class _Argument:
    def __init__(self, name, default_value=None, description=None):
        self.name, self.default = name, default_value


class _Configuration:
    def __init__(self, name, default=None):
        self.name, self.default = name, default

    def perform(self, context):
        return context[self.name]


class _Context(dict):
    """Launch arguments by name; `argv` are those of the command line."""

    argv = ()


class _Action:
    def __init__(self, *arguments, **keywords):
        self.arguments, self.keywords = arguments, keywords


class _Opaque(_Action):
    pass


class _Node(_Action):
    pass


class _LifecycleNode(_Node):
    pass


class _Description:
    def __init__(self, entities):
        self.entities = entities


class PackageNotFoundError(KeyError):
    """As that of ament_index_python."""


def _modules(installed):
    def module(name, **content):
        made = types.ModuleType(name)
        made.__dict__.update(content)
        return name, made

    def prefix(package):
        if package not in installed:
            raise PackageNotFoundError(package)

    return dict(
        [
            module(
                "launch", Action=_Action, LaunchContext=_Context, LaunchDescription=_Description
            ),
            module(
                "launch.actions",
                DeclareLaunchArgument=_Argument,
                OpaqueFunction=_Opaque,
                EmitEvent=_Action,
                RegisterEventHandler=_Action,
                Shutdown=_Action,
            ),
            module("launch.logging", get_logger=logging.getLogger),
            module("launch.events", matches_action=lambda action: action),
            module("launch.substitutions", LaunchConfiguration=_Configuration),
            module("launch_ros", actions=None),
            module("launch_ros.actions", Node=_Node, LifecycleNode=_LifecycleNode),
            module("launch_ros.event_handlers", OnStateTransition=_Action),
            module("launch_ros.events", lifecycle=None),
            module("launch_ros.events.lifecycle", ChangeState=_Action),
            module(
                "ament_index_python.packages",
                PackageNotFoundError=PackageNotFoundError,
                get_package_prefix=prefix,
            ),
        ]
    )


def launch_actions(file, *, installed=(), argv=(), **arguments):
    """Actions of a launch file, in their order; `installed` are packages found in the ament index.

    `argv` are the arguments as they were written on the command line. Each action has its
    `arguments` and `keywords`.
    """
    arguments = {"bag": "bag", **arguments}
    # only these are removed again: numba, which launch files import, cannot be imported twice
    with pytest.MonkeyPatch.context() as patched:
        for name, module in _modules(installed).items():
            patched.setitem(sys.modules, name, module)
        sys.modules.pop("tricycle_bringup.launching", None)  # bound to those of an earlier call
        description = runpy.run_path(str(LAUNCH_FOLDER / file))["generate_launch_description"]()
        declared = [entity for entity in description.entities if isinstance(entity, _Argument)]
        unknown = set(arguments) - {argument.name for argument in declared}
        assert not unknown, unknown
        context = _Context({a.name: arguments.get(a.name, a.default) for a in declared})
        context.argv = argv
        (action,) = (e for e in description.entities if isinstance(e, _Opaque))
        return action.keywords["function"](context)


def launched_nodes(file, *, installed=(), **arguments):
    """Nodes that a launch file starts: package, executable, remappings, parameters by name.

    `twice` names the parameters that more than one of the node's sources sets.
    """
    actions = launch_actions(file, installed=installed, **arguments)
    return [_resolved(action.keywords) for action in actions if isinstance(action, _Node)]


def _flat(parameters):
    """Parameters by their full names, as rcl reads nested ones."""
    flat = {}
    for name, value in parameters.items():
        if isinstance(value, dict):
            flat |= {f"{name}.{inner}": v for inner, v in _flat(value).items()}
        else:
            flat[name] = value
    return flat


def _resolved(node):
    parameters, twice = {}, []
    for source in node["parameters"]:
        if isinstance(source, str):
            document = yaml.safe_load(Path(source).read_text())
            found = {}
            for key in ("/**", f"/**/{node['executable']}"):
                found |= _flat(document.get(key, {}).get("ros__parameters", {}))
        else:
            found = source
        twice += [name for name in found if name in parameters]
        parameters |= found
    return {
        **node,
        "parameters": parameters,
        "twice": twice,
        "remappings": node.get("remappings", []),
    }
