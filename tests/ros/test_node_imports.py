"""What a node imports before it is up: each is to be up within a second and a half of CPU time."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.ros

SLOW = {
    *("scipy.stats", "scipy.signal", "scipy.linalg", "scipy.optimize", "numba", "sklearn"),
    *("matplotlib", "plotly", "pandas", "rosbags", "rich", "shapely"),
}
NEEDED = {
    "tricycle_bridge.bridge_node": set(),
    "tricycle_sim.sim_node": {"numba"},  # it steps the vehicle from the start
    "excitation_planner.planner_node": set(),
    "excitation_planner.maneuver_driver_node": set(),
    "trajectory_recorder.recorder_node": set(),
    "trajectory_recorder.replayer_node": set(),
    # it fits while a maneuver is driven
    "parameter_identification.identification_monitor_node": {
        *("numba", "scipy.linalg", "scipy.optimize", "shapely"),
    },
}


@pytest.mark.parametrize("module", NEEDED)
def test_a_node_imports_nothing_slow_that_it_does_not_need_at_once(module):
    code = f"import sys, {module}; print(*sys.modules)"
    command = [sys.executable, "-c", code]
    found = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert SLOW & set(found) <= NEEDED[module]
