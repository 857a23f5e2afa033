"""Windows of long recordings, and bags of them: a simulated car whose parameters are known."""

import dataclasses
import functools
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import tricycle_sim
from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.motion import Motion, motion_of
from parameter_identification.drives.samples import Samples
from parameter_identification.drives.table import (
    Columns,
    Recording,
    SteeringMap,
    load_columns,
    read_recording,
)
from parameter_identification.drives.windows import (
    APPROACH,
    RUN_IN,
    Windows,
    estimate_map,
    read_windows,
    recorded_commands,
    select_windows,
    setpoints_of,
    steering_of,
    turned_angle,
)
from parameter_identification.estimation.inputs import effects_of_columns
from parameter_identification.identification import identify
from tricycle_cli.main import main
from tricycle_core.errors import IdentificationError
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle, load_vehicle
from tricycle_sim.vehicle.batch import Trajectory, simulate

PACKAGED = Path(tricycle_sim.__file__).parent
VEHICLE = load_vehicle()
TRUTH = {"cornering_stiffness": 700.0, "camber_stiffness": 45.0}
GAIN, OFFSET, BEFORE = 0.4, 0.02, 1.0
MAPPING = """\
time: {column: stamp, unit: ms}
x: x
y: y
yaw: {column: yaw, unit: deg}
steering: {column: command, unit: "1"}
"""


@functools.cache
def slalom(vehicle: Vehicle = VEHICLE) -> tuple[str, ...]:
    """Rows of 20 s after a standstill, measured at 50 Hz with 2 mm and 0.5 mrad of noise."""
    time = np.arange(0.0, 20.0, 0.02)
    command = 0.6 * np.sin(0.9 * time) * np.minimum(1.0, time / 3.0)
    commands = Commands(time, GAIN * command + OFFSET, np.minimum(1.5, time))
    true = vehicle.replace(**TRUTH)
    motion = simulate(true, commands, true.nominal_point()[None])
    rng = np.random.default_rng(1)
    rows = []
    for t in np.arange(-BEFORE, 20.0 - 0.03, 0.02):
        x, y, yaw = (np.interp(t, motion.time, v[0]) for v in (motion.x, motion.y, motion.yaw))
        x, y = (v + 0.002 * rng.standard_normal() for v in (x, y))
        yaw = np.angle(np.exp(1j * (yaw + 3.0 + 0.0005 * rng.standard_normal())), deg=True)
        now = command[np.searchsorted(time, t + 1e-9) - 1] if t >= 0 else 0.0
        x, y = (np.cos(3.0) * x - np.sin(3.0) * y, np.sin(3.0) * x + np.cos(3.0) * y)
        rows.append(
            f"{1.7e12 + 1e3 * t:.1f},{x:.5f},{y:.5f},{yaw:.4f},{now:.5f},{min(1.5, max(t, 0)):.3f}"
        )
    return tuple(rows)


def table(
    path: Path,
    edit: Callable[[list[str]], None] = lambda rows: None,
    vehicle: Vehicle = VEHICLE,
) -> Path:
    rows = list(slalom(vehicle))
    edit(rows)
    path.write_text("\n".join(["stamp,x,y,yaw,command,speed", *rows]) + "\n")
    return path


def mapping(path: Path, more: str = f"steering_map: {{gain: {GAIN}, offset: {OFFSET}}}\n") -> Path:
    path.write_text(MAPPING + more)
    return path


@pytest.fixture
def columns(tmp_path: Path) -> Columns:
    return load_columns(mapping(tmp_path / "mapping.yaml"))


