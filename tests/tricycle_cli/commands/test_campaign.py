"""`tricycle campaign`: a mistake is found before anything is made."""

import contextlib
import dataclasses
import io
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from parameter_identification.identification_file import IdentificationDocument, ParameterEntry
from tricycle_cli.campaign.cycle import Campaign
from tricycle_cli.campaign.state_file import CampaignState, Step
from tricycle_cli.commands.campaign import _identify, _progress_of
from tricycle_cli.main import main
from tricycle_core.errors import NodeError, PlanError


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("--targets camber-stiffness,yaw-inertia --tolerance 0", "tolerance 0 must be above 0"),
        ("--targets mass --tolerance 5%", "unknown target 'mass'"),
        ("--targets camber_stiffness --tolerance five", "tolerance 'five': needs a share"),
        ("--targets camber_stiffness --tolerance 500%", "tolerance 5 must be"),
        ("--targets camber_stiffness --tolerance -5%", "tolerance -0.05 must be above 0"),
        ("--targets camber_stiffness --tolerance 5% --maneuver loop", "unknown maneuver 'loop'"),
        ("--targets camber_stiffness --tolerance 5% --budget -3", "budget -3 must be 1 or more"),
        (
            "--targets camber_stiffness --tolerance 5% --pose /typo",
            "--pose /typo: the nodes of a simulation publish poses on odom, ground_truth, tf only",
        ),
        (
            "--targets camber_stiffness --tolerance 5% --vehicle-nodes --true-seed 0",
            "--true-seed: of a simulation",
        ),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing(line, message, capsys, tmp_path):
    output = tmp_path / "campaign"
    assert main(["campaign", *line.split(), "--output", str(output)]) == 2
    assert message in capsys.readouterr().err
    assert not output.exists()


def test_a_kept_bag_is_identified_by_the_names_given_before_any_node_is_needed(
    monkeypatch, tmp_path, capsys
):
    def identify(campaign, **_):
        raise PlanError(f"identified by {campaign.topics.pose}")

    monkeypatch.setattr(Campaign, "identify", identify)
    output = tmp_path / "campaign"
    line = ["campaign", "--targets", "camber_stiffness", "--tolerance", "5%", "--vehicle-nodes"]
    line += ["--output", str(output), "--pose", "/localization/odometry"]
    with monkeypatch.context() as patch:  # begin it, and leave it at the first plan
        patch.setattr("tricycle_cli.commands.campaign._session", no_session)
        assert main(line) == 2
    state = CampaignState.read(output / "campaign.json")
    std = {"camber_stiffness": 1.0}
    step = Step("camber_stiffness", "plans/01.json", "bags/01", "circle", {}, "id", 8.0, std, True)
    CampaignState(state.settings, (step,), state.topics).write(output / "campaign.json")
    (output / "bags/01").mkdir(parents=True)
    assert main(line[:-2]) == 2
    assert "identified by /localization/odometry" in capsys.readouterr().err


def test_the_report_is_written_though_the_last_way_back_fails(monkeypatch, tmp_path, capsys):
    entry = ParameterEntry(
        estimate=710.0, low=690.0, high=730.0, standard_deviation=10.0, range=(500.0, 1500.0)
    )
    found = IdentificationDocument(
        level=0.95, parameters={"cornering_stiffness": entry}, covariance=np.array([[100.0]])
    )
    std = {"cornering_stiffness": 12.0}
    values = {"radius": 3.0, "speed": 0.8}
    names = "cornering_stiffness", "plans/01.json", "bags/01", "circle"
    step = Step(*names, values, "id", 8.0, std, True)

    @contextlib.contextmanager
    def session(*_):
        yield None
        raise NodeError("way back aborted: fence")

    def identify(campaign, _):
        campaign._keep((dataclasses.replace(step, identification=found),))

    for name, fake in (
        ("_session", session),
        ("_drive", lambda *_, **__: None),
        ("_identify", identify),
    ):
        monkeypatch.setattr(f"tricycle_cli.commands.campaign.{name}", fake)
    line = ["campaign", "--targets", "cornering_stiffness", "--tolerance", "5%"]
    assert main([*line, "--output", str(tmp_path / "new")]) == 2
    said = capsys.readouterr()
    assert "710" in said.out
    assert said.err.endswith("way back aborted: fence; the report of the campaign is written\n")
    for suffix in ("json", "txt", "png"):
        assert (tmp_path / "new" / f"report.{suffix}").exists()


def no_session(*_):
    raise PlanError("no nodes")


@pytest.mark.parametrize(
    ("steps", "told"),
    [
        ([False], "1 planned drive, 0 driven"),
        ([True], "1 planned drive, 1 driven"),
        ([True, True, False], "3 planned drives, 2 driven"),
    ],
)
def test_what_a_campaign_goes_on_after_is_told(steps, told):
    campaign = SimpleNamespace(
        folder="out", steps=[SimpleNamespace(driven=driven) for driven in steps]
    )
    assert _progress_of(campaign) == f"out: going on after {told}"


@pytest.mark.parametrize(("driven", "early"), [(14.54, False), (12.0, True)])
def test_only_a_drive_that_has_ended_early_is_said_to(driven, early):
    planned = SimpleNamespace(
        maneuver="circle", operation={}, target="mass", duration=14.540000000000001
    )
    campaign = SimpleNamespace(steps=[planned])
    campaign.request = SimpleNamespace(targets=())

    def identify(progress):
        campaign.steps = [SimpleNamespace(duration=driven)]
        return {}

    campaign.identify = identify
    _identify(campaign, console := Console(file=io.StringIO()))
    assert ("ended early" in console.file.getvalue()) == early
