"""Vehicle files with estimates."""

import dataclasses

import numpy as np
import pytest
import yaml
from found_identification import FOUND

from parameter_identification.estimation.results import EffectEstimate
from parameter_identification.identified_vehicle import (
    identified_vehicle,
    kind_of_drives,
    named_drives,
)
from tricycle_sim.vehicle import load_vehicle, vehicle_document


@pytest.fixture
def vehicle(tmp_path):
    path = tmp_path / "vehicle.yaml"
    path.write_text(identified_vehicle(FOUND, None), encoding="utf-8")
    return load_vehicle(path)


def test_what_the_drives_show_is_nominal_with_three_deviations_either_side(vehicle):
    assert vehicle.cornering_stiffness == 600.0
    assert vehicle.unknown["cornering_stiffness"] == (585.0, 615.0)


def test_what_they_do_not_show_keeps_its_range_and_fits_best_beside_the_others(vehicle):
    before = load_vehicle()
    for name in ("yaw_inertia", "camber_stiffness"):
        assert vehicle.unknown[name] == before.unknown[name]
    assert vehicle.yaw_inertia == FOUND.parameters["yaw_inertia"].estimate
    assert vehicle.camber_stiffness == before.camber_stiffness


def test_a_range_is_never_widened(tmp_path):
    vague = dataclasses.replace(FOUND.parameters["cornering_stiffness"], standard_deviation=400.0)
    text = identified_vehicle(
        dataclasses.replace(FOUND, parameters={"cornering_stiffness": vague}), None
    )
    assert yaml.safe_load(text)["constants"]["cornering_stiffness"]["range"] == [500.0, 1500.0]


def with_effects(tmp_path, *effects, source=None, drives=FOUND.drives):
    """The file's text and its vehicle, with effects by name and estimate."""
    found = dataclasses.replace(
        FOUND,
        drives=drives,
        effects=tuple(EffectEstimate(*(name, "1", value, 0.001, 0.1)) for name, value in effects),
    )
    path = tmp_path / "with_effects.yaml"
    path.write_text(identified_vehicle(found, source), encoding="utf-8")
    return path.read_text(encoding="utf-8"), load_vehicle(path)


def file_with(tmp_path, name, entry, parts=()):
    """The packaged file with other laws, and with one constant changed or added."""
    document = vehicle_document()
    document["parts"] = {**document.get("parts", {}), **dict(parts)}
    document["constants"].setdefault(name, {}).update(entry)
    path = tmp_path / "source.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return path


def test_effects_are_constants_of_the_file(tmp_path):
    before = load_vehicle()
    text, vehicle = with_effects(
        tmp_path, ("steering zero", 0.01), ("tyre rounding", 0.2), ("servo dead time", 0.03)
    )
    assert vehicle.steering_offset == before.steering_offset + 0.01
    assert vehicle.parts == {**before.parts, "tyre": "softened", "servo": "geared"}
    assert (vehicle.tyre_rounding, vehicle.servo_delay) == (0.2, 0.03)
    assert "# * tyre rounding: +20.0" in text
    assert set(vehicle.unknown) == set(before.unknown)


def test_what_the_boards_are_set_up_with_is_changed_once(tmp_path):
    before = load_vehicle()
    text, vehicle = with_effects(tmp_path, ("wheel radius", 0.01), ("speed loop", -0.3))
    assert vehicle.driven_radius == pytest.approx(1.01 * before.driven_radius)
    assert vehicle.speed_scale == before.speed_scale
    assert vehicle.speed_gain_proportional == before.speed_gain_proportional
    assert "#   speed loop: -30.0" in text


def test_tables_are_of_boards_that_do_not_know_the_file(tmp_path):
    before, (fit,) = load_vehicle(), FOUND.drives
    window = dataclasses.replace(fit, recording="lap.csv")
    effects = (("wheel radius", 0.01), ("speed loop", -0.3), ("servo dead time", 0.03))
    _, vehicle = with_effects(tmp_path, *effects, drives=(window,))
    assert vehicle.speed_scale == pytest.approx(1.01)
    assert vehicle.speed_gain_integral == pytest.approx(0.7 * before.speed_gain_integral)
    assert vehicle.parts == before.parts


