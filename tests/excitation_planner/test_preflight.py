"""What others say of themselves before a drive."""

import pytest

from excitation_planner.preflight import SILENCE, Report, clock, commanders, recording
from tricycle_core.diagnostics import Level

NOW = 100.0, 7.0  # on two clocks


def report(age=0.0, level=Level.OK, message="recording", **values):
    return Report(level, message, (100.0 - age, 7.0 - age), values)


BAG = {"bag": "/data/run", "disk_free": "2e9", "bytes_per_second": "1e6"}


@pytest.mark.parametrize(
    ("heard", "level", "message"),
    [
        (report(**BAG), Level.OK, "recording, 2.0 GB free"),
        (None, Level.ERROR, "no recorder heard"),
        (report(message="not recording"), Level.ERROR, "not recording"),
        (report(message="paused", paused="True", **BAG), Level.ERROR, "paused"),
        (report(age=SILENCE + 1.0, **BAG), Level.ERROR, "silent for 4 s: recording"),
        (report(level=Level.ERROR, message="disk full", **BAG), Level.ERROR, "disk full"),
        (
            report(**BAG | {"bytes_per_second": "1e8"}),
            Level.ERROR,
            "2.0 GB free, but the drive may take 6.0 GB: make room",
        ),
    ],
)
def test_a_drive_that_has_to_be_recorded_needs_a_recorder_and_room_for_it(heard, level, message):
    check = recording(heard, 60.0, NOW, needed=True)
    assert (check.level, check.message) == (level, message)
    if level is Level.ERROR:  # otherwise it is only said
        assert recording(heard, 60.0, NOW, needed=False).level is Level.WARN


def test_a_stale_or_failed_part_fails():
    assert report().check("link", NOW).level is Level.OK
    assert report(level=Level.STALE).check("link", NOW).level is Level.ERROR
    assert report(age=3.5).check("link", NOW).message == "silent for 4 s: recording"


def test_who_reports_by_a_slower_clock_is_not_silent():
    assert report().check("link", (100.5, 17.0)).level is Level.OK
    assert report().check("link", (110.0, 7.5)).level is Level.OK


def test_other_commanders_are_named():
    assert commanders("/driver", ["/driver"]).message == "nobody else"
    other = commanders("/driver", ["/driver", "/teleop", "/teleop"])
    assert other.level is Level.ERROR
    assert other.message.startswith("/teleop runs 2 times: end all but one; one that crashed")
    other = commanders("/driver", ["/driver", "/teleop"])
    assert other.level is Level.ERROR
    assert other.message.startswith("/teleop could command too: end it; one that crashed or was")


def test_a_namesake_of_the_driver_fails_the_pre_flight():
    check = commanders("/driver", ["/driver", "/driver"])
    assert check.level is Level.ERROR
    assert check.message == (
        "/driver runs 2 times: end all but one; one that crashed or was killed is forgotten "
        "within 20 s"
    )


def test_a_clock_that_stands_still_fails():
    assert clock(0.5, simulated=True).level is Level.OK
    check = clock(SILENCE + 9.0, simulated=True)
    assert check.level is Level.ERROR
    assert check.message.startswith("/clock has stood still for 12 s")


def test_on_a_vehicle_no_clock_stands_still_but_its_driver_may_be_held_up():
    assert clock(0.5, simulated=False).level is Level.OK
    check = clock(SILENCE + 9.0, simulated=False)
    assert check.level is Level.ERROR
    assert check.message == "the driver has been held up for 12 s: a busy computer?"
