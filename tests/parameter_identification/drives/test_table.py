"""Tables of other systems: mapping, units, clocks, wraps, missing and repeated samples."""

import dataclasses
import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from parameter_identification.drives.samples import Samples
from parameter_identification.drives.table import (
    Column,
    Columns,
    SensorPlace,
    SteeringMap,
    load_columns,
    read_recording,
)
from tricycle_core.errors import IdentificationError
from tricycle_sim.vehicle import load_vehicle

HEADER = "t,px,py,psi,cmd,ts,w"
PLAIN = Columns(time="t", x="px", y="py", yaw="psi", steering="cmd")


def write(path: Path, *rows: str, header: str = HEADER) -> Path:
    text = "\n".join([header, *rows]) + "\n"
    if path.suffix == ".gz":
        path.write_bytes(gzip.compress(text.encode()))
    else:
        path.write_text(text)
    return path


@pytest.mark.parametrize("name", ["drive.csv", "drive.csv.gz"])
def test_units_become_si_and_headings_continuous(name: str, tmp_path: Path) -> None:
    path = write(tmp_path / name, "1000,100,0,179,10,,", "1010,110,50,-179,20,,")
    columns = Columns(
        time=Column("t", unit="ms"),
        x=Column("px", unit="cm"),
        y=Column("py", unit="mm"),
        yaw=Column("psi", unit="deg"),
        steering=Column("cmd", unit="deg"),
    )
    found = read_recording(path, columns)
    assert found.start == pytest.approx(1.0)
    np.testing.assert_allclose(found.time, [0.0, 0.01])
    np.testing.assert_allclose(found.poses, [[1.0, 0.0, 3.12414], [1.1, 0.05, 3.15905]], atol=1e-5)
    np.testing.assert_allclose(found.steering.values, np.radians([10.0, 20.0]))


def test_wheel_speeds_in_m_s_become_rad_s_by_the_tyres_of_the_vehicle(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "0,0,0,0,0,3.6,1", "0.1,0,0,0,0,7.2,2")
    vehicle = load_vehicle(None).replace(tyre_radius=0.25, **{"rear.tyre_radius": 0.2})
    left = {"left": Column("w", unit="m/s")}
    columns = dataclasses.replace(PLAIN, wheel_speed=Column("ts", "km/h"), wheel_speeds=left)
    found = read_recording(path, columns, vehicle)
    np.testing.assert_allclose(found.more["wheel_speed"].values, [5.0, 10.0])
    np.testing.assert_allclose(found.more["wheel_speeds.left"].values, [4.0, 8.0])
    with pytest.raises(IdentificationError, match=r"a\.csv: wheel_speed: km/h needs a vehicle"):
        read_recording(path, columns)
    wrong = dataclasses.replace(PLAIN, wheel_speeds={"lefft": Column("w", unit="m/s")})
    with pytest.raises(IdentificationError, match=r"'lefft' is not an entry; did you mean left\?"):
        read_recording(path, wrong, vehicle)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a.csv: is empty: a header and rows of numbers are needed"),
        ("t,px,py,psy,cmd\n", "a.csv: column 'psi' is missing; did you mean psy?"),
        ("t,px,py,psi,cmd,t\n", "a.csv: column 't' comes twice"),
        ("t,px,py,psi,cmd\n0,inf,0,0,0\n", "a.csv: row 1: px: needs a number, not 'inf'"),
        ("t,px,py,psi,cmd\n0,1_0,0,0,0\n", "a.csv: row 1: px: needs a number, not '1_0'"),
        (
            "t,px,py,psi,cmd\n0,0,0,0,0\n1,1e300,0,0,0\n",
            "a.csv: row 2: px: 1e+300 m cannot be measured (more than 1e+08 in SI units): mend the "
            "table, or leave the cell empty",
        ),
        (
            "t,px,py,psi,cmd\n0,0,0,0,-1e300\n1,1,0,0,0\n",
            "a.csv: row 1: cmd: -1e+300 rad cannot be measured (more than 1e+08 in SI units): mend "
            "the table, or leave the cell empty",
        ),
        (
            "t;px;py;psi;cmd\n0;0,1;0;0;0\n",
            "a.csv: row 1: px: needs a number, with a point for its decimals, not '0,1'",
        ),
    ],
)
def test_a_wrong_table_is_told_with_what_would_be_right(
    tmp_path: Path, text: str, message: str
) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(IdentificationError) as caught:
        read_recording(tmp_path / "a.csv", PLAIN)
    assert str(caught.value) == f"{tmp_path}/{message}"


