"""What a campaign found, as numbers, as a table and as a figure."""

import dataclasses
import io
import json
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.console import Console

from excitation_planner.area.area import Area
from excitation_planner.maneuver import Circle, family_by_name, family_names
from parameter_identification.identification_file import IdentificationDocument, ParameterEntry
from tricycle_cli.campaign.cycle import Campaign
from tricycle_cli.campaign.request import WAY_BACK, CampaignRequest
from tricycle_cli.campaign.results import campaign_report, campaign_table, plot_campaign, plot_yard
from tricycle_cli.campaign.state_file import CampaignState, Step
from tricycle_sim.vehicle import load_vehicle

TRUTH = {"cornering_stiffness": 700.0}


@pytest.fixture
def campaign(tmp_path):
    """Open a campaign of one finished drive."""
    request = CampaignRequest(load_vehicle(), (Circle(),), ("cornering_stiffness",), 0.05)
    entry = ParameterEntry(
        estimate=710.0, low=690.0, high=730.0, standard_deviation=10.0, range=(500.0, 1500.0)
    )
    found = IdentificationDocument(
        level=0.95,
        parameters={"cornering_stiffness": entry},
        covariance=np.array([[100.0]]),
    )
    step = Step(
        target="cornering_stiffness",
        plan="plans/01.json",
        bag="bags/01",
        maneuver="circle",
        operation={"radius": 3.0, "speed": 0.8},
        plan_id="id",
        duration=20.0,
        predicted_std={"cornering_stiffness": 12.0},
        driven=True,
        identification=found,
    )
    CampaignState(request.settings(), (step,)).write(tmp_path / "campaign.json")
    return Campaign(tmp_path, request)


def test_the_report_says_what_is_known_after_each_drive(campaign):
    report = campaign_report(campaign, TRUTH)
    target = report["targets"]["cornering_stiffness"]
    assert target["estimate"] == 710.0
    assert target["truth"] == 700.0
    assert target["half_width"] == pytest.approx(1.96 * 10.0 / 710.0, rel=1e-4)
    assert target["within_tolerance"]
    assert (report["drives"], report["driving_seconds"]) == (1, 20.0)
    assert report["steps"][0]["known"]["cornering_stiffness"] == {"estimate": 710.0, "std": 10.0}
    assert "truth" not in campaign_report(campaign)["targets"]["cornering_stiffness"]


def test_the_table_has_a_row_per_drive(campaign):
    text = text_of(campaign_table(campaign, TRUTH))
    for part in ("wanted: ± 5 %", "nothing: the ranges", "1: circle", "710 ± 2.76%", "700"):
        assert part in text
    assert "expected: if no effects act" not in text  # those of this campaign count none either


def test_an_estimate_of_zero_has_no_share(campaign, tmp_path):
    step = campaign.steps[0]
    entry = step.identification.parameters["cornering_stiffness"]
    zero = {"cornering_stiffness": dataclasses.replace(entry, estimate=0.0)}
    found = dataclasses.replace(step.identification, parameters=zero)
    campaign.steps = (dataclasses.replace(step, identification=found),)
    report = campaign_report(campaign, TRUTH)
    json.dumps(report, allow_nan=False)
    assert report["targets"]["cornering_stiffness"]["half_width"] is None
    assert "0 ± inf%" in text_of(campaign_table(campaign, TRUTH))
    plot_campaign(campaign, TRUTH, tmp_path / "report.png")


def text_of(table):
    console = Console(width=120, file=io.StringIO(), record=True)
    console.print(table)
    return console.export_text()


@pytest.mark.slow
def test_the_figure_is_written(campaign, tmp_path):
    plot_campaign(campaign, TRUTH, tmp_path / "report.png")
    assert (tmp_path / "report.png").read_bytes().startswith(b"\x89PNG")


def test_every_drive_is_drawn_on_the_yard(campaign, record_drive, tmp_path):
    record_drive(tmp_path / "bags" / "01")
    area = Area(np.array([[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]]))
    plot_yard(campaign, area, tmp_path / "yard.png")
    assert (tmp_path / "yard.png").read_bytes().startswith(b"\x89PNG")


def test_a_way_back_that_cannot_be_read_is_not_drawn(campaign, record_drive, tmp_path):
    record_drive(tmp_path / "bags" / "01")
    (tmp_path / WAY_BACK / "01").mkdir(parents=True)
    area = Area(np.array([[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]]))
    plot_yard(campaign, area, tmp_path / "yard.png")
    assert (tmp_path / "yard.png").exists()


def test_every_family_has_a_colour_on_the_yard(campaign, record_drive, tmp_path, monkeypatch):
    record_drive(tmp_path / "bags" / "01")
    another = SimpleNamespace(name="another")  # as packages beside this one may have
    families = (*map(family_by_name, family_names()), another)
    campaign.request = dataclasses.replace(campaign.request, families=families)
    (step,) = campaign.steps
    campaign.steps = tuple(dataclasses.replace(step, maneuver=f.name) for f in families)
    figure = Figure()
    monkeypatch.setattr("tricycle_cli.campaign.results.Figure", lambda **_: figure)
    area = Area(np.array([[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]]))
    plot_yard(campaign, area, tmp_path / "yard.png")
    lines = figure.axes[0].get_legend().get_lines()
    colours = {line.get_label(): line.get_color() for line in lines if "from" in line.get_label()}
    assert len(colours) == len(families)
    assert len(set(colours.values())) == len(families) - 1  # `another` has the first one's
