"""`tricycle drive --vehicle-nodes`: an operator who comes and goes at nodes that stay."""

import signal
import subprocess
import sys
import time
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

from excitation_planner.maneuver import Circle
from excitation_planner.plan import save_plan
from excitation_planner.planning import PlanRequest, plan_at
from excitation_planner.playback import LONGEST_STOP
from parameter_identification.judging.judgement import judge
from trajectory_recorder.bag.reader import BagReader
from tricycle_cli.operation.operator_node import ServiceCaller
from tricycle_cli.operation.session import simulated_session
from tricycle_core.errors import JudgeError, NodeError
from tricycle_core.nodes import LATCHED
from tricycle_core.stamps import seconds_of
from tricycle_sim.vehicle import load_vehicle

pytestmark = [pytest.mark.ros, pytest.mark.slow]


def test_an_interrupted_drive_stops_the_vehicle_and_one_after_a_kill_says_what_is_still_running(
    ros_environment, ros_node, tmp_path
):
    def save(name, duration, vehicle=None):
        family = Circle(duration=duration)
        request = PlanRequest(load_vehicle(vehicle), family, "cornering_stiffness", samples=50)
        plan = plan_at(request, np.array([2.5, 1.0]))
        save_plan(plan, tmp_path / name)
        return plan.id

    long = save("long.json", 120.0)
    short = save("short.json", 4.0)
    state, vehicle = {}, {}
    for topic, heard in (("maneuver/state", state), ("vehicle/state", vehicle)):
        ros_node.create_subscription(
            DiagnosticStatus,
            topic,
            lambda message, heard=heard: heard.update({p.key: p.value for p in message.values}),
            LATCHED,
        )
    clock = {}
    ros_node.create_subscription(
        Clock, "/clock", lambda message: clock.update(now=seconds_of(message.clock)), 10
    )
    executor = SingleThreadedExecutor(context=ros_node.context)
    executor.add_node(ros_node)

    def wait(condition, what):
        deadline = time.monotonic() + 60
        while not condition():
            assert time.monotonic() < deadline, f"waited in vain for {what}: {state}"
            executor.spin_once(timeout_sec=0.02)

    services = ServiceCaller(ros_node, wait)

    def armed():
        return services.call("tricycle_bridge/arm", SetBool, SetBool.Request(data=True)).success

    def drive(plan, bag, *options):
        return subprocess.Popen(
            [Path(sys.executable).with_name("tricycle"), "drive", plan, "--bag", bag,
             "--vehicle-nodes", *options],
            cwd=tmp_path, env=ros_environment, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    with simulated_session(
        vehicle_file=None, true_seed=-1, real_time_factor=4.0, folder=tmp_path / "session"
    ):
        company = pytest.raises(NodeError, match=r"ROS domain \d+ has a .* already")
        another = simulated_session(
            vehicle_file=None, true_seed=-1, real_time_factor=4.0, folder=tmp_path / "another"
        )
        wait(armed, "both boards")
        with company, another:
            pass
        interrupted = drive("long.json", "first")
        wait(lambda: state.get("state") == "running" and float(state["elapsed"]) >= 1, "driving")
        for _ in range(3):  # the later ones while it asks for the abort
            interrupted.send_signal(signal.SIGHUP)
            time.sleep(0.015)
        _, errors = interrupted.communicate(timeout=60)
        assert (interrupted.returncode, errors.splitlines()[-1]) == (130, "tricycle: interrupted")
        wait(lambda: state["state"] == "aborted", "the abort")
        assert state["reason"] == "asked for"
        with BagReader(tmp_path / "first") as bag:
            assert bag.complete
        with pytest.raises(JudgeError, match="the maneuver was aborted: asked for"):
            judge(tmp_path / "first")

        stopped = "stopped: by joint_commands of /maneuver_driver"
        wait(lambda: stopped in vehicle.get("reason", ""), "the boards' stop")
        wait(armed, "rest")
        killed = drive("long.json", "second")
        wait(lambda: state["state"] == "running", "driving again")
        killed.kill()
        killed.communicate()
        for refusal, service in (
            (f"is driving plan {long}: wait for its end, or abort it", "maneuver_driver/abort"),
            ("second: stop it first", "trajectory_recorder/stop"),
        ):
            refused = drive("short.json", "third")
            _, errors = refused.communicate(timeout=60)
            assert (refused.returncode, refusal in errors) == (2, True), errors
            assert services.call(service, Trigger, Trigger.Request()).success
            if service.endswith("abort"):
                wait(lambda: stopped in vehicle["reason"], "the boards' stop")
            wait(armed, "rest")

        ended = clock["now"]
        wait(lambda: clock["now"] > ended + LONGEST_STOP + 1.0, "the driver's end of the stop")
        finished = drive("short.json", "third")
        _, errors = finished.communicate(timeout=60)
        assert finished.returncode == 0, errors

        longer = tmp_path / "longer.yaml"
        text = (resources.files("tricycle_sim") / "tricycle.yaml").read_text()
        longer.write_text(text.replace("axle: {value: 0.724", "axle: {value: 0.781"))
        save("longer.json", 4.0, longer)
        refused = drive("longer.json", "fourth", "--vehicle", longer)
        _, errors = refused.communicate(timeout=60)
        assert refused.returncode == 2
        assert "another vehicle than tricycle: wheelbase 1.443 instead of 1.5" in errors
    executor.shutdown()
    assert judge(tmp_path / "third").plan_id == short
