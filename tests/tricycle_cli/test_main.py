"""The command line: a user's mistake is one line on stderr and status 2, never a traceback."""

import json
import re
from importlib import resources

import pytest

from excitation_planner.maneuver import Circle
from excitation_planner.plan import save_plan
from excitation_planner.planning import PlanRequest, plan_at
from tricycle_cli.main import COMMANDS, main
from tricycle_sim.vehicle import load_vehicle


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "not_a_plan.json").write_text("{}")
    text = (resources.files("tricycle_sim") / "tricycle.yaml").read_text()
    assert "[500.0, 1500.0]" in text
    upside_down = text.replace("[500.0, 1500.0]", "[1500.0, 500.0]")
    (tmp_path / "upside_down.yaml").write_text(upside_down)
    known = re.sub(r"(camber_stiffness: \{)nominal: (\S+), range: \[.*?\]", r"\1value: \2", text)
    assert known != text
    (tmp_path / "camber_known.yaml").write_text(known)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("plan --target mass", "unknown target 'mass'"),
        ("plan --maneuver figure-eight", "there are: circle, double_lane_change"),
        ("plan --at radius=3", "circle takes radius, speed; got radius"),
        ("plan --at radius=3 speed=fast", "'speed=fast': want name=number"),
        ("plan --at radius=2 speed=1", "circle: the steering saturates at"),
        ("plan --noise-std -1", "noise_std = -1 m must be from 0 to 10"),
        ("plan --samples 3", "samples = 3"),
        ("plan --vehicle nowhere.yaml", "nowhere.yaml"),
        ("plan --target camber_stiffness --vehicle camber_known.yaml", "'camber_stiffness'"),
        ("demo --target mass", "unknown target 'mass'"),
        ("demo --firmware nowhere", "nowhere/steer.elf does not exist"),
        ("plc probe /dev/nowhere", "/dev/nowhere"),
        ("plan --vehicle upside_down.yaml", "[1500, 500] is upside down"),
        ("plan show not_a_plan.json", "not_a_plan.json: schema None"),
        ("plan show nowhere.json", "nowhere.json"),
        ("plan sho plan.json", "want `tricycle plan show FILE`"),
        ("drive nowhere.json", "nowhere.json"),
        ("judge nowhere", "nowhere"),
        (
            "simulate --maneuver circle radius=9 speed=0.8 --output a.csv",
            "outside its range 2 to 6",
        ),
        ("vehicle check upside_down.yaml", "[1500, 500] is upside down"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(line, message, capsys):
    assert main(line.split()) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    last = [text for text in errors.splitlines() if text.startswith("tricycle: ")]
    assert len(last) == 1
    assert message in last[0]
    assert "Traceback" not in errors


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example(command, capsys):
    with pytest.raises(SystemExit) as stop:
        main([command, "--help"])
    assert stop.value.code == 0
    assert f"tricycle {command}" in capsys.readouterr().out.partition("example")[2]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("fly", "invalid choice: 'fly'"),
        ("demo --seed -4", "argument --seed: '-4' must be a whole number from 0"),
        ("demo --real-time-factor fast", "'fast' must be from 0 (as fast as it runs) to 1000"),
    ],
)
def test_an_argument_that_cannot_be_is_status_2(line, message, capsys):
    with pytest.raises(SystemExit) as stop:
        main(line.split())
    assert stop.value.code == 2
    assert message in capsys.readouterr().err


def test_plan_prints_one_json_object_and_writes_plan_and_figure(capsys, tmp_path):
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
    assert (tmp_path / "p" / "plan.json").exists()
    assert (tmp_path / "p" / "plan.png").read_bytes().startswith(b"\x89PNG")


def test_demo_does_not_touch_the_bags_of_an_earlier_one(capsys, tmp_path):
    bag = tmp_path / "demo" / "bags" / "designed"
    bag.mkdir(parents=True)
    assert main(["demo", "--output", "demo"]) == 2
    assert "holds bags already" in capsys.readouterr().err
    assert bag.exists()


def test_a_plan_is_shown(capsys, tmp_path):
    request = PlanRequest(load_vehicle(), Circle(), "camber_stiffness", samples=20)
    save_plan(plan_at(request, Circle().operation.from_unit([0.5, 0.5])), tmp_path / "plan.json")
    assert main(["plan", "show", "plan.json"]) == 0
    output = capsys.readouterr().out
    assert "(target)" in output
    assert (tmp_path / "plan.png").exists()
