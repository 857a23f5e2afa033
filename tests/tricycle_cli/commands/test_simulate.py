"""`tricycle simulate`: commands to a trajectory."""

import json
import sys
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from tricycle_core.errors import CommandsError, ExcitationError, PlanError, VehicleError
from tricycle_sim.commands import Commands

CARGO = Path(str(resources.files("tricycle_sim") / "cargo_tadpole.yaml"))


@pytest.fixture
def commands(tmp_path):
    path = tmp_path / "commands.csv"
    time = np.arange(0.0, 4.01, 0.02)
    Commands(time, 0.1 * np.sin(time), np.minimum(0.9 * time, 1.5)).save(path)
    return path


def read(path):
    return np.genfromtxt(path, delimiter=",", names=True)


@pytest.mark.slow
def test_replays_commands_into_a_csv(tricycle, commands, tmp_path, capsys):
    output = tmp_path / "out.csv"
    assert tricycle("simulate", "--commands", commands, "--output", output, "--plot", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["rows"] == 401
    assert result["feasible"] == 1
    assert result["reasons"] == []
    table = read(output)
    assert table["time"][-1] == 4.0
    assert table["vx"][-1] == pytest.approx(1.5, rel=0.03)
    assert Path(result["plot"]).is_file()


def test_makes_the_commands_of_a_maneuver(tricycle, tmp_path, capsys):
    output = tmp_path / "circle.csv"
    assert (
        tricycle("simulate", "--maneuver", "circle", "radius=3", "speed=0.8", "--output", output)
        == 0
    )
    table = read(output)
    late = table[-500:]  # on the circle: speed over yaw rate is its radius
    radius = np.hypot(late["vx"], late["vy"]).mean() / late["yaw_rate"].mean()
    assert radius == pytest.approx(3.0, rel=0.05)
    assert "rows of 1 vehicle" in capsys.readouterr().out


def test_a_maneuver_outside_the_usual_ranges_has_a_range_of_its_own(tricycle, tmp_path):
    output = tmp_path / "circle.csv"
    maneuver = ("--maneuver", "circle", "radius=9", "speed=0.8")
    with pytest.raises(PlanError, match="outside its range 2 to 6; --range radius=LOW:HIGH"):
        tricycle("simulate", *maneuver, "--output", output)
    tricycle("simulate", *maneuver, "--range", "radius=6:12", "--output", output)
    late = read(output)[-500:]
    radius = np.hypot(late["vx"], late["vy"]).mean() / late["yaw_rate"].mean()
    assert radius == pytest.approx(9.0, rel=0.05)


@pytest.mark.slow
def test_set_changes_the_vehicle_and_samples_spread_it(tricycle, commands, tmp_path):
    base, soft, many = (tmp_path / name for name in ("a.csv", "b.csv", "c.csv"))
    tricycle("simulate", "--commands", commands, "--output", base)
    tricycle(
        "simulate", "--commands", commands, "--output", soft, "--set", "cornering_stiffness=600"
    )
    tricycle("simulate", "--commands", commands, "--output", many, "--samples", 3, "--seed", 0)
    assert read(base)["y"][-1] != read(soft)["y"][-1]
    table = read(many)
    assert np.unique(table["sample"]).tolist() == [0.0, 1.0, 2.0]
    assert len(np.unique(table["cornering_stiffness"])) == 3


@pytest.mark.slow
def test_another_vehicle_needs_nothing_but_its_file(tricycle, commands, tmp_path, capsys):
    output = tmp_path / "cargo.csv"
    tricycle("simulate", "--commands", commands, "--vehicle", CARGO, "--output", output)
    loads = read(output)[["load_left", "load_right", "load_rear"]][0]
    assert sum(loads) == pytest.approx(95.0 * 9.81, rel=1e-3)


def test_infeasible_drives_are_reported_not_hidden(tricycle, tmp_path, capsys):
    path = tmp_path / "c.csv"
    Commands([0.0, 3.0, 5.0], [0.0, 0.5, 0.5], [1.0, 1.0, 1.0]).save(path)
    tricycle("simulate", "--commands", path, "--output", tmp_path / "o.csv", "--json")
    result = json.loads(capsys.readouterr().out)
    assert result["feasible"] == 0
    assert result["reasons"][0]["reason"].startswith(
        "steering asked to turn faster than steering_slew, 2 rad/s, at 3.00 s"
    )
    least, used = result["least_load"]["left"], result["friction_used"]
    table = read(tmp_path / "o.csv")
    assert least["value"] == pytest.approx(table["load_left"].min())
    assert least["x"] == pytest.approx(table["x"][round(least["time"] * 100)])
    assert 0.0 < used["value"] <= 1.0
    assert used["time"] >= 3.0
    assert result["motor_saturated"] is None


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (["--set", "motor_lag=0.001"], VehicleError, "rad/s, steps of 10 ms allow 250"),
        (["--set", "wings=2"], VehicleError, "wings: is not a constant"),
        (["--set", "mass"], PlanError, "'mass': needs name=number"),
        (["--set", "mass=heavy"], PlanError, "'mass=heavy': needs name=number"),
        (["--set", "mass=40", "mass=50"], PlanError, "mass is given twice"),
        (
            ["--set", "mass=50", "cornering_stiffness=700", "--samples", "3"],
            VehicleError,
            "--set: cornering_stiffness is unknown, and --samples draws it",
        ),
        (["--range", "radius=3:4"], PlanError, "--range: only with --maneuver"),
        (["--samples", "1000000"], CommandsError, "401000000 rows are more than"),
        (["--vehicle", "absent.yaml"], FileNotFoundError, "absent.yaml"),
        (["--vehicle", __file__], VehicleError, "is not valid YAML"),
    ],
)
def test_mistakes_get_one_line(tricycle, commands, tmp_path, arguments, error, message):
    with pytest.raises(error, match=r"^[^\n]*$") as caught:
        tricycle("simulate", "--commands", commands, "--output", tmp_path / "o.csv", *arguments)
    assert message in str(caught.value)


