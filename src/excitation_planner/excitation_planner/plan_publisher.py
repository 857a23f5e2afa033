"""Publication of a plan on the latched `maneuver/*` topics, for every node that has plans."""

import math
from typing import Any

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.duration import Duration
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from excitation_planner.plan import Plan
from excitation_planner.playback import FRAME
from tricycle_core.joints import JOINTS
from tricycle_core.nodes import LATCHED, overridable, time_message
from tricycle_core.stamps import split_seconds


def _pose(x: float, y: float, yaw: float, time: float) -> PoseStamped:
    pose = PoseStamped()
    pose.header.frame_id = FRAME
    pose.header.stamp = time_message(time)
    pose.pose.position.x, pose.pose.position.y = x, y
    pose.pose.orientation.z, pose.pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    return pose


class PlanPublisher:
    """The three publishers of a plan.

    A joint trajectory has no frame, so `maneuver/commands` carries the plan id in its header's
    `frame_id`: the driver repeats it in `maneuver/state`. The three headers share one stamp, by
    which the messages of a plan are found in a bag with several.

    Parameters
    ----------
    node : Node
        Has the publishers.
    """

    def __init__(self, node: Node) -> None:
        def publisher(kind: type, topic: str) -> Any:
            return node.create_publisher(kind, topic, **overridable(LATCHED))

        self._clock = node.get_clock()
        self._path = publisher(Path, "maneuver/path")
        self._reference = publisher(Path, "maneuver/reference")
        self._commands = publisher(JointTrajectory, "maneuver/commands")

    def publish(self, plan: Plan) -> None:
        """Publish path and reference, then the commands that make them current."""
        path, reference = Path(), Path()
        commands = JointTrajectory(joint_names=list(JOINTS))
        path.header.frame_id = reference.header.frame_id = FRAME
        commands.header.frame_id = plan.id
        stamp = self._clock.now().to_msg()
        path.header.stamp = reference.header.stamp = commands.header.stamp = stamp
        path.poses = [_pose(float(x), float(y), 0.0, 0.0) for x, y in plan.path]
        r = plan.reference
        rows = zip(r.x.tolist(), r.y.tolist(), r.yaw.tolist(), r.time.tolist(), strict=True)
        reference.poses = [_pose(*row) for row in rows]
        c = plan.commands
        for time, angle, speed in zip(
            c.time.tolist(), c.steering_motor_angle.tolist(), c.speed.tolist(), strict=True
        ):
            point = JointTrajectoryPoint(
                positions=[angle, 0.0], velocities=[0.0, speed / plan.tyre_radius]
            )
            point.time_from_start.sec, point.time_from_start.nanosec = split_seconds(time)
            commands.points.append(point)
        self._path.publish(path)
        self._reference.publish(reference)
        self._commands.publish(commands)

    def received(self) -> bool:
        """Return whether every known subscriber has acknowledged the plan."""
        publishers = (self._path, self._reference, self._commands)
        return all(publisher.wait_for_all_acked(Duration()) for publisher in publishers)
