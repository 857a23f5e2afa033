"""Tables hold the numbers of what they show."""

import dataclasses
import io
import math
import re
from pathlib import Path

import numpy as np
import pytest
from found_identification import FOUND
from rich.console import Console
from simulated_drives import driven_pair

from parameter_identification.drives.measured import Sensor
from parameter_identification.estimation.noise import NoiseLevel
from parameter_identification.estimation.results import EffectEstimate, HeldOut
from parameter_identification.estimation.shares import DriveShare
from parameter_identification.estimation.whiteness import Whiteness
from parameter_identification.fleet import Fleet
from parameter_identification.judging.judgement import judge
from parameter_identification.many_drives import ManyDrives
from tricycle_cli.reports.remarks import (
    remarks,
    remarks_on_drives,
    remarks_on_fleet,
    remarks_on_many,
)
from tricycle_cli.reports.tables import (
    WIDEST,
    drives_table,
    judgement_table,
    plan_table,
    prediction_table,
    table_console,
)


def text_of(table, width=200):
    console = Console(width=width, file=io.StringIO(), record=True)
    console.print(table)
    return console.export_text()


def test_a_plan_shows_its_indices_and_marks_the_target(plan):
    text = text_of(plan_table(plan))
    assert f"circle for {plan.target}: radius = 3, speed = 0.8" in text
    for name, index in plan.main.items():
        assert name in text
        assert f"{index.value:.4f}" in text


@pytest.mark.parametrize("make", [plan_table, prediction_table])
def test_tables_are_complete_at_80_columns(plan, make):
    long = "longitudinal_relaxation_length"  # the longest name of a constant
    index = dataclasses.replace(next(iter(plan.main.values())), value=0.1234)
    wide = dataclasses.replace(
        plan,
        main=plan.main | {long: index},
        total=plan.total | {long: index},
        unknown=plan.unknown | {long: (0.0, 1.0)},
        predicted_std={long: 1.234e-5},
    )
    text = text_of(make(wide), width=80)
    assert "…" not in text.replace(" … ", "")
    assert long in text
    assert "1σ" in text or "0.1234" in text


def test_a_prediction_is_given_in_units_and_as_shares(plan):
    (low, high) = plan.unknown["yaw_inertia"]
    predicted = {"yaw_inertia": 0.1 * (high - low)}
    text = text_of(prediction_table(dataclasses.replace(plan, predicted_std=predicted, drives=2)))
    assert "expected after the 2 drives" in text
    assert "10.0%" in text
    assert "35%" in text  # of the deviation of a uniform parameter


def test_drives_show_what_was_planned_and_what_was_measured(plan, record_drive, tmp_path, capsys):
    record_drive(tmp_path / "bag")
    judgement = judge(tmp_path / "bag")
    one = {"designed": plan}, {"designed": 0.00123}, {"designed": judgement}
    text = text_of(drives_table("cornering_stiffness", *one))
    for part in ("designed", "0.00123", f"{judgement.te:.5f}", f"{plan.cost:.3f}"):
        assert part in text
    text = text_of(judgement_table([judgement, judgement]))
    assert text.count(f"{judgement.te_corrected:.5g}") >= 2
    assert "TE at anchor fit / m²" in text
    many = [dataclasses.replace(judgement, bag=Path(f"[left] run:{k}:")) for k in range(12)]
    table_console(width=WIDEST).print(judgement_table(many))
    printed = capsys.readouterr().out
    assert printed.count(f" {judgement.te_corrected:.5g} ") >= 12
    assert all(one.bag.name in printed for one in many)


def test_it_is_said_when_the_vehicle_moves_as_the_model_cannot():
    shown = EffectEstimate("turn deviation", "1", 0.0, 0.001, 0.01, chance=1e-9)
    found = dataclasses.replace(FOUND, effects=(shown,))
    assert any("moves as the model CANNOT (turn deviation)" in line for line in remarks(found))
    assert not any("CANNOT" in line for line in remarks(FOUND))


def test_effects_that_do_not_act_are_only_counted():
    def effect(name, acts):
        return EffectEstimate(name, "rad", 0.01, 0.001, 0.02, acts=acts)

    effects = (effect("steering zero", 0.98), effect("steering play", 0.01), effect("slope", 0.04))
    lines = remarks(dataclasses.replace(FOUND, effects=effects))
    told = [line for line in lines if line.startswith("effect")]
    assert "steering zero" in told[0]
    assert told[1].startswith("effects: 2 others, each with a probability below 5%")
    estimated = tuple(dataclasses.replace(effect, acts=None) for effect in effects)
    lines = remarks(dataclasses.replace(FOUND, effects=estimated))
    assert sum(line.startswith("effect: ") for line in lines) == 3


def test_parameters_that_were_not_identified_are_said_to_be_taken_as_known():
    assert any(line.startswith("taken as known: camber_stiffness 50.") for line in remarks(FOUND))
    whole = dataclasses.replace(FOUND, fixed={})
    assert not any("taken as known" in line for line in remarks(whole))


