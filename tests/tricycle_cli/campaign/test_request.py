"""What a campaign can be asked for."""

import json
from importlib.resources import files
from pathlib import Path

import pytest
import yaml

from excitation_planner.design.noise import SIMULATED, MeasurementNoise
from excitation_planner.maneuver import Circle
from tricycle_bringup.configuration import SIMULATION_CONFIG
from tricycle_cli.campaign.request import CampaignRequest
from tricycle_core.errors import PlanError
from tricycle_core.timing import TICK
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


def test_a_simulated_campaign_is_planned_for_what_the_simulation_measures():
    nodes = json.loads((files("tricycle_core") / "nodes.json").read_text())
    defaults = {name: default for name, default, *_ in nodes["TricycleSim"][1]}
    assert SIMULATED.noise_std == float(defaults["position_noise"])
    assert SIMULATED.heading_std == float(defaults["yaw_noise"])
    assert SIMULATED.yaw_rate_std == float(defaults["yaw_rate_noise"])
    assert SIMULATED.pose_rate == SIMULATED.gyro_rate == 1.0 / TICK


def test_the_planner_node_of_a_simulation_counts_on_the_same():
    planner = yaml.safe_load(Path(SIMULATION_CONFIG).read_text())["/**/excitation_planner"]
    assert MeasurementNoise(**planner["ros__parameters"]) == SIMULATED
