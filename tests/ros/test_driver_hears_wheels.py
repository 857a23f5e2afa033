"""The driver hears on `joint_states` where the steering motor is, before it plays row 0."""

import time

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState

from excitation_planner.maneuver_driver_node import ManeuverDriver

pytestmark = pytest.mark.ros

PATIENCE = 30.0  # s; only a failing test waits that long


def test_the_measured_angle_reaches_the_watch_of_the_vehicle(ros_environment, ros_node):
    rclpy.init()
    driver = ManeuverDriver()
    executor = SingleThreadedExecutor()
    executor.add_node(driver)
    publisher = ros_node.create_publisher(JointState, "joint_states", 10)
    message = JointState(name=["rear_wheel_joint", "steering_motor_joint"], position=[9.0, 0.4])
    turning, deadline = "", time.monotonic() + PATIENCE
    try:
        while not turning:
            assert time.monotonic() < deadline
            publisher.publish(message)
            executor.spin_once(timeout_sec=0.1)
            turning = driver._playback.watch.turning(0.1, driver._now())
    finally:
        executor.shutdown()
        driver.destroy_node()
        rclpy.shutdown()
    assert turning == "the steering motor is at 0.40 rad, the plan begins at 0.10 rad"
