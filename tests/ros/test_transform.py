"""odom to base_link, which the simulation broadcasts where tf2_msgs is installed."""

import pytest
from nav_msgs.msg import Odometry

from tricycle_sim.sim_node import _transform

pytestmark = pytest.mark.ros


def test_the_transform_is_the_pose_of_odom():
    odom = Odometry(child_frame_id="base_link")
    odom.header.frame_id, odom.header.stamp.sec = "odom", 7
    odom.pose.pose.position.x, odom.pose.pose.position.y = 3.0, -2.0
    odom.pose.pose.orientation.z, odom.pose.pose.orientation.w = 0.6, 0.8
    message = _transform(odom)
    assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
    assert message.header.stamp.sec == 7
    translation, rotation = message.transform.translation, message.transform.rotation
    assert (translation.x, translation.y, translation.z) == (3.0, -2.0, 0.0)
    assert (rotation.x, rotation.y, rotation.z, rotation.w) == (0.0, 0.0, 0.6, 0.8)
