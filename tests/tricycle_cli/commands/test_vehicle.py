"""`tricycle vehicle`: what a vehicle file says, what is odd in it, what follows from it."""

import errno
import io
import json
import math
import sys
from importlib import resources
from xml.etree import ElementTree

import pytest
import yaml

from tricycle_cli.new_vehicle import LAYOUTS, QUESTIONS, ask, from_answers
from tricycle_core.errors import ExcitationError, VehicleError
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle, warnings_about
from tricycle_sim.vehicle.batch import simulate
from tricycle_sim.vehicle.stability import check_step

CARGO = resources.files("tricycle_sim") / "cargo_tadpole.yaml"

SMALL = {"name": "rc car", "mass": "1.7", "wheelbase": "0.26", "front_track": "0.17",
         "rear_track": "0.17", "com_height": "0.045", "tyre_radius": "0.033",
         "motor_torque": "0.4", "battery_voltage": "7.4"}  # fmt: skip
LARGE = {"name": "golf cart", "mass": "500", "wheelbase": "1.7", "front_track": "0.9",
         "rear_track": "1.0", "com_height": "0.6", "tyre_radius": "0.23",
         "motor_torque": "200"}  # fmt: skip


def typed(answers):
    """What `ask` reads: the answer to each question by its text, otherwise an empty line."""
    by_text = {question.text: answers.get(question.key, "") for question in QUESTIONS}

    def read(prompt):
        return next(line for text, line in by_text.items() if prompt.startswith(text))

    return read


def vehicle_of(answers, folder):
    file = folder / "new.yaml"
    file.write_text(from_answers(ask(typed(answers), pytest.fail)))
    return load_vehicle(file)


def test_another_vehicle_is_described(tricycle, tmp_path, capsys):
    strong = tmp_path / "strong.yaml"
    strong.write_text(
        CARGO.read_text().replace("motor_torque: {value: 35", "motor_torque: {value: 45")
    )
    tricycle("vehicle", "check", strong, "--json")
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert "motor_torque: 45 N m, of which the boards use 35" in result["warnings"]
    assert "speed_gain_integral: 35 N m/rad; the firmware has 20" in result["warnings"]
    assert next(iter(result["unknown"])) == "yaw_inertia"
    assert len(result["unknown"]) == 5


def test_vehicle_check_warns_about_the_papers_inertia(tricycle, capsys):
    assert tricycle("vehicle", "check") == 0
    output = capsys.readouterr().out
    assert "tricycle: valid" in output
    assert "warning: yaw_inertia: 50 kg m^2 is larger" in output


def test_the_picture_shows_every_wheel_with_its_load(tricycle, tmp_path, capsys):
    picture = tmp_path / "cargo.svg"
    assert tricycle("vehicle", "check", CARGO, "--draw", picture) == 0
    assert f"figure: {picture}" in capsys.readouterr().out
    text = picture.read_text()
    assert ElementTree.fromstring(text).tag.endswith("svg")
    for shown in ("left", "right", "rear", "driven", "braked", "95 kg", "wheelbase 1.6 m"):
        assert f"<!-- {shown}" in text or shown in text


def test_a_picture_that_cannot_be_written_leaves_the_old_one(tricycle, tmp_path, monkeypatch):
    picture = tmp_path / "cargo.svg"
    picture.write_text("mine")

    def half(figure, path, **options):
        path.write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", half)
    with pytest.raises(OSError, match=r"No space left on device: .*cargo\.svg"):
        tricycle("vehicle", "check", CARGO, "--draw", picture, "--overwrite")
    assert picture.read_text() == "mine"
    assert [file.name for file in tmp_path.iterdir()] == ["cargo.svg"]


def test_a_picture_of_another_format_is_refused(tricycle, tmp_path, capsys):
    with pytest.raises(SystemExit, match="2"):
        tricycle("vehicle", "check", "--draw", tmp_path / "cargo.gif")
    assert "cargo.gif: needs to end in one of .svg, .png, .pdf" in capsys.readouterr().err
    assert not (tmp_path / "cargo.gif").exists()