def test_bad_commands_and_maneuvers_get_one_line(tricycle, tmp_path):
    (tmp_path / "c.csv").write_text("", encoding="utf-8")
    with pytest.raises(CommandsError, match="is empty"):
        tricycle("simulate", "--commands", tmp_path / "c.csv", "--output", tmp_path / "o.csv")
    with pytest.raises(PlanError, match="circle takes radius, speed"):
        tricycle("simulate", "--maneuver", "circle", "size=3", "--output", tmp_path / "o.csv")


def test_the_commands_are_not_overwritten(tricycle, commands):
    before = commands.read_bytes()
    with pytest.raises(CommandsError, match="would overwrite the commands"):
        tricycle("simulate", "--commands", commands, "--output", commands)
    assert commands.read_bytes() == before


def test_a_trajectory_is_replaced_only_when_asked(tricycle, commands, tmp_path):
    output = tmp_path / "o.csv"
    output.write_text("mine")
    with pytest.raises(ExcitationError, match="exists already; --overwrite replaces it"):
        tricycle("simulate", "--commands", commands, "--output", output)
    assert output.read_text() == "mine"
    assert tricycle("simulate", "--commands", commands, "--output", output, "--overwrite") == 0
    assert len(read(output)) == 401


@pytest.mark.parametrize(
    "option",
    [
        ["--output", "o.xls"],
        ["--output", "o.csv", "--samples", "0"],
        ["--output", "o.csv", "--seed", "-1"],
        ["--output", "o.csv", "--plot", "o.xls"],
    ],
)
def test_bad_options_exit_with_2(tricycle, commands, option, capsys):
    with pytest.raises(SystemExit) as caught:
        tricycle("simulate", "--commands", commands, *option)
    assert caught.value.code == 2
    assert "error: argument" in capsys.readouterr().err


def test_a_picture_that_cannot_be_drawn_is_refused_before_anything_is_written(
    tricycle, commands, tmp_path, monkeypatch
):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ExcitationError, match=r"a picture needs matplotlib.*\[plots\]"):
        tricycle("simulate", "--commands", commands, "--output", tmp_path / "o.csv", "--plot")
    assert list(tmp_path.iterdir()) == [commands]


def test_parquet_without_its_package_is_refused(tricycle, commands, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(SystemExit) as caught:
        tricycle("simulate", "--commands", commands, "--output", "o.parquet")
    assert caught.value.code == 2
    assert "o.parquet: needs pyarrow: " in capsys.readouterr().err
