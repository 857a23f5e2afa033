"""tricycle_sim: the simulated tricycle on two ptys; its clock is published as `/clock`."""

import contextlib
import math
import selectors
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu
from std_srvs.srv import Trigger

from tricycle_bridge.protocol.messages import Board
from tricycle_core.errors import ExcitationError, LinkError, VehicleError
from tricycle_core.frames import BASE_LINK, ODOM
from tricycle_core.nodes import RECORDED, declare, ending, overridable, run_node, time_message
from tricycle_core.poses import Pose
from tricycle_core.rotations import about_vertical
from tricycle_core.timing import TICK
from tricycle_sim.plants import OWN
from tricycle_sim.plants.installed import plant_by_name
from tricycle_sim.plc.pty_port import PtyPort
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.rig.faults import FaultKind
from tricycle_sim.rig.firmware import FirmwareRig
from tricycle_sim.rig.localisation import PoseNoise, measure_pose
from tricycle_sim.rig.rig import Rig
from tricycle_sim.vehicle import Vehicle, draw_truth, load_vehicle
from tricycle_sim.vehicle.live import LiveState

try:  # in a ROS installation, but not among the wheels
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None

CLOCK_QOS = QoSProfile(depth=1)
# set at any time: default, largest value, description
LIVE_PARAMETERS = {
    "real_time_factor": (1.0, 1000.0, "simulated s per s; 0: as fast as it runs"),
    "host_patience": (
        0.0,
        10.0,
        "s of wall time for which an armed simulation waits at a tick for its host's answer; "
        "0: it never waits",
    ),
    "position_noise": (0.01, 10.0, "m per axis, of odom"),
    "yaw_noise": (0.002, 1.0, "rad, of odom"),
    "speed_noise": (0.01, 1.0, "m/s, of odom"),
    "yaw_rate_noise": (0.005, 1.0, "rad/s, of odom and imu"),
    "acceleration_noise": (0.05, 10.0, "m/s^2, of imu"),
    "position_jump": (0.0, 1000.0, "m, added to x of odom: a localisation that has jumped"),
}
FAULTS = {kind.name.lower(): kind for kind in FaultKind if kind is not FaultKind.HOST_CLOCK}
# pose at the start and after ~/reset: largest absolute value, description
START_PARAMETERS = {
    "start_x": (100_000.0, "m, where the vehicle starts, also after ~/reset"),
    "start_y": (100_000.0, "m, where the vehicle starts, also after ~/reset"),
    "start_heading": (math.tau, "rad, of the vehicle at its start, also after ~/reset"),
}
NOISE = 1  # number of its sequence of random numbers
LARGEST_SEED = 2**31 - 1  # of a parameter
HOST_SILENCE = 2.0  # s of wall time after which a host is not waited for any more
UNKNOWN_VARIANCE = 1e6  # of what odom does not measure; 0 would mean exact


