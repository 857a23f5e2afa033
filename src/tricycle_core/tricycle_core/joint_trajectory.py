"""The commands in a JointTrajectory of `maneuver/commands`, as numbers."""

from typing import Any

import numpy as np

from tricycle_core.joints import JOINTS
from tricycle_core.quantities import FloatArray
from tricycle_core.stamps import seconds_of


def rows_of(message: Any) -> FloatArray:
    """Return time [s], steering motor angle [rad] and wheel rate [rad/s] of each point, (c, 3).

    Parameters
    ----------
    message : JointTrajectory message
        Message as read by rosbags or rclpy.

    Raises
    ------
    ValueError
        If the message lacks one of `JOINTS`.
    IndexError
        If a point lacks a position or velocity.
    """
    steer, wheel = map(list(message.joint_names).index, JOINTS)
    rows = [
        (seconds_of(p.time_from_start), p.positions[steer], p.velocities[wheel])
        for p in message.points
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, 3)
