"""What identification_monitor makes of the messages of a drive, given to it one by one."""

import re
from dataclasses import replace
from importlib.resources import files
from threading import Event

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from found_identification import FOUND
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import JointState
from simulated_drives import VEHICLE, commands_of_pair, driven
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from excitation_planner.maneuver import Circle
from excitation_planner.plan import save_plan
from excitation_planner.planning import PlanRequest, plan_at
from parameter_identification.drives.measured import Sensor
from parameter_identification.identification_file import document_of, save_identification_file
from parameter_identification.identification_monitor_node import IdentificationMonitor
from parameter_identification.live_identification import LiveIdentification
from tricycle_core.diagnostics import Level
from tricycle_core.errors import IdentificationError
from tricycle_core.joints import JOINTS
from tricycle_core.maneuver_state import ManeuverState, PlaybackState
from tricycle_core.stamps import SECOND
from tricycle_sim.vehicle import load_vehicle

pytestmark = pytest.mark.ros

START = 1_700_000_000 * SECOND


class Driven:
    """A monitor that hears the poses of a drive, and of its state what it is told."""

    def __init__(self):
        self.node = IdentificationMonitor()
        self.told = []
        self.plan_id = "plan"
        self.node._estimates.publish = self.told.append
        self.commands = commands_of_pair()["circle"]
        position = driven(self.commands, standstill=1.0).signals[Sensor.POSITION]
        self._poses = list(zip(position.time.tolist(), position.values.tolist(), strict=True))

    def hand_over(self):
        message = JointTrajectory(joint_names=list(JOINTS))
        message.header.frame_id, message.header.stamp = self.plan_id, stamp(-10.0)
        played = self.commands
        for row in zip(played.time, played.steering_motor_angle, played.speed, strict=True):
            at, angle, speed = map(float, row)
            message.points.append(
                JointTrajectoryPoint(
                    positions=[angle, 0.0],
                    velocities=[0.0, speed / VEHICLE.driven_radius],
                    time_from_start=Duration(sec=int(at), nanosec=round(at % 1.0 * SECOND)),
                )
            )
        self.node._on_commands(message)

    def state(self, state, elapsed=0.0, commander=""):
        whole = self.commands.duration
        told = ManeuverState(
            state, self.plan_id, START, elapsed, whole, commander=commander
        ).values()
        pairs = [KeyValue(key=key, value=value) for key, value in told.items()]
        self.node._on_state(DiagnosticStatus(values=pairs))

    def poses(self, begin, end):
        for at, (x, y) in self._poses:
            if begin <= at < end:
                message = Odometry()
                message.header.stamp = stamp(at)
                message.pose.pose.position.x, message.pose.pose.position.y = x, y
                message.pose.pose.orientation.w = 0.0  # no heading
                self.node._on_odom(message)

    def played(self, time, sender="", **values):
        message = JointState(name=list(JOINTS), **values)
        message.header.frame_id = sender
        message.header.stamp = stamp(time)
        self.node._on_played(message)

    def drive(self, end):
        """Drive until a time, the state told every half second and the monitor asked then."""
        self.hand_over()
        self.poses(-1.0, 0.0)
        for half in range(round(2.0 * end)):
            self.state(PlaybackState.RUNNING, 0.5 * half)
            self.poses(0.5 * half, 0.5 * half + 0.5)
            self.update()

    def update(self):
        """Ask the monitor, and let it tell what its fits have shown."""
        self.node._update()
        self.settle()

    def settle(self):
        for fit in self.node._fits:
            fit.thread.join()
        self.node._tell_fitted()


