"""`tricycle plc check` as an engineer runs it, on emulated boards behind serial devices."""

import json
import threading

import pytest

from tricycle_bridge.commissioning.record import StepResult, read_record
from tricycle_bridge.protocol.messages import Board
from tricycle_cli.main import main
from tricycle_sim.plc.pair import PlcPair

pytestmark = pytest.mark.real_time


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["check", "one"], "two ports"),
        (["check", "one", "two"], "--engineer NAME"),
        (["check", "one", "./one", "--engineer", "A"], "one and ./one are one port"),
        (["probe", "one", "two"], "takes one port, not 2"),
        (["probe", "one", "--seconds", "5"], "--seconds: only with monitor and stats"),
        (
            ["check", "one", "two", "--engineer", "A", "--seconds", "5"],
            "--seconds: only with monitor and stats",
        ),
        (
            ["stats", "one", "--engineer", "A", "--record", "r.json", "--overwrite"],
            "--engineer, --record, --overwrite: only with check",
        ),
        (["monitor", "one", "--vehicle", "v.yaml"], "--vehicle: only with check"),
        pytest.param(
            ["check", "nowhere", "nirgends", "--engineer", "A", "--boot-wait", "0"],
            "not exist",
            marks=pytest.mark.slow,  # it waits for the boards
        ),
    ],
)
def test_a_mistake_is_one_line_and_status_2(capsys, monkeypatch, tmp_path, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert main(["plc", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_check_that_is_interrupted_ends_the_record_of_an_earlier_one(tmp_path, monkeypatch):
    def interrupted(_stand):
        yield StepResult("links", True, {})
        raise KeyboardInterrupt

    monkeypatch.setattr("tricycle_bridge.commissioning.bring_up.bring_up", interrupted)
    record = tmp_path / "record.json"
    record.write_text("an earlier one")
    with PlcPair(tmp_path / "steer", tmp_path / "drive") as pair:
        ports = [pair.steer_path, pair.drive_path]
        options = ["--engineer", "A. Test", "--record", str(record), "--boot-wait", "0"]
        assert main(["plc", "check", *ports, *options, "--overwrite"]) == 130
    written = read_record(record)
    assert not written.complete
    assert written.settings["tyre_radius"] == pytest.approx(0.335)


def test_statistics_of_a_board_that_was_lost_are_none(capsys, tmp_path):
    with PlcPair(tmp_path / "steer", tmp_path / "drive") as pair:
        threading.Timer(1.0, pair.stall, [Board.DRIVE]).start()
        assert main(["plc", "stats", pair.drive_path, "--boot-wait", "0"]) == 2
    out, err = capsys.readouterr()
    assert not out
    assert "drive: no telemetry for" in err


@pytest.mark.slow
def test_a_check_that_fails_is_recorded_with_its_reason(capsys, tmp_path, monkeypatch):
    """Nobody presses the emergency stop."""
    monkeypatch.setattr("tricycle_bridge.commissioning.bring_up.BY_HAND", 0.3)
    record = tmp_path / "record.json"
    with PlcPair(tmp_path / "steer", tmp_path / "drive") as pair:
        ports = [pair.steer_path, pair.drive_path]
        options = ["--engineer", "A. Test", "--record", str(record), "--boot-wait", "0"]
        assert main(["plc", "check", *ports, *options]) == 1
    assert "FAILED: not both boards saw the emergency stop" in capsys.readouterr().out
    written = json.loads(record.read_text())
    assert not written["complete"]
    assert [step["passed"] for step in written["steps"]] == [True, False]