@pytest.mark.slow
def test_windows_have_their_own_start_and_do_not_share_samples(
    tmp_path: Path, columns: Columns
) -> None:
    drives = read_windows(table(tmp_path / "drive.csv"), VEHICLE, columns, Windows(length=3.0))
    assert 4 <= len(drives) <= 6
    begin = [float(re.search(r" ([\d.]+) s$", drive.name)[1]) for drive in drives]  # type: ignore[index]
    assert np.diff(begin).min() > 3.0
    for drive in drives:
        position = drive.signals[Sensor.POSITION]
        assert position.time[0] >= APPROACH + RUN_IN - 1e-9
        assert position.time[-1] == pytest.approx(APPROACH + RUN_IN + 3.0, abs=0.03)
        run = simulate(
            VEHICLE, drive.commands, VEHICLE.nominal_point()[None],
            speed=drive.start.speed, setpoint=drive.start.speed, threads=1,
        )  # fmt: skip
        way = np.hypot(*np.diff(position.values[:: len(position.time) - 1], axis=0)[0])
        at = [np.interp(position.time[[0, -1]], run.time, v[0]) for v in (run.x, run.y)]
        assert np.hypot(*np.diff(at, axis=1)[:, 0]) == pytest.approx(way, abs=0.06)


def test_windows_have_the_sensors_that_the_table_has(tmp_path: Path) -> None:
    def measured(rows: list[str]) -> None:
        rows[:] = [
            f"{row},{0.01 * k},{4 + 1e-3 * k},{40 + 0.01 * k},0.1" for k, row in enumerate(rows)
        ]

    path = table(tmp_path / "drive.csv", measured)
    path.write_text(path.read_text().replace(",speed\n", ",speed,ay,left,right,torque\n", 1))
    more = "acceleration_y: {column: ay, unit: g}\nmotor_torque: torque\n"
    wheels = "wheel_speeds: {right: {column: right, unit: rpm}, left: left}\n"
    columns = load_columns(mapping(tmp_path / "mapping.yaml", more + wheels))
    signals = read_windows(path, VEHICLE, columns)[0].signals
    row = 100.0 * signals[Sensor.LATERAL_ACCELERATION].values[0, 0] / 9.80665
    assert signals[Sensor.MOTOR_TORQUE].values[0] == 0.1
    speeds = signals[Sensor.WHEEL_SPEEDS]
    assert speeds.wheels == ("right", "left")
    assert speeds.values[0] == pytest.approx([(40 + 0.01 * row) * np.pi / 30.0, 4 + 1e-3 * row])
    other = load_columns(mapping(tmp_path / "other.yaml", "wheel_speeds: {lefd: left}\n"))
    with pytest.raises(IdentificationError, match="'lefd' is not an entry; did you mean left"):
        read_windows(path, VEHICLE, other)


@pytest.mark.slow
def test_the_servo_of_the_model_has_the_steering_angle_that_was_measured(tmp_path: Path) -> None:
    time = np.arange(0.0, 12.0, 0.02)
    commands = Commands(time, 0.3 * np.sign(np.sin(0.9 * time)), np.minimum(1.5, time))
    slower = VEHICLE.replace(servo_natural_frequency=6.0)
    motion = simulate(slower, commands, slower.nominal_point()[None])
    columns = (motion.time, motion.x[0], motion.y[0], motion.yaw[0], motion.steering_motor_angle[0])
    noise = 0.003 * np.random.default_rng(1).standard_normal(len(motion.time))
    columns = (*columns[:-1], columns[-1] + noise)
    rows = [",".join(f"{v:.5f}" for v in row) for row in zip(*columns, strict=True)]
    path = tmp_path / "drive.csv"
    path.write_text("\n".join(["t,x,y,yaw,angle", *rows]) + "\n")
    mapping = Columns(time="t", x="x", y="y", yaw="yaw", steering_angle="angle")
    entries = {"steering_angle": mapping, "steering": taken_as_set_points(mapping)}
    errors = {}
    for name, entry in entries.items():
        drive = read_windows(path, VEHICLE, entry, Windows(length=8.0))[0]
        run = simulate(
            VEHICLE, drive.commands, VEHICLE.nominal_point()[None], speed=drive.start.speed
        )
        begin = float(drive.name.split()[1]) - RUN_IN - APPROACH
        measured = np.interp(begin + run.time, motion.time, motion.steering_motor_angle[0])
        errors[name] = np.abs(run.steering_motor_angle[0] - measured)[
            run.time > APPROACH + 0.5 * RUN_IN
        ]
    assert errors["steering"].max() > 0.08
    assert errors["steering_angle"].max() < 0.02
    assert np.sqrt(np.mean(errors["steering_angle"] ** 2)) < 0.004