@pytest.mark.parametrize("size", [SMALL, LARGE], ids=lambda size: size["name"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_dozen_answers_make_a_vehicle(tmp_path, layout, size):
    vehicle = vehicle_of({**size, "layout": layout}, tmp_path)
    assert {w.name: w.axle for w in vehicle.wheels} == {
        name: axle for axle, names in LAYOUTS[layout].items() for name in names
    }
    assert {w.axle for w in vehicle.wheels if w.steered} == {"front"}
    assert {w.axle for w in vehicle.wheels if w.driven and w.braked} == {"rear"}
    assert (vehicle.mass, vehicle.wheelbase) == (float(size["mass"]), float(size["wheelbase"]))
    assert sum(vehicle.static_loads()) == pytest.approx(9.81 * vehicle.mass)
    assert warnings_about(vehicle) == ()


def assert_it_drives(vehicle):
    check_step(vehicle, 0.01)
    motion = simulate(vehicle, Commands([0.0, 3.0], [0.1, 0.0], [0.5, 0.0]))
    assert motion.x[0, -1] > 0.8
    assert motion.yaw[0, -1] > 0.02


@pytest.mark.slow
@pytest.mark.parametrize("size", [SMALL, LARGE], ids=lambda size: size["name"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_vehicle_of_answers_drives(tmp_path, layout, size):
    assert_it_drives(vehicle_of({**size, "layout": layout}, tmp_path))


@pytest.mark.slow
@pytest.mark.parametrize("driven", ["front", "all"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_vehicle_of_answers_drives_with_rear_steering_and_a_law_for_each_axle(
    tmp_path, layout, driven
):
    tyres = {"front.tyre": "fiala", "rear.tyre": "magic_formula"}
    vehicle = vehicle_of(
        {**LARGE, **tyres, "layout": layout, "steered": "rear", "driven": driven}, tmp_path
    )
    assert {w.axle for w in vehicle.wheels if w.steered} == {"rear"}
    assert all(w.driven == (driven == "all" or w.axle == driven) for w in vehicle.wheels)
    assert tyres.items() <= vehicle.parts.items()
    assert_it_drives(vehicle)


def test_the_rear_tyres_law_is_that_of_the_front_unless_another_is_named(tmp_path):
    assert vehicle_of({**LARGE, "front.tyre": "fiala"}, tmp_path).parts["tyre"] == "fiala"


ACTUATORS = {
    "servo": ("geared", {"servo_delay": "0", "servo_backlash": "2"}),
    "motor": ("direct_torque", {"setpoint_torque": "30"}),
    "throttle": ("throttle_curve", {
        "throttle_full_setpoint": "4", "throttle_torque_25": "0", "throttle_torque_50": "40",
        "throttle_torque_75": "90", "throttle_torque_100": "180"}),
}  # fmt: skip


@pytest.mark.parametrize("case", ACTUATORS)
def test_a_part_is_asked_for_what_it_uses(tricycle, tmp_path, monkeypatch, case):
    """A terminal: the questions that are printed, and what the file has of their answers."""
    law, own = ACTUATORS[case]
    part = "motor" if case == "throttle" else case
    answer, prompts = typed({**LARGE, part: law, **own}), []
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", lambda text: prompts.append(text) or answer(text))
    assert tricycle("vehicle", "new", tmp_path / "new.yaml") == 0
    vehicle = load_vehicle(tmp_path / "new.yaml")
    assert vehicle.parts[part] == law
    for name, value in own.items():
        scale = math.pi / 180.0 if name == "servo_backlash" else 1.0
        assert vehicle.values[name] == pytest.approx(scale * float(value))
    asked = [q.key for q in QUESTIONS if any(text.startswith(q.text) for text in prompts)]
    others = {name for _, constants in ACTUATORS.values() for name in constants} - own.keys()
    assert own.keys() <= set(asked)
    assert not others & set(asked)
    assert ("speed_gain_proportional" in vehicle.values) == (part == "servo")


def at_a_terminal(monkeypatch, answers):
    """Have these answers typed."""
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", typed(answers))


@pytest.mark.parametrize("voltage", ["1", "60", "72", "1000"])
def test_a_battery_of_any_voltage_makes_a_vehicle(tricycle, tmp_path, monkeypatch, voltage):
    at_a_terminal(monkeypatch, {**LARGE, "battery_voltage": voltage})
    assert tricycle("vehicle", "new", tmp_path / "new.yaml") == 0
    assert load_vehicle(tmp_path / "new.yaml").battery_voltage == float(voltage)


@pytest.mark.parametrize("answer", [{"front_track": "5"}, {"wheelbase": "0.05"}])
def test_answers_that_make_no_vehicle_are_told_and_nothing_is_written(
    tricycle, tmp_path, monkeypatch, answer
):
    at_a_terminal(monkeypatch, {**LARGE, **answer})
    with pytest.raises(VehicleError, match=r"new\.yaml, not written: steering_limit: .* deg"):
        tricycle("vehicle", "new", tmp_path / "new.yaml")
    assert not list(tmp_path.iterdir())


def test_a_wrong_answer_is_asked_again():
    said = []
    lines = iter(["", "x\ty", "x", "sedan", "delta"])
    read = typed(LARGE)

    def slips(prompt):
        first = prompt.startswith(("name", "wheels"))
        return next(lines) if first else read(prompt)

    answers = ask(slips, said.append)
    assert (answers["name"], answers["layout"]) == ("x", "delta")
    assert said == [*2 * ["needs a printable text"], "'sedan': must be one of tadpole, delta, car"]


@pytest.mark.parametrize(
    ("line", "problem"), [("heavy", "'heavy': needs a number"), ("0", "must be between 0.1 and")]
)
def test_numbers_out_of_bounds_are_no_answer(line, problem):
    (mass,) = [question for question in QUESTIONS if question.key == "mass"]
    with pytest.raises(ValueError, match=problem):
        mass.read(line)


def test_new_from_a_file_is_the_same_vehicle(tricycle, tmp_path):
    file = tmp_path / "mine.yaml"
    assert tricycle("vehicle", "new", file, "--from", CARGO) == 0
    mine, cargo = load_vehicle(file), load_vehicle(CARGO)
    assert mine.name == "mine"
    assert (mine.values, mine.unknown) == (cargo.values, cargo.unknown)
    assert "# road_grade: {value: 0.0" in file.read_text()


def test_new_from_a_shipped_vehicle(tricycle, tmp_path, capsys):
    file = tmp_path / "all mine.yaml"
    assert tricycle("vehicle", "new", file, "--from", "tricycle") == 0
    assert f"tricycle vehicle check '{file}'" in capsys.readouterr().out  # as a shell needs it
    assert load_vehicle(file).values == load_vehicle().values


def test_a_name_that_is_no_vehicle_is_told_with_those_that_are(tricycle, tmp_path):
    with pytest.raises(VehicleError, match=r"tricyle: no such file; shipped are .*, tricycle"):
        tricycle("vehicle", "new", tmp_path / "mine.yaml", "--from", "tricyle")


def test_a_file_that_is_there_is_kept(tricycle, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("precious")
    with pytest.raises(ExcitationError, match="exists already; --overwrite replaces it"):
        tricycle("vehicle", "new", file, "--from", CARGO)
    assert file.read_text() == "precious"
    assert tricycle("vehicle", "new", file, "--from", CARGO, "--overwrite") == 0
    assert load_vehicle(file).name == "mine"


def test_without_a_terminal_nothing_is_asked(tricycle, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    with pytest.raises(VehicleError, match="this is not a terminal: give --from FILE"):
        tricycle("vehicle", "new", tmp_path / "mine.yaml")


@pytest.mark.slow
def test_what_follows_from_a_vehicle_is_printed(tricycle, capsys):
    tricycle("vehicle", "show", "urdf", CARGO)
    assert ElementTree.fromstring(capsys.readouterr().out).get("name") == "cargo_tadpole"
    tricycle("vehicle", "show", "foxglove", CARGO)
    assert "configById" in json.loads(capsys.readouterr().out)
    tricycle("vehicle", "show", "bridge", CARGO)
    (section,) = yaml.safe_load(capsys.readouterr().out).values()
    assert section["ros__parameters"]["wheelbase"] == pytest.approx(1.6)
