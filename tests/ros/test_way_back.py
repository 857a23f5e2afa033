"""A vehicle that drives back to its start by itself, on real nodes."""

import math
from contextlib import suppress

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from excitation_planner.area.area import Area
from excitation_planner.maneuver import Circle
from excitation_planner.planning import PlanRequest, plan_at
from parameter_identification.drives.poses import stamp_of
from parameter_identification.drives.recorded import read_drive, read_way_back
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
            vehicle_file=None, true_seed=3, real_time_factor=10.0, folder=tmp_path, back=tmp_path
        ) as drive,
    ):
        for bag in ("first", "second"):
            drive(plan, tmp_path / bag, lambda *_: None)
        raise KeyboardInterrupt  # before the way back from the last drive, which takes its time
    first, second = (_truth(tmp_path / bag) for bag in ("first", "second"))
    assert math.hypot(*(first[-1] - first[0])[:2]) > 1.0  # there was a way to go
    # nobody put it there: the start is near the planned one, and is not the planned one
    off = _at_start(tmp_path / "second") - plan.start_pose
    assert 0.0 < math.hypot(*off[:2]) < 0.05
    assert abs(math.remainder(off[2], math.tau)) < math.radians(1.0)
    # the way is in the bag, and is not judged
    assert judge(tmp_path / "second").matched_fraction == 1.0
    assert read_way_back(tmp_path / "first") is None
    way, ended = read_way_back(tmp_path / "second"), read_drive(tmp_path / "first").driven
    assert math.hypot(way.x[0] - ended.x[-1], way.y[0] - ended.y[-1]) < 2.0  # the way to rest
    assert math.hypot(way.x[-1] - second[-1, 0], way.y[-1] - second[-1, 1]) > 1.0
    assert math.hypot(way.x[-1] - plan.start_pose[0], way.y[-1] - plan.start_pose[1]) < 0.1


def _at_start(bag):
    """Ground truth x, y, yaw when the drive began."""
    rows, times = _truth(bag, stamps=True)
    return rows[np.searchsorted(times, read_drive(bag).start)]


def _truth(bag, *, stamps=False):
    """Rows x, y, yaw of the ground truth (t, 3), and on demand their stamps (t,) [ns]."""
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == "/ground_truth"]
        messages = [
            reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(connections)
        ]
    poses = [m.pose.pose for m in messages]
    rows = np.array([(p.position.x, p.position.y, yaw_of(p.orientation)) for p in poses])
    return (rows, [stamp_of(m) for m in messages]) if stamps else rows
