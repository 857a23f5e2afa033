"""identification_monitor beside the nodes of a simulated drive."""

import re
import time

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry

from excitation_planner.design.noise import SIMULATED
from excitation_planner.maneuver import Circle
from excitation_planner.plan import save_plan
from excitation_planner.planning import PlanRequest, plan_at
from parameter_identification import identification_monitor_node
from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.measured_from_bag import read_measured_drive
from parameter_identification.identification import identify
from tricycle_bringup.configuration import SIMULATION_CONFIG
from tricycle_cli.operation.processes import NodeProcesses
from tricycle_cli.operation.session import simulated_session
from tricycle_core.nodes import LATCHED
from tricycle_sim.vehicle import load_vehicle

pytestmark = pytest.mark.ros

TARGET = "cornering_stiffness"
DEADLINE = 60.0  # s


@pytest.mark.slow
def test_the_verdict_agrees_with_the_identification_of_the_bag(ros_environment, ros_node, tmp_path):
    vehicle = load_vehicle()
    request = PlanRequest(vehicle, Circle(duration=6.0), TARGET, samples=50, noise=SIMULATED)
    plan = plan_at(request, np.array([2.5, 1.0]))
    save_plan(plan, tmp_path / "plan.json")
    heard = []
    ros_node.create_subscription(
        DiagnosticStatus, "identification/estimates", heard.append, LATCHED
    )
    executor = rclpy.executors.SingleThreadedExecutor(context=ros_node.context)
    executor.add_node(ros_node)

    def wait_for(condition):
        deadline = time.monotonic() + DEADLINE
        while not condition():
            assert time.monotonic() < deadline, heard
            executor.spin_once(timeout_sec=0.1)

    with NodeProcesses(ros_environment, tmp_path / "log") as nodes:
        nodes.start(
            "identification_monitor",
            config=SIMULATION_CONFIG,
            parameters={"plan_file": str(tmp_path / "plan.json")},
        )
        wait_for(lambda: ros_node.count_publishers("identification/estimates"))
        with simulated_session(
            vehicle_file=None, noise_seed=1, true_seed=3, real_time_factor=1.0, folder=tmp_path
        ) as drive:
            drive(plan, tmp_path / "bag", lambda *_: executor.spin_once(timeout_sec=0.0))
            wait_for(lambda: heard and "informative" in heard[-1].message)
        nodes.check()
    executor.shutdown()
    assert len(heard) > 1  # estimates during the drive
    last = {pair.key: pair.value for pair in heard[-1].values}
    found = identify([read_measured_drive(tmp_path / "bag", vehicle)], vehicle).parameters
    for name, parameter in found.items():
        std = parameter.standard_deviation
        assert float(last[f"{name} std"]) == pytest.approx(std, rel=0.2), name
        assert float(last[name]) == pytest.approx(parameter.estimate, abs=0.5 * std), name
    ratio = found[TARGET].standard_deviation / plan.predicted_std[TARGET]
    assert float(last["ratio"]) == pytest.approx(ratio, rel=0.2)
    assert heard[-1].message.startswith(("as informative as", "less informative than"))


def test_poses_of_another_frame_are_ignored_and_told_once(
    ros_environment, ros_node, monkeypatch, capfd
):
    sensed = []

    class Listening(identification_monitor_node.LiveIdentification):
        def sense(self, sensor, stamp, values):
            sensed.append((sensor, values))

    monkeypatch.setattr(identification_monitor_node, "LiveIdentification", Listening)
    rclpy.init()
    executor = rclpy.executors.SingleThreadedExecutor()
    monitor = identification_monitor_node.IdentificationMonitor()
    try:
        executor.add_node(monitor)
        odom = ros_node.create_publisher(Odometry, "odom", 10)
        deadline = time.monotonic() + DEADLINE
        while not odom.get_subscription_count():
            assert time.monotonic() < deadline
            executor.spin_once(timeout_sec=0.1)
        while len(sensed) < 4:
            assert time.monotonic() < deadline
            for x, frame in enumerate(("map", "camera_link", "base_link", "")):
                message = Odometry(child_frame_id=frame)
                message.pose.pose.position.x = float(x)
                message.pose.pose.orientation.w = 1.0
                odom.publish(message)
                executor.spin_once(timeout_sec=0.1)
    finally:
        executor.shutdown()
        monitor.destroy_node()
        rclpy.shutdown()
    assert {values for sensor, values in sensed if sensor is Sensor.POSITION} <= {
        (2.0, 0.0), (3.0, 0.0),
    }  # fmt: skip
    told = capfd.readouterr().err
    assert told.count("are ignored") == 1
    # the first messages may come before the two have found each other
    said = r"odom: poses of (map|camera_link) are ignored: those of base_link are needed"
    assert re.search(said, told)