@pytest.mark.parametrize(
    "part", ["steering_map: {gain: .nan}", "steering_map: {offset: .inf}", "sensor: {x: .nan}"]
)
def test_numbers_of_a_mapping_are_finite(tmp_path: Path, part: str) -> None:
    file = tmp_path / "m.yaml"
    file.write_text(f"time: t\nx: px\ny: py\nyaw: psi\nsteering: cmd\n{part}\n")
    with pytest.raises(IdentificationError, match=r"m\.yaml: (steering_map|sensor): .* finite"):
        load_columns(file)


def test_missing_and_repeated_samples_are_left_out(tmp_path: Path) -> None:
    rows = ("0,0,0,0,1,,", "0.1,,0,0,2,,", "0.1,9,9,9,9,,", "0.2,2,0,0,nan,,", ",3,0,0,3,,")
    found = read_recording(write(tmp_path / "a.csv", *rows), PLAIN)
    np.testing.assert_array_equal(found.time, [0.0, 0.2])
    np.testing.assert_array_equal(found.steering.time, [0.0, 0.1])


def test_samples_of_a_second_clock_count_once_and_are_shifted(tmp_path: Path) -> None:
    rows = [
        f"{100 + 0.01 * i:.2f},{i},0,0,0,{7 + 0.1 * (i // 10):.1f},{i // 10}" for i in range(50)
    ]
    columns = Columns(
        time="t", x="px", y="py", steering="cmd", yaw_rate=Column("w", unit="deg/s", clock="ts")
    )
    rate = read_recording(write(tmp_path / "a.csv", *rows), columns).more["yaw_rate"]
    np.testing.assert_allclose(rate.time, [0.0, 0.1, 0.2, 0.3, 0.4], atol=1e-9)
    np.testing.assert_allclose(rate.values, np.radians(np.arange(5.0)))
    rows[0] = "100.00,0,0,0,0,0,9"  # the clock jumped after its first sample
    rate = read_recording(write(tmp_path / "b.csv", *rows), columns).more["yaw_rate"]
    np.testing.assert_allclose(rate.time, [0.0, 0.1, 0.2, 0.3, 0.4], atol=0.011)


def of_a_second_clock(path: Path, pace: float, jump: float = 0.0) -> Samples:
    """Samples whose values are their true times, of a clock with a pace, set after 25 s."""
    time = np.arange(0.0, 60.0, 0.01)
    late = np.where(time % 2.0 < 0.4, 0.1, 0.0)  # a fifth of them
    newest = np.maximum.accumulate(0.04 * np.floor(np.maximum(time - late, 0.0) / 0.04 + 1e-6))
    clock = 1e4 + pace * newest + jump * (newest > 25.0)
    rows = [
        f"{t:.2f},{i},0,0,0,{c:.6f},{s:.2f}"
        for i, (t, c, s) in enumerate(zip(time, clock, newest, strict=True))
    ]
    columns = Columns(time="t", x="px", y="py", steering="cmd", yaw_rate=Column("w", clock="ts"))
    return read_recording(write(path, *rows), columns).more["yaw_rate"]


@pytest.mark.parametrize("pace", [0.995, 1.0, 1.002])
def test_a_second_clock_may_have_another_pace(tmp_path: Path, pace: float) -> None:
    found = of_a_second_clock(tmp_path / "a.csv", pace)
    np.testing.assert_allclose(found.time, found.values, atol=0.01)


