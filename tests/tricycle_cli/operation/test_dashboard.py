"""The screen of a live run says what was heard, and what was not."""

import io
import json
import math

import pytest
from rich.console import Console

from tricycle_cli.operation.dashboard import (
    Dashboard,
    DiagnosticEntry,
    JointReading,
    OdometryReading,
    screen,
)
from tricycle_core.diagnostics import Level

RUNNING = {"state": "running", "plan_id": "p1", "elapsed": "5.0", "duration": "20.0", "reason": ""}


def text_of(dashboard, now=100.0, width=100):
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(screen(dashboard, now=now, where="domain 7"))
    return console.export_text()


def test_before_anything_was_heard_it_says_so():
    text = text_of(Dashboard())
    assert "domain 7: nothing heard yet" in text
    assert "no maneuver_driver heard" in text


def test_a_running_maneuver_shows_progress_speeds_and_links():
    dashboard = Dashboard(
        diagnostics={
            "tricycle_bridge: steer PLC": DiagnosticEntry(Level.OK, "active", 99.5),
            "tricycle_bridge: drive PLC": DiagnosticEntry(Level.ERROR, "e-stop", 99.5),
        },
        maneuver=RUNNING,
        learnt="8.0 s: cornering_stiffness 700 ± 30 N/rad",
        commanded=JointReading(0.7854, 2.5),
        measured=JointReading(0.7511, 2.4),
        odometry=OdometryReading(1.0, -2.0, 0.93, 0.41),
        heard=99.9,
    )
    text = text_of(dashboard)
    for part in (
        "running",
        "plan p1",
        "5.0 of 20.0 s",
        "0.7854",
        "0.7511",
        "0.93",
        "e-stop",
        "700 ± 30",
    ):
        assert part in text
    assert "silent" not in text


@pytest.mark.parametrize(("age", "silent"), [(2.9, False), (3.1, True)])
def test_a_source_that_fell_silent_is_told(age, silent):
    dashboard = Dashboard(
        diagnostics={"a: b": DiagnosticEntry(Level.OK, "fine", 100.0 - age)}, heard=99.9
    )
    assert ("silent for 3 s" in text_of(dashboard)) == silent


@pytest.mark.parametrize("damage", [{"elapsed": "soon"}, {"duration": "0"}, {"duration": None}])
def test_values_of_another_software_do_not_end_it(damage):
    assert "running" in text_of(Dashboard(maneuver=RUNNING | damage))


@pytest.mark.parametrize(
    ("reason", "shown"), [("", "20.0 of 20.0 s"), ("ended early", "5.0 of 20.0 s")]
)
def test_a_drive_that_ended_early_is_not_shown_as_driven_to_its_end(reason, shown):
    assert shown in text_of(Dashboard(maneuver=RUNNING | {"state": "done", "reason": reason}))


def test_a_snapshot_is_json():
    dashboard = Dashboard(
        {"a: b": DiagnosticEntry(Level.WARN, "hm", 1.0)},
        RUNNING,
        JointReading(0.1, 0.2),
        JointReading(math.nan, 0.3),
    )
    told = json.loads(json.dumps(dashboard.snapshot(), allow_nan=False))
    assert told["diagnostics"] == {"a: b": {"level": "warn", "message": "hm"}}
    assert told["commanded"] == {"steering_motor_angle": 0.1, "wheel_rate": 0.2}
    assert told["measured"] == {"steering_motor_angle": None, "wheel_rate": 0.3}
    assert told["odom"] is None


def test_the_preflight_is_shown_until_the_drive_begins():
    item = DiagnosticEntry(Level.ERROR, "no pose on odom", 99.5)
    waiting = Dashboard(maneuver={"state": "waiting"}, preflight={"localisation": item}, heard=99.9)
    assert "pre-flight" in text_of(waiting)
    assert "no pose on odom" in text_of(waiting)
    driving = Dashboard(maneuver=RUNNING, preflight={"localisation": item}, heard=99.9)
    assert "no pose on odom" not in text_of(driving)


@pytest.mark.parametrize(("age", "times"), [(0.5, 1), (3.5, 2)])
def test_what_a_fresh_preflight_says_is_not_said_again_by_the_diagnostics(age, times):
    link = {"tricycle_bridge: steer PLC": DiagnosticEntry(Level.OK, "SAFE", 99.9)}
    checked = {name: DiagnosticEntry(Level.OK, "SAFE", 100.0 - age) for name in link}
    dashboard = Dashboard(link, {"state": "waiting"}, preflight=checked, heard=99.9)
    assert text_of(dashboard).count("steer PLC") == times


def test_the_head_of_the_speeds_is_one_line_in_a_terminal_of_80():
    assert "speed m/s  yaw rate rad/s  steering motor rad  rear wheel rad/s" in text_of(
        Dashboard(), width=80
    )


def test_a_picture_is_complete_with_what_every_run_publishes():
    heard = Dashboard({"a: b": DiagnosticEntry(Level.OK, "fine", 1.0)}, RUNNING)
    assert not heard.complete
    heard.measured, heard.odometry = JointReading(0.1, 0.2), OdometryReading(0.0, 0.0, 0.0, 0.0)
    assert heard.complete


NARROW = Dashboard(
    diagnostics={"tricycle_bridge: steer PLC": DiagnosticEntry(Level.OK, "supply 12.345 V", 95.0)},
    maneuver=RUNNING,
    commanded=JointReading(0.7854, -123.456),
    measured=JointReading(-0.7511, 123.457),
    odometry=OdometryReading(5412345.67, -1234.56, -12.93, 0.4123),
)


@pytest.mark.parametrize("width", [24, 40, 60, 79, 120])
def test_no_number_is_cut_however_narrow_the_terminal_is(width):
    text = text_of(NARROW, width=width)
    assert max(map(len, text.splitlines())) <= width
    for number in (
        *("0.7854", "-123.456", "-0.7511", "123.457", "5412345.67", "-1234.56", "-12.93"),
        *("0.412", "12.345", "5.0 of 20.0 s"),
    ):
        assert number in text


@pytest.mark.parametrize(("age", "shown"), [(2.9, True), (3.1, False)])
def test_a_speed_of_long_ago_is_not_shown_as_the_present_one(age, shown):
    dashboard = Dashboard(
        maneuver=RUNNING,
        commanded=JointReading(0.7854, 2.5, heard=100.0 - age),
        measured=JointReading(0.7511, 2.4, heard=100.0 - age),
        odometry=OdometryReading(1.0, -2.0, 0.93, 0.41, heard=100.0 - age),
        heard=99.9,
    )
    text = text_of(dashboard)
    for number in ("0.7854", "2.500", "0.7511", "0.93", "-2.00 m"):
        assert (number in text) is shown
    assert "heard" not in json.dumps(dashboard.snapshot()["measured"])
