"""Planner, driver and simulation as processes: what they answer, refuse and say at their end."""

import dataclasses
import multiprocessing
import signal
import subprocess
import sys
import time
from importlib import resources
from itertools import pairwise
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PolygonStamped, PoseStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from excitation_planner import planner_node
from excitation_planner.maneuver import Circle
from excitation_planner.plan import save_plan
from excitation_planner.planning import PlanRequest, plan_at
from tricycle_cli.operation.operator_node import ServiceCaller
from tricycle_core.nodes import LATCHED
from tricycle_core.readiness import Readiness
from tricycle_sim.vehicle import load_vehicle

pytestmark = [pytest.mark.ros, pytest.mark.slow]

PATIENCE = 90.0  # s; only a failing test waits that long
BIN = Path(sys.executable).parent


class Observer:
    """Spins a node until something is so."""

    def __init__(self, node):
        self.node = node
        self.executor = SingleThreadedExecutor(context=node.context)
        self.executor.add_node(node)
        self.services = ServiceCaller(node, self.wait)

    def wait(self, condition, what):
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, f"waited in vain for {what}"
            self.executor.spin_once(timeout_sec=0.05)

    def newest(self, kind, topic, qos=10):
        box = []
        self.node.create_subscription(kind, topic, lambda m: box.__setitem__(slice(None), [m]), qos)
        return box

    def call(self, service):
        return self.services.call(service, Trigger, Trigger.Request())


@pytest.fixture
def observer(ros_node):
    return Observer(ros_node)


@pytest.fixture
def start(ros_environment, tmp_path):
    """Starts node executables with parameters; ends them after the test, exit status 0 each."""
    running = []

    def start_node(name, **parameters):
        arguments = [a for key, value in parameters.items() for a in ("-p", f"{key}:={value}")]
        process = subprocess.Popen(
            [BIN / name, "--ros-args", *arguments],
            env=ros_environment,
            cwd=tmp_path,
            stderr=subprocess.PIPE,
            text=True,
        )
        running.append(process)
        return process

    yield start_node
    for process in running:
        process.send_signal(signal.SIGINT)
    for process in running:
        _, errors = process.communicate(timeout=20)
        assert "Traceback" not in errors
        assert process.returncode in (0, 2), errors


def test_planner_answers_at_once_plans_publishes_and_remembers(observer, start, tmp_path):
    diagnostics = observer.newest(DiagnosticArray, "/diagnostics")
    small = {"criterion": "c", "samples": 20, "budget": 2500, "plan_file": "plan.json"}
    first = start("excitation_planner", **small)
    asked = time.monotonic()
    answer = observer.call("excitation_planner/plan")
    assert answer.success, answer.message
    assert not observer.call("excitation_planner/plan").success  # one at a time
    observer.wait(lambda: (tmp_path / "plan.json").exists(), "the plan")
    commands = observer.newest(JointTrajectory, "maneuver/commands", LATCHED)
    reference = observer.newest(PathMessage, "maneuver/reference", LATCHED)
    observer.wait(lambda: commands and reference, "the latched plan")
    assert commands[0].joint_names == ["steering_motor_joint", "rear_wheel_joint"]
    assert reference[0].poses[0].header.stamp.sec == 0
    observer.wait(
        lambda: diagnostics and "H" in {v.key for v in diagnostics[0].status[0].values},
        "indices in the diagnostics",
    )
    values = {v.key: v.value for v in diagnostics[0].status[0].values}
    assert values["criterion"] == "c"
    assert 0.0 < float(values["std cornering_stiffness"]) < 1000.0 / 12.0**0.5
    first.send_signal(signal.SIGINT)
    first.wait(20)
    plan_id = commands[0].header.frame_id
    commands.clear()
    start("excitation_planner", **small)
    observer.wait(lambda: commands, "the last plan after a restart")
    assert commands[0].header.frame_id == plan_id
    assert time.monotonic() - asked < PATIENCE


def test_planner_refuses_an_unknown_target_and_can_be_cancelled(observer, start):
    start("excitation_planner", target="mass", plan_file="a.json")
    answer = observer.call("excitation_planner/plan")
    assert not answer.success
    assert "unknown target 'mass'" in answer.message
    assert observer.call("excitation_planner/cancel").message == "nothing is being planned"


