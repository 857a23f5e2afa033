"""What an identification found: its page, its files and its remarks."""

import dataclasses
import io

import numpy as np
import pytest
from rich.console import Console

from parameter_identification.drives.measured import Sensor
from parameter_identification.estimation.model import Prediction
from parameter_identification.estimation.noise import NoiseLevel
from parameter_identification.estimation.results import (
    Combination,
    DriveFit,
    Estimate,
    HeldOut,
    Identification,
    Lack,
    NuisanceEstimate,
    Profile,
)
from parameter_identification.estimation.whiteness import Whiteness
from parameter_identification.identification_file import load_identification_file
from tricycle_cli.reports.identification_page import (
    CONDITIONS,
    drawn_drives,
    identification_page,
    lack_figure,
    profiles_figure,
    residuals_figure,
    save_identification,
    trajectories_figure,
)
from tricycle_cli.reports.remarks import remarks
from tricycle_cli.reports.tables import parameter_table
from tricycle_sim.vehicle import load_vehicle

LEFT = "left of the model / m"
TIME = np.linspace(0.0, 2.0, 50)


def predicted(offset):
    values = np.column_stack([TIME, offset * np.sin(TIME)])
    residual = np.full((len(TIME), 2), 0.003)
    return {
        Sensor.POSITION: Prediction(
            Sensor.POSITION, TIME, values, residual, np.empty(0), ("x", "y")
        )
    }


@pytest.fixture
def found():
    """Return an identification of one short drive that shows one of two parameters."""
    profile = Profile(np.array([590.0, 600.0, 611.0]), np.array([3.9, 0.0, 3.9]))
    nuisances = {"gyro bias": NuisanceEstimate(0.1, 0.01, "rad/s")}
    row = np.array([0.5, 1.5])
    lack = Lack(row, row + 1.0, 0.1 * row, -row, {LEFT: row}, {LEFT: 0.1 * row})
    return Identification(
        vehicle="tricycle",
        vehicle_hash=load_vehicle().fingerprint,
        parameters={
            "cornering_stiffness": Estimate(
                *("N/rad", 600.0, 5.0, 590.0, 611.0, (591.0, 610.0), (500.0, 1500.0), True, profile)
            ),
            "yaw_inertia": Estimate(
                *("kg m^2", 50.0, 14.0, 25.0, 75.0, (25.0, 75.0), (25.0, 75.0), False)
            ),
        },
        covariance=np.array([[25.0, 1.0], [1.0, 196.0]]),
        fixed={},
        hidden=(Combination({"yaw_inertia": 1.0}, 0.97),),
        noise={Sensor.POSITION: NoiseLevel(0.01, 0.0, 1.0)},
        whiteness=(
            Whiteness("first", "x", 0.003, 0.1, 90.0, 100, 0.5),
            Whiteness("first", "y", 0.003, np.nan, np.nan, 100, np.nan),
        ),
        drives=(DriveFit("first", nuisances, predicted(0.5), predicted(1.0), {}, lack),),
        held_out=(HeldOut("second", 0.2, 0.02, 0.014),),
        outliers=3,
        rivals=(np.array([700.0, 55.0]),),
        starts=(4, 3),
        truth={"cornering_stiffness": 601.0},
        level=0.95,
        seed=1,
        seconds=2.5,
    )


@pytest.mark.slow
def test_the_page_begins_with_the_parameters_and_what_the_drives_do_not_show(found):
    page = identification_page(found)
    for text in ("600 ± 5", "590 – 611", "601 ✓", "not shown", "gyro bias", "0.1 ± 0.01"):
        assert text in page
    assert page.index("Parameters") < page.index("Trajectories") < page.index("Residuals")
    assert page.count("<img") == 4


@pytest.mark.slow
def test_without_profiles_there_is_no_figure_of_them(found):
    plain = {name: dataclasses.replace(e, profile=None) for name, e in found.parameters.items()}
    page = identification_page(dataclasses.replace(found, parameters=plain))
    assert "Profiles" not in page
    assert page.count("<img") == 3


