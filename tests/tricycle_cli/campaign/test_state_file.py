"""The state of a campaign is read as it was written; files of before too; others are refused."""

import json

import numpy as np
import pytest

from excitation_planner.design.noise import SIMULATED
from parameter_identification.identification_file import IdentificationDocument, ParameterEntry
from tricycle_cli.campaign.request import Settings
from tricycle_cli.campaign.state_file import CampaignState, Step
from tricycle_core.errors import PlanError

SETTINGS = Settings(
    "tricycle", "0" * 64, ("circle",), 1, SIMULATED, None, {"circle.radius": (2.0, 6.0)}
)
STEP = Step(
    "mass", "plans/01.json", "bags/01", "circle", {"radius": 3.0}, "id", 8.0, {"mass": 2.0}, True
)  # fmt: skip


def test_it_is_read_as_it_was_written(tmp_path):
    state = CampaignState(SETTINGS, (STEP,))
    state.write(tmp_path / "campaign.json")
    assert CampaignState.read(tmp_path / "campaign.json") == state
    written = json.loads((tmp_path / "campaign.json").read_text())
    assert list(written) == ["schema", "settings", "steps", "topics"]


def test_what_was_identified_is_read_with_it(tmp_path):
    entry = ParameterEntry(
        estimate=30.0, low=29.0, high=31.0, standard_deviation=0.5, range=(20.0, 40.0)
    )
    found = IdentificationDocument(
        level=0.95, parameters={"mass": entry}, covariance=np.array([[0.25]])
    )
    step = Step(**vars(STEP) | {"identification": found})
    CampaignState(SETTINGS, (step,)).write(tmp_path / "campaign.json")
    (read,) = CampaignState.read(tmp_path / "campaign.json").steps
    assert read.identification.parameters == {"mass": entry}
    assert read.identification.covariance.tolist() == [[0.25]]


@pytest.mark.parametrize(
    "elsewhere",
    [{"bag": "/home/me"}, {"bag": "bags/../.."}, {"bag": "bags/01/.."}, {"plan": "../plan.json"}],
)
def test_plans_and_bags_elsewhere_are_refused(elsewhere, tmp_path):
    file = tmp_path / "campaign.json"
    CampaignState(SETTINGS, (STEP,)).write(file)
    values = json.loads(file.read_text())
    values["steps"][0] |= elsewhere
    file.write_text(json.dumps(values))
    with pytest.raises(PlanError, match=r"state of a campaign: steps\[0\]: '.*' must be"):
        CampaignState.read(file)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not JSON"),
        ("[]", "not the state of a campaign"),
        (json.dumps({"schema": 9}), "schema 9; this one reads 3"),
        (json.dumps({"schema": 3, "settings": {}}), "not the state of a campaign"),
    ],
)
def test_another_file_is_refused_with_its_name(text, message, tmp_path):
    file = tmp_path / "campaign.json"
    file.write_text(text)
    with pytest.raises(PlanError, match=message) as refused:
        CampaignState.read(file)
    assert str(file) in str(refused.value)
