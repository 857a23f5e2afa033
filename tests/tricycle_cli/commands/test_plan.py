"""`tricycle plan`: a plan with its figure, and what of it is printed."""

import json
from importlib import resources

import pytest

from excitation_planner.maneuver import Circle
from excitation_planner.plan import save_plan
from excitation_planner.planning import PlanRequest, plan_at
from tricycle_cli.main import main
from tricycle_sim.vehicle import load_vehicle


@pytest.mark.slow
def test_plan_prints_one_json_object_and_writes_plan_and_figure(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert (
        main(
            ["plan", "--at", "radius=3", "speed=0.8", "--samples", "20", "--json", "--output", "p"]
        )
        == 0
    )
    result = json.loads(capsys.readouterr().out)
    assert {"maneuver", "target", "x", "cost", "main", "total", "variance"} <= set(result)
    assert {"leave_one_out_q2", "simulations", "seconds", "feasible"} <= set(result)
    assert result["x"] == {"radius": 3.0, "speed": 0.8}
    assert result["ranges"] == {"radius": [2.0, 6.0], "speed": [0.6, 1.0]}
    assert (tmp_path / "p" / "plan.json").exists()
    assert (tmp_path / "p" / "plan.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_a_plan_is_shown(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    request = PlanRequest(load_vehicle(), Circle(), "camber_stiffness", samples=20)
    save_plan(plan_at(request, Circle().operation.from_unit([0.5, 0.5])), tmp_path / "plan.json")
    assert main(["plan", "show", "plan.json"]) == 0
    output = capsys.readouterr().out
    assert "circle for camber_stiffness: radius = 4" in output
    assert (tmp_path / "plan.png").exists()


@pytest.mark.slow
def test_a_plan_is_made_in_the_search_box_that_is_given_and_shown(capsys, tmp_path):
    (tmp_path / "yard.yaml").write_text("circle: {speed: [0.5, 0.8]}")
    command = ["plan", "--at", "radius=9", "speed=0.8", "--samples", "20"]
    command += ["--range", "radius=3:12", "--ranges", str(tmp_path / "yard.yaml")]
    assert main([*command, "--output", str(tmp_path)]) == 0
    output = capsys.readouterr().out
    assert "allowed: radius=3:12 speed=0.5:0.8, speed at the end of its range" in output
    assert "position ± 10 mm and heading ± 2 mrad at 100 Hz, gyro ± 5 mrad/s at 100 Hz" in output


@pytest.mark.slow
@pytest.mark.slow
def test_the_place_and_a_doubtful_size_of_an_area_are_told(capsys, tmp_path):
    yard = tmp_path / "yard.yaml"
    for side, warned in ((2000, False), (12000, True)):
        corners = [[0, 0], [side, 0], [side, 25], [0, 25]]
        yard.write_text(f"keep_in: {corners}\ndatum: [6.6323, 46.5197]\n")
        options = ("--at", "radius=4", "speed=0.8", "--output", tmp_path / "plan", "--overwrite")
        main(["plan", "--area", str(yard), *map(str, options)])
        told = capsys.readouterr()
        assert (
            "in odom, its origin at latitude 6.6323°, longitude 46.5197°; " in told.out + told.err
        )
        warning = f"warning: {yard}: keep_in: is 12000 m x 25 m large; its corners are in m\n"
        assert (warning in told.err) == warned


def test_a_plan_is_replaced_only_when_asked(capsys, tmp_path):
    for name in ("plan-1.json", "plan-2.json", "notes.json"):
        (tmp_path / name).write_text("{}")
    command = ["plan", "--at", "radius=3", "speed=0.8", "--samples", "20", "--output"]
    assert main([*command, str(tmp_path)]) == 2
    earlier = tmp_path / "plan-1.json"
    assert f"{earlier}: exists already; --overwrite replaces it" in capsys.readouterr().err
    assert main([*command, str(tmp_path), "--overwrite"]) == 0
    assert {p.name for p in tmp_path.glob("*.json")} == {"plan.json", "notes.json"}


@pytest.mark.slow
def test_an_impossible_inertia_is_warned_of_in_a_file_of_the_user_only(capsys, tmp_path):
    command = ["plan", "--at", "radius=3", "speed=0.8", "--samples", "20", "--output"]
    assert main([*command, str(tmp_path / "packaged")]) == 0
    assert "warning" not in capsys.readouterr().err
    with resources.as_file(resources.files("tricycle_sim") / "tricycle.yaml") as file:
        assert main([*command, str(tmp_path / "own"), "--vehicle", str(file)]) == 0
    assert "warning: yaw_inertia: 50 kg m^2 is larger than the sum" in capsys.readouterr().err


@pytest.mark.slow
def test_a_plan_is_shown_where_nothing_can_be_drawn_and_its_picture_is_kept(plan, capsys, tmp_path):
    file, picture = tmp_path / "mine.json", tmp_path / "mine.png"
    save_plan(plan, file)
    picture.mkdir()
    assert main(["plan", "show", str(file), "--overwrite"]) == 2
    assert "circle for cornering_stiffness" in capsys.readouterr().out
    picture.rmdir()
    picture.write_text("precious")
    assert main(["plan", "show", str(file)]) == 0
    assert picture.read_text() == "precious"
    assert main(["plan", "show", str(file), "--overwrite"]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_file_in_the_place_of_the_output_is_told_before_anything_is_planned(capsys, tmp_path):
    (tmp_path / "taken").touch()
    assert main(["plan", "--output", str(tmp_path / "taken" / "plans")]) == 2
    taken = tmp_path / "taken"
    assert capsys.readouterr().err == f"tricycle: {taken} is a file; a folder is needed\n"


def test_help_names_the_search_boxes(capsys):
    with pytest.raises(SystemExit):
        main(["plan", "--help"])
    assert "circle: radius=2:6 speed=0.6:1" in capsys.readouterr().out


@pytest.mark.parametrize("option", ["--maneuver circle", "--at foo", "--seed 0", "--noise-std 0"])
def test_an_option_of_planning_is_refused_where_a_plan_is_shown(option, capsys):
    assert main(["plan", "show", "plan.json", *option.split()]) == 2
    given = option.split()[0]
    (said,) = capsys.readouterr().err.splitlines()
    assert said == f"tricycle: {given}: `plan show FILE` plans nothing; leave it out"
