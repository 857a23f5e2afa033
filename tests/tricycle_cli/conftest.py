"""The command line as a user types it; a plan, and a bag in which it was driven."""

import copy
import dataclasses
import json
import math

import numpy as np
import pytest

from excitation_planner.maneuver import Circle
from excitation_planner.plan import SearchHistory, save_plan
from excitation_planner.planning import PlanRequest, plan_at
from trajectory_recorder.bag.topics import Topic, jazzy
from trajectory_recorder.bag.writer import BagWriter
from tricycle_cli.main import parser
from tricycle_sim.vehicle import load_vehicle

TYPES = jazzy().types
IDENTIFIED = {
    "level": 0.95,
    "parameters": {
        "cornering_stiffness": {
            "estimate": 610.0, "low": 590.0, "high": 640.0, "unit": "N/rad", "range": [500, 1500],
            "identifiable": True, "truth": 600.0,
            "profile": {"values": [590.0, 610.0, 640.0], "rise": [3.8, 0.0, 3.8]},
        },
        "yaw_inertia": {
            "estimate": 50.0, "low": 25.0, "high": 75.0, "unit": "kg m^2", "range": [25, 75],
            "identifiable": False, "profile": None,
        },
    },
}  # fmt: skip
OFFSET = 0.05  # m to the left that the recorded vehicle drives
START = 1_000_000_000_000  # ns


def header(ns):
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id="odom")


def pose(x, y, yaw):
    return TYPES["geometry_msgs/msg/Pose"](
        position=TYPES["geometry_msgs/msg/Point"](x=x, y=y, z=0.0),
        orientation=TYPES["geometry_msgs/msg/Quaternion"](
            x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2)
        ),
    )


def odometry(ns, x, y, yaw):
    zero = TYPES["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    return TYPES["nav_msgs/msg/Odometry"](
        header=header(ns),
        child_frame_id="base_link",
        pose=TYPES["geometry_msgs/msg/PoseWithCovariance"](
            pose=pose(x, y, yaw), covariance=np.zeros(36)
        ),
        twist=TYPES["geometry_msgs/msg/TwistWithCovariance"](
            twist=TYPES["geometry_msgs/msg/Twist"](linear=zero, angular=zero),
            covariance=np.zeros(36),
        ),
    )


def status(plan, state):
    values = {"state": state, "plan_id": plan.id, "start_time": f"{START / 1e9:.9f}"}
    values |= {"duration": f"{plan.reference.time[-1]:.3f}"}
    return TYPES["diagnostic_msgs/msg/DiagnosticStatus"](
        level=0,
        name="maneuver_driver: maneuver",
        message=state,
        hardware_id="",
        values=[TYPES["diagnostic_msgs/msg/KeyValue"](key=k, value=v) for k, v in values.items()],
    )


def joints(ns, angle, rate):
    return TYPES["sensor_msgs/msg/JointState"](
        header=header(ns),
        name=["steering_motor_joint", "rear_wheel_joint"],
        position=np.array([angle, 0.0]),
        velocity=np.array([0.0, rate]),
        effort=np.array([]),
    )


def record(plan, bag, *, end="done"):
    """A bag of the plan driven `OFFSET` to the left, after a second of standstill."""
    reference = plan.reference
    path = TYPES["nav_msgs/msg/Path"](
        header=header(0),
        poses=[
            TYPES["geometry_msgs/msg/PoseStamped"](header=header(round(t * 1e9)), pose=pose(*at))
            for t, *at in zip(*vars(reference).values(), strict=True)
        ],
    )
    rows = [(START - 10**9, "maneuver/reference", path)]
    rows += [(START, "maneuver/state", status(plan, "running"))]
    time = np.arange(-1.0, reference.time[-1] + 0.5, 0.01)
    x, y, yaw = (
        np.interp(time, reference.time, v) for v in (reference.x, reference.y, reference.yaw)
    )
    y = y + OFFSET * (time > 0.0)
    for ns, *at in zip(START + np.round(time * 1e9).astype(int), x, y, yaw, strict=True):
        rows += [(int(ns), "odom", odometry(int(ns), *map(float, at)))]
        rows += [(int(ns), "joint_states", joints(int(ns), 0.25, 2.0))]
    rows += [(rows[-1][0], "maneuver/state", status(plan, end))]
    with BagWriter(bag) as writer:
        ids = {}
        for ns, name, message in rows:
            kind = message.__msgtype__
            if name not in ids:
                ids[name] = writer.add_topic(Topic.of_type(f"/{name}", kind))
            writer.write(ids[name], ns, bytes(jazzy().serialize_cdr(message, kind)))


@pytest.fixture(scope="session")
def plan():
    request = PlanRequest(load_vehicle(), Circle(duration=4.0), "cornering_stiffness", samples=20)
    x, y = np.meshgrid([2.5, 3.0, 4.0], [0.7, 0.9])
    tried = np.column_stack([x.ravel(), y.ravel()])
    cost = np.array([3.0, 2.0, 2.5, 1.5, 1.0, np.inf])
    found = plan_at(request, np.array([3.0, 0.8]))
    return dataclasses.replace(found, search=SearchHistory(tried, cost))


@pytest.fixture
def folder(plan, tmp_path):
    save_plan(plan, tmp_path / "plans" / "designed.json")
    record(plan, tmp_path / "bags" / "recorded")
    (tmp_path / "result.json").write_text(json.dumps({"designed": {"te_expected": 0.00123}}))
    return tmp_path


@pytest.fixture
def record_drive(plan):
    """Record the plan, driven `OFFSET` to the left, to a bag."""
    return lambda bag, **how: record(plan, bag, **how)


@pytest.fixture
def offset():
    """Distance to the left that the recorded vehicle drives [m]."""
    return OFFSET


@pytest.fixture
def identified():
    """Content of an identification.json with what is needed."""
    return copy.deepcopy(IDENTIFIED)


@pytest.fixture
def tricycle():
    """Run a subcommand with these arguments; mistakes are raised, as `main` catches them."""

    def run(*arguments):
        words = [str(argument) for argument in arguments]
        args = parser(words[:1]).parse_args(words)
        return args.run(args)

    return run
