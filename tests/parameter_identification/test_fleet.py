"""A fleet of simulated vehicles, from their bags."""

import dataclasses
import json
import math
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from simulated_drives import TRUTH, VEHICLE, driven, planned

from excitation_planner.maneuver import Circle
from parameter_identification import fleet
from parameter_identification.drives.imported import recording_of, write_bag
from parameter_identification.drives.kept import KeptTimes
from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.simulated import SensorNoise
from parameter_identification.drives.table import SteeringMap
from parameter_identification.fleet import DAY, course, identify_fleet
from trajectory_recorder.bag.topics import Topic
from trajectory_recorder.bag.writer import BagWriter
from tricycle_cli.main import main
from tricycle_cli.reports.remarks import remarks_on_fleet
from tricycle_core.errors import IdentificationError

SENSORS = {Sensor.HEADING: SensorNoise(0.002), Sensor.YAW_RATE: SensorNoise(0.005)}
BEGINNING = 1.7e9  # s since 1970


def write(bag, seed, stiffness, *, days=0.0, circle=(2.5, 0.8)):
    truth = np.append(stiffness, TRUTH[1:])
    drive = driven(
        planned(Circle(duration=6.0), *circle),
        noise=0.001, seed=seed, truth=truth, others=SENSORS, standstill=1.0,
    )  # fmt: skip
    bag.parent.mkdir(parents=True, exist_ok=True)
    recording = dataclasses.replace(recording_of(drive), start=BEGINNING + DAY * days)
    write_bag(recording, VEHICLE, SteeringMap(), bag)
    return bag


@pytest.mark.slow
def test_a_fleet_has_a_population_and_an_odd_vehicle(tmp_path, capsys):
    true = TRUTH[0] * np.array([0.98, 1.0, 1.01, 0.99, 1.02, 1.35])
    bags = [
        write(tmp_path / "bags" / f"trike_{number}" / "drive", number, stiffness)
        for number, stiffness in enumerate(true)
    ]
    command, pattern = ["fleet", "identify"], str(tmp_path / "bags" / "**")
    options = ["--workers", "1", "--own", "camber-stiffness", "--shared", "rolling_coefficient_2"]
    out = tmp_path / "out"
    assert main([*command, pattern, *options, "--output", str(out), "--json"]) == 0
    printed = capsys.readouterr()
    found = json.loads(printed.out)
    assert found == json.loads((out / "fleet.json").read_text())
    assert found["odd"] == ["trike_5"]
    assert re.search(r"trike_5 is odd: .* in cornering_stiffness \(\+", printed.err)
    stiffness = found["populations"]["cornering_stiffness"]
    assert stiffness["mean"]["low"] < true[:5].mean() < stiffness["mean"]["high"]
    for member, value in zip(stiffness["members"], true, strict=True):
        assert abs(member["own"] - value) < 4.0 * member["deviation"]
    assert "camber_stiffness" not in found["populations"]
    shared = found["shared"]["rolling_coefficient_2"]
    for vehicle in found["vehicles"].values():
        assert vehicle["parameters"]["rolling_coefficient_2"] == shared
    assert (out / "fleet.png").stat().st_size > 10_000
    assert len(list((out / "drives").glob("*.npz"))) == 6

    page = (out / "report.html").read_text()
    assert page.index("Odd vehicles") < page.index("trike_5") < page.index("Population</h2>")
    assert page.index(">trike_5</td>", page.index("Vehicles</h2>")) < page.index(">trike_0</td>")
    assert page.count("<svg class=") == 6 * len(VEHICLE.unknown)
    assert len(page) < 2e6
    assert "<script" not in page

    keep = ["--keep", str(out / "drives"), "--workers", "1"]
    assert main([*command, *map(str, bags[:3]), *keep]) == 2
    assert "at least 4 vehicles; given: trike_0, trike_1, trike_2" in capsys.readouterr().err
    assert main([*command, pattern, *keep, "--vehicles", "vehicle_id"]) == 2
    assert "its metadata has no 'vehicle_id'; there is: imported_from" in capsys.readouterr().err
    assert main([*command, pattern, *keep, "--vehicles", "vehicle_id", "--leave-out"]) == 2
    assert "no bag can be used. Left out: " in capsys.readouterr().err
    shutil.copytree(bags[0], other := out / "x" / "trike_0" / "drive")
    assert main([*command, str(other), pattern, *keep]) == 2
    assert "two folders of bags have one name" in capsys.readouterr().err


@pytest.mark.slow
def test_a_vehicle_beyond_a_range_is_named_and_compared_in_nothing(tmp_path):
    low = VEHICLE.unknown["cornering_stiffness"][0]
    true = [*TRUTH[0] * np.array([0.98, 1.0, 1.01, 0.99, 1.02]), 0.88 * low]
    bags = {
        f"trike_{v}": [
            write(tmp_path / f"{v}_{i}", 10 * v + i, stiffness, circle=(2.5 + 0.5 * i, 0.8))
            for i in range(2)
        ]
        for v, stiffness in enumerate(true)
    }
    fleet = identify_fleet(bags, VEHICLE, folder=tmp_path / "work")
    assert fleet.beyond == {"trike_5": ("cornering_stiffness",)}
    assert re.match("trike_5: .* cornering_stiffness beyond", remarks_on_fleet(fleet)[0])
    assert fleet.odd == ()
    for found in fleet.populations.values():
        assert "trike_5" not in [m.vehicle for m in found.members]