def test_remarks_say_what_a_reader_must_know(found):
    lines = remarks(found)
    for text in (
        "yaw_inertia (1σ is 97% of the range",
        "1 other set(s)",
        "3 samples",
        "second, not",
    ):
        assert any(text in line for line in lines), text


def test_that_there_is_no_minimum_is_said_first(found):
    first, *others = remarks(dataclasses.replace(found, converged=False))
    assert first.startswith("NO minimum was found")
    assert remarks(found) == others


def test_the_terminal_shows_a_truth_that_is_given(found):
    console = Console(width=120, file=io.StringIO(), record=True)
    console.print(parameter_table(found, {"yaw_inertia": 90.0}))
    text = console.export_text()
    assert "90 ✗" in text
    assert "601" not in text


def test_figures_have_a_panel_per_drive_channel_and_profile(found):
    assert len(trajectories_figure(found).axes) == 2
    assert len(residuals_figure(found).axes) == 2
    panels = lack_figure(found).axes
    assert [axes.get_xlabel() for axes in panels] == list(CONDITIONS)
    assert panels[1].lines[0].get_xdata().tolist() == [1.5, 2.5]  # over the speed
    (profile,) = (axes for axes in profiles_figure(found).axes if axes.lines)
    assert list(profile.lines[0].get_ydata()) == [3.9, 0.0, 3.9]


def test_what_looks_like_a_formula_in_a_name_is_none(found):
    name = "cost $x^{$"
    drives = (dataclasses.replace(found.drives[0], name=name),)
    tests = tuple(dataclasses.replace(test, drive=name) for test in found.whiteness)
    found = dataclasses.replace(found, drives=drives, whiteness=tests)
    for draw in (trajectories_figure, residuals_figure, lack_figure):
        draw(found).savefig(io.BytesIO(), format="svg")


def test_the_numbers_are_saved_also_where_a_figure_cannot_be_drawn(found, tmp_path, monkeypatch):
    monkeypatch.delattr("tricycle_cli.reports.identification_page.trajectories_figure")
    for earlier in ("vehicle.yaml", "report.html", "lack.png"):
        (tmp_path / earlier).write_text("of an earlier identification")
    with pytest.raises(NameError):
        save_identification(found, None, tmp_path)
    assert load_identification_file(tmp_path / "identification.json").vehicle == "tricycle"
    assert [file.name for file in tmp_path.iterdir()] == ["identification.json"]


def test_of_many_drives_those_that_fit_worst_are_drawn(found):
    (drive,) = found.drives
    position = drive.after[Sensor.POSITION]

    def worse(factor):
        after = {
            Sensor.POSITION: dataclasses.replace(position, residual=factor * position.residual)
        }
        return dataclasses.replace(drive, name=str(factor), after=after)

    factors = [1, 9, 8, 2, 7, 3, 6, 5, 4]
    many = dataclasses.replace(found, drives=tuple(worse(factor) for factor in factors))
    assert [one.name for one in drawn_drives(many)] == ["9", "8", "7", "6", "5", "4"]
    assert len(trajectories_figure(many).axes) == 12


@pytest.mark.slow
def test_everything_is_saved_and_can_be_read_again(found, tmp_path):
    save_identification(found, None, tmp_path / "new" / "folder")
    assert {path.name for path in (tmp_path / "new" / "folder").iterdir()} == {
        *("identification.json", "vehicle.yaml", "report.html"),
        *("trajectories.png", "residuals.png", "profiles.png", "lack.png"),
    }
    document = load_identification_file(tmp_path / "new" / "folder" / "identification.json")
    assert document.parameters["cornering_stiffness"].estimate == 600.0
    vehicle = load_vehicle(tmp_path / "new" / "folder" / "vehicle.yaml")
    assert vehicle.nominal["cornering_stiffness"] == 600.0