def stamp(time):
    nanoseconds = START + round(time * SECOND)
    return Time(sec=nanoseconds // SECOND, nanosec=nanoseconds % SECOND)


@pytest.fixture
def monitor(ros_environment):
    """Constructs a monitor with parameters, NAME=VALUE."""
    made = []

    def construct(**parameters):
        pairs = [("-p", f"{name}:={value}") for name, value in parameters.items()]
        rclpy.init(args=["--ros-args", *(word for pair in pairs for word in pair)])
        made.append(Driven())
        return made[-1]

    yield construct
    for one in made:
        one.node.destroy_node()
    rclpy.try_shutdown()


def test_estimates_come_while_it_drives(monitor):
    driven = monitor()
    driven.drive(3.0)
    assert driven.told[-1].message.startswith("3.0 s: cornering_stiffness ")


@pytest.mark.parametrize("other", [False, True])
def test_earlier_drives_count_where_they_are_of_this_vehicle(monitor, tmp_path, capfd, other):
    file = tmp_path / "known.json"
    found = FOUND if other else replace(FOUND, vehicle_hash=VEHICLE.fingerprint)
    save_identification_file(document_of(found), file)
    driven = monitor(known_file=file)
    driven.drive(3.0)
    std = float(driven.told[-1].message.split()[5])
    assert (std > 50.0) == other  # 5 after these drives
    warned = f"earlier drives do not count: {file} is of another vehicle, tricycle (abc)"
    assert (warned in capfd.readouterr().err) == other


@pytest.mark.parametrize(
    "state", [PlaybackState.WAITING, PlaybackState.STARTING, PlaybackState.RETURNING, None]
)
def test_a_drive_whose_driver_is_gone_gets_no_verdict(monitor, capfd, state):
    driven = monitor()
    driven.drive(3.0)
    if state is None:
        driven.poses(3.0, 4.5)
        driven.update()
        assert driven.told[-1].message.startswith("4.")  # a message may be late
        driven.poses(4.5, 5.2)
    else:
        driven.state(state)
    told = len(driven.told)
    driven.update()
    assert len(driven.told) == told
    line = f"the driver is {state.value if state else 'silent'}: the drive of plan plan gets no"
    assert line in capfd.readouterr().err
    driven.poses(5.2, 11.5)
    kept = driven.node._live._samples[Sensor.POSITION]
    assert kept[-1][0] - kept[0][0] < 6 * SECOND
    driven.drive(3.0)  # replayed
    assert driven.told[-1].message.startswith("3.0 s: ")


@pytest.mark.parametrize(("first", "line"), [(0.0, ""), (1.5, "first 1.5 s"), (9.0, "first 2.0 s")])
def test_set_points_of_a_lead_in_that_were_not_heard_are_told(monitor, capfd, first, line):
    driven = monitor()
    lead_in = Path()
    lead_in.header.stamp = stamp(-10.0)
    lead_in.poses.append(PoseStamped())
    lead_in.poses[-1].header.stamp = Time(sec=2)
    driven.node._on_lead_in(lead_in)
    driven.drive(3.0)
    driven.played(first, velocity=[0.0, 1.0])  # no angle
    for tick in range(300):
        if tick >= 100.0 * first:
            driven.played(0.01 * tick, position=[0.0, 0.0])
    driven.state(PlaybackState.ABORTED, 3.0)
    for _ in range(2):
        driven.node._end()
    said = capfd.readouterr().err
    assert (
        f"/joint_commands: the steering in the {line} of the lead-in was not heard" in said
    ) == (bool(line))
    assert ("was not heard" in said) == bool(line)


def test_targets_may_stand_apart(monitor, capfd):
    driven = monitor(targets="cornering_stiffness, yaw_inertia", tolerance=0.5)
    driven.drive(2.0)
    assert {pair.key: pair.value for pair in driven.told[-1].values}["known"] == "false"
    assert "no unknown parameter" not in capfd.readouterr().err


def test_a_vehicle_of_which_all_is_known_is_refused(monitor, tmp_path):
    packaged = (files("tricycle_sim") / "tricycle.yaml").read_text(encoding="utf-8")
    known = re.sub(r"nominal: ([^,]+), range: \[[^\]]*\]", r"value: \1", packaged)
    (tmp_path / "known.yaml").write_text(known, encoding="utf-8")
    with pytest.raises(IdentificationError, match="tricycle has no unknown parameter"):
        monitor(vehicle_file=tmp_path / "known.yaml")


def test_samples_are_heard_while_a_fit_takes_long(monitor, monkeypatch):
    go_on, update = Event(), LiveIdentification.update

    def slow(live):
        go_on.wait(60.0)
        return update(live)

    driven = monitor()
    monkeypatch.setattr(LiveIdentification, "update", slow)
    driven.hand_over()
    driven.state(PlaybackState.RUNNING)
    driven.poses(-1.0, 3.0)
    driven.state(PlaybackState.RUNNING, 3.0)
    driven.node._update()
    driven.poses(3.0, 4.0)
    driven.node._update()  # the first fit goes on
    assert driven.node._live.newest(Sensor.POSITION) > START + 3.9 * SECOND
    assert len(driven.node._fits) == 1
    go_on.set()
    driven.settle()
    driven.update()
    elapsed = [{p.key: p.value for p in message.values}["elapsed"] for message in driven.told]
    assert [round(float(value)) for value in elapsed] == [3, 4]


def test_the_model_is_compiled_before_a_drive(monitor, monkeypatch):
    prepared = []
    monkeypatch.setattr(LiveIdentification, "prepare", lambda live: prepared.append(live))
    driven = monitor()
    assert prepared == [driven.node._live]


def test_a_drive_of_which_nothing_was_heard_gets_a_message_too(monitor):
    driven = monitor()
    driven.hand_over()
    driven.state(PlaybackState.RUNNING)
    driven.state(PlaybackState.DONE, 12.0)
    driven.node._end()
    driven.settle()
    (message,) = driven.told
    assert message.level == bytes([Level.WARN])
    assert message.message.startswith("no verdict: its samples show no motion")


def test_a_plan_for_another_vehicle_is_not_identified(monitor, tmp_path):
    packaged = (files("tricycle_sim") / "tricycle.yaml").read_text(encoding="utf-8")
    (tmp_path / "longer.yaml").write_text(
        packaged.replace("axle: {value: 0.724", "axle: {value: 0.781"), encoding="utf-8"
    )
    longer = load_vehicle(tmp_path / "longer.yaml")
    request = PlanRequest(longer, Circle(duration=4.0), "cornering_stiffness", samples=50)
    plan = plan_at(request, np.array([2.5, 1.0]))
    save_plan(plan, tmp_path / "plan.json")
    driven = monitor(plan_file=tmp_path / "plan.json")
    driven.plan_id = plan.id
    driven.drive(3.0)
    (message,) = driven.told
    assert message.level == bytes([Level.WARN])
    assert message.message.startswith(f"nothing is identified: plan {plan.id} is for")


def test_a_clock_that_begins_anew_ends_a_drive_without_a_verdict(monitor, capfd):
    driven = monitor()
    driven.drive(6.0)
    told = len(driven.told)
    for tick in range(200):  # of the new clock
        message = Odometry()
        message.header.stamp = stamp(-100.0 + 0.05 * tick)
        message.pose.pose.orientation.w = 1.0
        driven.node._on_odom(message)
    driven.state(PlaybackState.ABORTED, 6.0)
    driven.node._end()
    driven.update()
    assert len(driven.told) == told
    line = "the clock of the samples began anew: the drive of plan plan gets no verdict"
    assert line in capfd.readouterr().err


def test_set_points_of_another_commander_are_not_those_of_the_lead_in(monitor):
    driven = monitor()
    lead_in = Path()
    lead_in.header.stamp = stamp(-10.0)
    lead_in.poses.append(PoseStamped())
    lead_in.poses[-1].header.stamp = Time(sec=2)
    driven.node._on_lead_in(lead_in)
    driven.hand_over()
    driven.state(PlaybackState.RUNNING, commander="/maneuver_driver")
    for tick in range(100):
        driven.played(0.01 * tick, "/maneuver_driver", position=[0.0, 0.0])
        driven.played(0.01 * tick, "/teleop", position=[0.5, 0.0])
    assert {angle for _, angle in driven.node._live._drive.led} == {0.0}
