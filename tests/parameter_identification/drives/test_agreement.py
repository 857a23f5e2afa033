"""Columns of another quantity, unit or sign are told by the poses, in slow and steady turns too."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from parameter_identification.drives.table import Columns, SteeringMap, read_recording
from parameter_identification.drives.windows import select_windows
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray
from tricycle_sim.vehicle import load_vehicle

VEHICLE = load_vehicle()
RADIUS, SPEED, STEERING = 3.0, 0.8, 0.43
COLUMNS = Columns(
    **{name: name for name in ("time", "x", "y", "yaw", "steering", "yaw_rate")},
    wheel_speed="wheel_speed",
    acceleration_y="acceleration_y",
    wheel_speeds={"right": "right"},
)
Edit = Callable[[dict[str, FloatArray]], dict[str, FloatArray]]


def circle(edit: Edit, path: Path) -> Path:
    """Ten seconds of a steady circle to the left, begun at a heading of 2 rad; no vehicle model."""
    time = np.arange(0.0, 10.0, 0.02)
    yaw = 2.0 + SPEED / RADIUS * time
    rng = np.random.default_rng(1)
    noise = {name: 0.002 * rng.standard_normal(len(time)) for name in "xy"}
    table = {
        "time": time,
        "x": RADIUS * np.sin(yaw) + noise["x"],
        "y": -RADIUS * np.cos(yaw) + noise["y"],
        "yaw": yaw,
        "steering": np.full(len(time), STEERING),
        "yaw_rate": np.full(len(time), SPEED / RADIUS + 0.01),
        "wheel_speed": np.full(len(time), SPEED / VEHICLE.driven_radius),
        "acceleration_y": np.full(len(time), SPEED**2 / RADIUS),
        "right": np.full(len(time), 1.2 * SPEED / VEHICLE.driven_radius),
    }
    table = edit(table)
    rows = (",".join(map(repr, map(float, row))) for row in zip(*table.values(), strict=True))
    path.write_text("\n".join([",".join(table), *rows]) + "\n")
    return path


def scaled(name: str, factor: float) -> Edit:
    return lambda table: table | {name: factor * table[name]}


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda t: t | {"x": t["y"], "y": t["x"]}, "not move the way that yaw points: are x and y"),
        (scaled("yaw", 57.3), "does not move the way that yaw points"),
        (scaled("yaw", -1.0), "does not move the way that yaw points"),
        (lambda t: t | {"x": 100 * t["x"], "y": 100 * t["y"]}, "the poses move at 8.* m/s: mend"),
        (lambda t: t | {"time": t["time"] * 1e6}, "lasts 9.98e.06 s, of which 2e.04 s are between"),
        (scaled("yaw_rate", 57.3), "yaw_rate is 59 times what the poses give"),
        (scaled("yaw_rate", -1.0), "yaw_rate has the opposite sign of what the poses give"),
        (scaled("wheel_speed", VEHICLE.driven_radius), "wheel_speed is 0.33 times what the poses"),
        (scaled("right", VEHICLE.driven_radius), "wheel_speeds.right is 0.4 times what the poses"),
        (scaled("yaw_rate", 0.0), "yaw_rate is 0 times what the poses give"),
        (scaled("right", 0.0), "wheel_speeds.right is 0 times what the poses give"),
        (scaled("steering", 0.0), "steering is 0 times what the turns of the poses need"),
        (scaled("steering", 57.3), "steering is .* times what the turns of the poses need"),
        (scaled("steering", -1.0), "steering has the opposite sign of what the turns"),
    ],
)
def test_a_column_that_contradicts_the_poses_is_named(
    tmp_path: Path, edit: Edit, message: str
) -> None:
    recording = read_recording(circle(edit, tmp_path / "drive.csv"), COLUMNS)
    assert not isinstance(COLUMNS.steering_map, str)
    with pytest.raises(IdentificationError, match=f"drive.csv: .*{message}"):
        select_windows(recording, VEHICLE, COLUMNS.steering_map)


@pytest.mark.parametrize(
    "edit",
    [
        lambda table: table,
        scaled("steering", 0.6),  # a vehicle that understeers, or a map that is a guess
        lambda table: table | {"yaw": table["yaw"] + 0.3},  # a sensor mounted askew, or sideslip
    ],
)
def test_what_a_real_vehicle_may_do_is_let_through(tmp_path: Path, edit: Edit) -> None:
    recording = read_recording(circle(edit, tmp_path / "drive.csv"), COLUMNS)
    assert not isinstance(COLUMNS.steering_map, str)
    assert select_windows(recording, VEHICLE, COLUMNS.steering_map).drives


def test_a_vehicle_that_drives_backward_contradicts_nothing(tmp_path: Path) -> None:
    def backward(table: dict[str, FloatArray]) -> dict[str, FloatArray]:
        names = ("wheel_speed", "right", "steering")
        return table | {"yaw": table["yaw"] + np.pi} | {name: -table[name] for name in names}

    recording = read_recording(circle(backward, tmp_path / "drive.csv"), COLUMNS)
    assert not isinstance(COLUMNS.steering_map, str)
    with pytest.raises(IdentificationError, match="no window"):  # those are driven forward
        select_windows(recording, VEHICLE, COLUMNS.steering_map)


def test_what_is_0_without_a_reason_to_be_else_is_let_through(tmp_path: Path) -> None:
    def ahead(table: dict[str, FloatArray]) -> dict[str, FloatArray]:
        still = dict.fromkeys(("y", "yaw", "steering", "yaw_rate", "acceleration_y"), 0.0)
        return (
            table
            | {"x": SPEED * table["time"]}
            | {n: v + 0.0 * table["x"] for n, v in still.items()}
        )

    recording = read_recording(circle(ahead, tmp_path / "drive.csv"), COLUMNS)
    assert not isinstance(COLUMNS.steering_map, str)
    assert select_windows(recording, VEHICLE, COLUMNS.steering_map).drives


def winding(place: float, course: bool, path: Path) -> Path:
    """Twenty seconds of turns to both sides, of a point so far in front of the rear axle.

    The heading is that of the body, or of the motion of that point.
    """
    time = np.arange(0.0, 20.0, 0.001)
    curvature = 0.35 * np.sin(0.8 * time)
    yaw = 2.0 + 0.001 * SPEED * np.cumsum(curvature)
    x, y = (0.001 * SPEED * np.cumsum(f(yaw)) + place * f(yaw) for f in (np.cos, np.sin))
    if course:
        yaw = np.unwrap(np.arctan2(np.gradient(y), np.gradient(x)))
    rng = np.random.default_rng(1)
    x, y = (v + 0.01 * rng.standard_normal(len(v)) for v in (x, y))
    steering = np.arctan(VEHICLE.wheelbase * curvature)
    rows = (",".join(map(repr, map(float, row))) for row in np.c_[time, x, y, yaw, steering][::20])
    path.write_text("\n".join(["time,x,y,yaw,steering", *rows]) + "\n")
    return path


@pytest.mark.parametrize(
    ("place", "course", "message"),
    [
        (VEHICLE.com_to_rear_axle, False, ""),
        (VEHICLE.com_to_rear_axle + 0.2, False, ""),
        (0.0, False, r"turn about a point -?0.\d+ m behind .* of a point -0.7\d* m farther ahead"),
        (VEHICLE.wheelbase, False, r"of a point \+0.7\d* m farther ahead"),
        (VEHICLE.com_to_rear_axle, True, "is yaw the direction of the motion"),
    ],
)
def test_poses_of_another_point_are_told(
    tmp_path: Path, place: float, course: bool, message: str
) -> None:
    columns = Columns(**{name: name for name in ("time", "x", "y", "yaw", "steering")})
    recording = read_recording(winding(place, course, tmp_path / "drive.csv"), columns)
    if not message:
        assert select_windows(recording, VEHICLE, SteeringMap()).drives
        return
    with pytest.raises(IdentificationError, match=f"drive.csv: the poses .*{message}"):
        select_windows(recording, VEHICLE, SteeringMap())
