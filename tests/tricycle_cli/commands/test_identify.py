"""The subcommand identify: what it refuses, and hundreds of bags drive by drive."""

import json
import shutil
from argparse import ArgumentParser, Namespace

import numpy as np
import pytest
from driven_bags import SimulatedBag
from simulated_drives import TRUTH, VEHICLE, driven, planned

from excitation_planner.maneuver import Circle
from parameter_identification import many_drives
from parameter_identification.drives.imported import recording_of, write_bag
from parameter_identification.drives.measured import Input, Sensor
from parameter_identification.drives.simulated import SensorNoise
from parameter_identification.drives.table import Columns, SteeringMap
from parameter_identification.drives.windows import Selection, Windows
from parameter_identification.estimation.results import Estimate
from parameter_identification.identification_file import load_identification_file
from parameter_identification.many_drives import ManyDrives
from tricycle_cli.completion import words_of
from tricycle_cli.drives import _windows_of, read_drives
from tricycle_cli.options import add_topic_options
from tricycle_core.errors import ExcitationError, IdentificationError, VehicleError
from tricycle_sim.vehicle import load_vehicle


@pytest.mark.parametrize("command", ["identify", "demo", "campaign"])
def test_an_effect_that_is_none_is_refused_before_any_work(tricycle, tmp_path, command):
    more = {
        "identify": [tmp_path / "bag"],
        "demo": [],
        "campaign": ["--targets", "yaw_inertia", "--tolerance", "5%", "--output", tmp_path / "c"],
    }[command]
    with pytest.raises(VehicleError, match=r"'stering-zero'.*did you mean steering-zero"):
        tricycle(command, *more, "--effects", "stering-zero")
    assert not (tmp_path / "c").exists()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--robust"], "--drive-by-drive: not together with --robust"),
        (["--fmu", "f.yaml", "--columns", "c.yaml"], "--columns, --fmu"),
    ],
)
def test_what_drive_by_drive_cannot_do_is_refused(tricycle, tmp_path, more, message):
    with pytest.raises(IdentificationError, match=message):
        tricycle("identify", tmp_path / "bag", "--drive-by-drive", tmp_path / "work", *more)
    assert not (tmp_path / "work").exists()


def test_bags_of_one_name_are_told_apart_by_their_paths(tmp_path):
    whole = SimulatedBag().write(tmp_path / "drive.1")
    (inside,) = whole.glob("*.mcap")
    other = shutil.copytree(whole, tmp_path / "drive.2")
    parser = ArgumentParser()
    add_topic_options(parser)
    args = parser.parse_args([], Namespace(held_out=[], window=None, every=None, above=None))
    for drives, names in (
        ([whole, other], ["drive.1", "drive.2"]),
        ([inside, other / inside.name], [str(inside), str(other / inside.name)]),
    ):
        args.drives = drives
        assert [drive.name for drive in read_drives(args, VEHICLE, None).used] == names


def test_without_a_worker_nothing_is_read(tricycle, tmp_path, capsys):
    with pytest.raises(SystemExit):
        tricycle("identify", tmp_path / "bag", "--drive-by-drive", tmp_path, "--workers", "0")
    assert "'0': needs a whole number, 1 or more" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--window", "3"], "--window: only with --columns"),
        (["--leave-out"], "--leave-out: only with --drive-by-drive"),
        (["--workers", "2"], "--workers: only with --drive-by-drive"),
        (["--hold-others"], "--hold-others: only with --parameters"),
    ],
)
def test_an_option_that_would_do_nothing_is_refused(tricycle, tmp_path, more, message):
    with pytest.raises(IdentificationError, match=message):
        tricycle("identify", tmp_path / "bag", *more)


def topic_options():
    parser = ArgumentParser(add_help=False)
    add_topic_options(parser, sensors=True)
    return [word for word in words_of(parser) if word.startswith("--")]


@pytest.mark.parametrize("option", topic_options())
def test_topics_are_refused_where_every_drive_is_a_table(tricycle, tmp_path, option):
    (tmp_path / "m.yaml").write_text("time: t\nx: x\ny: y\nsteering: s\n")
    (tmp_path / "a.csv").write_text("t,x,y,s\n")
    line = "identify", tmp_path / "a.csv", "--columns", tmp_path / "m.yaml", option, "46,7"
    with pytest.raises(ExcitationError, match=f"^{option}: only for bags; every drive is a table"):
        tricycle(*line)
    with pytest.raises(ExcitationError, match="has a header and no rows"):
        tricycle(*line, "--held-out", tmp_path / "bag")


def test_an_entry_for_import_only_is_said_to_be(tmp_path, monkeypatch):
    path = tmp_path / "a.csv"
    path.write_text("t,x,a\n" + "".join(f"{0.1 * k},{0.1 * k},0\n" for k in range(40)))
    monkeypatch.setattr(
        "parameter_identification.drives.windows.select_windows", lambda *_: Selection((), {})
    )
    for more, said in (({}, False), ({"acceleration_x": "a"}, True)):
        columns = Columns(time="t", x="x", y="a", steering="a", **more)
        _, _, remark = _windows_of(path, VEHICLE, columns, Windows())
        assert ("acceleration_x is not used here, only by tricycle import" in remark) == said


