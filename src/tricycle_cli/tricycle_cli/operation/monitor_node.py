"""Listens to a live run for `tricycle monitor`."""

import math
import os
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from tricycle_cli.operation.dashboard import (
    Dashboard,
    JointReading,
    OdometryReading,
    diagnostic_entries,
)
from tricycle_cli.operation.processes import interrupts_held
from tricycle_core.closing import Closing
from tricycle_core.diagnostics import values_of
from tricycle_core.joints import JOINTS
from tricycle_core.nodes import LATCHED


class Monitor(Closing):
    """A node that only listens, and keeps the newest messages in its `dashboard`.

    Parameters
    ----------
    domain : int
        ROS domain id.
    namespace : str
        Namespace of the tricycle; empty for the root. Its diagnostics are in it too, as launched.

    Attributes
    ----------
    dashboard : Dashboard
        Newest messages.
    """

    def __init__(self, *, domain: int, namespace: str = "") -> None:
        self.dashboard = Dashboard()
        self._context = rclpy.Context()
        rclpy.init(
            context=self._context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO
        )
        # several may listen to one run
        self._node = rclpy.create_node(
            f"monitor_{os.getpid()}", namespace=namespace, context=self._context
        )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        listen = self._node.create_subscription
        listen(DiagnosticArray, "diagnostics", self._on_diagnostics, 10)
        listen(DiagnosticArray, "maneuver/preflight", self._on_preflight, LATCHED)
        listen(DiagnosticStatus, "maneuver/state", self._on_maneuver, LATCHED)
        listen(DiagnosticStatus, "identification/estimates", self._on_estimates, LATCHED)
        listen(JointState, "joint_commands", self._on_commands, qos_profile_sensor_data)
        listen(JointState, "joint_states", self._on_joints, qos_profile_sensor_data)
        listen(Odometry, "odom", self._on_odom, qos_profile_sensor_data)

    def close(self) -> None:
        """Leave the ROS domain."""
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def listen(self, duration: float) -> None:
        """Take messages for `duration` seconds of wall time."""
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0.0:
            with interrupts_held():
                self._executor.spin_once(timeout_sec=left)

    def _hear(self) -> float:
        self.dashboard.heard = time.monotonic()
        return self.dashboard.heard

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.dashboard.diagnostics |= diagnostic_entries(message.status, self._hear())

    def _on_preflight(self, message: DiagnosticArray) -> None:
        self.dashboard.preflight = diagnostic_entries(message.status, self._hear())

    def _on_maneuver(self, message: DiagnosticStatus) -> None:
        self._hear()
        self.dashboard.maneuver = values_of(message)

    def _on_estimates(self, message: DiagnosticStatus) -> None:
        self._hear()
        self.dashboard.learnt = message.message

    def _on_commands(self, message: JointState) -> None:
        self.dashboard.commanded = _joints(message, self._hear()) or self.dashboard.commanded

    def _on_joints(self, message: JointState) -> None:
        self.dashboard.measured = _joints(message, self._hear()) or self.dashboard.measured

    def _on_odom(self, message: Odometry) -> None:
        heard = self._hear()
        position, twist = message.pose.pose.position, message.twist.twist
        speed = math.copysign(math.hypot(twist.linear.x, twist.linear.y), twist.linear.x)
        self.dashboard.odometry = OdometryReading(
            position.x, position.y, speed, twist.angular.z, heard
        )


def _joints(message: JointState, heard: float) -> JointReading | None:
    """Return the values of the two joints; None if the message is about others."""
    try:
        steering, wheel = map(list(message.name).index, JOINTS)
        return JointReading(message.position[steering], message.velocity[wheel], heard)
    except (ValueError, IndexError):
        return None