@pytest.mark.slow
def test_paths_that_are_no_bags_are_told_as_such(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for v in range(4):
        (tmp_path / "bags" / f"trike_{v}" / "drive").mkdir(parents=True)
    folders = [f"bags/trike_{v}" for v in range(4)]
    drives = [f"{folder}/drive" for folder in folders]
    fleet = ["fleet", "identify", "--workers", "1"]
    for command, message in [
        ([*fleet, "missing"], "missing: no such bag"),
        ([*fleet, *folders], "bags/trike_0 is not a bag"),
        (
            [*fleet, *drives, "--leave-out"],
            "no bag can be used. Left out: bags/trike_0/drive is not a bag",
        ),
        (
            ["identify", "missing", "--drive-by-drive", "work", "--leave-out", "--workers", "1"],
            "no drive: nothing to identify from. Left out: missing: no such bag",
        ),
    ]:
        assert main(command) == 2
        assert message in capsys.readouterr().err
    for drive in drives:
        (tmp_path / drive / "metadata.yaml").touch()
    assert main([*fleet, *drives, "--leave-out"]) == 2
    said = capsys.readouterr().err
    assert "4 vehicles; with drives that can be used: none. Left out: bags/trike_0/drive" in said
    assert "trike_2" in said
    assert "trike_3" not in said
    assert said.endswith("; …\n")


def test_a_vehicle_without_a_name_is_none(tmp_path, capsys):
    with BagWriter(tmp_path / "drive", metadata={"vehicle_id": " "}) as bag:
        bag.add_topic(Topic("/odom", "nav_msgs/msg/Odometry"))
    assert main(["fleet", "identify", str(tmp_path / "drive"), "--vehicles", "vehicle_id"]) == 2
    assert "drive: 'vehicle_id' of its metadata is empty" in capsys.readouterr().err


@pytest.mark.slow
def test_a_parameter_changes_in_each_vehicle_at_its_own_rate(tmp_path):
    rates = TRUTH[0] / 180.0 * np.array([-0.04, -0.05, -0.05, -0.06, -0.05, -0.04, -0.06, -0.5])
    days = np.array([-90.0, 60.0])
    bags = {
        f"trike_{v}": [
            write(
                tmp_path / f"trike_{v}_{i}", 10 * v + i, TRUTH[0] * (1.0 + 0.01 * v) + rate * day,
                days=day, circle=(2.5 + 0.5 * i, 0.8),
            )
            for i, day in enumerate(days)
        ]
        for v, rate in enumerate(rates)
    }  # fmt: skip
    fleet = identify_fleet(
        bags, VEHICLE, folder=tmp_path / "work", changing=["cornering_stiffness"]
    )
    assert fleet.when == pytest.approx(BEGINNING + DAY * days.mean(), abs=60.0)
    change = fleet.changes["cornering_stiffness"]
    assert change.mean.low < rates[:7].mean() < change.mean.high < 0.0
    for member, rate in zip(change.members, rates, strict=True):
        assert member.value.low < rate < member.value.high, member
    assert [m.vehicle for m in change.members if m.odd] == ["trike_7"]
    assert ("cornering_stiffness", True) in {entry[:2] for entry in fleet.outliers}
    levels = fleet.populations["cornering_stiffness"].members
    for v, (member, rate) in enumerate(zip(levels, rates, strict=True)):
        level = TRUTH[0] * (1.0 + 0.01 * v) + rate * days.mean()
        assert abs(member.own - level) < 4.0 * member.deviation
    seen = course(fleet.vehicles["trike_7"], "cornering_stiffness")
    true = TRUTH[0] * 1.07 + rates[7] * days
    assert np.all(np.abs(seen.values - true) < 4.0 * seen.deviations)
    assert np.all(seen.deviations < 0.1 * true)
    other = course(fleet.vehicles["trike_7"], "yaw_inertia")
    assert np.all(np.abs(other.values - TRUTH[3]) < 4.0 * other.deviations)


@pytest.mark.slow
@pytest.mark.parametrize("days", [[0, 0, 0, 0], [0, 30, 60, 90]], ids=["none", "of vehicles"])
def test_times_that_differ_in_no_vehicle_show_no_change(tmp_path, days):
    bags = {
        f"trike_{v}": [write(tmp_path / f"drive_{v}", v, TRUTH[0], days=day)]
        for v, day in enumerate(days)
    }
    with pytest.raises(IdentificationError, match="by 60 min or more, of at least 4 vehicles"):
        identify_fleet(bags, VEHICLE, folder=tmp_path / "work", changing=["cornering_stiffness"])


def test_a_drive_whose_time_is_not_known_is_named_by_its_bag(monkeypatch):
    files = {name: [Path(f"{name}.npz"), Path(f"{name}_late.npz")] for name in "abcd"}
    bags = {Path("bags", file.stem): file for drives in files.values() for file in drives}
    times = {file: DAY * i for i, file in enumerate(bags.values())} | {files["c"][1]: math.nan}
    monkeypatch.setattr(fleet, "times_of", lambda file: KeptTimes(times[file], 0.0))
    with pytest.raises(IdentificationError, match=r"^yaw_inertia: the time .* of bags/c_late$"):
        fleet._times(files, bags, ["yaw_inertia"])
    assert math.isnan(fleet._times(files, bags, [])[0])


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ({"shared": ["mass"]}, "'mass' is not an unknown parameter"),
        ({"changing": ["yaw_inertia", "yaw_inertia"]}, "yaw_inertia is named twice"),
        ({"shared": ["yaw_inertia"], "own": ["yaw_inertia"]}, "shared by all vehicles and their"),
        ({"own": ["yaw_inertia"], "changing": ["yaw_inertia"]}, "cannot be shared or own too"),
    ],
)
def test_parameters_that_cannot_be_so_are_refused(tmp_path, named, message):
    with pytest.raises(IdentificationError, match=message):
        identify_fleet({}, VEHICLE, folder=tmp_path, **named)
