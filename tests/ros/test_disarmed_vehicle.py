"""`tricycle drive` with a vehicle that is not armed, or no longer, is an error."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor

from excitation_planner.maneuver import Circle
from excitation_planner.plan import save_plan
from excitation_planner.planning import PlanRequest, plan_at
from parameter_identification.drives.reader import read_drive
from tricycle_bringup.configuration import VEHICLE_CONFIG
from tricycle_cli.operation.processes import NodeProcesses
from tricycle_core.errors import JudgeError
from tricycle_core.nodes import LATCHED
from tricycle_core.readiness import PERIOD, TOPIC, Readiness
from tricycle_sim.vehicle import load_vehicle

pytestmark = [pytest.mark.ros, pytest.mark.slow]

PATIENCE = 60.0  # s; only a failing test waits that long
PRESSED = Readiness(armed=False, reason="hardware e-stop pressed")


class StandingVehicle:
    """Says what a bridge and a localisation would say of a vehicle that stands on its path."""

    def __init__(self, node):
        self._node = node
        self.readiness = Readiness(armed=True)
        self.state = {}
        self._says = node.create_publisher(DiagnosticStatus, TOPIC, LATCHED)
        self._odom = node.create_publisher(Odometry, "odom", 10)
        node.create_subscription(DiagnosticStatus, "maneuver/state", self._on_state, LATCHED)
        node.create_timer(0.02, self._pose)
        node.create_timer(PERIOD, self.say)
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)

    def say(self):
        values = self.readiness.values().items()
        self._says.publish(DiagnosticStatus(values=[KeyValue(key=k, value=v) for k, v in values]))

    def _pose(self):
        pose = Odometry()
        pose.header.stamp = now = self._node.get_clock().now().to_msg()
        pose.pose.pose.position.x = 1e-12 * now.nanosec  # no measured pose stays the same
        self._odom.publish(pose)

    def _on_state(self, message):
        self.state = {pair.key: pair.value for pair in message.values}

    def until(self, condition):
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, self.state
            self._executor.spin_once(timeout_sec=0.02)


@pytest.mark.parametrize(
    ("when", "error"),
    [
        (
            "before",
            "maneuver_driver/start: the vehicle is not armed: hardware e-stop pressed; arm it "
            "(tricycle_bridge/arm)",
        ),
        ("during", "maneuver aborted: the vehicle is not armed: hardware e-stop pressed"),
    ],
)
def test_a_drive_of_a_vehicle_that_is_not_armed_fails(
    ros_environment, ros_node, tmp_path, when, error
):
    request = PlanRequest(load_vehicle(), Circle(duration=8.0), "cornering_stiffness", samples=50)
    save_plan(plan_at(request, np.array([2.5, 1.0])), tmp_path / "plan.json")
    vehicle = StandingVehicle(ros_node)
    if when == "before":
        vehicle.readiness = PRESSED
    with NodeProcesses(ros_environment, tmp_path / "log") as nodes:
        for name in ("maneuver_driver", "trajectory_recorder"):
            nodes.start(name, config=VEHICLE_CONFIG, parameters={})
        drive = subprocess.Popen(
            [Path(sys.executable).with_name("tricycle"), "drive", "plan.json", "--vehicle-nodes",
             "--bag", "bag"],
            cwd=tmp_path, env=ros_environment, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        if when == "during":
            vehicle.until(lambda: float(vehicle.state.get("elapsed", 0.0)) >= 0.5)
            vehicle.readiness = PRESSED
            vehicle.say()
        vehicle.until(lambda: drive.poll() is not None)
        _, errors = drive.communicate()
    assert (drive.returncode, errors.splitlines()[-1]) == (2, f"tricycle: {error}")
    if when == "before":
        assert not (tmp_path / "bag").exists()  # the next try may have this name
    else:
        with pytest.raises(JudgeError, match="maneuver was aborted"):
            read_drive(tmp_path / "bag")


def test_each_of_several_drives_waits_for_enter_and_for_what_fails_to_be_mended(
    ros_environment, ros_node, tmp_path
):
    request = PlanRequest(load_vehicle(), Circle(duration=8.0), "cornering_stiffness", samples=50)
    save_plan(plan_at(request, np.array([2.5, 1.0])), tmp_path / "plan.json")
    vehicle, screen = StandingVehicle(ros_node), tmp_path / "screen.txt"
    vehicle.readiness = PRESSED
    with NodeProcesses(ros_environment, tmp_path / "log") as nodes, screen.open("w") as output:
        for name in ("maneuver_driver", "trajectory_recorder"):
            nodes.start(name, config=VEHICLE_CONFIG, parameters={})
        drive = subprocess.Popen(
            [Path(sys.executable).with_name("tricycle"), "drive", "plan.json", "--vehicle-nodes",
             "--repeat", "2", "--bag", "bags"],
            cwd=tmp_path, env=ros_environment | {"COLUMNS": "120"}, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=output,
        )  # fmt: skip
        vehicle.until(lambda: "Enter looks again (vehicle)" in screen.read_text())
        assert "the vehicle is not armed: hardware e-stop pressed" in screen.read_text()
        assert "trajectory_recorder: bag" in screen.read_text()
        vehicle.readiness = Readiness(armed=True)
        vehicle.say()
        drive.stdin.write("\n")
        drive.stdin.flush()
        vehicle.until(lambda: "Enter drives, Ctrl-C leaves" in screen.read_text())
        assert vehicle.state["state"] == "waiting"  # nothing moves before the second Enter
        drive.stdin.close()
        vehicle.until(lambda: drive.poll() is not None)
    assert drive.returncode == 2
    lines = screen.read_text().splitlines()
    assert lines[-1] == "tricycle: nobody is there to say that the vehicle is ready"
