"""The table of the intervals that a campaign's drives were to give, and gave."""

import numpy as np
import pytest

from excitation_planner.maneuver import Circle
from parameter_identification.identification_file import IdentificationDocument, ParameterEntry
from tricycle_cli.campaign.intervals_section import intervals_section
from tricycle_cli.campaign.request import CampaignRequest
from tricycle_cli.campaign.state_file import CampaignState, Step
from tricycle_cli.main import main
from tricycle_sim.vehicle import load_vehicle


@pytest.fixture
def folder(tmp_path):
    """Folder of a campaign of two drives, of which the second is not identified yet."""
    range_ = (500.0, 1500.0)
    stiffness = ParameterEntry(
        estimate=700.0, low=680.4, high=719.6, unit="N/rad", range=range_, identifiable=True
    )
    unseen = ParameterEntry(estimate=1000.0, low=500.0, high=1500.0, range=range_)
    found = IdentificationDocument(
        level=0.95,
        parameters={"cornering_stiffness": stiffness, "camber_stiffness": unseen},
        covariance=np.eye(2),
    )
    names = "cornering_stiffness", "plans/01.json", "bags/01", "double_lane_change"
    std = {"cornering_stiffness": 5.0, "camber_stiffness": 100.0}
    steps = (
        Step(*names, {}, "id", 20.0, std, driven=True, identification=found),
        Step("camber_stiffness", "plans/02.json", "bags/02", "circle", {}, "id", 8.0, std),
    )
    request = CampaignRequest(load_vehicle(), (Circle(),), ("cornering_stiffness",), 0.05)
    CampaignState(request.settings(), steps).write(tmp_path / "campaign.json")
    return tmp_path


def test_every_parameter_has_both_intervals_after_each_drive(folder):
    (table,) = intervals_section(folder).blocks
    after = "1: double lane change", "cornering_stiffness (target)"
    assert table.rows == (
        (*after, "N/rad", "700", "±\u00a09.8", "680.4 … 719.6", "2.00"),
        ("", "camber_stiffness", "", "not shown", "±\u00a0196", "500 … 1500", "2.55"),
    )


def test_a_folder_without_a_campaign_has_no_such_section(tmp_path):
    assert intervals_section(tmp_path) is None


def test_a_file_of_another_program_is_told(folder):
    (folder / "campaign.json").write_text("{}")
    (text,) = intervals_section(folder).blocks
    assert text.startswith("Not shown: ")
    assert "campaign.json" in text


@pytest.mark.slow
def test_the_report_of_a_campaign_has_the_table(folder, record_drive):
    record_drive(folder / "bags" / "01")
    assert main(["report", str(folder)]) == 0
    page = (folder / "report.html").read_text()
    assert page.index("<h2>Results</h2>") < page.index("<h2>Intervals expected and found</h2>")
    assert ">680.4 … 719.6</td>" in page
