"""Commands read back as written; bad ones get one line naming row and column."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tricycle_bridge.protocol.limits import MAX_SPEED, MAX_STEERING_ANGLE
from tricycle_core.errors import CommandsError
from tricycle_sim.commands import Commands, load_commands

HEADER = "time,steering_motor_angle,speed\n"


@given(
    steps=st.lists(st.floats(0.01, 10.0), min_size=1, max_size=20),
    angle=st.floats(-MAX_STEERING_ANGLE, MAX_STEERING_ANGLE),
    speed=st.floats(-MAX_SPEED, MAX_SPEED),
)
def test_a_saved_file_reads_back_exactly(tmp_path_factory, steps, angle, speed):
    time = np.cumsum([0.0, *steps])
    commands = Commands(time, np.full(time.shape, angle), np.full(time.shape, speed))
    path = tmp_path_factory.mktemp("commands") / "c.csv"
    commands.save(path)
    read = load_commands(path)
    for name in ("time", "steering_motor_angle", "speed"):
        assert np.array_equal(getattr(read, name), getattr(commands, name))
    assert read.duration == time[-1]


def test_columns_may_come_in_any_order_and_with_spaces(tmp_path):
    path = tmp_path / "c.csv"
    path.write_text("speed, time, steering_motor_angle\n0, 0, 0.1\n1, 2, 0\n\n", encoding="utf-8")
    commands = load_commands(path)
    assert commands.speed.tolist() == [0.0, 1.0]
    assert commands.steering_motor_angle.tolist() == [0.1, 0.0]


@pytest.mark.parametrize("separator", [";", "\t"])
@pytest.mark.parametrize("before", ["", "\n", " \n\n"])
def test_columns_may_be_separated_as_spreadsheets_do(tmp_path, separator, before):
    path, rows = tmp_path / "c.csv", "time,steering_motor_angle,speed\n0,0,1\n2,0.1,0\n"
    path.write_text(before + rows.replace(",", separator))
    commands = load_commands(path)
    assert commands.time.tolist() == [0.0, 2.0]
    assert commands.steering_motor_angle.tolist() == [0.0, 0.1]
    assert commands.speed.tolist() == [1.0, 0.0]


def test_commands_keep_no_door_to_their_arrays_open():
    time = np.array([0.0, 1.0])
    commands = Commands(time, np.zeros(2), np.zeros(2))
    time[1] = -1.0
    assert commands.duration == 1.0
    with pytest.raises(ValueError, match="read-only"):
        commands.speed[0] = 1.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("\n\n", "is empty"),
        ("a,b,c\n0,0,0\n", "header: needs the columns time, steering_motor_angle, speed"),
        ("time,speed\n0,0\n", "header: needs the columns"),
        ("0,0,0\n1,0,0\n", "header: needs the columns"),
        (HEADER, "at least two rows"),
        (HEADER + "0,0,0\n", "at least two rows"),
        (HEADER + "0,0,0\n1,0\n", "row 2: has 2 columns instead of 3"),
        (HEADER + "0,0,0\n1,fast,0\n", "row 2: steering_motor_angle: needs a number, not 'fast'"),
        ("time;steering_motor_angle;speed\n0;0,1;0\n", "number, with a point for its decimals"),
        (HEADER + "0,0,0\n1,0,\n", "row 2: speed: needs a number, not ''"),
        (HEADER + "0,0,0\n1,nan,0\n", "row 2: steering_motor_angle: is nan"),
        (HEADER + "0,0,inf\n1,0,0\n", "row 1: speed: is inf"),
        (HEADER + "0.5,0,0\n1,0,0\n", "row 1: time: starts at 0.5 s instead of 0"),
        (HEADER + "0,0,0\n1,0,0\n0.5,0,0\n", "row 3: time: 0.5 s does not come after 1 s"),
        (HEADER + "0,0,0\n0,0,0\n", "row 2: time: 0 s does not come after 0 s"),
        (HEADER + "0,0,0\n1,0.79,0\n", "row 2: steering_motor_angle: 0.79 rad is beyond"),
        (HEADER + "0,0,0\n1,0,-4.9\n", "row 2: speed: -4.9 m/s is beyond the PLC's limit of 4.8"),
        (HEADER + "0,0,0\n0.005,0,0\n", "row 2: time: the drive ends after 0.005 s; needs 0.01 s"),
        (HEADER + "0,0,0\n1e9,0,0\n", "row 2: time: the drive ends after 1e+09 s"),
    ],
)
def test_bad_files_get_one_line_naming_row_and_column(tmp_path, text, message):
    path = tmp_path / "c.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CommandsError, match=r"^[^\n]*$") as error:
        load_commands(path)
    assert str(error.value).startswith(f"{path}: ")
    assert message in str(error.value)


def test_a_plan_is_no_table(tmp_path):
    path = tmp_path / "plan.json"
    path.write_text('{"schema": 3, "commands": {}}')
    with pytest.raises(CommandsError, match=r"is JSON, not a table .* driven by `tricycle drive`"):
        load_commands(path)


def test_a_binary_file_is_no_csv(tmp_path):
    path = tmp_path / "c.csv"
    path.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(CommandsError, match=r"is not a CSV file in UTF-8$"):
        load_commands(path)


def test_the_first_part_of_commands_ends_between_or_at_rows():
    commands = Commands([0.0, 0.1, 0.2, 0.3], [0.0, 0.1, 0.2, 0.3], [1.0, 2.0, 3.0, 4.0])
    part = commands.until(0.25)
    assert part.time.tolist() == [0.0, 0.1, 0.2, 0.25]
    assert part.steering_motor_angle.tolist() == [0.0, 0.1, 0.2, 0.2]  # as held until then
    assert part.speed.tolist() == [1.0, 2.0, 3.0, 3.0]
    assert commands.until(0.2).time.tolist() == [0.0, 0.1, 0.2]
    assert commands.until(9.0).duration == commands.duration
    with pytest.raises(CommandsError):
        commands.until(0.0)


def test_columns_of_different_length():
    with pytest.raises(CommandsError, match="speed: needs as many numbers"):
        Commands([0.0, 1.0], [0.0, 0.0], [0.0])
    assert math.isclose(Commands([0, 1], [0, 0], [0, 0]).duration, 1.0)
