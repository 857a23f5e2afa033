"""Modules under the names that the documentation of 0.1 showed; they go with 0.3."""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

RENAMED = {
    "excitation_planner.steering_maneuver": "excitation_planner.maneuver.steering",
    "parameter_identification.judge": "parameter_identification.judging.judgement",
    "parameter_identification.measured_drive": "parameter_identification.drives.measured_from_bag",
    "tricycle_bridge.command_messages": "tricycle_bridge.commands.command_messages",
    "tricycle_bridge.command_stream": "tricycle_bridge.commands.command_stream",
    "tricycle_bridge.command_thread": "tricycle_bridge.commands.command_thread",
    "tricycle_bridge.command_thread_node": "tricycle_bridge.commands.command_thread",
    "tricycle_bridge.framing": "tricycle_bridge.protocol.framing",
    "tricycle_bridge.joint_pairing": "tricycle_bridge.measurements.joint_pairing",
    "tricycle_bridge.link": "tricycle_bridge.plc_link.link",
    "tricycle_bridge.messages": "tricycle_bridge.protocol.messages",
    "tricycle_bridge.odometry_watch": "tricycle_bridge.measurements.odometry_watch",
    "tricycle_bridge.start_watch": "tricycle_bridge.measurements.start_watch",
    "tricycle_bringup.cli": "tricycle_cli.main",
    "tricycle_sim.firmware_plc": "tricycle_sim.plc.firmware",
    "tricycle_sim.firmware_simulator": "tricycle_sim.rig.firmware",
    "tricycle_sim.plc_pair": "tricycle_sim.plc.pair",
    "tricycle_sim.simulated_avr": "tricycle_sim.plc.simulated_uno",
}


class _Loader(Loader):
    """Puts the module of the present name in place of the one that is imported."""

    def exec_module(self, module: ModuleType) -> None:
        now = RENAMED[module.__name__]
        message = f"{module.__name__} is {now} now; the old name goes with version 0.3"
        warnings.warn(message, DeprecationWarning, stacklevel=2)
        sys.modules[module.__name__] = importlib.import_module(now)


class _Finder(MetaPathFinder):
    """Finds the old names."""

    def find_spec(
        self, fullname: str, _path: Sequence[str] | None, _target: ModuleType | None = None
    ) -> ModuleSpec | None:
        return ModuleSpec(fullname, _Loader()) if fullname in RENAMED else None


def install() -> None:
    """Make the old names importable; the packages that had them call this."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.append(_Finder())