def taken_as_set_points(columns: Columns) -> Columns:
    return dataclasses.replace(columns, steering=columns.steering_angle, steering_angle=None)


@pytest.mark.slow
def test_windows_leave_out_gaps_and_jumps(tmp_path: Path, columns: Columns) -> None:
    def spoil(rows: list[str]) -> None:
        del rows[400:440]
        cells = rows[700].split(",")
        rows[700] = ",".join([cells[0], "50.0", *cells[2:]])

    whole = read_windows(table(tmp_path / "a.csv"), VEHICLE, columns)
    spoilt = read_windows(table(tmp_path / "b.csv", spoil), VEHICLE, columns)
    assert 2 <= len(spoilt) < len(whole)
    for drive in spoilt:
        assert np.abs(drive.signals[Sensor.POSITION].values).max() < 40.0
        assert np.diff(drive.signals[Sensor.POSITION].time).max() < 0.1


def test_the_map_is_estimated_where_the_vehicle_turns_slowly(
    tmp_path: Path, columns: Columns
) -> None:
    recording = read_recording(table(tmp_path / "drive.csv"), columns)
    found = estimate_map(recording, VEHICLE)
    assert found.gain == pytest.approx(GAIN, rel=0.1)
    assert found.offset == pytest.approx(OFFSET, abs=0.01)


@pytest.mark.parametrize("load_sensitivity", [0.0, 1.0])
def test_the_angle_of_a_steady_turn_counts_how_tyres_are_loaded(load_sensitivity: float) -> None:
    stiffness = {"cornering_stiffness": 600.0, "camber_stiffness": 25.0}  # lean is not counted
    vehicle = VEHICLE.replace(load_sensitivity=load_sensitivity, **stiffness)
    time = np.arange(0.0, 12.0, 0.01)
    commands = Commands(time, 0.1 * np.minimum(time / 3.0, 1.0), np.minimum(time, 3.0))
    run = simulate(vehicle, commands, vehicle.nominal_point()[None], threads=1)
    x, y, speed, yaw, rate = (v[0, -100:] for v in (run.x, run.y, run.vx, run.yaw, run.yaw_rate))
    motion = Motion(run.time[-100:], x, y, speed, 0.0, 0.0 * x, 0.0 * x, yaw, rate, 0.0 * x)
    assert turned_angle(motion, vehicle) == pytest.approx(0.1, rel=0.02)


@pytest.mark.parametrize("ripple", [0.0, 1e-10, 0.002])
def test_a_map_is_not_estimated_from_turns_of_one_command(
    tmp_path: Path, columns: Columns, ripple: float
) -> None:
    recording = read_recording(table(tmp_path / "drive.csv"), columns)
    time, radius = recording.time, 4.0
    command = 0.5 + ripple * np.sin(5.0 * time)
    command *= np.clip(2.0 * time - 2.0, 0.0, 1.0) if ripple == 0.002 else 1.0  # it turns in once
    course = 1.2 * time / radius
    noise = 0.002 * np.random.default_rng(1).standard_normal((2, len(time)))
    circle = dataclasses.replace(
        recording,
        x=radius * np.sin(course) + noise[0],
        y=-radius * np.cos(course) + noise[1],
        yaw=None,
        steering=Samples(time, command),
    )
    with pytest.raises(IdentificationError, match=r"always the same|not show the gain.* ± .*give"):
        estimate_map(circle, VEHICLE)


def test_x_and_y_of_different_units_are_told_without_a_yaw(
    tmp_path: Path, columns: Columns
) -> None:
    recording = read_recording(table(tmp_path / "drive.csv"), columns)
    squashed = dataclasses.replace(
        recording,
        x=1e-3 * recording.x,
        yaw=None,
        steering=Samples(recording.time, np.full(len(recording.time), 2.0)),
    )
    assert not isinstance(columns.steering_map, str)
    with pytest.raises(IdentificationError, match="do x and y have the same unit"):
        select_windows(squashed, VEHICLE, columns.steering_map)