class TricycleSim(Node):
    """Runs a rig in a thread of its own, by the wall clock or as fast as it can."""

    def __init__(self) -> None:
        super().__init__("tricycle_sim")
        vehicle = self._true_vehicle()
        noise_seed = declare(
            self,
            "noise_seed",
            -1,
            "of the measurement noise; -1: another at every start",
            (-1, LARGEST_SEED),
        )
        if noise_seed < 0:
            noise_seed = int(np.random.default_rng().integers(LARGEST_SEED))
        self._declare_live()
        self._rig, self._ports = self._made_boards(vehicle, noise_seed)
        # another sequence than that of the hidden truth, which may have the same seed
        self._rng = np.random.default_rng([noise_seed, NOISE])
        self._clock_publisher = self.create_publisher(Clock, "/clock", **overridable(CLOCK_QOS))
        self._odom = self.create_publisher(Odometry, "odom", **overridable(RECORDED))
        self._truth = self.create_publisher(Odometry, "ground_truth", **overridable(RECORDED))
        self._imu = self.create_publisher(Imu, "imu", **overridable(RECORDED))
        self._tf = None
        if TFMessage is None:
            self.get_logger().info("odom to base_link is not broadcast: tf2_msgs is not installed")
        else:
            self._tf = self.create_publisher(TFMessage, "/tf", **overridable(RECORDED))
        self.create_service(Trigger, "~/reset", self._on_reset)
        self._heard = -math.inf  # wall time of the host's last accepted command
        self._in_step = False  # the host answered the last tick
        self._lock = threading.Lock()  # of the rig
        self._stop = threading.Event()
        self._failure = "the simulation has failed"
        self._thread = threading.Thread(target=self._run, name="simulation")
        self._thread.start()
        self.create_timer(0.5, self._end_with_simulation)

    def _true_vehicle(self) -> Vehicle:
        """Return the vehicle that is simulated: some values of the file may be replaced."""
        file = declare(self, "vehicle_file", "", "YAML; empty: the packaged tricycle")
        seed = declare(
            self, "true_seed", -1, "of the hidden true parameters; -1: nominal", (-1, LARGEST_SEED)
        )
        pairs = declare(self, "true_values", [""], "name=value of parameters that are known")
        vehicle = load_vehicle(Path(file) if file else None)
        truth = draw_truth(vehicle, np.random.default_rng(seed)) if seed >= 0 else {}
        return vehicle.replace(**(truth | _numbers_by_name(pairs)))

    def _declare_live(self) -> None:
        """Declare the parameters that can be set at any time, and take their values."""
        for name, (default, high, about) in LIVE_PARAMETERS.items():
            declare(self, name, default, about, (0.0, high), read_only=False)
        for name, (limit, about) in START_PARAMETERS.items():
            declare(self, name, 0.0, about, (-limit, limit), read_only=False)
        declare(self, "faults", [""], f"what fails now, of: {', '.join(FAULTS)}", read_only=False)
        _check_faults(self.get_parameter("faults").value)
        self.add_on_set_parameters_callback(_refuse_unknown)
        self._on_parameters([])
        self.add_post_set_parameters_callback(self._on_parameters)

    def _made_boards(self, vehicle: Vehicle, seed: int) -> tuple[Rig, dict[Board, PtyPort]]:
        """Return the boards with their plant, and their ports; of all, or nothing is left."""
        plc = declare(self, "plc", "emulated", "emulated, or firmware: on simulated UNOs")
        name = declare(
            self, "plant", OWN, "what the boards drive: our own model, mujoco, or an installed one"
        )
        build = declare(self, "firmware", "build/firmware", "what `make firmware` builds into")
        folder = "/tmp/tricycle"  # noqa: S108 - a device path that every user knows
        paths = {
            board: declare(
                self, f"{side}_port", f"{folder}/{side}", f"link to the {side} PLC's pty"
            )
            for board, side in ((Board.STEER, "steer"), (Board.DRIVE, "drive"))
        }
        if paths[Board.STEER] == paths[Board.DRIVE]:
            raise LinkError(f"steer_port and drive_port are both {paths[Board.STEER]}")
        if plc not in ("emulated", "firmware"):
            raise VehicleError(f"plc: {plc!r} must be emulated or firmware")
        with contextlib.ExitStack() as failing:
            plant = plant_by_name(name, vehicle, seed)
            failing.callback(plant.close)
            rig: Rig
            if plc == "firmware":
                rig = FirmwareRig(vehicle, Path(build), plant=plant)
            else:
                rig = EmulatedRig(vehicle, plant=plant)
            if any(self._start_pose()):
                rig.reset(self._start_pose())
            ports: dict[Board, PtyPort] = {}
            for board, path in paths.items():
                ports[board] = PtyPort(path)
                failing.callback(ports[board].close)
            failing.pop_all()
        return rig, ports

    def _on_parameters(self, _parameters: list[Parameter]) -> None:
        value = {name: float(self.get_parameter(name).value) for name in LIVE_PARAMETERS}
        self._factor, self._patience = value["real_time_factor"], value["host_patience"]
        self._noise = PoseNoise(
            position=value["position_noise"],
            yaw=value["yaw_noise"],
            speed=value["speed_noise"],
            yaw_rate=value["yaw_rate_noise"],
        )
        self._acceleration_noise, self._jump = value["acceleration_noise"], value["position_jump"]
        names = self.get_parameter("faults").value
        self._failing = frozenset(FAULTS[name] for name in names if name)  # taken at the next tick

    def _start_pose(self) -> Pose:
        x, y, heading = (float(self.get_parameter(name).value) for name in START_PARAMETERS)
        return x, y, heading

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            with self._lock:
                self._rig.reset(self._start_pose())
        except ExcitationError as error:
            response.success, response.message = False, str(error)
        else:
            response.success, response.message = True, "at rest at its start pose, boards rebooted"
        return response

    def _end_with_simulation(self) -> None:
        """End the node where its simulation has failed: whoever started it then knows."""
        if not self._thread.is_alive() and not ending():
            self.get_logger().fatal(self._failure)
            raise SystemExit(1)

    def _run(self) -> None:
        """Simulate until the node is destroyed, or the plant or a board fails."""
        try:
            self._simulate()
        except ExcitationError as error:
            self._failure = str(error)

    def _simulate(self) -> None:
        """Publish, wait for the host and the wall clock, step; until the node is destroyed."""
        with selectors.DefaultSelector() as selector:
            for board, port in self._ports.items():
                selector.register(port, selectors.EVENT_READ, board)
            due, failing = time.monotonic(), frozenset[FaultKind]()
            while not self._stop.is_set():
                if failing != self._failing:
                    self._rig.fail(failing := self._failing)
                with self._lock:
                    self._publish(self._rig.state, self._rig.time)
                    self._listen(selector, due)
                    for board, data in self._rig.step().items():
                        self._ports[board].write(data)
                    self._plug(selector)
                    if self._rig.state.rolled_over:
                        self.get_logger().error("the vehicle has rolled over", once=True)
                period = TICK / self._factor if self._factor else 0.0
                now = time.monotonic()
                due = min(due, now) + period
                # what is late is caught up, but never more than ten ticks
                if due < now - 10 * period:
                    due = now - 10 * period
                    if self._factor and not self._patience:  # with patience it waits for its host
                        self.get_logger().warning(
                            "the simulation does not keep up with real_time_factor "
                            f"{self._factor:g}: this machine is too slow for it, or busy",
                            throttle_duration_sec=5.0,
                        )

    def _plug(self, selector: selectors.BaseSelector) -> None:
        """Pull the cables of the boards that have none, and put back the others."""
        for board, port in self._ports.items():
            if port.plugged and not self._rig.plugged(board):
                selector.unregister(port)
                port.unplug()
            elif self._rig.plugged(board) and not port.plugged:
                port.plug()
                selector.register(port, selectors.EVENT_READ, board)

    def _listen(self, selector: selectors.BaseSelector, due: float) -> None:
        """Serve the ports until `due` and, armed, until the host has answered or fallen silent.

        A tick that was not answered in time is followed by one that waits out all its patience:
        then no answer is left on its way, to be taken for that of a later tick.
        """
        rig, factor = self._rig, self._factor
        deadline = time.monotonic() + self._patience
        while not self._stop.is_set():
            if self._factor != factor:  # another pace counts at once
                due = 0.0
            for board, port in self._ports.items():
                if data := port.read():
                    port.write(rig.receive(board, data))
                    if rig.heard(board):
                        self._heard = time.monotonic()
            now = time.monotonic()
            answered = self._in_step and rig.answered
            waits = rig.armed and not answered and now - self._heard < HOST_SILENCE
            left = (max(due, deadline) if waits else due) - now
            if left <= 0.0:
                break
            selector.select(min(left, 0.1))
        if self._in_step and self._patience and rig.armed and not rig.answered:
            self.get_logger().warning(
                f"the boards accepted no command at {rig.time:.2f} s within host_patience, "
                f"{self._patience:g} s: the vehicle follows the ones before",
                throttle_duration_sec=1.0,
            )
        self._in_step = rig.armed and rig.answered

    def _publish(self, state: LiveState, now: float) -> None:
        stamp = time_message(now)
        self._clock_publisher.publish(Clock(clock=stamp))
        pose = measure_pose(state, self._noise, self._rng)
        odom = _odometry(stamp)
        odom.pose.pose.position.x, odom.pose.pose.position.y = pose.x + self._jump, pose.y
        odom.pose.pose.orientation.z, odom.pose.pose.orientation.w = about_vertical(pose.yaw)
        odom.twist.twist.linear.x, odom.twist.twist.linear.y = pose.vx, pose.vy
        odom.twist.twist.angular.z = pose.yaw_rate
        noise = self._noise
        odom.pose.covariance[0] = odom.pose.covariance[7] = noise.position**2
        odom.pose.covariance[35] = noise.yaw**2
        odom.pose.covariance[[14, 21, 28]] = UNKNOWN_VARIANCE  # z, roll, pitch
        odom.twist.covariance[0] = odom.twist.covariance[7] = noise.speed**2
        odom.twist.covariance[35] = noise.yaw_rate**2
        odom.twist.covariance[[14, 21, 28]] = UNKNOWN_VARIANCE
        self._odom.publish(odom)
        if self._tf is not None:
            self._tf.publish(TFMessage(transforms=[_transform(odom)]))
        self._truth.publish(_ground_truth(state, stamp))
        self._imu.publish(self._measured_imu(state, stamp))

    def _measured_imu(self, state: LiveState, stamp: Time) -> Imu:
        message = Imu()
        message.header.stamp, message.header.frame_id = stamp, BASE_LINK
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
        self._rig.close()
        for port in self._ports.values():
            port.close()
        super().destroy_node()


def _numbers_by_name(pairs: list[str]) -> dict[str, float]:
    values = {}
    for pair in filter(None, pairs):  # an empty list of strings has no type in ROS: it is [""]
        name, _, value = pair.partition("=")
        try:
            values[name] = float(value)
        except ValueError:
            raise VehicleError(f"true_values: {pair!r} must be name=number") from None
    return values


def _odometry(stamp: Time) -> Odometry:
    message = Odometry(child_frame_id=BASE_LINK)
    message.header.stamp, message.header.frame_id = stamp, ODOM
    return message


def _check_faults(names: Sequence[str]) -> None:
    """Raise if a fault is unknown."""
    if unknown := sorted(set(names) - {"", *FAULTS}):
        raise VehicleError(f"faults: {', '.join(unknown)}: needs some of {', '.join(FAULTS)}")


def _refuse_unknown(parameters: list[Parameter]) -> SetParametersResult:
    try:
        _check_faults([name for p in parameters if p.name == "faults" for name in p.value])
    except VehicleError as error:
        return SetParametersResult(successful=False, reason=str(error))
    return SetParametersResult(successful=True)


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
