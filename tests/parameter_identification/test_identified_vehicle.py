"""Vehicle files with estimates."""

import dataclasses

import pytest
import yaml
from found_identification import FOUND

from parameter_identification.estimation.results import EffectEstimate
from parameter_identification.identified_vehicle import (
    identified_vehicle,
    kind_of_drives,
    named_drives,
)
from tricycle_sim.vehicle import load_vehicle


@pytest.fixture
def vehicle(tmp_path):
    path = tmp_path / "vehicle.yaml"
    path.write_text(identified_vehicle(FOUND, None), encoding="utf-8")
    return load_vehicle(path)


def test_what_the_drives_show_is_nominal_with_three_deviations_either_side(vehicle):
    assert vehicle.cornering_stiffness == 600.0
    assert vehicle.unknown["cornering_stiffness"] == (585.0, 615.0)


def test_what_they_do_not_show_stays_as_it_was(vehicle):
    before = load_vehicle()
    for name in ("yaw_inertia", "camber_stiffness"):
        assert vehicle.unknown[name] == before.unknown[name]
        assert getattr(vehicle, name) == getattr(before, name)


def test_a_range_is_never_widened(tmp_path):
    vague = dataclasses.replace(FOUND.parameters["cornering_stiffness"], standard_deviation=400.0)
    text = identified_vehicle(
        dataclasses.replace(FOUND, parameters={"cornering_stiffness": vague}), None
    )
    assert yaml.safe_load(text)["constants"]["cornering_stiffness"]["range"] == [500.0, 1500.0]


def test_entries_name_their_source():
    (fit,) = FOUND.drives
    days = tuple(dataclasses.replace(fit, name=day) for day in ("monday", "tuesday"))
    text = identified_vehicle(dataclasses.replace(FOUND, drives=days), None)
    assert text.startswith("# tricycle with parameters identified from monday, tuesday")
    entry = yaml.safe_load(text)["constants"]["cornering_stiffness"]
    assert entry["basis"] == "data"
    assert "identified from monday, tuesday: 95 % interval 590 to 611" in entry["about"]
    assert "not shown by first" in identified_vehicle(FOUND, None)


def test_windows_are_told_as_windows_of_their_tables():
    (fit,) = FOUND.drives
    fits = [dataclasses.replace(fit, name=f"lap {i} s", recording="lap.csv") for i in range(20)]
    windows = dataclasses.replace(FOUND, drives=tuple(fits))
    assert named_drives(windows) == "20 windows of lap.csv"
    assert kind_of_drives(windows) == "windows"
    mixed = dataclasses.replace(FOUND, drives=(*fits, fit))
    assert named_drives(mixed) == "21 drives"
    assert "identified from 20 windows of lap.csv" in identified_vehicle(windows, None)


def test_doubts_about_the_model_are_in_the_entries():
    shown = EffectEstimate("turn deviation", "1", 0.0, 0.001, 0.01, chance=1e-9)
    text = identified_vehicle(dataclasses.replace(FOUND, effects=(shown,)), None)
    about = yaml.safe_load(text)["constants"]["cornering_stiffness"]["about"]
    assert "but the vehicle moves as the model cannot (turn deviation)" in about