@pytest.mark.slow
def test_parameters_are_found_where_the_map_is_estimated_with_other_tyres(tmp_path: Path) -> None:
    columns = load_columns(mapping(tmp_path / "m.yaml", "steering_map: estimate\n"))
    recording = read_recording(table(tmp_path / "drive.csv"), columns)
    drives = select_windows(recording, VEHICLE, steering_of(recording, VEHICLE, columns)).drives
    name = "cornering_stiffness"
    found = identify(
        drives,
        VEHICLE.replace(**TRUTH),
        parameters=[name],
        hold_others=True,
        effects=effects_of_columns(columns),
        weighed=True,
    ).parameters[name]
    assert found.identifiable
    assert found.low < TRUTH[name] < found.high


@pytest.mark.slow  # compiles
def test_the_map_counts_the_servo_of_the_vehicle(tmp_path: Path, columns: Columns) -> None:
    geared = dataclasses.replace(VEHICLE, parts={"servo": "geared"})
    geared = geared.replace(servo_delay=0.15, servo_backlash=0.04)
    recording = read_recording(table(tmp_path / "drive.csv", vehicle=geared), columns)
    assert estimate_map(recording, geared).gain == pytest.approx(GAIN, rel=0.1)


def test_a_motor_without_speed_loop_needs_its_set_points(
    tmp_path: Path, columns: Columns, without_speed_loop: Vehicle
) -> None:
    with pytest.raises(IdentificationError, match="needs speed_command, the set-points of the mot"):
        read_windows(table(tmp_path / "drive.csv"), without_speed_loop, columns)


@pytest.mark.slow
def test_what_cannot_be_taken_is_told(tmp_path: Path, columns: Columns) -> None:
    recording = read_recording(table(tmp_path / "drive.csv"), columns)
    assert not isinstance(columns.steering_map, str)
    with pytest.raises(IdentificationError, match="no window of 2 s begins"):
        select_windows(recording, VEHICLE, columns.steering_map, Windows(above=3.0))
    with pytest.raises(IdentificationError, match="must be positive"):
        Windows(every=0.0)
    throttle = Samples(recording.time, np.full(len(recording.time), 0.2))
    throttled = dataclasses.replace(recording, more={"speed_command": throttle})
    with pytest.raises(IdentificationError, match=r"speed_command is .* not a throttle"):
        select_windows(throttled, VEHICLE, columns.steering_map)
    still = dataclasses.replace(recording, x=0 * recording.x, y=0 * recording.y)
    with pytest.raises(IdentificationError, match="cannot be estimated: less than 2 s"):
        estimate_map(still, VEHICLE)
    small = dataclasses.replace(recording, x=1e-3 * recording.x, y=1e-3 * recording.y)
    with pytest.raises(
        IdentificationError,
        match=r"are the units wrong\? In the mean, the poses come every 0.02 s .* at 0.001\d+ m/s$",
    ):
        estimate_map(small, VEHICLE)


def test_an_offset_of_the_steering_is_no_error_of_a_measured_angle(
    tmp_path: Path, columns: Columns
) -> None:
    told = read_recording(table(tmp_path / "told.csv"), columns)
    told = dataclasses.replace(told, steering_measured=True)
    motion, askew = motion_of(told), VEHICLE.replace(steering_offset=0.05)
    noisy = told.steering.values + 0.01 * np.random.default_rng(2).standard_normal(len(told.time))
    told = dataclasses.replace(told, steering=Samples(told.time, noisy))
    off = [setpoints_of(told, motion, own, SteeringMap(gain=GAIN))[1] for own in (VEHICLE, askew)]
    assert off[1] == pytest.approx(off[0], rel=0.1)


@pytest.mark.slow
def interpolate_where_yaw_wraps(rows: list[str]) -> None:
    cells = [row.split(",") for row in rows]
    yaw = [float(row[3]) for row in cells]
    (wraps,) = np.nonzero(np.abs(np.diff(yaw)) > 180.0)
    for row in wraps[3:4]:
        cells[row][3] = f"{0.5 * (yaw[row] + yaw[row + 1]):.4f}"
        rows[row] = ",".join(cells[row])