def test_a_second_clock_that_was_set_is_refused(tmp_path: Path) -> None:
    with pytest.raises(IdentificationError, match=r"a.csv: ts: does not run evenly .* Cut the"):
        of_a_second_clock(tmp_path / "a.csv", 1.0, jump=0.5)


def test_a_clock_in_another_unit_or_of_a_pose_is_refused(tmp_path: Path) -> None:
    rows = [f"{0.01 * i:.2f},{i},0,0,0,{10 * i},{i}" for i in range(500)]  # ts in ms
    path = write(tmp_path / "a.csv", *rows)
    gyro = Columns(time="t", x="px", y="py", steering="cmd", yaw_rate=Column("w", clock="ts"))
    with pytest.raises(IdentificationError, match=r"a.csv: ts: \d+% of its times are outside"):
        read_recording(path, gyro)
    rows = [f"{10 * i},{i},0,0,0,{0.01 * i:.2f},{i}" for i in range(500)]  # t in ms
    gyro = dataclasses.replace(gyro, time=Column("t", unit="us"))
    with pytest.raises(IdentificationError, match=r"or the unit of `time` is wrong$"):
        read_recording(write(tmp_path / "b.csv", *rows), gyro)
    pose = Columns(time="t", x=Column("px", clock="ts"), y="py", steering="cmd")
    with pytest.raises(IdentificationError, match="x: takes no clock"):
        read_recording(path, pose)


def test_a_clock_that_goes_back_is_told_with_its_row_of_the_file(tmp_path: Path) -> None:
    rows = [f"{0.01 * i:.2f},{i},0,0,0,{0.01 * i:.2f},{i}" for i in range(60)]
    rows[:20] = [",0,0,0,0,,"] * 20
    rows[30:35] = [rows[29]] * 5
    rows[40] = "0.40,40,0,0,0,0.10,40"
    gyro = Columns(time="t", x="px", y="py", steering="cmd", yaw_rate=Column("w", clock="ts"))
    with pytest.raises(IdentificationError, match=r"a.csv: ts: goes back by 0.29 s at row 41;"):
        read_recording(write(tmp_path / "a.csv", *rows), gyro)


def test_the_pose_is_moved_from_the_sensor_to_the_com(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "0,1,0,1.6707963,0,,", "1,1,1,1.6707963,0,,")
    columns = Columns(
        time="t", x="px", y="py", yaw="psi", steering="cmd", sensor=SensorPlace(0.5, 0.2, 0.1)
    )
    np.testing.assert_allclose(
        read_recording(path, columns).poses[0], [1.2, -0.5, math.pi / 2], atol=1e-6
    )


def test_a_steering_map_bends_to_either_side_of_its_own() -> None:
    steering = SteeringMap(gain=0.5, limit=0.4, gain_right=0.6, offset=0.01)
    expected = [0.4 * math.tanh(-1.5) + 0.01, 0.01, 0.4 * math.tanh(1.25) + 0.01]
    np.testing.assert_allclose(steering.angle(np.array([-1.0, 0.0, 1.0])), expected)
    np.testing.assert_allclose(SteeringMap(gain=-2.0).angle(np.array([-1.0, 1.0])), [2.0, -2.0])


BAD_TABLES = {
    "text": (("0,0,0,0,0,,", "1,abc,0,0,0,,"), r"row 2: px: needs a number, not 'abc'"),
    "cells": (("0,0,0",), r"row 1: has 3 cells, the header 7; it is the last one"),
    "back": (("1,0,0,0,0,,", "0,0,0,0,0,,"), r"t: goes back by 1 s at row 2"),
    "empty": ((), r"has a header and no rows"),
    "one": (("0,0,0,0,0,,",), r"needs two different times"),
    "untimed": (("0,0,0,0,0,,", *2 * [",0,0,0,0,,"]), r"t: is empty in 2 of 3 rows .*row 2"),
    "no poses": (("0,,0,0,0,,", "1,,0,0,0,,"), r"no two rows have x, y, yaw"),
    "no steering": (("0,0,0,0,,,", "1,0,0,0,,,"), r"cmd: holds no number"),
}


