"""A trajectory reads back from every format as it was."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from tricycle_sim.commands import Commands
from tricycle_sim.trajectory_files import plot_trajectory, save_trajectory
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate

VEHICLE = load_vehicle()
COMMANDS = Commands([0.0, 1.0, 2.0], [0.0, 0.1, 0.1], [1.0, 1.0, 1.0])
PARAMETERS = VEHICLE.nominal_point() * np.array([[0.9], [1.1]])
COLUMNS = [
    "time",
    "x",
    "y",
    "z",
    "roll",
    "pitch",
    "yaw",
    "vx",
    "vy",
    "vz",
    "roll_rate",
    "pitch_rate",
    "yaw_rate",
    "wheel_speed_left",
    "wheel_speed_right",
    "wheel_speed_rear",
    "steering_motor_angle",
    "load_left",
    "load_right",
    "load_rear",
]


def test_csv_has_the_columns_and_a_row_every_10_ms(tmp_path):
    trajectory = simulate(VEHICLE, COMMANDS)
    path = tmp_path / "new" / "t.csv"
    assert save_trajectory(trajectory, path, vehicle=VEHICLE) == 201
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows[0] == COLUMNS
    table = np.array(rows[1:], dtype=float)
    assert table[:, 0] == pytest.approx(np.arange(201) * 0.01)
    for index, name in enumerate(COLUMNS[1:], start=1):
        assert table[:, index] == pytest.approx(getattr(trajectory, name)[0], rel=1e-9), name


def test_parquet_has_a_sample_after_the_other(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    trajectory = simulate(VEHICLE, COMMANDS, PARAMETERS)
    path = tmp_path / "t.parquet"
    assert save_trajectory(trajectory, path, vehicle=VEHICLE, parameters=PARAMETERS) == 402
    table = parquet.read_table(path)
    assert table.column_names == [*COLUMNS, "sample", *VEHICLE.unknown]
    assert np.array_equal(table["x"].to_numpy(), trajectory.x.ravel())
    assert table["sample"].to_pylist() == [0.0] * 201 + [1.0] * 201
    assert table["yaw_inertia"].to_pylist()[-1] == PARAMETERS[1, 3]


def test_mcap_has_a_topic_for_each_sample(tmp_path):
    trajectory = simulate(VEHICLE, COMMANDS, PARAMETERS)
    path = tmp_path / "t.mcap"
    save_trajectory(trajectory, path, vehicle=VEHICLE, parameters=PARAMETERS)
    with path.open("rb") as file:
        found = [
            (channel.topic, message.log_time, json.loads(message.data))
            for _, channel, message in make_reader(file).iter_messages()
        ]
    assert len(found) == 402
    last = [state for topic, _, state in found if topic == "vehicle_state/1"][-1]
    assert last["x"] == trajectory.x[1, -1]
    assert last["load_rear"] == trajectory.load_rear[1, -1]
    assert found[-1][1] == 2_000_000_000


def test_other_suffixes_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"needs to end in one of \.csv, \.parquet, \.mcap"):
        save_trajectory(simulate(VEHICLE, COMMANDS), tmp_path / "t.xls", vehicle=VEHICLE)


def test_a_failure_leaves_nothing_behind(tmp_path, monkeypatch):
    def fill_the_disk(path, *_arguments, **_options):
        Path(path).write_text("half", encoding="utf-8")
        raise OSError("No space left on device")

    monkeypatch.setattr(np, "savetxt", fill_the_disk)
    with pytest.raises(OSError, match="No space left"):
        save_trajectory(simulate(VEHICLE, COMMANDS), tmp_path / "t.csv", vehicle=VEHICLE)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_picture_is_one(tmp_path):
    plot_trajectory(simulate(VEHICLE, COMMANDS, PARAMETERS), tmp_path / "t.png")
    assert (tmp_path / "t.png").read_bytes().startswith(b"\x89PNG")
