"""Quality of service as a user overrides it, on live nodes and on the profiles that they share."""

import subprocess
import sys
import time
from pathlib import Path

import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data

from tricycle_core.nodes import overridable

pytestmark = pytest.mark.ros

DRIVER = Path(sys.executable).with_name("maneuver_driver")
PATIENCE = 30.0  # s; only a failing test waits that long


def test_an_override_reaches_its_topic_and_no_other(ros_environment, ros_node):
    parameter = "qos_overrides./odom.subscription.reliability:=reliable"
    driver = subprocess.Popen([DRIVER, "--ros-args", "-p", parameter], env=ros_environment)
    try:
        deadline = time.monotonic() + PATIENCE
        while not (found := ros_node.get_subscriptions_info_by_topic("/odom")):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        assert found[0].qos_profile.reliability == ReliabilityPolicy.RELIABLE
    finally:
        driver.terminate()
        assert driver.wait(timeout=PATIENCE) == 0


def test_a_policy_that_does_not_exist_is_one_line_and_status_2(ros_environment):
    parameter = "qos_overrides./odom.subscription.reliability:=sometimes"
    ran = subprocess.run(
        [DRIVER, "--ros-args", "-p", parameter],
        env=ros_environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert ran.returncode == 2
    assert "`reliability`: `sometimes`" in ran.stderr
    assert len(ran.stderr.strip().splitlines()) == 1


def test_profiles_that_topics_share_stay_as_they_are(ros_node):
    shared = QoSProfile(depth=1)
    for name in ("first", "second"):
        arguments = overridable(shared)
        arguments["qos_profile"].depth = 7  # as rclpy does with a parameter's value
        assert shared.depth == 1, name
    assert overridable(5)["qos_profile"].depth == 5
    assert overridable(qos_profile_sensor_data)["qos_profile"] == qos_profile_sensor_data