def test_planner_refuses_an_unknown_criterion(observer, start):
    start("excitation_planner", criterion="e", plan_file="a.json")
    answer = observer.call("excitation_planner/plan")
    assert (answer.success, answer.message) == (
        False,
        "unknown criterion 'e'; one of: 'h', 'c', 'd', 'a'",
    )


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({"budget": 10}, "budget = 10 is too small"),
        ({"plan_file": "file/plan.json"}, "file is a file; a folder is needed"),
    ],
)
def test_planner_refuses_before_its_work_what_would_fail_after_it(
    observer, start, tmp_path, parameters, problem
):
    (tmp_path / "file").touch()
    start("excitation_planner", **parameters)
    answer = observer.call("excitation_planner/plan")
    assert not answer.success
    assert problem in answer.message


@pytest.mark.parametrize("knowingly", [False, True])
def test_planner_publishes_the_plan_of_another_vehicle_knowingly_only(
    observer, start, tmp_path, knowingly
):
    request = PlanRequest(load_vehicle(), Circle(duration=2.0), "cornering_stiffness", samples=20)
    plan = plan_at(request, Circle().operation.from_unit([0.5, 0.5]))
    other = plan.constants | {"com_to_front_axle": 1.25}
    save_plan(dataclasses.replace(plan, constants=other), tmp_path / "plan.json")
    node = start("excitation_planner", plan_file="plan.json", other_vehicle=knowingly)
    if knowingly:
        commands = observer.newest(JointTrajectory, "maneuver/commands", LATCHED)
        observer.wait(lambda: commands, "the plan")
    else:
        said = next(line for line in node.stderr if "not published" in line)
        assert "com_to_front_axle 1.25 instead of" in said


def test_planner_refuses_parameters_that_no_plan_can_be_made_of(observer, start):
    start("excitation_planner", plan_file="c.json")

    def change(name, value):
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        (result,) = observer.services.call(
            "excitation_planner/set_parameters", SetParameters, request
        ).results
        return result.successful, result.reason

    for name, value in (
        *(("criterion", "e"), ("target", "weight"), ("maneuver", "loop")),
        ("area_file", "nowhere.yaml"),
    ):
        accepted, reason = change(name, value)
        assert not accepted
        assert repr(value) in reason or value in reason
    assert change("target", "yaw_inertia") == (True, "")


def test_the_planner_warns_of_files_that_it_takes_but_doubts(observer, start, tmp_path):
    text = (resources.files("tricycle_sim") / "tricycle.yaml").read_text()
    (tmp_path / "long.yaml").write_text(
        text.replace("pitch_inertia: {value: 36.7", "pitch_inertia: {value: 367")
    )
    (tmp_path / "yard.yaml").write_text("keep_in: [[0, 0], [12000, 0], [12000, 25000], [0, 25000]]")
    said = []
    observer.node.create_subscription(Log, "/rosout", lambda log: said.append(log.msg), 10)
    start("excitation_planner", vehicle_file="long.yaml", area_file="yard.yaml")
    observer.wait(lambda: observer.node.count_publishers("/rosout") > 1, "the node's log")
    answer = observer.call("excitation_planner/plan")
    assert answer.success, answer.message
    for text in (
        "yard.yaml: keep_in: is 12000 m x 25000 m large; its corners are in m",
        "long.yaml: pitch_inertia: 367 kg m^2 is larger than the sum of the other two",
    ):
        observer.wait(lambda text=text: any(line.startswith(text) for line in said), text)
    observer.call("excitation_planner/cancel")