def test_a_table_is_told_by_its_ending(tricycle, tmp_path):
    (tmp_path / "m.yaml").write_text("time: t\nx: x\ny: y\nsteering: s\n")
    for name, message in {
        "drive.txt": r"no drive is a table, which ends in \.csv or \.csv\.gz",
        "drive.CSV": r"drive\.CSV: has a header and no rows",
    }.items():
        (tmp_path / name).write_text("t,x,y,s\n")
        with pytest.raises(IdentificationError, match=message):
            tricycle("identify", tmp_path / name, "--columns", tmp_path / "m.yaml")


def test_no_report_of_an_earlier_identification_stays_beside_new_numbers(
    tricycle, tmp_path, monkeypatch
):
    wide = {n: Estimate("", low, 0.1, low, up, (low, up), (low, up), False)
            for n, (low, up) in VEHICLE.unknown.items()}  # fmt: skip
    found = ManyDrives(
        vehicle=VEHICLE.name,
        vehicle_hash=VEHICLE.fingerprint,
        parameters=wide,
        covariance=np.eye(len(wide)),
        scatter=1.0,
        truth={},
        level=0.95,
        drives=(),
        left_out=(),
    )
    monkeypatch.setattr(many_drives, "identify_many", lambda *_, **__: found)
    for name in ("report.html", "lack.png", "notes.txt"):
        (tmp_path / name).write_text("of before")
    call = "identify", "bag", "--drive-by-drive", tmp_path / "work", "--output", tmp_path
    with pytest.raises(ExcitationError, match=r"report\.html: exists already; --overwrite"):
        tricycle(*call)
    assert tricycle(*call, "--overwrite") == 0
    assert {path.name for path in tmp_path.iterdir()} == {
        "identification.json", "vehicle.yaml", "notes.txt",
    }  # fmt: skip


def test_the_file_has_what_drive_by_drive_knows(tricycle, tmp_path, monkeypatch, capsys):
    estimate = Estimate("", 700.0, 5.0, 690.0, 710.0, (690.0, 710.0), (500.0, 1500.0), True)

    def identified(_bags, vehicle, *, seed, **_):
        assert list(vehicle.unknown) == ["cornering_stiffness"]
        return ManyDrives(
            vehicle=vehicle.name,
            vehicle_hash=vehicle.fingerprint,
            parameters={"cornering_stiffness": estimate},
            covariance=np.array([[25.0]]),
            scatter=1.2,
            truth={},
            level=0.95,
            measured=frozenset({Input.SPEED}),
            seed=seed,
            drives=(),
            left_out=("x: is no bag",),
        )

    monkeypatch.setattr(many_drives, "identify_many", identified)
    of_one = "--parameters", "cornering-stiffness", "--hold-others", "--seed", 7, "--json"
    assert tricycle("identify", "bag", "--drive-by-drive", tmp_path, *of_one) == 0
    printed = capsys.readouterr()
    found = json.loads(printed.out)
    held = {n: v for n, v in VEHICLE.nominal.items() if n != "cornering_stiffness"}
    assert found["fixed"] == held
    assert found["vehicle_hash"] == VEHICLE.fingerprint
    expected = {
        "seed": 7, "scatter": 1.2, "correlation": [[1.0]], "measured": ["speed"],
        "left_out": ["x: is no bag"],
    }  # fmt: skip
    assert {key: found[key] for key in expected} == expected
    assert "taken as known: " in printed.err
    assert "the wheels turned as measured" in printed.err


@pytest.mark.slow
def test_drive_by_drive_writes_what_it_found(tricycle, tmp_path, capsys):
    sensors = {Sensor.HEADING: SensorNoise(0.002), Sensor.YAW_RATE: SensorNoise(0.005)}
    for number, radius in enumerate((2.5, 4.0)):
        commands = planned(Circle(duration=6.0), radius, 0.8)
        drive = driven(commands, noise=0.001, seed=number, others=sensors, standstill=1.0)
        write_bag(recording_of(drive), VEHICLE, SteeringMap(), tmp_path / f"drive_{number}")
    bags = tmp_path / "drive_0", tmp_path / "drive_1", tmp_path / "nowhere"
    options = "--drive-by-drive", tmp_path / "work", "--workers", 1, "--output", tmp_path / "out"
    with pytest.raises(IdentificationError, match="nowhere: no such bag"):
        tricycle("identify", *bags, *options)
    assert not (tmp_path / "out").exists()
    more = "--leave-out", "--json", "--effects", "steering-zero"
    assert tricycle("identify", *bags, *options, *more) == 0
    printed = capsys.readouterr()
    assert "left out" in printed.err
    assert "effect: steering zero" in printed.err
    document = load_identification_file(tmp_path / "out" / "identification.json")
    stiffness = document.parameters["cornering_stiffness"]
    assert json.loads(printed.out)["parameters"]["cornering_stiffness"]["low"] == stiffness.low
    assert abs(stiffness.estimate - TRUTH[0]) < 4.0 * stiffness.standard_deviation
    assert [effect.name for effect in document.effects] == ["steering zero"]
    assert [reason.split(":")[0] for reason in document.left_out] == [str(bags[2])]
    found = load_vehicle(tmp_path / "out" / "vehicle.yaml")
    assert found.nominal["cornering_stiffness"] == pytest.approx(stiffness.estimate)
