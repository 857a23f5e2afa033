"""Drives on real nodes of a plan with an area: one that fits it, and one that the fence stops."""

from dataclasses import replace

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from excitation_planner.area.area import Area
from excitation_planner.maneuver import Circle
from excitation_planner.planning import PlanRequest, plan_at
from parameter_identification.judging.judgement import judge
from tricycle_cli.operation.session import simulated_session
from tricycle_core.errors import JudgeError, NodeError
from tricycle_core.poses import placed
from tricycle_core.rotations import yaw_of
from tricycle_sim.vehicle import load_vehicle

pytestmark = [pytest.mark.ros, pytest.mark.slow]

YARD = np.array([[0.0, 0.0], [12.0, 0.0], [12.0, 14.0], [0.0, 14.0]])


def test_a_drive_that_fits_passes_and_one_that_does_not_rests_inside(ros_environment, tmp_path):
    request = PlanRequest(
        load_vehicle(), Circle(duration=8.0), "cornering_stiffness", samples=20, area=Area(YARD)
    )
    plan = plan_at(request, np.array([2.5, 1.0]))
    # the same drive on a ground that ends before it turns back
    ground = placed(
        np.array([[-9.0, -9.0], [3.2, -9.0], [3.2, 9.0], [-9.0, 9.0]]), *plan.start_pose
    )
    tight = replace(plan, area=replace(plan.area, keep_in=ground))
    with simulated_session(
        vehicle_file=None, true_seed=3, real_time_factor=10.0, folder=tmp_path
    ) as drive:
        with pytest.raises(NodeError, match=r"maneuver aborted: fence: would come out of"):
            drive(tight, tmp_path / "stopped", lambda *_: None)
        drive(plan, tmp_path / "bag", lambda *_: None)
    truth = _truth(tmp_path / "stopped")
    assert np.hypot(*truth[-1, 3:]) < 0.02
    for pose in truth[::5, :3]:
        assert tight.area.clearance(placed(plan.footprint, *pose)).min() > plan.area.margin
    with pytest.raises(JudgeError, match="aborted"):
        judge(tmp_path / "stopped")
    assert judge(tmp_path / "bag").plan_id == plan.id
    truth = _truth(tmp_path / "bag")
    np.testing.assert_allclose(truth[0, :3], plan.start_pose, atol=0.01)


def _truth(bag):
    """Rows x, y, yaw, vx, vy of the ground truth (t, 5)."""
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == "/ground_truth"]
        messages = [
            reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(connections)
        ]
    poses = [
        (m.pose.pose.position, yaw_of(m.pose.pose.orientation), m.twist.twist.linear)
        for m in messages
    ]
    return np.array([(p.x, p.y, yaw, v.x, v.y) for p, yaw, v in poses])
