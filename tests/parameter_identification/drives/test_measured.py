"""Drives out of bags that a simulation has filled, and `tricycle identify` on them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from driven_bags import TRUTH, VEHICLE, SimulatedBag

from parameter_identification.drives.following import servo_angle
from parameter_identification.drives.measured import (
    STAMP_JITTER,
    Input,
    MeasuredDrive,
    Sensor,
    Signal,
    resolved,
    usable,
)
from parameter_identification.drives.measured_from_bag import (
    commands_of,
    measured_drive,
    read_measured_drive,
)
from parameter_identification.drives.reader import read_drive
from trajectory_recorder.bag.topics import jazzy
from tricycle_cli.main import main
from tricycle_core.errors import IdentificationError
from tricycle_core.joints import JOINTS
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle

USUAL = {Sensor.POSITION, Sensor.HEADING, Sensor.YAW_RATE, Sensor.WHEEL_SPEED}


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return SimulatedBag(tell=True).write(tmp_path_factory.mktemp("bags") / "circle")


def test_a_bag_gives_commands_signals_and_truth(bag: Path) -> None:
    drive = read_measured_drive(str(bag), VEHICLE)
    commands = SimulatedBag().commands()
    np.testing.assert_allclose(drive.commands.time, commands.time, atol=1e-9)
    np.testing.assert_allclose(drive.commands.speed, commands.speed, atol=1e-12)
    assert set(drive.signals) == USUAL
    position = drive.signals[Sensor.POSITION]
    assert position.time[0] == pytest.approx(-1.0, abs=0.02)
    np.testing.assert_allclose(position.values[0], [1.0, 2.0], atol=0.06)
    assert drive.truth == TRUTH
    assert drive.vehicle_hash == VEHICLE.fingerprint
    time = np.arange(0.5, 13.5, 0.1)
    angle = servo_angle(commands, time, VEHICLE)
    np.testing.assert_allclose(drive.steering_angle.at(time), angle, atol=2e-3)


def test_a_steering_angle_that_is_not_told_throughout_is_not_used(bag: Path) -> None:
    recorded = read_drive(bag)
    joints = recorded.joint_states
    assert joints is not None
    for begin, end, used in ((3.0, 3.1, True), (3.0, 3.5, False), (13.0, 14.0, False)):
        angle = joints.steering_motor_angle.copy()
        angle[(joints.time > begin) & (joints.time < end)] = np.nan
        states = replace(joints, steering_motor_angle=angle)
        drive = measured_drive(replace(recorded, joint_states=states), VEHICLE)
        assert (Input.STEERING in drive.measured_throughout) == used


def test_a_sensor_with_another_clock_is_told_as_unheard(bag: Path) -> None:
    recorded = read_drive(bag)
    assert recorded.imu is not None
    assert measured_drive(recorded, VEHICLE).unheard == ()
    imu = replace(recorded.imu, time=recorded.imu.time + 3600.0)
    drive = measured_drive(replace(recorded, imu=imu), VEHICLE)
    assert Sensor.YAW_RATE not in drive.signals
    assert drive.unheard == (Sensor.YAW_RATE, Sensor.LATERAL_ACCELERATION)[: len(drive.unheard)]
    assert Sensor.YAW_RATE in drive.unheard


def test_a_bag_without_commands_is_told(tmp_path: Path) -> None:
    path = SimulatedBag(without=("/maneuver/commands",)).write(tmp_path / "bag")
    with pytest.raises(IdentificationError, match="maneuver/commands"):
        read_measured_drive(path, VEHICLE)


@pytest.mark.slow
def test_sensors_that_a_bag_lacks_are_done_without(tmp_path: Path) -> None:
    path = SimulatedBag(without=("/imu", "/joint_states")).write(tmp_path / "bag")
    assert set(read_measured_drive(path, VEHICLE).signals) == {Sensor.POSITION, Sensor.HEADING}


@pytest.mark.slow
def test_the_command_prints_and_writes_what_it_found(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    options = ["--effects", "none", "--json", "--output", str(out)]  # weighed, it has no profiles
    assert main(["identify", str(bag), *options]) == 0
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


def test_signals_are_checked() -> None:
    time = np.arange(3.0)
    with pytest.raises(IdentificationError, match="must increase"):
        Signal(time[::-1].copy(), np.zeros((3, 1)))
    with pytest.raises(IdentificationError, match="finite"):
        Signal(time, np.array([[0.0], [np.nan], [0.0]]))
    with pytest.raises(IdentificationError, match="no positions"):
        MeasuredDrive("a", Commands([0, 1], [0, 0], [0, 0]), {})


BAD: dict[str, tuple[SimulatedBag, str]] = {
    "nothing moved": (SimulatedBag(standing=True), "too little motion"),
    "another vehicle": (
        SimulatedBag(vehicle=VEHICLE.replace(com_to_rear_axle=1.2, mass=80.0)),
        "another vehicle",
    ),
    "cut after a moment": (SimulatedBag(until=0.5), "too little motion"),
}


@pytest.mark.slow
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


def test_speeds_are_those_of_the_driven_tyres_where_others_have_another_radius() -> None:
    vehicle = load_vehicle().replace(**{"front.tyre_radius": 0.2, "rear.tyre_radius": 0.3})
    kind = "trajectory_msgs/msg/JointTrajectory"
    types = jazzy().types
    points = [
        types["trajectory_msgs/msg/JointTrajectoryPoint"](
            positions=np.array([0.1, 4.0]), velocities=np.array([0.0, 4.0]),
            accelerations=np.zeros(0), effort=np.zeros(0),
            time_from_start=types["builtin_interfaces/msg/Duration"](sec=second, nanosec=0),
        )
        for second in (0, 1)
    ]  # fmt: skip
    stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    message = types[kind](header=header, joint_names=list(JOINTS), points=points)
    assert commands_of(message, vehicle, "bag").speed == pytest.approx([1.2, 1.2])


@pytest.mark.slow
def test_three_seconds_are_told_to_show_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    quiet = replace(SimulatedBag(), until=3.0, without=("/imu", "/joint_states"))
    path = quiet.write(tmp_path / "bag")
    assert main(["identify", str(path), "--effects", "none"]) == 0
    printed = capsys.readouterr().out
    assert printed.count("not shown") >= 5


def test_topics_of_another_system_are_named_by_options(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = {"/odom": "/tracker", "/imu": "/os/imu", "/joint_states": "/wheels"}
    path = SimulatedBag(until=0.5, names=tuple(names.items())).write(tmp_path / "bag")
    assert main(["identify", str(path)]) == 2
    assert "holds no topic odom" in capsys.readouterr().err
    options = ["--pose", "/tracker", "--imu", "/os/imu", "--joint-states", "/wheels"]
    assert main(["identify", str(path), *options]) == 2  # it is read, and too short
    assert "too little motion" in capsys.readouterr().err


def test_a_parameter_that_does_not_exist_is_told(
    bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["identify", str(bag), "--parameters", "mass"]) == 2
    assert "'mass' is not an unknown parameter" in capsys.readouterr().err


def test_wheel_speeds_that_a_sensor_of_pulses_cannot_tell_are_left_out() -> None:
    time = 0.01 * np.arange(600)
    true = np.minimum(2.0 * time, 6.0)
    pulses = np.where(true < 0.6, 0.0, np.round(true / 0.003) * 0.003)
    seen = resolved(Signal(time, pulses[:, None], STAMP_JITTER[Sensor.WHEEL_SPEED]))
    assert seen.values.min() == pytest.approx(2.7, abs=0.01)
    assert seen.time[-1] == time[-1]
    assert seen.jitter > STAMP_JITTER[Sensor.WHEEL_SPEED]


def test_the_firmware_counts_pulses() -> None:
    first = [0.0] * 8 + [0.149] * 12  # as it was read, at 100 Hz, until the third pulse
    later = 0.439 + 0.02 * np.arange(150)
    braked = np.arange(3.0, 0.0, -0.02)  # no faster than a pulse that has not come
    values = np.concatenate([first, later, braked])
    seen = resolved(Signal(0.01 * np.arange(len(values)), values[:, None]))
    assert seen.values.min() >= 0.439


def test_a_sensor_of_pulses_is_known_also_where_the_bag_begins_with_a_drive_to_the_start(
    bag: Path,
) -> None:
    recorded = read_drive(bag)
    joints = recorded.joint_states
    assert joints is not None
    step = 0.03 * np.arange(1.0, 34.0)  # of a reading that passes all speeds while the wheel stops
    before, standing = -5.0 + 0.02 * np.arange(len(step)), joints.time <= 0.0
    rate = np.where(standing | (joints.wheel_rate < 0.6), 0.0, joints.wheel_rate)
    drive = measured_drive(
        replace(
            recorded,
            joint_states=replace(
                joints,
                time=np.append(before, joints.time),
                steering_motor_angle=np.append(0.0 * step, joints.steering_motor_angle),
                wheel_rate=np.append(step[::-1], rate),
                motor_torque=np.append(np.nan * step, joints.motor_torque),
            ),
        ),
        VEHICLE,
    )
    assert drive.signals[Sensor.WHEEL_SPEED].values.min() > 2.5


def test_wheel_speeds_of_a_sensor_without_a_dead_zone_are_all_used() -> None:
    time = 0.01 * np.arange(600)
    fine = Signal(time, np.round(np.minimum(2.0 * time, 6.0) / 0.003)[:, None] * 0.003)
    assert resolved(fine) is fine
    moving = Signal(time, 3.0 + 0.001 * np.arange(600)[:, None])
    assert resolved(moving) is moving


def test_no_wheel_is_counted_twice_and_few_samples_are_left_out() -> None:
    def signal(samples: int, *wheels: str) -> Signal:
        values = np.ones((samples, max(1, len(wheels))))
        return Signal(np.arange(samples) * 0.1, values, wheels=wheels)

    position = Signal(np.arange(3) * 0.1, np.zeros((3, 2)))
    signals = {
        Sensor.POSITION: position,
        Sensor.YAW_RATE: signal(9),
        Sensor.WHEEL_SPEED: signal(20),
        Sensor.WHEEL_SPEEDS: signal(20, "left", "rear"),
    }
    found = usable(signals, VEHICLE)
    assert found.keys() == {Sensor.POSITION, Sensor.WHEEL_SPEED, Sensor.WHEEL_SPEEDS}
    assert found[Sensor.WHEEL_SPEEDS].wheels == ("left",)
    alone = usable({**signals, Sensor.WHEEL_SPEEDS: signal(20, "rear")}, VEHICLE)
    assert Sensor.WHEEL_SPEEDS not in alone
    few = usable({**signals, Sensor.WHEEL_SPEED: signal(9)}, VEHICLE)
    assert few[Sensor.WHEEL_SPEEDS].wheels == ("left", "rear")
