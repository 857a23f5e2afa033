"""Drives out of bags that a simulation has filled, and `tricycle identify` on them."""

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from excitation_planner.maneuver import Circle
from excitation_planner.planning.replay import nominal_run
from parameter_identification.drives.measured import Sensor, read_measured_drive
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from trajectory_recorder.bag.topics import OfferedQos, Topic, jazzy
from trajectory_recorder.bag.writer import BagWriter
from tricycle_cli.main import main
from tricycle_core.errors import IdentificationError
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle, load_vehicle
from tricycle_sim.vehicle.batch import simulate

TYPES = jazzy().types
LATCHED = (OfferedQos(durability="transient_local", depth=1),)
START = 1_700_000_000_123_456_789  # ns
VEHICLE = load_vehicle()
TRUTH = {"cornering_stiffness": 800.0, "camber_stiffness": 60.0, "yaw_inertia": 35.0}
TOPICS = {
    "/maneuver/reference": "nav_msgs/msg/Path",
    "/maneuver/state": "diagnostic_msgs/msg/DiagnosticStatus",
    "/maneuver/commands": "trajectory_msgs/msg/JointTrajectory",
    "/odom": "nav_msgs/msg/Odometry",
    "/imu": "sensor_msgs/msg/Imu",
    "/joint_states": "sensor_msgs/msg/JointState",
}


def message(kind: str, /, **fields: Any) -> Any:
    return TYPES[kind](**fields)


