"""Publication of a plan on the latched `maneuver/*` topics, for every node that has plans."""

from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point32, PolygonStamped, PoseStamped, Twist
from nav_msgs.msg import Path
from rclpy.duration import Duration
from rclpy.node import Node
from trajectory_msgs.msg import (
    JointTrajectory,
    JointTrajectoryPoint,
    MultiDOFJointTrajectory,
    MultiDOFJointTrajectoryPoint,
)

from excitation_planner.area.fence import Fence
from excitation_planner.plan import Plan
from tricycle_core.frames import BASE_LINK, MANEUVER
from tricycle_core.joints import JOINTS
from tricycle_core.nodes import LATCHED, overridable, time_message
from tricycle_core.quantities import FloatArray
from tricycle_core.rotations import about_vertical
from tricycle_core.stamps import split_seconds


def _pose(x: float, y: float, yaw: float, time: float) -> PoseStamped:
    pose = PoseStamped()
    pose.header.frame_id = MANEUVER
    pose.header.stamp = time_message(time)
    pose.pose.position.x, pose.pose.position.y = x, y
    pose.pose.orientation.z, pose.pose.orientation.w = about_vertical(yaw)
    return pose


def _polygon(*rings: FloatArray) -> PolygonStamped:
    """Corners of all rings; z is the number of the ring."""
    message = PolygonStamped()
    message.polygon.points = [
        Point32(x=x, y=y, z=float(number))
        for number, ring in enumerate(rings)
        for x, y in ring.tolist()
    ]
    return message


def _unit_twist(curvature: float, time: float) -> MultiDOFJointTrajectoryPoint:
    """Motion along a path at 1 m/s."""
    twist = Twist()
    twist.linear.x, twist.angular.z = 1.0, curvature
    point = MultiDOFJointTrajectoryPoint(velocities=[twist])
    point.time_from_start.sec, point.time_from_start.nanosec = split_seconds(time)
    return point


class PlanPublisher:
    """The publishers of a plan.

    A joint trajectory has no frame, so `maneuver/commands` carries the plan id in its header's
    `frame_id`: the driver repeats it in `maneuver/state`. All headers share one stamp, by which
    the messages of a plan are found in a bag with several. Without an area `maneuver/ground` is
    empty, and footprint, planned start and twist are not published; nor is a lead-in that is none.

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
        self._ground = publisher(PolygonStamped, "maneuver/ground")
        self._footprint = publisher(PolygonStamped, "maneuver/footprint")
        self._planned_start = publisher(PoseStamped, "maneuver/planned_start")
        self._lead_in = publisher(Path, "maneuver/lead_in")
        self._twist = publisher(MultiDOFJointTrajectory, "maneuver/twist")
        self._commands = publisher(JointTrajectory, "maneuver/commands")

    def publish(self, plan: Plan) -> None:
        """Publish path, reference and area, then the commands that make them current."""
        path, reference = Path(), Path()
        commands = JointTrajectory(joint_names=list(JOINTS))
        path.header.frame_id = reference.header.frame_id = MANEUVER
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
        lead_in = Path()  # empty where there is none: a plan before it may have the same stamp
        lead_in.header.frame_id, lead_in.header.stamp = MANEUVER, stamp
        if plan.lead_in > 0.0:
            end = float(r.x[r.time <= plan.lead_in][-1])
            lead_in.poses = [_pose(0.0, 0.0, 0.0, 0.0), _pose(end, 0.0, 0.0, plan.lead_in)]
        self._lead_in.publish(lead_in)
        self._publish_area(plan.fence, c.time, stamp)
        self._path.publish(path)
        self._reference.publish(reference)
        self._commands.publish(commands)

    def _publish_area(self, fence: Fence | None, time: FloatArray, stamp: Time) -> None:
        ground = _polygon(*(fence.ground if fence else ()))
        ground.header.stamp = stamp
        if fence is not None:
            ground.header.frame_id = fence.frame
            footprint = _polygon(fence.footprint)
            start = _pose(*fence.start, 0.0)
            twist = MultiDOFJointTrajectory(joint_names=[BASE_LINK])
            twist.points = list(map(_unit_twist, fence.curvature.tolist(), time.tolist()))
            start.header.frame_id = fence.frame
            footprint.header.frame_id = twist.header.frame_id = BASE_LINK
            footprint.header.stamp = start.header.stamp = twist.header.stamp = stamp
            self._footprint.publish(footprint)
            self._planned_start.publish(start)
            self._twist.publish(twist)
        self._ground.publish(ground)

    def received(self) -> bool:
        """Return whether every known subscriber has acknowledged the plan."""
        publishers = (
            *(self._path, self._reference, self._ground, self._footprint, self._planned_start),
            *(self._twist, self._lead_in, self._commands),
        )
        return all(publisher.wait_for_all_acked(Duration()) for publisher in publishers)
