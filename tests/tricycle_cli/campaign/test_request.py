"""What a campaign can be asked for."""

import pytest

from excitation_planner.design.noise import MeasurementNoise
from excitation_planner.maneuver import Circle
from tricycle_cli.campaign.request import CampaignRequest
from tricycle_core.errors import PlanError
from tricycle_sim.vehicle import load_vehicle


def request(tolerance=0.05, **changes):
    return CampaignRequest(
        load_vehicle(), (Circle(),), ("cornering_stiffness",), tolerance, **changes
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tolerance": 0.0}, "tolerance 0 must be"),
        ({"most_drives": 0}, "most drives 0"),
        ({"noise": MeasurementNoise(noise_std=0.0)}, "criterion c needs noise_std above 0"),
    ],
)
def test_impossible_requests_are_refused(changes, message):
    with pytest.raises(PlanError, match=message):
        request(**changes)


def test_what_may_change_while_a_campaign_goes_on_is_no_setting():
    assert request(0.02, most_drives=3, budget=100).settings() == request().settings()
    assert request(seed=1).settings() != request().settings()