def header(ns: int) -> Any:
    stamp = message("builtin_interfaces/msg/Time", sec=ns // 10**9, nanosec=ns % 10**9)
    return message("std_msgs/msg/Header", stamp=stamp, frame_id="odom")


def vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    return message("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def quaternion(heading: float) -> Any:
    z, w = math.sin(heading / 2), math.cos(heading / 2)
    return message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=z, w=w)


def pose(x: float, y: float, heading: float) -> Any:
    point = message("geometry_msgs/msg/Point", x=x, y=y, z=0.0)
    return message("geometry_msgs/msg/Pose", position=point, orientation=quaternion(heading))


def odometry(ns: int, x: float, y: float, heading: float) -> Any:
    twist = message("geometry_msgs/msg/Twist", linear=vector(), angular=vector())
    nothing = np.zeros(36)
    return message(
        "nav_msgs/msg/Odometry",
        header=header(ns),
        child_frame_id="base_link",
        pose=message(
            "geometry_msgs/msg/PoseWithCovariance", pose=pose(x, y, heading), covariance=nothing
        ),
        twist=message("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=nothing),
    )


def imu(ns: int, yaw_rate: float) -> Any:
    nothing = np.zeros(9)
    return message(
        "sensor_msgs/msg/Imu",
        header=header(ns),
        orientation=quaternion(0.0),
        orientation_covariance=nothing,
        angular_velocity=vector(z=yaw_rate),
        angular_velocity_covariance=nothing,
        linear_acceleration=vector(),
        linear_acceleration_covariance=nothing,
    )


def joint_state(ns: int, wheel_speed: float) -> Any:
    return message(
        "sensor_msgs/msg/JointState",
        header=header(ns),
        name=["steering_motor_joint", "rear_wheel_joint"],
        position=np.zeros(2),
        velocity=np.array([0.0, wheel_speed]),
        effort=np.zeros(0),
    )


def state(name: str, start: str, duration: float) -> Any:
    values = {"state": name, "plan_id": "p1", "start_time": start, "duration": f"{duration:.3f}"}
    return message(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=0,
        name="maneuver_driver: maneuver",
        message=name,
        hardware_id="",
        values=[message("diagnostic_msgs/msg/KeyValue", key=k, value=v) for k, v in values.items()],
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


@dataclass(frozen=True)
class Recording:
    """A simulated circle as the recorder would have kept it."""

    vehicle: Vehicle = VEHICLE  # that it is planned with
    truth: tuple[tuple[str, float], ...] = tuple(TRUTH.items())
    until: float = math.inf  # s; what is recorded after it is lost
    standing: bool = False  # the vehicle does not move
    without: tuple[str, ...] = ()  # topics
    tell: bool = False  # the truth, in the bag's record

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
        for t, p, h, r, w in zip(drive.signals[Sensor.POSITION].time, *values, strict=True):
            if t < self.until:
                ns = START + round(float(t) * 1e9)
                rows += [
                    (ns, "/odom", odometry(ns, *map(float, p), float(h[0]))),
                    (ns, "/imu", imu(ns, float(r[0]))),
                    (ns, "/joint_states", joint_state(ns, float(w[0]))),
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
            (START, "/maneuver/state", state("running", at, commands.duration)),
        ]
        rows = sorted((row for row in rows if row[1] not in self.without), key=lambda row: row[0])
        told = {f"true_{name}": repr(value) for name, value in self.truth} if self.tell else {}
        with BagWriter(path, metadata=told) as bag:
            ids = {
                name: bag.add_topic(Topic.of_type(name, kind, qos=LATCHED if "man" in name else ()))
                for name, kind in TOPICS.items()
                if name not in self.without
            }
            for ns, name, m in rows:
                bag.write(ids[name], ns, bytes(jazzy().serialize_cdr(m, TOPICS[name])))
        return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Recording(tell=True).write(tmp_path_factory.mktemp("bags") / "circle")


def test_a_bag_gives_commands_signals_and_truth(bag: Path) -> None:
    drive = read_measured_drive(bag, VEHICLE)
    commands = Recording().commands()
    np.testing.assert_allclose(drive.commands.time, commands.time, atol=1e-9)
    np.testing.assert_allclose(drive.commands.speed, commands.speed, atol=1e-12)
    assert set(drive.signals) == set(Sensor)
    position = drive.signals[Sensor.POSITION]
    assert position.time[0] == pytest.approx(-1.0, abs=0.02)
    np.testing.assert_allclose(position.values[0], [1.0, 2.0], atol=0.06)
    assert drive.truth == TRUTH


def test_a_bag_without_commands_is_told(tmp_path: Path) -> None:
    path = Recording(without=("/maneuver/commands",)).write(tmp_path / "bag")
    with pytest.raises(IdentificationError, match="maneuver/commands"):
        read_measured_drive(path, VEHICLE)


def test_sensors_that_a_bag_lacks_are_done_without(tmp_path: Path) -> None:
    path = Recording(without=("/imu", "/joint_states")).write(tmp_path / "bag")
    assert set(read_measured_drive(path, VEHICLE).signals) == {Sensor.POSITION, Sensor.HEADING}


def test_the_command_prints_and_writes_what_it_found(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["identify", str(bag), "--json", "--output", str(out)]) == 0
    printed = capsys.readouterr()
    found = json.loads(printed.out)
    for name in ("cornering_stiffness", "camber_stiffness"):
        entry = found["parameters"][name]
        assert entry["truth"] == TRUTH[name]
        assert abs(entry["estimate"] - entry["truth"]) < 4 * entry["standard_deviation"]
        assert entry["identifiable"]
    assert found["white"]
    assert json.loads((out / "identification.json").read_text()) == found
    assert "<html" in (out / "report.html").read_text(encoding="utf-8")
    for name in ("trajectories", "residuals", "profiles"):
        assert (out / f"{name}.png").stat().st_size > 10_000
    assert main(["vehicle", "check", str(out / "vehicle.yaml")]) == 0
    assert "cornering_stiffness" in printed.err


BAD: dict[str, tuple[Recording, str]] = {
    "nothing moved": (Recording(standing=True), "too little motion"),
    "another vehicle": (
        Recording(vehicle=VEHICLE.replace(com_to_rear_axle=1.2, mass=80.0)),
        "another vehicle",
    ),
    "cut after a moment": (Recording(until=0.5), "too little motion"),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_bags_are_one_line_and_status_2(
    what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, expected = BAD[what]
    path = recording.write(tmp_path / "bag")
    out = tmp_path / "out"
    assert main(["identify", str(path), "--output", str(out)]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "tricycle:" in line]
    assert expected in line
    assert not out.exists()


def test_three_seconds_are_told_to_show_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    quiet = replace(Recording(), until=3.0, without=("/imu", "/joint_states"))
    path = quiet.write(tmp_path / "bag")
    assert main(["identify", str(path)]) == 0
    printed = capsys.readouterr().out
    assert printed.count("not shown") >= 5


def test_a_parameter_that_does_not_exist_is_told(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["identify", str(bag), "--parameters", "mass"]) == 2
    assert "'mass' is not an unknown parameter" in capsys.readouterr().err