def test_a_vehicle_and_its_plan_are_set_at_once_and_the_plan_is_published(
    observer, start, tmp_path
):
    longer = tmp_path / "longer.yaml"
    text = (resources.files("tricycle_sim") / "tricycle.yaml").read_text()
    longer.write_text(text.replace("axle: {value: 0.724", "axle: {value: 0.781"))
    request = PlanRequest(
        load_vehicle(longer), Circle(duration=2.0), "cornering_stiffness", samples=20
    )
    plan = plan_at(request, Circle().operation.from_unit([0.5, 0.5]))
    save_plan(plan, tmp_path / "longer.json")
    start("excitation_planner", plan_file="none.json")

    def change(**values):
        parameters = [
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]
        request = SetParametersAtomically.Request(parameters=parameters)
        service = "excitation_planner/set_parameters_atomically"
        result = observer.services.call(service, SetParametersAtomically, request).result
        return result.successful, result.reason

    commands = observer.newest(JointTrajectory, "maneuver/commands", LATCHED)
    own = {"plan_file": str(tmp_path / "longer.json")}
    assert not change(**own)[0]
    assert change(**own, vehicle_file=str(longer)) == (True, "")
    observer.wait(lambda: commands, "the plan")
    assert commands[0].header.frame_id == plan.id
    accepted, reason = change(**own, vehicle_file="")  # back to the packaged one, with this plan
    assert not accepted
    assert "com_to_front_axle 0.781 instead of 0.724" in reason


def test_a_planning_under_way_is_cancelled(observer, start, tmp_path):
    start("excitation_planner", plan_file="b.json")
    assert observer.call("excitation_planner/plan").success
    assert observer.call("excitation_planner/cancel").success
    assert not (tmp_path / "b.json").exists()
    assert observer.call("excitation_planner/cancel").message == "nothing is being planned"
    assert observer.call("excitation_planner/plan").success  # refused while one is under way


class Chain:
    """What a driver hears of planner, bridge and localisation, and what it says."""

    def __init__(self, observer):
        self.observer, self.node = observer, observer.node
        self.state = observer.newest(DiagnosticStatus, "maneuver/state", LATCHED)
        self.running = observer.newest(Bool, "maneuver/running", LATCHED)
        self.joints = observer.newest(JointState, "joint_commands")
        publisher = self.node.create_publisher
        self._commands = publisher(JointTrajectory, "maneuver/commands", LATCHED)
        self._path = publisher(PathMessage, "maneuver/path", LATCHED)
        self._ground = publisher(PolygonStamped, "maneuver/ground", LATCHED)
        self._readiness = publisher(DiagnosticStatus, "vehicle/state", LATCHED)
        self._odom = publisher(Odometry, "odom", 10)
        self.pose = Odometry()
        self.posing = False
        self.said = None  # on vehicle/state, again and again
        self.node.create_timer(0.02, self._send)

    def _send(self):
        if self.said is not None:
            self._readiness.publish(self.said)
        if self.posing:
            self.pose.header.stamp = self.node.get_clock().now().to_msg()
            self._odom.publish(self.pose)

    def values(self):
        return {v.key: v.value for v in self.state[0].values} if self.state else {}

    def plan(self, plan_id, *, path=((0.0, 0.0), (60.0, 0.0)), ground=True):
        """Publish a straight plan of a minute without an area, and its path unless that is None."""
        stamp = self.node.get_clock().now().to_msg()
        if ground:
            message = PolygonStamped()
            message.header.stamp = stamp
            self._ground.publish(message)
        if path is not None:
            message = PathMessage(poses=[PoseStamped() for _ in path])
            message.header.stamp = stamp
            for pose, (x, y) in zip(message.poses, path, strict=True):
                pose.pose.position.x, pose.pose.position.y = x, y
            self._path.publish(message)
        message = JointTrajectory(joint_names=["steering_motor_joint", "rear_wheel_joint"])
        message.header.frame_id, message.header.stamp = plan_id, stamp
        for second in range(60):
            point = JointTrajectoryPoint(positions=[0.1, 0.0], velocities=[0.0, 1.0])
            point.time_from_start.sec = second
            message.points.append(point)
        self._commands.publish(message)

    def tell(self, armed, reason=""):
        """Publish `vehicle/state` from now on."""
        values = Readiness(armed, reason).values().items()
        self.said = DiagnosticStatus(values=[KeyValue(key=k, value=v) for k, v in values])

    def start(self):
        call = self.observer.call
        self.observer.wait(lambda: call("maneuver_driver/start").success, "the start")

    def refused(self):
        answer = self.observer.call("maneuver_driver/start")
        assert not answer.success
        return answer.message

    def wait_for(self, **values):
        self.observer.wait(lambda: values.items() <= self.values().items(), str(values))


@pytest.fixture
def chain(observer):
    return Chain(observer)


