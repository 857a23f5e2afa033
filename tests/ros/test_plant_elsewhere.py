"""A plant that is a node of somebody else, that of the how-to: driven by a plan, silent, absent."""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import Quaternion
from nav_msgs.msg import Odometry

from excitation_planner.maneuver import Circle
from excitation_planner.planning import PlanRequest, plan_at
from parameter_identification.judging.judgement import judge
from tricycle_cli.operation.session import simulated_session
from tricycle_core.errors import NodeError, PlantError
from tricycle_sim.plants import elsewhere_node
from tricycle_sim.vehicle import load_vehicle

pytestmark = pytest.mark.ros

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


@pytest.mark.slow
def test_a_plan_is_driven_on_it_and_judged(elsewhere, plan, tmp_path):
    drive(plan, tmp_path)
    judgement = judge(tmp_path / "bag")
    assert judgement.plan_id == plan.id
    # without slip and with other wheels' angles it drives another circle, but a circle
    assert 1e-3 < np.sqrt(judgement.te_corrected) < 2.0


@pytest.mark.slow
def test_where_it_falls_silent_the_drive_ends_with_one_line(elsewhere, plan, tmp_path):
    def stop(done, _):
        if done > 2000:
            elsewhere.send_signal(signal.SIGSTOP)

    with pytest.raises(NodeError, match=r"plant/odom: no answer to plant/set_points of \d+\.\d+ s"):
        drive(plan, tmp_path, stop)
    assert (tmp_path / "bag" / "metadata.yaml").exists()


def test_ctrl_c_while_nobody_answers_ends_the_simulation_at_once(
    ros_environment, ros_node, tmp_path
):
    ports = ["-p", f"steer_port:={tmp_path / 'steer'}", "-p", f"drive_port:={tmp_path / 'drive'}"]
    words = ["--ros-args", "-p", "plant:=elsewhere", *ports]
    program = Path(sys.executable).with_name("tricycle_sim")
    sim = subprocess.Popen(
        [program, *words], env=ros_environment, stderr=subprocess.PIPE, text=True
    )
    try:
        deadline = time.monotonic() + 60.0
        while not ros_node.count_publishers("plant/set_points"):
            assert time.monotonic() < deadline
            assert sim.poll() is None
            time.sleep(0.05)
        begin = time.monotonic()
        sim.send_signal(signal.SIGINT)
        _, errors = sim.communicate(timeout=30.0)
        assert time.monotonic() - begin < elsewhere_node.PATIENCE / 2.0
    finally:
        sim.kill()
    assert (sim.returncode, "no answer" in errors) == (0, False), errors


@pytest.mark.parametrize(
    ("child", "w", "wrong"),
    [
        ("rear_axle", 1.0, "plant/odom: child_frame_id is rear_axle, must be base_link: pose and"),
        ("base_link", 0.0, r"plant/odom: orientation 0, 0, 0, 0 \(w, x, y, z\) is not a unit quat"),
        ("base_link", 2.0, "is not a unit quaternion"),
        ("base_link", float("nan"), "orientation nan, 0, 0, 0"),
        ("base_link", 1.0, ""),
        ("", 1.0, ""),
    ],
)
def test_a_pose_of_another_frame_or_without_an_orientation_is_refused(child, w, wrong):
    odom = Odometry(child_frame_id=child)
    odom.pose.pose.orientation = Quaternion(w=w)
    if not wrong:
        elsewhere_node._check(odom)
        return
    with pytest.raises(PlantError, match=wrong):
        elsewhere_node._check(odom)
