"""tricycle_sim: the simulated tricycle on two ptys; its clock is everybody's `/clock`."""

import math
import selectors
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu
from std_srvs.srv import Trigger

from tricycle_bridge.messages import TICK, Board
from tricycle_bridge.run_node import overridable, run_node
from tricycle_sim.firmware_simulator import FirmwareSimulator
from tricycle_sim.live import LiveState
from tricycle_sim.pty_port import PtyPort
from tricycle_sim.simulator import PoseNoise, Simulator, draw_truth, measure_pose
from tricycle_sim.vehicle import VehicleError, load_vehicle

try:  # in a ROS installation, but not among the wheels
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None

SENSOR_QOS = QoSProfile(depth=100)  # reliable: a recorder shall miss nothing
CLOCK_QOS = QoSProfile(depth=1)
HOST_SILENCE = 2.0  # s of wall time after which a host is not waited for any more


class TricycleSim(Node):
    """Runs a `Simulator` in a thread of its own, by the wall clock or as fast as it can."""

    def __init__(self) -> None:
        super().__init__("tricycle_sim")
        number, text = self._number, self._text
        vehicle_file = text("vehicle_file", "", "vehicle YAML; empty: the packaged tricycle")
        self._factor = number("real_time_factor", 1.0, 0.0, 1000.0, "0: as fast as it runs")
        self._patience = number(
            "host_patience",
            0.0,
            0.0,
            10.0,
            "s of wall time for which an armed simulation waits at a tick for its host's answer; "
            "0: it never waits",
        )
        self._noise = PoseNoise(
            position=number("position_noise", 0.01, 0.0, 10.0, "m per axis, of odom"),
            yaw=number("yaw_noise", 0.002, 0.0, 1.0, "rad, of odom"),
            speed=number("speed_noise", 0.01, 0.0, 1.0, "m/s, of odom"),
            yaw_rate=number("yaw_rate_noise", 0.005, 0.0, 1.0, "rad/s, of odom and imu"),
        )
        self._acceleration_noise = number("acceleration_noise", 0.05, 0.0, 10.0, "m/s^2, of imu")
        truth_seed = self._integer(
            "true_seed", -1, -1, "of the hidden true parameters; -1: nominal"
        )
        noise_seed = self._integer("noise_seed", 0, 0, "of the measurement noise")
        truth_pairs = self._strings("true_values", "name=value of parameters that are known")
        plc = text("plc", "emulated", "emulated, or firmware: the real one on simulated UNOs")
        build = text("firmware", "build/firmware", "folder that `make firmware` builds into")
        ports = {
            Board.STEER: text("steer_port", "/tmp/tricycle/steer", "link to the steer PLC's pty"),  # noqa: S108
            Board.DRIVE: text("drive_port", "/tmp/tricycle/drive", "link to the drive PLC's pty"),  # noqa: S108
        }
        vehicle = load_vehicle(Path(vehicle_file) if vehicle_file else None)
        truth = draw_truth(vehicle, np.random.default_rng(truth_seed)) if truth_seed >= 0 else {}
        vehicle = vehicle.replace(**(truth | _numbers_by_name(truth_pairs)))
        self._simulator: Simulator | FirmwareSimulator
        if plc == "firmware":
            self._simulator = FirmwareSimulator(vehicle, Path(build))
        elif plc == "emulated":
            self._simulator = Simulator(vehicle)
        else:
            raise VehicleError(f"plc: {plc!r} must be emulated or firmware")
        self._rng = np.random.default_rng(noise_seed)
        self._ports = {board: PtyPort(path) for board, path in ports.items()}
        self._clock_publisher = self.create_publisher(Clock, "/clock", **overridable(CLOCK_QOS))
        self._odom = self.create_publisher(Odometry, "odom", **overridable(SENSOR_QOS))
        self._truth = self.create_publisher(Odometry, "ground_truth", **overridable(SENSOR_QOS))
        self._imu = self.create_publisher(Imu, "imu", **overridable(SENSOR_QOS))
        self._tf = None
        if TFMessage is None:
            self.get_logger().info("odom to base_link is not broadcast: tf2_msgs is not installed")
        else:
            self._tf = self.create_publisher(TFMessage, "/tf", **overridable(SENSOR_QOS))
        self.create_service(Trigger, "~/reset", self._on_reset)
        self._heard = -math.inf  # wall time of the host's last accepted command
        self._in_step = False  # the host answered the last tick
        self._lock = threading.Lock()  # of the simulator
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="simulation")
        self._thread.start()

    def _number(self, name: str, default: float, low: float, high: float, about: str) -> float:
        span = [FloatingPointRange(from_value=low, to_value=high)]
        return float(self._declared(name, default, about, floating_point_range=span))

    def _integer(self, name: str, default: int, low: int, about: str) -> int:
        span = [IntegerRange(from_value=low, to_value=2**31 - 1)]
        return int(self._declared(name, default, about, integer_range=span))

    def _text(self, name: str, default: str, about: str) -> str:
        return str(self._declared(name, default, about))

    def _strings(self, name: str, about: str) -> list[str]:
        return [item for item in self._declared(name, [""], about) if item]

    def _declared(self, name: str, default: Any, about: str, **ranges: Any) -> Any:
        descriptor = ParameterDescriptor(description=about, read_only=True, **ranges)
        return self.declare_parameter(name, default, descriptor).value

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            self._simulator.reset()
        response.success, response.message = True, "at rest at the origin, boards rebooted"
        return response

    def _run(self) -> None:
        """Publish, wait for the host and the wall clock, step; until the node is destroyed."""
        with selectors.DefaultSelector() as selector:
            for board, port in self._ports.items():
                selector.register(port, selectors.EVENT_READ, board)
            due = time.monotonic()
            while not self._stop.is_set():
                with self._lock:
                    self._publish(self._simulator.state, self._simulator.time)
                    self._listen(selector, due)
                    for board, data in self._simulator.step().items():
                        self._ports[board].write(data)
                    if self._simulator.state.rolled_over:
                        self.get_logger().error("the vehicle has rolled over", once=True)
                period = TICK / self._factor if self._factor else 0.0
                # what is late is caught up, but never more than ten ticks
                due = max(due + period, time.monotonic() - 10 * period)

    def _listen(self, selector: selectors.BaseSelector, due: float) -> None:
        """Serve the ports until `due` and, armed, until the host has answered or fallen silent.

        A tick that was not answered in time is followed by one that waits out all its patience:
        then no answer is left on its way, to be taken for that of a later tick.
        """
        simulator = self._simulator
        deadline = time.monotonic() + self._patience
        while not self._stop.is_set():
            for board, port in self._ports.items():
                if data := port.read():
                    port.write(simulator.receive(board, data))
                    if simulator.heard(board):
                        self._heard = time.monotonic()
            now = time.monotonic()
            answered = self._in_step and simulator.answered
            waits = simulator.armed and not answered and now - self._heard < HOST_SILENCE
            left = (max(due, deadline) if waits else due) - now
            if left <= 0.0:
                break
            selector.select(min(left, 0.1))
        self._in_step = simulator.armed and simulator.answered

    def _publish(self, state: LiveState, now: float) -> None:
        stamp = _stamp(now)
        self._clock_publisher.publish(Clock(clock=stamp))
        pose = measure_pose(state, self._noise, self._rng)
        odom = _odometry(stamp)
        odom.pose.pose.position.x, odom.pose.pose.position.y = pose.x, pose.y
        half = 0.5 * pose.yaw
        odom.pose.pose.orientation.z, odom.pose.pose.orientation.w = math.sin(half), math.cos(half)
        odom.twist.twist.linear.x, odom.twist.twist.linear.y = pose.vx, pose.vy
        odom.twist.twist.angular.z = pose.yaw_rate
        noise = self._noise
        odom.pose.covariance[0] = odom.pose.covariance[7] = noise.position**2
        odom.pose.covariance[35] = noise.yaw**2
        odom.twist.covariance[0] = odom.twist.covariance[7] = noise.speed**2
        odom.twist.covariance[35] = noise.yaw_rate**2
        self._odom.publish(odom)
        if self._tf is not None:
            self._tf.publish(TFMessage(transforms=[_transform(odom)]))
        self._truth.publish(_ground_truth(state, stamp))
        self._imu.publish(self._measured_imu(state, stamp))

    def _measured_imu(self, state: LiveState, stamp: Time) -> Imu:
        message = Imu()
        message.header.stamp, message.header.frame_id = stamp, "base_link"
        rates = (state.roll_rate, state.pitch_rate, state.yaw_rate)
        noise = self._rng.standard_normal(6)
        rate, force = message.angular_velocity, message.linear_acceleration
        rate.x, rate.y, rate.z = (
            float(v + self._noise.yaw_rate * n) for v, n in zip(rates, noise, strict=False)
        )
        force.x, force.y, force.z = (
            float(v + self._acceleration_noise * n)
            for v, n in zip(state.specific_force, noise[3:], strict=True)
        )
        message.orientation_covariance[0] = -1.0  # no orientation
        message.angular_velocity_covariance[[0, 4, 8]] = self._noise.yaw_rate**2
        message.linear_acceleration_covariance[[0, 4, 8]] = self._acceleration_noise**2
        return message

    def destroy_node(self) -> None:
        """Stop the simulation and remove the ptys."""
        self._stop.set()
        self._thread.join()
        self._simulator.close()
        for port in self._ports.values():
            port.close()
        super().destroy_node()