def test_driver_starts_only_an_armed_vehicle_that_it_sees_and_aborts_when_it_is_disarmed(
    chain, start
):
    log = chain.observer.newest(Log, "/rosout")
    start("maneuver_driver", odom_timeout=0.3)
    assert chain.refused().startswith("no commands yet")
    for plan_id, path in (("pathless", None), ("empty", ()), ("a point", ((0.0, 0.0),))):
        chain.plan(plan_id, path=path)
        chain.wait_for(plan_id=plan_id)
        assert chain.refused().startswith("no path on maneuver/path with the stamp of the commands")
    chain.plan("whole")
    chain.wait_for(plan_id="whole", state="waiting")
    assert chain.refused().startswith("nothing heard on vehicle/state")
    chain.tell(armed=False, reason="hardware e-stop pressed")
    chain.observer.wait(lambda: "is not armed: hardware e-stop" in chain.refused(), "the refusal")
    chain.tell(armed=True)
    chain.observer.wait(lambda: chain.refused().startswith("no pose on odom;"), "the refusal")
    assert not chain.joints  # nothing is commanded unless it drives
    chain.pose.header.frame_id, chain.pose.pose.pose.position.x = "odom", 7.0
    origin = chain.observer.newest(PoseStamped, "maneuver/start", LATCHED)
    chain.posing = True
    chain.plan("groundless", ground=False)
    chain.wait_for(plan_id="groundless", state="waiting")
    groundless = "nothing on maneuver/ground with the stamp of the commands"
    chain.observer.wait(lambda: chain.refused().startswith(groundless), "the refusal")
    chain.plan("whole")
    chain.wait_for(plan_id="whole", state="waiting")
    chain.start()
    chain.observer.wait(lambda: origin, "where the path lies")
    assert (origin[0].header.frame_id, origin[0].pose.position.x) == ("odom", 7.0)
    moved = lambda: chain.joints and chain.joints[0].velocity[1] == 1.0  # noqa: E731
    chain.observer.wait(moved, "the first row")
    chain.observer.wait(lambda: chain.running and chain.running[0].data, "running, as a value")
    assert chain.joints[0].header.frame_id == "/maneuver_driver"
    chain.plan("next")
    chain.tell(armed=False, reason="steer PLC is FAULT (SENSOR)")
    aborted = "the vehicle is not armed: steer PLC is FAULT (SENSOR)"
    chain.wait_for(state="aborted", plan_id="whole", reason=aborted)
    chain.observer.wait(lambda: log[0].msg == f"aborted: {aborted}", "the line in the log")
    chain.observer.wait(lambda: not chain.running[0].data, "not running, as a value")
    chain.observer.wait(lambda: chain.joints[0].velocity[1] == 0.0, "standstill")
    assert chain.joints[0].position[0] == pytest.approx(0.1)
    chain.wait_for(state="waiting", plan_id="next")
    chain.tell(armed=True)
    chain.start()
    chain.posing = False
    chain.wait_for(state="aborted", plan_id="next")
    assert chain.values()["reason"].startswith("no pose on odom for")


def test_on_the_way_back_the_origin_is_told_now_and_then_and_a_failed_link_refuses_it(chain, start):
    start("maneuver_driver")
    chain.pose.header.frame_id, chain.posing = "odom", True
    chain.tell(armed=True)
    chain.plan("there")
    chain.wait_for(plan_id="there", state="waiting")
    chain.start()
    chain.wait_for(state="running")
    chain.tell(armed=False)
    chain.wait_for(state="aborted")
    chain.tell(armed=True)
    chain.pose.pose.pose.position.x = 0.25  # less than a jump
    diagnostics = chain.node.create_publisher(DiagnosticArray, "/diagnostics", 10)

    def answer(level):
        status = DiagnosticStatus(level=level, name="tricycle_bridge: steer PLC", message="how")
        diagnostics.publish(DiagnosticArray(status=[status]))
        # while it is being stopped, each refusal is logged into a pipe that nobody empties
        asked_at = time.monotonic()
        chain.observer.wait(lambda: time.monotonic() > asked_at + 0.1, "a tenth of a second")
        return chain.observer.call("maneuver_driver/go_back")

    failed = "tricycle_bridge: steer PLC: how"
    chain.observer.wait(
        lambda: answer(DiagnosticStatus.ERROR).message == failed, "the refusal by the link"
    )
    told = []
    chain.node.create_subscription(PoseStamped, "maneuver/start", told.append, LATCHED)
    chain.observer.wait(lambda: answer(DiagnosticStatus.OK).success, "the way back")
    chain.wait_for(state="returning")
    told.clear()
    chain.observer.wait(lambda: float(chain.values()["elapsed"]) >= 1.0, "a second of it")
    assert len(told) < 5  # of 50 poses


