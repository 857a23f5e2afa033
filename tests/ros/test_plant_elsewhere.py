"""A plant that is a node of somebody else, that of the how-to: driven by a plan, silent, absent."""

import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from excitation_planner.maneuver import Circle
from excitation_planner.planning import PlanRequest, plan_at
from parameter_identification.judging.judgement import judge
from tricycle_cli.operation.session import simulated_session
from tricycle_core.errors import NodeError
from tricycle_sim.vehicle import load_vehicle

pytestmark = [pytest.mark.ros, pytest.mark.slow]

PAGE = Path(__file__).parents[2] / "docs" / "how-to-plant.md"
(EXAMPLE,) = re.findall(
    r"```python\n(import math\n\nimport rclpy.*?)```", PAGE.read_text(), re.DOTALL
)


@pytest.fixture
def elsewhere(ros_environment, tmp_path):
    """The node of the how-to, in a process of its own."""
    (tmp_path / "elsewhere.py").write_text(EXAMPLE)
    process = subprocess.Popen(
        [sys.executable, tmp_path / "elsewhere.py"], stderr=subprocess.DEVNULL
    )
    yield process
    process.kill()
    process.wait()


@pytest.fixture
def plan():
    request = PlanRequest(load_vehicle(), Circle(duration=6.0), "cornering_stiffness", samples=50)
    return plan_at(request, np.array([2.5, 1.0]))


def drive(plan, folder, progress=lambda *_: None):
    with simulated_session(
        vehicle_file=None, true_seed=-1, real_time_factor=10.0, folder=folder, plant="elsewhere"
    ) as session:
        session(plan, folder / "bag", progress)


def test_a_plan_is_driven_on_it_and_judged(elsewhere, plan, tmp_path):
    drive(plan, tmp_path)
    judgement = judge(tmp_path / "bag")
    assert judgement.plan_id == plan.id
    # without slip and with other wheels' angles it drives another circle, but a circle
    assert 1e-3 < np.sqrt(judgement.te_corrected) < 2.0


def test_where_it_falls_silent_the_drive_ends_with_one_line(elsewhere, plan, tmp_path):
    def stop(done, _):
        if done > 2000:
            elsewhere.send_signal(signal.SIGSTOP)

    with pytest.raises(NodeError, match=r"plant/odom: no answer to plant/set_points of \d+\.\d+ s"):
        drive(plan, tmp_path, stop)
    assert (tmp_path / "bag" / "metadata.yaml").exists()