def test_parameters_that_were_not_asked_for_are_said_to_count_as_unknown():
    asked, *others = FOUND.names
    (line,) = (r for r in remarks(FOUND.only([asked])) if r.startswith("not asked for"))
    assert all(name in line for name in others)
    assert not any(r.startswith("not asked for") for r in remarks(FOUND))


def test_tyres_that_used_much_of_their_friction_are_told():
    hard = dataclasses.replace(FOUND, friction_used=0.853)
    assert any(line.startswith("a tyre used up to 85% of its friction") for line in remarks(hard))
    gentle = dataclasses.replace(FOUND, friction_used=0.3)
    unknown = dataclasses.replace(FOUND, friction_used=float("nan"))
    assert not any("friction" in line for found in (gentle, unknown) for line in remarks(found))


def test_an_estimate_at_an_end_of_its_range_is_told():
    name, e = next(iter(FOUND.parameters.items()))
    at_end = {**FOUND.parameters, name: dataclasses.replace(e, estimate=e.range[0])}
    lines = remarks(dataclasses.replace(FOUND, parameters=at_end))
    assert any(line.startswith(f"at an end of the range: {name}. Widen") for line in lines)
    assert not any("at an end" in line for line in remarks(FOUND))


def test_an_effect_far_from_the_vehicle_file_is_told():
    near, far = (
        EffectEstimate("centre of mass forward", "m", x, 0.01, 0.02) for x in (0.05, -0.08)
    )
    (line,) = (s for s in remarks(dataclasses.replace(FOUND, effects=(far,))) if "farther" in s)
    assert "centre of mass forward" in line
    assert not any("farther" in s for s in remarks(dataclasses.replace(FOUND, effects=(near,))))


def test_where_the_tyres_curve_is_among_the_effects_nothing_is_told_of_friction():
    rounding = EffectEstimate("tyre rounding", "1", 0.1, 0.05, 0.5)
    hard = dataclasses.replace(FOUND, friction_used=0.853, effects=(rounding,))
    assert not any(line.startswith("a tyre used") for line in remarks(hard))


def test_a_drive_outside_its_band_is_told():
    held = HeldOut("last", 0.5, 0.2, 0.03, expected=0.07, inside=0.2)
    (line,) = (s for s in remarks(dataclasses.replace(FOUND, held_out=(held,))) if "last" in s)
    assert line.endswith("it is OUTSIDE: this vehicle moves as the model CANNOT)")
    within = dataclasses.replace(held, inside=0.93)
    assert not any("OUTSIDE" in s for s in remarks(dataclasses.replace(FOUND, held_out=(within,))))


def test_drives_that_miss_each_other_are_told():
    (line,) = (s for s in remarks(dataclasses.replace(FOUND, missed=0.0353)) if "farther" in s)
    assert line.startswith("one of the drives is 35.3 mm (rms) farther than expected from where")
    assert not any("farther than expected from where" in s for s in remarks(FOUND))


def test_effects_at_an_end_of_what_is_possible_are_told():
    held = EffectEstimate("relaxation length", "1", -0.8, 0.01, 0.3, at_an_end=True)
    (line,) = (s for s in remarks(dataclasses.replace(FOUND, effects=(held,))) if "at an end" in s)
    assert line.startswith("at an end of what is taken for possible: relaxation length. Correct")


def test_residuals_that_are_not_white_are_counted_and_the_least_white_is_named():
    tests = [Whiteness(f"w {i}", "x", 0.01, 0.3, 50.0 + i % 7, 20, 1e-9) for i in range(30)]

    def told(number):
        found = dataclasses.replace(FOUND, whiteness=tuple(tests[:number]))
        (line,) = (text for text in remarks(found) if "NOT white" in text)
        return line

    assert told(1).startswith("residuals are NOT white (1 of 1: w 0 x): the model")
    assert "(30 of 30, least of all w 6 x; all: identification.json)" in told(30)


def test_numbers_are_whole_in_a_narrow_terminal(plan, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "40")
    table_console().print(plan_table(plan))
    text = capsys.readouterr().out
    assert "…" not in text.replace(" … ", "")
    assert all(f"{index.value:.4f}" in text for index in plan.main.values())


def share(name, **others):
    nothing = np.zeros(0)
    return DriveShare(*(name, 0.0, 9, nothing, 0.0, nothing, nothing, nothing, True, {}), **others)


def found_in(*drives):
    return ManyDrives(
        vehicle="tricycle",
        vehicle_hash="abc",
        parameters=FOUND.parameters,
        covariance=FOUND.covariance,
        scatter=1.0,
        truth={},
        level=0.95,
        drives=drives,
        left_out=(),
    )