def test_a_start_after_the_simulation_has_ended_names_its_clock(chain, start):
    publisher = chain.node.create_publisher(Clock, "/clock", 1)
    now = chain.node.get_clock().now
    ticking = chain.node.create_timer(0.01, lambda: publisher.publish(Clock(clock=now().to_msg())))
    told = chain.observer.newest(DiagnosticArray, "maneuver/preflight", LATCHED)

    def clock_is(level):
        checks = {status.name: status.level for status in told[0].status} if told else {}
        return checks.get("clock") == level

    start("maneuver_driver", use_sim_time=True)
    chain.observer.wait(lambda: clock_is(DiagnosticStatus.OK), "a clock that runs")
    assert chain.refused().startswith("no commands yet")
    ticking.cancel()
    chain.observer.wait(lambda: clock_is(DiagnosticStatus.ERROR), "a clock that stands still")
    assert chain.refused().startswith("/clock has stood still for")


def test_simulation_ticks_once_per_10_ms_and_resets(observer, start, tmp_path):
    ports = {"steer_port": tmp_path / "steer", "drive_port": tmp_path / "drive"}
    start("tricycle_sim", **ports, true_seed=1, real_time_factor=5.0, position_noise=0.0)
    ticks = []
    observer.node.create_subscription(
        Clock, "/clock", lambda m: ticks.append(m.clock.sec * 10**9 + m.clock.nanosec), 1000
    )
    truth = observer.newest(Odometry, "ground_truth")
    observer.wait(lambda: len(ticks) > 200, "the clock")
    assert all((b - a) % 10_000_000 == 0 and b > a for a, b in pairwise(ticks))
    assert (tmp_path / "steer").is_char_device()
    observer.wait(lambda: truth, "the truth")
    assert abs(truth[0].pose.pose.position.x) < 1e-6
    aside = SetParameters.Request(parameters=[Parameter("start_x", value=3.0).to_parameter_msg()])
    (set_aside,) = observer.services.call(
        "tricycle_sim/set_parameters", SetParameters, aside
    ).results
    assert set_aside.successful
    assert observer.call("tricycle_sim/reset").success
    observer.wait(lambda: abs(truth[0].pose.pose.position.x - 3.0) < 1e-3, "the start pose")


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("tricycle_sim", {"vehicle_file": "nowhere.yaml"}, "nowhere.yaml"),
        ("tricycle_sim", {"true_values": "[mass]"}, "'mass' must be name=number"),
        ("tricycle_sim", {"true_values": "[weight=3]"}, "weight: is not a constant"),
        ("tricycle_sim", {"real_time_factor": "-1.0"}, "real_time_factor"),
        ("maneuver_driver", {"max_deviation": "0.0"}, "max_deviation"),
        ("excitation_planner", {"seed": "text"}, "seed"),
        (
            "trajectory_recorder",
            {"topics": "['a b']"},
            "topics: 'a b': topic name must not contain",
        ),
        ("trajectory_recorder", {"exclude": "['1']"}, "exclude: '1': topic name token must not"),
    ],
)
def test_a_wrong_parameter_is_one_line_and_status_2(start, name, parameters, message):
    process = start(name, **parameters)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    (line,) = errors.strip().splitlines()
    assert message in line


def test_the_planning_of_a_killed_node_ends_in_silence(monkeypatch):
    nodes_end, planning_end = multiprocessing.Pipe()
    nodes_end.close()
    monkeypatch.setattr(planner_node, "_request", lambda _: None)
    monkeypatch.setattr(planner_node.signal, "signal", lambda *_: None)
    monkeypatch.setattr(planner_node.planning, "plan_maneuver", lambda _, progress: progress(1, 2))
    with pytest.raises(SystemExit):
        planner_node._plan_in_process({}, Path("plan.json"), planning_end)