def test_a_yaw_that_was_interpolated_where_it_wraps_is_left_out(
    tmp_path: Path, columns: Columns
) -> None:
    """Along it the speed of the poses would turn round for an instant."""
    odd = read_recording(table(tmp_path / "odd.csv", interpolate_where_yaw_wraps), columns)
    steering = columns.steering_map
    assert not isinstance(steering, str)
    found = select_windows(odd, VEHICLE, steering, Windows(length=1.0, above=1.2))
    (reason,) = (reason for reason in found.left_out if "jump of the yaw" in reason)
    assert found.left_out[reason] >= 1
    assert odd.yaw is not None
    at = odd.time[1 + int(np.argmax(np.abs(np.diff(odd.yaw, 2))))]
    for drive in found.drives:
        first = float(drive.name.split()[1])
        assert first + 1.0 < at or first - RUN_IN > at


def test_what_is_left_out_is_counted_by_its_reason(
    tmp_path: Path, columns: Columns, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = read_recording(table(tmp_path / "whole.csv"), columns)
    gap = read_recording(
        table(tmp_path / "gap.csv", lambda rows: rows.__delitem__(slice(600, 620))), columns
    )
    steering = columns.steering_map
    assert not isinstance(steering, str)
    ask = Windows(length=1.0, every=0.5, above=1.2)
    selection = select_windows(whole, VEHICLE, steering, ask)
    assert str(selection) == "1 slower than 1.2 m/s"  # as it begins, after a standstill
    lost = select_windows(gap, VEHICLE, steering, ask)
    (reason,) = lost.left_out.keys() - selection.left_out.keys()
    assert reason.startswith("with a gap of the poses")
    around = (0.4 + 1.0 + RUN_IN) / 0.5  # windows that it is in, or in what leads into them
    assert around - 2 <= lost.left_out[reason] <= around + 2
    time, values = whole.steering.time, whole.steering.values
    begin = time[len(time) // 2]
    for end in (begin + 0.5, time[-1]):
        keep = (time <= begin) | (time > end)
        told = dataclasses.replace(
            whole, steering=Samples(time[keep], values[keep]), steering_measured=True
        )
        found = select_windows(told, VEHICLE, steering, ask)
        assert "with a gap of the steering of more than 0.2 s" in found.left_out
        for drive in found.drives:
            first = float(drive.name.split()[1])
            assert first + 1.0 <= begin + 0.2 or first - RUN_IN >= end
    monkeypatch.setattr("parameter_identification.drives.windows.MAX_SPEED", 1.4)
    with pytest.raises(IdentificationError, match=r"left out: .*\d+ faster than 1\.4 m/s"):
        select_windows(whole, VEHICLE, steering, ask)


@pytest.mark.slow
def test_the_commands_identify_a_table_and_a_bag_of_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known = f"speed_command: speed\nsteering_map: {{gain: {GAIN}, offset: {OFFSET}}}\n"
    drive, columns = table(tmp_path / "drive.csv"), mapping(tmp_path / "mapping.yaml", known)
    ask = ["--parameters", "cornering_stiffness,camber_stiffness", "--json"]
    assert main(["identify", str(drive), "--columns", str(columns), "--window", "4", *ask]) == 0
    printed = capsys.readouterr()
    assert re.search(
        r"drive\.csv: \d windows of 4 s are \d+ of its \d+ s; left out of .* for what is in them "
        r"or in the [\d.]+ s before: ",
        printed.err,
    )
    windows = json.loads(printed.out)["parameters"]
    bag = tmp_path / "bag"
    assert main(["import", str(drive), "--columns", str(columns), "--output", str(bag)]) == 0
    assert main(["judge", str(bag), "--json"]) == 0
    capsys.readouterr()
    assert main(["identify", str(bag), *ask]) == 0
    whole = json.loads(capsys.readouterr().out)["parameters"]
    for found in (windows, whole):
        for name, value in TRUTH.items():
            assert found[name]["low"] < value < found[name]["high"], (name, found[name])
    assert whole["cornering_stiffness"]["identifiable"]


@pytest.mark.slow
@pytest.mark.parametrize(("more", "told"), [("", True), ("speed_command: speed\n", False)])
def test_what_a_speed_of_scattered_positions_errs_by_is_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: str, told: bool
) -> None:
    def scatter(rows: list[str]) -> None:
        rng = np.random.default_rng(0)
        for number, row in enumerate(rows):
            stamp, x, y, *others = row.split(",")
            scattered = (repr(float(v) + 0.01 * rng.standard_normal()) for v in (x, y))
            rows[number] = ",".join([stamp, *scattered, *others])

    known = f"steering_map: {{gain: {GAIN}, offset: {OFFSET}}}\n{more}"
    drive, columns = table(tmp_path / "d.csv", scatter), mapping(tmp_path / "m.yaml", known)
    assert main(["identify", str(drive), "--columns", str(columns)]) == 0
    assert ("the intervals count, by tables" in capsys.readouterr().out) == told


def test_bad_tables_are_one_line_and_status_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = table(tmp_path / "drive.csv")
    assert main(["identify", str(drive)]) == 2
    assert "needs --columns" in capsys.readouterr().err
    bad = mapping(tmp_path / "bad.yaml", "yawrate: w\n")
    bag = tmp_path / "bag"
    assert main(["import", str(drive), "--columns", str(bad), "--output", str(bag)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "'yawrate' is not an entry; did you mean yaw_rate?" in line
    assert not bag.exists()


@pytest.mark.parametrize(
    ("right", "wrong", "told"),
    [
        ("ms", "us", r"has \d+ poses in 0\.021 s: .*; or is the unit of time wrong\?"),
        ("ms", "s", r"a pose every 20 s: is the unit of time wrong\?"),
    ],
)
def test_a_wrong_unit_of_time_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], right: str, wrong: str, told: str
) -> None:
    def from_zero(rows: list[str]) -> None:
        rows[:] = [
            f"{float(stamp) - 1.7e12:.1f},{rest}"
            for stamp, _, rest in (row.partition(",") for row in rows)
        ]

    drive, columns = table(tmp_path / "drive.csv", from_zero), mapping(tmp_path / "mapping.yaml")
    columns.write_text(columns.read_text().replace(f"unit: {right}", f"unit: {wrong}"))
    bag = tmp_path / "bag"
    main(["import", str(drive), "--columns", str(columns), "--output", str(bag)])
    assert re.search(told, capsys.readouterr().err)


@pytest.mark.slow
def test_the_lines_of_the_page_identify_a_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = Path(__file__).parents[3] / "docs/how-to-recordings.md"
    (code,) = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    (text,) = re.findall(r"```yaml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "mapping.yaml").write_text(text)
    assert load_columns(tmp_path / "mapping.yaml").steering_map == "estimate"
    text = table(tmp_path / "drive.csv").read_text()
    (tmp_path / "drive.csv").write_text(
        text.replace("x,y,yaw,command,speed", "px,py,heading,command,set-point", 1)
    )
    (tmp_path / "car.yaml").write_text((PACKAGED / "tricycle.yaml").read_text())
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(TRUTH)
    for line, true in zip(lines, TRUTH.values(), strict=True):
        low, high = (float(number) for number in re.findall(r" ([\d.]+)", line)[:2])
        assert low <= true <= high


@pytest.mark.slow
def test_windows_with_set_points_of_the_speed_hold_what_is_true(tmp_path: Path) -> None:
    steering = f"speed_command: speed\nsteering_map: {{gain: {GAIN}, offset: {OFFSET}}}\n"
    columns = load_columns(mapping(tmp_path / "mapping.yaml", steering))
    drives = read_windows(table(tmp_path / "drive.csv"), VEHICLE, columns, Windows(length=4.0))
    found = identify(drives, VEHICLE)
    rolling = "rolling_coefficient_1"  # a loop that has not settled lacks the torque against it
    for name, true in {**TRUTH, rolling: VEHICLE.values[rolling]}.items():
        assert found.parameters[name].low <= true <= found.parameters[name].high


def logged(
    path: Path, motion: Trajectory, commands: Commands, position: float, yaw_rate: float
) -> None:
    """Write what a logger at 50 Hz sees of a drive, with these noises, and its set-points."""
    rng, every = np.random.default_rng(3), slice(None, -1, 2)
    held = np.searchsorted(commands.time, motion.time[every] + 1e-9, side="right") - 1
    columns = {
        "t": motion.time[every],
        "wanted": commands.steering_motor_angle[held],
        "speed": commands.speed[held],
    }
    for name, values, noise in (
        ("x", motion.x, position),
        ("y", motion.y, position),
        ("yaw", motion.yaw, 0.2 * position),
        ("rate", motion.yaw_rate, yaw_rate),
        ("angle", motion.steering_motor_angle, 2.0 * yaw_rate),
    ):
        columns[name] = values[0, every] + noise * rng.standard_normal(len(held))
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, fmt="%.9f", delimiter=",", header=",".join(columns), comments="")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("position", "yaw_rate", "duration"), [(0.0, 0.0, 24.0), (0.002, 0.001, 30.0)]
)
def test_parameters_of_a_vehicle_unlike_the_file_are_found_from_a_table(
    tmp_path: Path, position: float, yaw_rate: float, duration: float
) -> None:
    """Its speed is not that of the file's vehicle under the same set-points, nor is its start."""
    time = np.arange(0.0, duration, 0.01)
    angle = 0.3 * np.sin(0.35 * time) + 0.25 * np.sin(0.9 * time + 1.0)
    commands = Commands(time, angle * np.minimum(1.0, time / 3.0), np.minimum(0.9, time))
    truth = VEHICLE.nominal | {
        "cornering_stiffness": 1400.0,
        "camber_stiffness": 40.0,
        "yaw_inertia": 32.0,
        "rolling_coefficient_1": 0.0125,
    }
    motion = simulate(VEHICLE, commands, np.array([list(truth.values())]))
    path = tmp_path / "drive.csv"
    logged(path, motion, commands, position, yaw_rate)
    mapping = Columns(time="t", x="x", y="y", yaw="yaw", yaw_rate="rate", steering_angle="angle")
    found = identify(read_windows(path, VEHICLE, mapping), VEHICLE).parameters
    for name in ("cornering_stiffness", "camber_stiffness", "yaw_inertia"):
        low, high = VEHICLE.unknown[name]
        assert found[name].estimate == pytest.approx(truth[name], abs=0.12 * (high - low)), name
        assert found[name].low - 0.01 * (high - low) < truth[name], name
        assert truth[name] < found[name].high + 0.01 * (high - low), name
    assert not found["rolling_coefficient_1"].identifiable  # the speed is an input