@pytest.mark.parametrize("what", BAD_TABLES)
def test_a_bad_table_is_told_with_its_place(what: str, tmp_path: Path) -> None:
    rows, message = BAD_TABLES[what]
    with pytest.raises(IdentificationError, match=message):
        read_recording(write(tmp_path / "a.csv", *rows), PLAIN)


def test_a_missing_column_and_a_file_that_is_not_packed_are_told(tmp_path: Path) -> None:
    with pytest.raises(IdentificationError, match=r"column 'cmd' is missing; there are"):
        read_recording(write(tmp_path / "a.csv", header="t,x"), PLAIN)
    (tmp_path / "b.csv.gz").write_text("no")
    with pytest.raises(IdentificationError, match="is not a gzip file"):
        read_recording(tmp_path / "b.csv.gz", PLAIN)
    (tmp_path / "b.csv.gz").write_bytes(gzip.compress(HEADER.encode())[:-9])
    with pytest.raises(IdentificationError, match=r"b\.csv\.gz: is cut off"):
        read_recording(tmp_path / "b.csv.gz", PLAIN)
    with pytest.raises(IdentificationError, match="sensor: needs the column yaw"):
        read_recording(
            write(tmp_path / "c.csv", "0,0,0,0,0,,", "1,1,0,0,0,,"),
            Columns(time="t", x="px", y="py", steering="cmd", sensor=SensorPlace(x=1.0)),
        )


NEEDED = "time: t\nx: px\ny: py\n"
BAD_MAPPINGS = {
    "- a": r"needs entries such as",
    "time: t\nx: px\ny: py": r"needs `steering`, the set-points, or `steering_angle`",
    NEEDED + "steering: c\nsteering_angle: a": r"needs `steering`, the set-points, or",
    NEEDED + "steering: c\nyawrate: w": r"'yawrate' is not an entry; did you mean yaw_rate",
    NEEDED + "steering: {column: c, unit: grad}": r"steering: unit 'grad' is not known; use one of",
    NEEDED + "steering: {column: c, units: rad}": r"steering: 'units' is not an entry",
    NEEDED + "steering: c\nsteering_angle: a": r"the measured angle; not both",
    NEEDED + "steering: c\nsteering_map: guess": r"steering_map: needs `estimate`",
    NEEDED + "steering: c\nsteering_map: {gain: 0}": r"a gain other than 0",
    NEEDED + "steering: c\nsensor: {z: 1}": r"sensor: 'z' is not an entry",
    NEEDED + "steering: [c]": r"steering: needs a text or entries by name, not a list",
    NEEDED + "steering: c\nwheel_speeds: {left: {column: l, unit: m}}": (
        r"wheel_speeds.left: unit 'm' is not known; use one of rad/s"
    ),
    NEEDED + "steering: c\nwheel_speeds: {left: {colum: l}}": r"wheel_speeds.left: 'colum' is no",
    NEEDED
    + "steering: c\nwheel_speeds: 3": r"wheel_speeds: needs entries by name, not a whole number",
}


@pytest.mark.parametrize("text", BAD_MAPPINGS)
def test_a_bad_mapping_is_told_with_its_entry(text: str, tmp_path: Path) -> None:
    path = tmp_path / "mapping.yaml"
    path.write_text(text)
    with pytest.raises(IdentificationError, match=BAD_MAPPINGS[text]) as caught:
        load_columns(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_mapping_is_read(tmp_path: Path) -> None:
    path = tmp_path / "mapping.yaml"
    path.write_text(
        NEEDED
        + "yaw: {column: psi, unit: deg}\nsteering: {column: cmd, unit: '1', clock: ts}\n"
        + "steering_map: {gain: 0.5, limit: 0.4}\nsensor: {x: 0.1}\n"
    )
    assert load_columns(path) == Columns(
        time="t",
        x="px",
        y="py",
        yaw=Column("psi", unit="deg"),
        steering=Column("cmd", unit="1", clock="ts"),
        steering_map=SteeringMap(gain=0.5, limit=0.4),
        sensor=SensorPlace(x=0.1),
    )
