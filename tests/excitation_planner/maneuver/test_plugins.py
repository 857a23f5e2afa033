"""Families of other distributions: the classes and the entry points of the how-to, installed."""

import csv
import pickle
import re
import sys
import tomllib
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from excitation_planner.maneuver.family import family_by_name, family_names, operation_point
from excitation_planner.planning.replay import ReplayedTrajectoryError
from tricycle_cli import main as cli
from tricycle_core.errors import PlanError
from tricycle_sim.vehicle import load_vehicle

PAGE = Path(__file__).parents[3] / "docs" / "how-to-maneuver-family.md"
EXAMPLE = re.search(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)[1]
POINTS = tomllib.loads(re.search(r"```toml\n(.*?)```", PAGE.read_text(), re.DOTALL)[1])
(GROUP, ENTRIES) = POINTS["project"]["entry-points"].popitem()


@pytest.fixture
def install(install_distribution):
    """Install a distribution of one module and its families."""
    return partial(install_distribution, GROUP)


@pytest.mark.slow
def test_the_families_of_the_how_to_are_listed_planned_and_simulated(install, tmp_path, capsys):
    install("skid_pad", "skid_pad", EXAMPLE, ENTRIES)
    assert "j_turn" in family_names()
    family = family_by_name("j-turn")
    x = operation_point(family, {"rate": 0.2, "speed": 1.5})
    vehicle = load_vehicle()
    simulator = pickle.loads(pickle.dumps(ReplayedTrajectoryError(vehicle, family)))
    assert simulator(x, vehicle.nominal_point()[np.newaxis])[0] == pytest.approx(0.0, abs=1e-20)

    file = tmp_path / "j_turn.csv"
    arguments = ["--maneuver", "j-turn", "rate=0.2", "speed=1.5", "--output", str(file)]
    assert cli.main(["simulate", *arguments]) == 0
    assert file.exists()
    for point in ("length=6 speed=1.5", "length=12 speed=0.8"):
        arguments = ["--maneuver", "lane-change", *point.split(), "--output", str(file)]
        assert cli.main(["simulate", *arguments, "--overwrite"]) == 0
        with file.open() as rows:
            *_, last = csv.DictReader(rows)
        assert float(last["y"]) == pytest.approx(1.0, abs=0.05)
    with pytest.raises(SystemExit):
        cli.main(["plan", "--help"])
    assert "j_turn" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("raise RuntimeError('of its own')", r"'j_turn' cannot be loaded .*of its own"),
        ("JTurn = 5", "'j_turn' cannot be loaded from skid_pad_broken:JTurn"),
        ("JTurn = dict", "not a maneuver family with the name 'j_turn'"),
        (EXAMPLE.replace('"j_turn"', '"k_turn"'), "not a maneuver family with the name 'j_turn'"),
    ],
)
def test_a_broken_family_is_one_line(install, monkeypatch, source, message):
    install("skid_pad", "skid_pad_broken", source, {"j_turn": "skid_pad_broken:JTurn"})
    monkeypatch.delitem(sys.modules, "skid_pad_broken", raising=False)
    with pytest.raises(PlanError, match=message) as caught:
        family_by_name("j_turn")
    assert "\n" not in str(caught.value)


def test_two_classes_under_one_name_are_refused(install):
    install("skid_pad_circle", "skid_pad_circle", "", {"circle": "skid_pad_circle:Circle"})
    with pytest.raises(PlanError, match=r"'circle' is registered for .* and for "):
        family_by_name("circle")
    assert family_by_name("slalom").name == "slalom"
