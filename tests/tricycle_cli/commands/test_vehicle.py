"""`tricycle vehicle check`: what a vehicle file says, and what is doubtful in it."""

import json
from importlib import resources

CARGO = resources.files("tricycle_sim") / "cargo_tricycle.yaml"


def test_another_vehicle_is_described(tricycle, capsys):
    tricycle("vehicle", "check", CARGO, "--json")
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert result["warnings"] == []
    assert next(iter(result["unknown"])) == "cornering_stiffness"
    assert len(result["unknown"]) == 4


def test_vehicle_check_warns_about_the_papers_inertia(tricycle, capsys):
    assert tricycle("vehicle", "check") == 0
    output = capsys.readouterr().out
    assert "tricycle: valid" in output
    assert "warning: yaw_inertia: 50 kg m^2 is larger" in output