def _numbers_by_name(pairs: list[str]) -> dict[str, float]:
    values = {}
    for pair in pairs:
        name, _, value = pair.partition("=")
        try:
            values[name] = float(value)
        except ValueError:
            raise VehicleError(f"true_values: {pair!r} must be name=number") from None
    return values


def _stamp(seconds: float) -> Time:
    nanoseconds = round(seconds * 1e9)
    return Time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


def _odometry(stamp: Time) -> Odometry:
    message = Odometry(child_frame_id="base_link")
    message.header.stamp, message.header.frame_id = stamp, "odom"
    return message


def _transform(odom: Odometry) -> TransformStamped:
    """The pose of an Odometry as the transform of its child frame."""
    message = TransformStamped(header=odom.header, child_frame_id=odom.child_frame_id)
    position, translation = odom.pose.pose.position, message.transform.translation
    translation.x, translation.y, translation.z = position.x, position.y, position.z
    message.transform.rotation = odom.pose.pose.orientation
    return message


def _ground_truth(state: LiveState, stamp: Time) -> Odometry:
    message = _odometry(stamp)
    position, q = message.pose.pose.position, message.pose.pose.orientation
    position.x, position.y, position.z = state.x, state.y, state.z
    q.w, q.x, q.y, q.z = state.quaternion
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    linear.x, linear.y, linear.z = state.vx, state.vy, state.vz
    angular.x, angular.y, angular.z = state.roll_rate, state.pitch_rate, state.yaw_rate
    return message


def main() -> None:
    """Run the node."""
    run_node(TricycleSim)
