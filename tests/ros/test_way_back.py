"""A vehicle that drives back to its start by itself, on real nodes."""

import math
from contextlib import suppress

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from excitation_planner.area.area import Area
from excitation_planner.maneuver import Circle
from excitation_planner.planning import PlanRequest, plan_at
from parameter_identification.judging.judgement import judge
from tricycle_cli.operation.session import simulated_session
from tricycle_core.rotations import yaw_of
from tricycle_sim.vehicle import load_vehicle

pytestmark = [pytest.mark.ros, pytest.mark.slow]

YARD = np.array([[0.0, 0.0], [16.0, 0.0], [16.0, 16.0], [0.0, 16.0]])


def test_the_second_drive_begins_where_the_first_one_did(ros_environment, tmp_path):
    request = PlanRequest(
        load_vehicle(), Circle(duration=8.0), "cornering_stiffness", samples=20, area=Area(YARD)
    )
    plan = plan_at(request, np.array([2.5, 1.0]))
    with (
        suppress(KeyboardInterrupt),
        simulated_session(
            vehicle_file=None, true_seed=3, real_time_factor=10.0, folder=tmp_path, back=True
        ) as drive,
    ):
        for bag in ("first", "second"):
            drive(plan, tmp_path / bag, lambda *_: None)
        raise KeyboardInterrupt  # before the way back from the last drive, which takes its time
    first, second = (_truth(tmp_path / bag) for bag in ("first", "second"))
    assert math.hypot(*(first[-1] - first[0])[:2]) > 1.0  # there was a way to go
    # nobody put it there: the start is near the planned one, and is not the planned one
    off = second[0] - plan.start_pose
    assert 0.0 < math.hypot(*off[:2]) < 0.05
    assert abs(math.remainder(off[2], math.tau)) < math.radians(1.0)
    assert judge(tmp_path / "second").matched_fraction == 1.0


def _truth(bag):
    """Rows x, y, yaw of the ground truth (t, 3)."""
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == "/ground_truth"]
        messages = [
            reader.deserialize(raw, c.msgtype).pose.pose
            for c, _, raw in reader.messages(connections)
        ]
    return np.array([(m.position.x, m.position.y, yaw_of(m.orientation)) for m in messages])