def test_bags_of_tables_are_of_boards_that_do_not_know_the_file_either(tmp_path):
    before, (fit,) = load_vehicle(), FOUND.drives
    imported = dataclasses.replace(fit, steering_late=0.08)
    effects = (("speed loop", -0.3), ("servo dead time", 0.03))
    _, vehicle = with_effects(tmp_path, *effects, drives=(imported,))
    assert vehicle.speed_gain_integral == pytest.approx(0.7 * before.speed_gain_integral)
    assert vehicle.parts == before.parts
    # beside drives of the suite, neither is known to be the vehicle's
    _, vehicle = with_effects(tmp_path, *effects, drives=(fit, imported))
    assert vehicle.speed_gain_integral == before.speed_gain_integral
    assert vehicle.parts == before.parts


def test_what_an_estimated_map_errs_by_is_not_the_vehicles(tmp_path):
    before, (fit,) = load_vehicle(), FOUND.drives
    effects = (("steering zero", 0.01), ("steering gain", -0.03), ("wheel radius", 0.01))
    window = dataclasses.replace(fit, recording="lap.csv", map_estimated=True)
    text, vehicle = with_effects(tmp_path, *effects, drives=(window,))
    assert vehicle.steering_offset == before.steering_offset
    assert vehicle.steering_scale == before.steering_scale
    assert vehicle.driven_radius == pytest.approx(1.01 * before.driven_radius)
    assert "#   steering gain: -3.0" in text


def test_an_unknown_parameter_that_was_held_may_have_an_effect(tmp_path):
    entry = {"nominal": 0.0, "range": [-2.0, 1.0], "unit": "deg", "basis": "argued", "about": ""}
    path = file_with(tmp_path, "steering_offset", entry)
    _, vehicle = with_effects(tmp_path, ("steering zero", 0.03), source=path)
    assert vehicle.unknown["steering_offset"] == pytest.approx([np.radians(-2.0), 0.03])
    assert vehicle.steering_offset == pytest.approx(0.03)


def test_effects_of_a_vehicle_that_is_too_stiff_already_are_written(tmp_path):
    path = file_with(tmp_path, "lateral_relaxation_length", {"value": 0.012})
    assert with_effects(tmp_path, ("steering zero", 0.01), source=path)[1].steering_offset == 0.01


def test_a_dead_time_ends_at_none(tmp_path):
    entry = {"value": 0.031, "unit": "s", "basis": "data", "about": "measured"}
    path = file_with(tmp_path, "servo_delay", entry, {"servo": "geared"})
    _, vehicle = with_effects(tmp_path, ("servo dead time", -0.0310000001), source=path)
    assert vehicle.servo_delay == 0.0


def test_an_effect_beyond_what_any_vehicle_has_is_not_said_to_be_a_constant(tmp_path):
    entry = {"value": 0.03, "unit": "s", "basis": "data", "about": "measured"}
    path = file_with(tmp_path, "servo_delay", entry, {"servo": "geared"})
    effects = (("servo dead time", -0.05), ("steering zero", 0.01))
    text, vehicle = with_effects(tmp_path, *effects, source=path)
    assert (vehicle.servo_delay, vehicle.steering_offset) == (0.0, 0.01)
    assert "# * steering zero" in text
    assert "#   servo dead time" in text
    assert "at the end of what any vehicle has" in text


def test_effects_of_drives_and_sensors_are_told_only(tmp_path):
    text, vehicle = with_effects(tmp_path, ("sensor left", 0.02), ("drive dead time", 0.05))
    assert vehicle.parts == load_vehicle().parts
    assert "#   sensor left" in text
    assert "*" not in text.replace("; * also", "")


def test_a_relaxation_that_steps_do_not_allow_is_told_only(tmp_path):
    short = file_with(tmp_path, "lateral_relaxation_length", {"value": 0.02})
    held = ("relaxation length", -0.75)
    assert with_effects(tmp_path, held, source=short)[1].lateral_relaxation_length == 0.02
    _, viscous = with_effects(tmp_path, held, ("slip by speed", 1.0), source=short)
    assert viscous.lateral_relaxation_length == pytest.approx(0.005)


def test_angles_of_a_file_in_degrees_stay_right(tmp_path):
    entry = {"value": 1.0, "unit": "deg", "basis": "data", "about": "measured"}
    path = file_with(tmp_path, "steering_offset", entry)
    _, vehicle = with_effects(tmp_path, ("steering zero", 0.01), source=path)
    assert vehicle.steering_offset == pytest.approx(np.radians(1.0) + 0.01)


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
