"""Bags of drives whose errors and parameters are known, as the recorder would write them."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from excitation_planner.maneuver import Circle
from excitation_planner.planning.replay import nominal_run
from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.poses import Datum
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from trajectory_recorder.bag.topics import OfferedQos, Topic, jazzy
from trajectory_recorder.bag.writer import BagWriter
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle, load_vehicle
from tricycle_sim.vehicle.batch import simulate

Array = NDArray[np.float64]
TYPES = jazzy().types
LATCHED = (OfferedQos(durability="transient_local", depth=1),)
START = 1_700_000_000_123_456_789  # ns


def stamp(ns: int) -> Any:
    return TYPES["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)


def header(ns: int, frame: str = "odom") -> Any:
    return TYPES["std_msgs/msg/Header"](stamp=stamp(ns), frame_id=frame)


def pose(x: float, y: float, heading: float) -> Any:
    return TYPES["geometry_msgs/msg/Pose"](
        position=TYPES["geometry_msgs/msg/Point"](x=x, y=y, z=0.3),
        orientation=TYPES["geometry_msgs/msg/Quaternion"](
            x=0.0, y=0.0, z=math.sin(heading / 2), w=math.cos(heading / 2)
        ),
    )


def vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    return TYPES["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)


def pose_stamped(ns: int, x: float, y: float, heading: float) -> Any:
    return TYPES["geometry_msgs/msg/PoseStamped"](header=header(ns), pose=pose(x, y, heading))


def odometry(ns: int, x: float, y: float, heading: float) -> Any:
    twist = TYPES["geometry_msgs/msg/Twist"](linear=vector(), angular=vector())
    return TYPES["nav_msgs/msg/Odometry"](
        header=header(ns),
        child_frame_id="base_link",
        pose=TYPES["geometry_msgs/msg/PoseWithCovariance"](
            pose=pose(x, y, heading), covariance=np.zeros(36)
        ),
        twist=TYPES["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36)),
    )


def transform(ns: int, x: float, y: float, heading: float) -> Any:
    return TYPES["geometry_msgs/msg/TransformStamped"](
        header=header(ns),
        child_frame_id="base_link",
        transform=TYPES["geometry_msgs/msg/Transform"](
            translation=vector(x, y), rotation=pose(x, y, heading).orientation
        ),
    )


def tf(ns: int, x: float, y: float, heading: float) -> Any:
    other = transform(ns, -y, x, 0.0)
    other.child_frame_id = "lidar"
    return TYPES["tf2_msgs/msg/TFMessage"](transforms=[other, transform(ns, x, y, heading)])


DATUM = Datum(46.5, 6.6, 400.0)


def fix(ns: int, x: float, y: float, heading: float) -> Any:
    """Inverse of the tangent plane by its metric at the datum: good to 1e-4 of 10 m."""
    a, e2, phi = 6_378_137.0, 6.694_379_990_14e-3, math.radians(DATUM.latitude)
    w = math.sqrt(1 - e2 * math.sin(phi) ** 2)
    meridian, normal = a * (1 - e2) / w**3, a / w
    return TYPES["sensor_msgs/msg/NavSatFix"](
        header=header(ns),
        status=TYPES["sensor_msgs/msg/NavSatStatus"](status=0, service=1),
        latitude=DATUM.latitude + math.degrees(y / (meridian + DATUM.altitude)),
        longitude=DATUM.longitude + math.degrees(x / ((normal + DATUM.altitude) * math.cos(phi))),
        altitude=DATUM.altitude,
        position_covariance=np.zeros(9),
        position_covariance_type=0,
    )


MAKERS: dict[str, tuple[str, Callable[..., Any]]] = {
    "odometry": ("nav_msgs/msg/Odometry", odometry),
    "pose": ("geometry_msgs/msg/PoseStamped", pose_stamped),
    "transform": ("geometry_msgs/msg/TransformStamped", transform),
    "tf": ("tf2_msgs/msg/TFMessage", tf),
    "fix": ("sensor_msgs/msg/NavSatFix", fix),
}


def status(state: str, start: str, **values: str) -> Any:
    values = {"state": state, "plan_id": "p1", "start_time": start, "duration": "8.0", **values}
    return TYPES["diagnostic_msgs/msg/DiagnosticStatus"](
        level=0,
        name="maneuver_driver: maneuver",
        message=state,
        hardware_id="",
        values=[TYPES["diagnostic_msgs/msg/KeyValue"](key=k, value=v) for k, v in values.items()],
    )


@dataclass
class Scene:
    """A straight run-in of 2 s, then a circle of 2 m at 1 m/s; what deviates is said here."""

    deviation: Callable[[Array], Array] = lambda t: np.zeros((2, len(t)))  # in reference frame
    lag: float = 0.0  # s
    noise: float = 0.0  # m
    heading_noise: float = 0.0  # rad
    anchor: tuple[float, float, float] = (3.0, -2.0, 2.5)
    rate: float = 100.0  # Hz
    before: float = 1.5  # s recorded
    after: float = 1.5
    duration: float = 8.0
    seed: int = 0
    poses: str = "odometry"
    topics: dict[str, str] = field(default_factory=dict)  # other names
    edit: Callable[[dict[str, list[Any]]], None] = lambda messages: None  # what is wrong
    more: dict[str, tuple[str, list[tuple[int, Any]]]] = field(default_factory=dict)  # topics

    def reference(self, t: Array) -> Array:
        """x, y, heading (3, t) of a start at rest: 1 m/s² for 1 s, then 1 m/s."""
        t = np.clip(t, 0, self.duration)
        s = np.where(t < 1, t**2 / 2, t - 0.5)
        arc = np.maximum(s - 1.5, 0)
        straight = np.minimum(s, 1.5)
        return np.stack([straight + 2 * np.sin(arc / 2), 2 * (1 - np.cos(arc / 2)), arc / 2])

    def messages(self) -> dict[str, list[Any]]:
        """Topic -> [(receive stamp, message)]."""
        t = np.arange(0, self.duration + 1e-9, 0.01)
        poses = [
            pose_stamped(round(ti * 1e9), *p) for ti, p in zip(t, self.reference(t).T, strict=True)
        ]
        path = TYPES["nav_msgs/msg/Path"](header=header(0), poses=poses)
        rng = np.random.default_rng(self.seed)
        t = np.arange(-self.before, self.duration + self.after, 1 / self.rate) + 0.001234
        x, y, heading = self.reference(t - self.lag)
        x, y = np.stack([x, y]) + self.deviation(np.clip(t, 0, self.duration))
        x0, y0, a = self.anchor
        measured = np.stack(
            [x0 + np.cos(a) * x - np.sin(a) * y, y0 + np.sin(a) * x + np.cos(a) * y]
        )
        measured += rng.normal(0, self.noise, measured.shape) if self.noise else 0
        heading = heading + a + rng.normal(0, 1, len(t)) * self.heading_noise
        stamps = START + np.round(t * 1e9).astype(np.int64)
        make = MAKERS[self.poses][1]
        first, at = int(stamps[0]) - 10**7, f"{START // 10**9}.{START % 10**9:09d}"
        end = START + round(self.duration * 1e9)
        length = {"duration": f"{self.duration:.3f}"}
        messages = {
            "/maneuver/reference": [(first, path)],
            "/maneuver/state": [
                (first, status("waiting", "", **length)),
                (START + 10**6, status("running", at, **length)),
                (START + 10**9, status("running", at, elapsed="1.0", **length)),
                (end, status("done", at, **length)),
            ],
            "/odom": [
                (int(s) + 10**6, make(int(s), float(px), float(py), float(h)))
                for s, px, py, h in zip(stamps, *measured, heading, strict=True)
            ],
        }
        messages |= {name: rows for name, (_, rows) in self.more.items()}
        self.edit(messages)
        return messages

    def types(self) -> dict[str, str]:
        return {
            "/maneuver/reference": "nav_msgs/msg/Path",
            "/maneuver/state": "diagnostic_msgs/msg/DiagnosticStatus",
            "/maneuver/commands": "trajectory_msgs/msg/JointTrajectory",
            "/joint_commands": "sensor_msgs/msg/JointState",
            "/odom": MAKERS[self.poses][0],
            **{name: kind for name, (kind, _) in self.more.items()},
        }

    def write(self, path: Path, **options: Any) -> Path:
        messages, types = self.messages(), self.types()
        rows = [(s, name, m) for name, found in messages.items() for s, m in found]
        rows.sort(key=lambda row: row[0])
        with BagWriter(path, **options) as bag:
            ids = {
                name: bag.add_topic(
                    Topic.of_type(
                        self.topics.get(name, name),
                        types[name],
                        qos=LATCHED if "man" in name else (),
                    )
                )
                for name in messages
            }
            for i, (s, name, message) in enumerate(rows):
                bag.write(ids[name], s, bytes(jazzy().serialize_cdr(message, types[name])))
                if i % 100 == 0:
                    bag.flush()
        return path


def sideways(distance: float) -> Callable[[Array], Array]:
    """Deviation in y that grows as sin² over the eight seconds: mean square 3/8 d²."""
    return lambda t: np.stack([0 * t, distance * np.sin(np.pi * t / 16) ** 2])


def message(kind: str, /, **fields: Any) -> Any:
    return TYPES[kind](**fields)


def imu(ns: int, yaw_rate: float) -> Any:
    nothing = np.zeros(9)
    return message(
        "sensor_msgs/msg/Imu",
        header=header(ns),
        orientation=message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=nothing,
        angular_velocity=vector(z=yaw_rate),
        angular_velocity_covariance=nothing,
        linear_acceleration=vector(),
        linear_acceleration_covariance=nothing,
    )


def joint_state(ns: int, steering: float, wheel_speed: float) -> Any:
    joints = {"steering_motor_joint": 0.0, "rear_wheel_joint": wheel_speed}
    return velocities(ns, joints, (steering, 0.0))


def velocities(
    ns: int, joints: Mapping[str, float], positions: Sequence[float] | None = None
) -> Any:
    return message(
        "sensor_msgs/msg/JointState",
        header=header(ns),
        name=list(joints),
        position=np.array(positions or np.zeros(len(joints))),
        velocity=np.array(list(joints.values())),
        effort=np.zeros(0),
    )


def trajectory(commands: Commands, radius: float) -> Any:
    rows = zip(commands.time, commands.steering_motor_angle, commands.speed, strict=True)
    return message(
        "trajectory_msgs/msg/JointTrajectory",
        header=header(0),
        joint_names=["steering_motor_joint", "rear_wheel_joint"],
        points=[
            message(
                "trajectory_msgs/msg/JointTrajectoryPoint",
                positions=np.array([angle, 0.0]),
                velocities=np.array([0.0, speed / radius]),
                accelerations=np.zeros(0),
                effort=np.zeros(0),
                time_from_start=message(
                    "builtin_interfaces/msg/Duration",
                    sec=int(t),
                    nanosec=round((t - int(t)) * 1e9),
                ),
            )
            for t, angle, speed in rows
        ],
    )


VEHICLE = load_vehicle()
TRUTH = {"cornering_stiffness": 800.0, "camber_stiffness": 60.0, "yaw_inertia": 35.0}
SIGNAL_TOPICS = {
    "/maneuver/reference": "nav_msgs/msg/Path",
    "/maneuver/state": "diagnostic_msgs/msg/DiagnosticStatus",
    "/maneuver/commands": "trajectory_msgs/msg/JointTrajectory",
    "/odom": "nav_msgs/msg/Odometry",
    "/imu": "sensor_msgs/msg/Imu",
    "/joint_states": "sensor_msgs/msg/JointState",
}


@dataclass(frozen=True)
class SimulatedBag:
    """A simulated circle as the recorder would have kept it."""

    vehicle: Vehicle = VEHICLE  # that it is planned with
    truth: tuple[tuple[str, float], ...] = tuple(TRUTH.items())
    until: float = math.inf  # s; what is recorded after it is lost
    ended_early: float | None = None  # s; the driver ended it then, as told to
    standing: bool = False  # the vehicle does not move
    without: tuple[str, ...] = ()  # topics
    tell: bool = False  # the truth and the vehicle's fingerprint, in the bag's record
    names: tuple[tuple[str, str], ...] = ()  # topics that have other names

    def commands(self) -> Commands:
        return nominal_run(self.vehicle, Circle(duration=14.0), np.array([3.0, 1.0])).commands

    def write(self, path: Path) -> Path:
        commands = self.commands()
        motion = SensedMotion.of(simulate(self.vehicle.replace(**dict(self.truth)), commands))
        if self.standing:
            zero = np.zeros_like(motion.time)
            motion = SensedMotion(motion.time, zero, zero, zero, zero, zero)
        nominal = simulate(self.vehicle, commands)
        rows: list[tuple[int, str, Any]] = []
        noise = {
            Sensor.POSITION: SensorNoise(0.01, rate=50.0),
            Sensor.HEADING: SensorNoise(0.002, rate=50.0),
            Sensor.YAW_RATE: SensorNoise(0.005, rate=50.0),
            Sensor.WHEEL_SPEED: SensorNoise(0.003, rate=50.0),
        }
        rng = np.random.default_rng(3)
        drive = measure(motion, commands, noise, rng=rng, standstill=1.5, pose=(1.0, 2.0, 3.0))
        values = [drive.signals[sensor].values for sensor in noise]

        def steering(t: float) -> float:
            return float(np.interp(t, nominal.time, nominal.steering_motor_angle[0]))

        for t, p, h, r, w in zip(drive.signals[Sensor.POSITION].time, *values, strict=True):
            if t < self.until:
                ns = START + round(float(t) * 1e9)
                rows += [
                    (ns, "/odom", odometry(ns, *map(float, p), float(h[0]))),
                    (ns, "/imu", imu(ns, float(r[0]))),
                    (ns, "/joint_states", joint_state(ns, steering(float(t)), float(w[0]))),
                ]
        first, at = rows[0][0] - 10**6, f"{START // 10**9}.{START % 10**9:09d}"
        poses = [
            message("geometry_msgs/msg/PoseStamped", header=header(round(t * 1e9)), pose=pose(*p))
            for t, *p in zip(nominal.time, nominal.x[0], nominal.y[0], nominal.yaw[0], strict=True)
        ]
        path_message = message("nav_msgs/msg/Path", header=header(0), poses=poses)
        rows += [
            (first, "/maneuver/reference", path_message),
            (first, "/maneuver/commands", trajectory(commands, self.vehicle.tyre_radius)),
            (START, "/maneuver/state", status("running", at, duration=f"{commands.duration:.3f}")),
        ]
        if (end := self.ended_early) is not None:
            told_to = {"elapsed": repr(end), "reason": "ended early"}
            done = status("done", at, duration=f"{commands.duration:.3f}", **told_to)
            rows.append((START + round(end * 1e9), "/maneuver/state", done))
        rows = sorted((row for row in rows if row[1] not in self.without), key=lambda row: row[0])
        told = {}
        if self.tell:
            told = {f"true_{name}": repr(value) for name, value in self.truth}
            told["vehicle_hash"] = self.vehicle.fingerprint
        with BagWriter(path, metadata=told) as bag:
            ids = {
                name: bag.add_topic(
                    Topic.of_type(
                        dict(self.names).get(name, name),
                        kind,
                        qos=LATCHED if "man" in name else (),
                    )
                )
                for name, kind in SIGNAL_TOPICS.items()
                if name not in self.without
            }
            for ns, name, m in rows:
                bag.write(ids[name], ns, bytes(jazzy().serialize_cdr(m, SIGNAL_TOPICS[name])))
        return path
