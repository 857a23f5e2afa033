"""A fleet of simulated vehicles, from their bags."""

import json

import numpy as np
import pytest
from simulated_drives import TRUTH, VEHICLE, driven, planned

from excitation_planner.maneuver import Circle
from parameter_identification.drives.imported import recording_of, write_bag
from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.simulated import SensorNoise
from parameter_identification.drives.table import SteeringMap
from tricycle_cli.main import main

SENSORS = {Sensor.HEADING: SensorNoise(0.002), Sensor.YAW_RATE: SensorNoise(0.005)}


@pytest.mark.slow
def test_a_fleet_has_a_population_and_an_odd_vehicle(tmp_path, capsys):
    true = TRUTH[0] * np.array([0.98, 1.0, 1.01, 0.99, 1.02, 1.35])
    commands = planned(Circle(duration=6.0), 2.5, 0.8)
    for number, stiffness in enumerate(true):
        truth = np.append(stiffness, TRUTH[1:])
        drive = driven(
            commands, noise=0.001, seed=number, truth=truth, others=SENSORS, standstill=1.0
        )
        bag = tmp_path / f"trike_{number}" / "drive"
        bag.parent.mkdir()
        write_bag(recording_of(drive), VEHICLE, SteeringMap(), bag)
    bags = sorted(str(bag) for bag in tmp_path.glob("trike_*/drive"))
    options = ["--keep", str(tmp_path / "work"), "--workers", "1"]
    out = tmp_path / "out"
    assert main(["fleet", *bags, *options, "--output", str(out), "--json"]) == 0
    printed = capsys.readouterr()
    found = json.loads(printed.out)
    assert found == json.loads((out / "fleet.json").read_text())
    assert found["odd"] == ["trike_5"]
    assert "trike_5 is odd" in printed.err
    stiffness = found["populations"]["cornering_stiffness"]
    assert stiffness["mean"]["low"] < true[:5].mean() < stiffness["mean"]["high"]
    for member, value in zip(stiffness["members"], true, strict=True):
        assert abs(member["own"] - value) < 4.0 * member["deviation"]
    assert (out / "fleet.png").stat().st_size > 10_000

    assert main(["fleet", *bags[:3], *options]) == 2
    assert "3 vehicles (trike_0, trike_1, trike_2) are no fleet" in capsys.readouterr().err
    assert main(["fleet", *bags, *options, "--vehicles", "vehicle_id"]) == 2
    assert "its metadata has no 'vehicle_id'; there is: imported_from" in capsys.readouterr().err
