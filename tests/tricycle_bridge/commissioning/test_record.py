import dataclasses
from datetime import UTC, datetime, timedelta

import pytest

from tricycle_bridge.commissioning.record import (
    BringUpRecord,
    StepResult,
    read_record,
    write_record,
)
from tricycle_bridge.protocol.messages import Board
from tricycle_bridge.settings import BridgeSettings
from tricycle_core.errors import LinkError

TIME = datetime(2026, 5, 1, 12, tzinfo=UTC)
RECORD = BringUpRecord(
    engineer="A. Test",
    time=TIME.isoformat(),
    steer_firmware="2.0.0 (1)",
    drive_firmware="2.0.0 (2)",
    steps=(StepResult("hall count", True, {"pulses per turn": 138.0, "by": "hand"}),),
    complete=True,
    settings=dataclasses.asdict(BridgeSettings()),
)
MONTH = timedelta(days=30)


def problem(record=RECORD, steer="2.0.0 (1)", drive="2.0.0 (2)", now=TIME, **settings):
    here = BridgeSettings(**settings)
    return record.problem({Board.STEER: steer, Board.DRIVE: drive}, here, now, MONTH)


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "record.json"
    write_record(path, RECORD)
    return path


def test_what_is_written_is_read(path):
    read = read_record(path)
    assert dataclasses.replace(read, digest="") == RECORD
    assert problem(read) is None


def test_a_record_that_was_edited_is_refused(path):
    path.write_text(path.read_text().replace("138.0", "140.0"))
    with pytest.raises(LinkError, match="changed after the bring-up"):
        read_record(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{}", "lacks `engineer`"),
        ("no", "not JSON|JSON"),
        (None, "`tricycle plc check` writes it"),
    ],
)
def test_what_is_no_record_is_refused(path, content, message):
    path.write_text(content) if content is not None else path.unlink()
    with pytest.raises(LinkError, match=message):
        read_record(path)


def test_a_time_without_its_zone_is_refused(path):
    write_record(path, dataclasses.replace(RECORD, time="2026-05-01T12:00:00"))
    with pytest.raises(LinkError, match="UTC offset"):
        read_record(path)


def test_it_holds_for_the_vehicle_that_was_brought_up(path):
    assert problem(read_record(path), tyre_radius=0.3) == (
        "the bring-up was made with tyre_radius 0.335, not 0.3: "
        "`tricycle plc check --vehicle FILE` of this vehicle"
    )
    assert "hall_pulse" in problem(hall_pulse=0.02)
    assert "mass 58.1, not 90" in problem(mass=90.0)
    assert problem(max_speed=2.0, max_steering_angle=0.5, payload=20.0, command_rate=40.0) is None
    slow = dataclasses.replace(RECORD, settings=RECORD.settings | {"max_speed": 2.0})
    assert "max_speed 2, not 4.8" in problem(slow)
    unknown = dataclasses.replace(RECORD, settings={})
    assert problem(unknown).startswith("the bring-up was made with max_steering_angle nan")


def test_a_record_of_before_it_named_its_vehicle_is_refused(path):
    write_record(path, dataclasses.replace(RECORD, settings={}, format="tricycle bring-up 1"))
    with pytest.raises(LinkError, match="must be 'tricycle bring-up 2': bring the vehicle up"):
        read_record(path)


def test_it_holds_for_these_boards_and_for_a_while():
    assert "drive PLC 2.0.0 (2), not 2.0.1 (3)" in problem(drive="2.0.1 (3)")
    assert "steer PLC" in problem(steer="other")
    assert problem(now=TIME + MONTH) is None
    assert problem(now=TIME + timedelta(days=30, hours=12)) == (
        "the bring-up is 30.5 days old, at most 30.0 are allowed"
    )
    assert problem(now=TIME - timedelta(hours=1)) is None  # of another computer's clock
    assert problem(now=TIME - timedelta(days=400)) == (
        "the bring-up is dated 2026-05-01T12:00:00+00:00, 400.0 days ahead of this clock"
    )
    failed = StepResult("brake", False, {}, "it slips")
    record = dataclasses.replace(RECORD, steps=(*RECORD.steps, failed), complete=False)
    assert problem(record) == "the bring-up did not pass: brake"
