"""A plant that is a node of somebody else: it takes set-points as a topic and gives odometry."""

import math
import time

from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from tricycle_core.errors import PlantError
from tricycle_core.frames import BASE_LINK, of_frame
from tricycle_core.joints import JOINTS
from tricycle_core.nodes import ending, time_message
from tricycle_core.poses import Pose
from tricycle_core.rotations import is_unit, yaw_of
from tricycle_core.timing import TICK
from tricycle_sim.plants.actuators import Motor, SteeringServo
from tricycle_sim.plants.plant import PlanarMotion, planar_state
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.live import LiveState

SET_POINTS, ODOM = "plant/set_points", "plant/odom"
PATIENCE = 10.0
"""Wall time [s] for which an answer is waited for."""
REPEAT = 0.2  # s of wall time
STANDING = 1e-3  # m/s
LONGEST_STOP = 20.0  # simulated s
QOS = QoSProfile(depth=10)  # reliable


class ElsewherePlant:
    """Exchanges a message of set-points for one of odometry, 10 ms later, at every tick.

    The servo, the motor's limits and its lag are the vehicle file's.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle as boards and planner know it.
    seed : int
        Not used: what is random is elsewhere.
    """

    def __init__(self, vehicle: Vehicle, seed: int = 0) -> None:  # noqa: ARG002 (of every plant)
        self._vehicle = vehicle
        self._node = Node("plant", start_parameter_services=False)
        # spun by who advances the plant, which a callback of another node may be
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._publisher = self._node.create_publisher(JointState, SET_POINTS, QOS)
        self._node.create_subscription(Odometry, ODOM, self._on_odom, QOS)
        self._stamp = 0.0  # s since the start of the exchange
        self._odom: Odometry | None = None
        self._rest()

    def place(self, start: Pose) -> LiveState:
        """Return the state at rest at a pose: elsewhere the vehicle is stopped where it is.

        Parameters
        ----------
        start : (float, float, float)
            x, y [m] and heading [rad].
        """
        self._rest()
        end = self._stamp + LONGEST_STOP
        while True:
            odom = self._exchange(1.0)
            if math.hypot(odom.twist.twist.linear.x, odom.twist.twist.linear.y) < STANDING:
                break
            if self._stamp > end:
                raise PlantError(f"{ODOM}: moves after {LONGEST_STOP:g} s of full brake")
        x, y, yaw = _pose(odom)
        turn = start[2] - yaw
        c, s = math.cos(turn), math.sin(turn)
        self._frame = (start[0] - c * x + s * y, start[1] - s * x - c * y, turn)
        return self._state(0, odom)

    def advance(self, tick: int, steering: float | None, torque: float, brake: float) -> LiveState:
        """Return the state after a tick.

        Parameters
        ----------
        tick, steering, torque, brake : int, float or None, float, float
            Arguments of `Plant.advance`.
        """
        self._servo.advance(steering)
        self._motor.advance(torque, self._wheel[1])
        return self._state(tick + 1, self._exchange(brake))

    def close(self) -> None:
        """End the node."""
        self._executor.shutdown()
        self._node.destroy_node()

    def _rest(self) -> None:
        self._servo, self._motor = SteeringServo(self._vehicle), Motor(self._vehicle)
        self._frame = (0.0, 0.0, 0.0)
        self._wheel = (0.0, 0.0)
        self._velocity = (0.0, 0.0)

    def _exchange(self, brake: float) -> Odometry:
        """Send set-points and return their answer; repeat the first until there is one."""
        self._stamp += TICK
        message = JointState(name=[*JOINTS, "brake"])
        message.header.stamp = time_message(self._stamp)
        message.position = [self._servo.output, math.nan, math.nan]
        message.effort = [math.nan, self._motor.torque, brake * self._vehicle.brake_torque]
        met = self._odom is not None
        self._publisher.publish(message)
        begin = sent = time.monotonic()
        while self._odom is None or self._odom.header.stamp != message.header.stamp:
            if ending():  # in the constructor, a service or the simulation's thread
                raise SystemExit(0)
            now = time.monotonic()
            if now - begin > PATIENCE:
                raise PlantError(
                    f"{ODOM}: no answer to {SET_POINTS} of {self._stamp:.2f} s "
                    f"within {PATIENCE:g} s"
                )
            if not met and now - sent > REPEAT:
                self._publisher.publish(message)
                sent = now
            self._executor.spin_once(timeout_sec=REPEAT)
        _check(self._odom)
        return self._odom

    def _on_odom(self, message: Odometry) -> None:
        self._odom = message

    def _state(self, tick: int, odom: Odometry) -> LiveState:
        x, y, yaw = _pose(odom)
        x0, y0, turn = self._frame
        c, s = math.cos(turn), math.sin(turn)
        velocity, yaw_rate = odom.twist.twist.linear, odom.twist.twist.angular.z
        rise_x, rise_y = velocity.x - self._velocity[0], velocity.y - self._velocity[1]
        self._velocity = (velocity.x, velocity.y)
        angle, before = self._wheel
        spin = velocity.x / self._vehicle.driven_radius  # odometry knows no slip
        self._wheel = (angle + 0.5 * TICK * (before + spin), spin)
        motion = PlanarMotion(
            velocity.x,
            velocity.y,
            yaw_rate,
            rise_x / TICK - yaw_rate * velocity.y,
            rise_y / TICK + yaw_rate * velocity.x,
        )
        return planar_state(
            self._vehicle,
            tick,
            (x0 + c * x - s * y, y0 + s * x + c * y, yaw + turn),
            motion,
            steering=self._servo.motor,
            wheel=self._wheel,
            torque=self._motor.torque,
        )


def _check(odom: Odometry) -> None:
    """Refuse a pose that is not that of the vehicle's centre of mass, or none."""
    if not of_frame(odom.child_frame_id, BASE_LINK):
        raise PlantError(
            f"{ODOM}: child_frame_id is {odom.child_frame_id}, must be {BASE_LINK}: pose and "
            "motion of the centre of mass"
        )
    q = odom.pose.pose.orientation
    if not is_unit(q):
        raise PlantError(
            f"{ODOM}: orientation {q.w:g}, {q.x:g}, {q.y:g}, {q.z:g} (w, x, y, z) is not a "
            "unit quaternion"
        )


def _pose(odom: Odometry) -> Pose:
    position = odom.pose.pose.position
    return position.x, position.y, yaw_of(odom.pose.pose.orientation)
