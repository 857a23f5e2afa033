"""`tricycle campaign`: a mistake is found before anything is made."""

import io
from types import SimpleNamespace

import pytest
from rich.console import Console

from tricycle_cli.commands.campaign import _identify
from tricycle_cli.main import main


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("--targets camber-stiffness,yaw-inertia --tolerance 0", "tolerance 0 must be above 0"),
        ("--targets mass --tolerance 5%", "unknown target 'mass'"),
        ("--targets camber_stiffness --tolerance five", "tolerance 'five': want a share"),
        ("--targets camber_stiffness --tolerance 500%", "tolerance 5 must be"),
        ("--targets camber_stiffness --tolerance -5%", "tolerance -0.05 must be above 0"),
        ("--targets camber_stiffness --tolerance 5% --maneuver loop", "unknown maneuver 'loop'"),
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