@pytest.mark.slow
def test_a_speed_loop_that_is_not_the_one_of_the_file_is_estimated_beside(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It hears 0.1 s late, and tyres are 2 % larger than it knows; both make parameters wrong."""
    time = np.arange(0.0, 40.0, 0.01)
    angle = 0.3 * np.sin(0.35 * time) + 0.25 * np.sin(0.9 * time + 1.0)
    speed = np.minimum(0.9 + 0.2 * np.sin(0.3 * time), time)
    commands = Commands(time, angle * np.minimum(1.0, time / 3.0), speed)
    heard = dataclasses.replace(commands, speed=np.interp(time - 0.1, time, speed))
    radius = 1.02 * VEHICLE.values["tyre_radius"]
    other = VEHICLE.replace(speed_scale=1.02, tyre_radius=radius)
    truth = VEHICLE.nominal | {"cornering_stiffness": 1400.0, "yaw_inertia": 32.0}
    motion = simulate(other, heard, np.array([list(truth.values())]))
    logged(tmp_path / "drive.csv", motion, commands, 0.005, 0.001)
    columns = tmp_path / "mapping.yaml"
    columns.write_text(
        "time: t\nx: x\ny: y\nyaw: yaw\nyaw_rate: rate\nsteering: wanted\nspeed_command: speed\n"
    )
    ask = ["identify", str(tmp_path / "drive.csv"), "--columns", str(columns), "--json"]

    def found(*effects: str) -> dict[str, bool]:
        """Whether each parameter is shown and its interval holds the truth."""
        assert main([*ask, *effects]) == 0
        parameters = json.loads(capsys.readouterr().out)["parameters"]
        spare = {n: 0.01 * (high - low) for n, (low, high) in VEHICLE.unknown.items()}
        return {
            n: parameters[n]["identifiable"]
            and parameters[n]["low"] - spare[n] < truth[n] < parameters[n]["high"] + spare[n]
            for n in TRUTH
        }

    assert found() == dict.fromkeys(TRUTH, True)
    assert found("--effects", "none") == dict.fromkeys(TRUTH, False)


@pytest.mark.slow
@pytest.mark.parametrize("early", [0.08, -0.06])
def test_steering_that_was_logged_early_or_late_is_estimated_beside(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], early: float
) -> None:
    time = np.arange(0.0, 40.0, 0.01)
    angle = 0.3 * np.sin(0.35 * time) + 0.25 * np.sin(0.9 * time + 1.0) + 0.1 * np.sin(2.2 * time)
    commands = Commands(time, angle * np.minimum(1.0, time / 3.0), np.minimum(0.9, time))
    later = np.interp(time - early, time, commands.steering_motor_angle)
    heard = dataclasses.replace(commands, steering_motor_angle=later)
    truth = VEHICLE.nominal | {"cornering_stiffness": 1100.0, "yaw_inertia": 42.0}
    motion = simulate(VEHICLE, heard, np.array([list(truth.values())]))
    logged(tmp_path / "drive.csv", motion, commands, 0.001, 0.001)
    columns = tmp_path / "mapping.yaml"
    columns.write_text("time: t\nx: x\ny: y\nyaw: yaw\nyaw_rate: rate\nsteering: wanted\n")
    assert main(["identify", str(tmp_path / "drive.csv"), "--columns", str(columns), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    for name in (*TRUTH, "yaw_inertia"):
        assert found["parameters"][name]["low"] < truth[name] < found["parameters"][name]["high"]
    (delay,) = (e for e in found["effects"] if e["name"] == "servo dead time")
    assert abs(delay["estimate"] - early) < 3.0 * delay["standard_deviation"]
    assert abs(delay["estimate"]) > 0.04


def test_a_table_with_hardly_any_steering_angles_is_refused(tmp_path: Path) -> None:
    rows = [f"{0.02 * i:.2f},{0.02 * i:.3f},0,0,{'0.1' if i < 5 else ''}" for i in range(300)]
    path = tmp_path / "drive.csv"
    path.write_text("\n".join(["t,x,y,yaw,angle", *rows]) + "\n")
    mapping = Columns(time="t", x="x", y="y", yaw="yaw", steering_angle="angle")
    with pytest.raises(IdentificationError, match="5 steering angles: at least 10"):
        read_windows(path, VEHICLE, mapping)


def test_a_speed_that_no_set_point_gives_is_not_followed() -> None:
    rng, time = np.random.default_rng(0), np.arange(0.0, 9.0, 0.02)
    x = np.cumsum(np.clip(1.5 * (time - 2.0), 0.0, 6.5)) * 0.02
    x, y, yaw = (v + 1e-4 * rng.standard_normal(len(time)) for v in (x, 0.0, 0.0))
    recording = Recording("fast.csv", 0.0, time, x, y, yaw, Samples(time, 0.0 * time), {})
    with pytest.raises(IdentificationError, match=r"drives faster than 4\.8 m/s, at 5\.[12]\d s"):
        recorded_commands(recording, VEHICLE, SteeringMap(), 1.0)


@pytest.mark.slow
def test_commands_begin_at_the_tick_of_a_start_that_round_off_took_beyond_it(
    tmp_path: Path,
) -> None:
    columns = load_columns(mapping(tmp_path / "m.yaml", "speed_command: speed\n"))
    recording = read_recording(table(tmp_path / "drive.csv"), columns, VEHICLE)
    tick = float(motion_of(recording).time[170])
    for start in (tick, np.nextafter(tick, np.inf), np.nextafter(tick, 0.0)):
        commands, _ = recorded_commands(recording, VEHICLE, SteeringMap(), start)
        assert commands.speed[0] == recording.more["speed_command"].at(np.array([tick]), held=True)
        assert len(commands.time) == len(motion_of(recording).time) - 170
