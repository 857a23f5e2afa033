"""A vehicle that drives back to its start by itself, and begins with a lead-in, on real nodes."""

import math
from contextlib import suppress

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from excitation_planner.area.area import Area
from excitation_planner.maneuver import Circle, with_lead_in
from excitation_planner.planning import PlanRequest, plan_at
from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.measured_from_bag import read_measured_drive
from parameter_identification.drives.poses import stamp_of
from parameter_identification.drives.reader import read_drive, read_way_back
from parameter_identification.judging.judgement import judge
from tricycle_cli.operation.session import simulated_session
from tricycle_core.poses import placed
from tricycle_core.rotations import yaw_of
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate

pytestmark = [pytest.mark.ros, pytest.mark.slow]

YARD = np.array([[0.0, 0.0], [16.0, 0.0], [16.0, 16.0], [0.0, 16.0]])


def test_the_second_drive_begins_where_the_first_one_did(ros_environment, tmp_path):
    vehicle = load_vehicle()
    (family,) = with_lead_in([Circle(duration=8.0)], 1.5)
    request = PlanRequest(vehicle, family, "cornering_stiffness", samples=20, area=Area(YARD))
    plan = plan_at(request, np.array([2.5, 1.0]))
    assert plan.lead_in > 2.0
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
    _check_lead_in(read_measured_drive(tmp_path / "second", vehicle), plan, vehicle)
    # the way is in the bag, and is not judged
    assert judge(tmp_path / "second").plan_id == plan.id
    assert read_way_back(tmp_path / "first") is None
    way, ended = read_way_back(tmp_path / "second"), read_drive(tmp_path / "first").driven
    assert math.hypot(way.x[0] - ended.x[-1], way.y[0] - ended.y[-1]) < 2.0  # the way to rest
    assert math.hypot(way.x[-1] - second[-1, 0], way.y[-1] - second[-1, 1]) > 1.0
    assert math.hypot(way.x[-1] - plan.start_pose[0], way.y[-1] - plan.start_pose[1]) < 0.1


def _check_lead_in(drive, plan, vehicle):
    """What was steered in the lead-in is identified with, and the rest is the plan."""
    commands, row = drive.commands, plan.commands
    led = commands.time < plan.lead_in - 0.005
    assert 0.0 < np.abs(commands.steering_motor_angle[led]).max() < 0.1
    open_loop = np.searchsorted(row.time, commands.time[~led] + 1e-6, side="right") - 1
    np.testing.assert_allclose(
        commands.steering_motor_angle[~led], row.steering_motor_angle[open_loop], atol=1e-9
    )
    # with the hidden truth, these commands lead where the vehicle went
    truth = np.array([[drive.truth[name] for name in vehicle.unknown]])
    motion = simulate(vehicle, commands, truth)
    seen = drive.signals[Sensor.POSITION].between(0.0, commands.duration)
    heading = drive.signals[Sensor.HEADING].between(-1.0, 0.0).values.mean()
    origin = drive.signals[Sensor.POSITION].between(-1.0, 0.0).values.mean(axis=0)
    path = placed(np.column_stack([motion.x[0], motion.y[0]]), *origin, heading)
    expected = [np.interp(seen.time, motion.time, column) for column in path.T]
    assert np.hypot(*(seen.values.T - expected)).mean() < 0.04


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
