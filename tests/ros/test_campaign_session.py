"""Campaigns on live nodes: one goes on after a kill; a drive ends when it taught enough."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from excitation_planner.plan import load_plan
from parameter_identification.drives.reader import read_drive

pytestmark = [pytest.mark.ros, pytest.mark.slow]

PATIENCE = 240.0  # s


def test_a_campaign_killed_while_driving_goes_on(ros_environment, tmp_path):
    output = tmp_path / "campaign"
    command = [
        *(Path(sys.executable).parent / "tricycle", "campaign", "--maneuver", "circle"),
        *("--targets", "cornering_stiffness", "--tolerance", "50%", "--true-seed", "2"),
        *("--budget", "4200", "--most-drives", "1", "--json", "--output", output),
    ]
    first = subprocess.Popen(command, env=ros_environment, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + PATIENCE
    while not (output / "bags" / "01").exists():
        assert first.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.1)
    first.kill()
    first.wait()
    before = json.loads((output / "campaign.json").read_text())["steps"][0]
    assert not before["driven"]
    second = subprocess.run(
        command, env=ros_environment, capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    assert second.returncode == 0, second.stderr
    report = json.loads(second.stdout)
    target = report["targets"]["cornering_stiffness"]
    assert target["within_tolerance"]
    assert abs(target["estimate"] - target["truth"]) < 4.0 * target["standard_deviation"]
    assert report["drives"] == 1
    assert (
        json.loads((output / "campaign.json").read_text())["steps"][0]["plan_id"]
        == (before["plan_id"])
    )
    assert (output / "report.png").read_bytes().startswith(b"\x89PNG")


def test_a_drive_that_has_taught_enough_ends_early(ros_environment, tmp_path):
    output = tmp_path / "campaign"
    done = subprocess.run(
        [
            *(Path(sys.executable).parent / "tricycle", "campaign", "--maneuver", "circle"),
            *("--targets", "cornering_stiffness", "--tolerance", "50%", "--true-seed", "2"),
            *("--budget", "4200", "--most-drives", "2", "--real-time-factor", "1"),
            *("--stop-early", "--output", output),
        ],
        env=ros_environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "ended early" in done.stderr
    (step,) = json.loads((output / "campaign.json").read_text())["steps"]
    planned = load_plan(output / step["plan"]).commands.duration
    drive = read_drive(output / "bags" / "01")
    assert step["duration"] == drive.ended_early
    assert drive.ended_early < planned - 1.0
    report = json.loads((output / "report.json").read_text())
    target = report["targets"]["cornering_stiffness"]
    assert target["within_tolerance"]
    assert abs(target["estimate"] - target["truth"]) < 4.0 * target["standard_deviation"]