def fleet_of(vehicle):
    return Fleet({"red": vehicle}, {}, {}, {}, (), {}, 0.0, (), 0.95)


def test_bags_that_are_not_whole_are_told_drive_by_drive_too():
    vehicle = found_in(share("whole", complete=True), share("torn", complete=False))
    (line,) = (line for line in remarks_on_many(vehicle) if "not whole" in line)
    assert line.endswith(": 1 (torn)")
    (line,) = (line for line in remarks_on_fleet(fleet_of(vehicle)) if "not whole" in line)
    assert line.endswith(": 1 (red/torn)")


@pytest.mark.parametrize(
    ("drives", "alike"), [(3, "and as much again for what errs"), (10, "not what errs")]
)
def test_drives_that_contradict_each_other_are_told_drive_by_drive_too(drives, alike):
    vehicle = found_in(*(share(f"drive {i}") for i in range(drives)))
    assert not any("contradict" in line for line in remarks_on_many(vehicle))
    vehicle = dataclasses.replace(vehicle, scatter=12.34)
    (line,) = (line for line in remarks_on_many(vehicle) if "contradict" in line)
    assert "up to 12.3 times as much as their noise" in line
    assert alike in line


def test_vehicles_whose_drives_contradict_each_other_are_named_the_worst_first():
    vehicle = found_in(share("one"), share("other"))
    scatter = {"red": 2.5, "green": 1.0, "alone": math.nan, "blue": 12.34}
    vehicles = {name: dataclasses.replace(vehicle, scatter=s) for name, s in scatter.items()}
    fleet = dataclasses.replace(fleet_of(vehicle), vehicles=vehicles)
    (line,) = (line for line in remarks_on_fleet(fleet) if "contradict" in line)
    assert line.startswith("the drives of 2 of 4 vehicles contradict each other (blue, red): ")
    assert "up to 12.3 times" in line
    assert not any("contradict" in line for line in remarks_on_fleet(fleet_of(vehicle)))


def test_what_is_missing_of_a_drive_is_told():
    whole, torn = driven_pair()
    signals = {Sensor.POSITION: torn.signals[Sensor.POSITION].between(-1.0, 4.0)}
    torn = dataclasses.replace(torn, signals=signals, unheard=(Sensor.YAW_RATE,))
    found = dataclasses.replace(FOUND, noise={Sensor.POSITION: NoiseLevel(0.01)})
    lines = [*remarks_on_drives(found, [whole], [torn], tables=False, redrawn=False)]
    assert len(lines) == 2
    assert re.match(r"lane: samples of position are missing for \d+\.\d of \d+\.\d s$", lines[0])
    assert lines[1].startswith("yaw rate: not used of 1 (lane), whose bags have samples, but ")
    vehicle = found_in(share("first", unheard=(Sensor.YAW_RATE,), converged=False), share("second"))
    assert any(
        line.startswith("yaw rate: not used of 1 (first)") for line in remarks_on_many(vehicle)
    )
    told = remarks_on_fleet(fleet_of(vehicle))
    assert any(line.startswith("yaw rate: not used of 1 (red/first)") for line in told)
    for name, lines in (("first", remarks_on_many(vehicle)), ("red/first", told)):
        (line,) = (line for line in lines if line.startswith("NO minimum"))
        assert f"1 of the drives have of their own, as their start poses ({name})" in line


def test_a_window_of_a_table_does_not_lack_what_is_before_it():
    _, lane = driven_pair()
    within = {Sensor.POSITION: lane.signals[Sensor.POSITION].between(3.0, 5.0)}
    window = dataclasses.replace(lane, signals=within, recording="drive.csv")
    found = dataclasses.replace(FOUND, noise={Sensor.POSITION: NoiseLevel(0.01)})
    assert not [*remarks_on_drives(found, [window], [], tables=True, redrawn=False)]


def test_drives_with_another_vehicle_file_are_told():
    known = {"same": "abc", "other": "def", "unknown": ""}
    vehicle = found_in(*(share(name, vehicle_hash=file) for name, file in known.items()))
    told = r"driven with another vehicle file \(def\) than this one \(abc\): 1 of the drives "
    (line,) = (line for line in remarks_on_many(vehicle) if "another vehicle" in line)
    assert re.match(rf"{told}\(other\)", line)
    (line,) = (line for line in remarks_on_fleet(fleet_of(vehicle)) if "another vehicle" in line)
    assert re.match(rf"{told}\(red/other\)", line)
    drives = [
        dataclasses.replace(driven_pair()[0], name=f"drive {known}", vehicle_hash=known)
        for known in ("", FOUND.vehicle_hash, "def")
    ]
    found = dataclasses.replace(FOUND, noise={Sensor.POSITION: NoiseLevel(0.01)})
    lines = remarks_on_drives(found, drives, [], tables=False, redrawn=False)
    (line,) = (line for line in lines if "another vehicle" in line)
    assert "1 of the drives (drive def)" in line
