"""Which command counts, and when it is due."""

import math
import random

import pytest

from tricycle_bridge.command_stream import CommandStream, Source, VehicleCommand
from tricycle_core.errors import LinkError

START = 1000.0  # s
STANDSTILL = VehicleCommand(0.0, 0.0)


def sent_at(stream, times, *, repeat_rate=50.0):
    """Those of the times at which a command is due."""
    return [t for t in times if stream.due(t, repeat_rate=repeat_rate, enabled=False)]


def add(stream, command, now, source=Source.JOINT_COMMANDS):
    return stream.add(command, stamp=now, now=now, source=source)


@pytest.fixture
def stream():
    return CommandStream()


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_command_must_be_finite(value):
    with pytest.raises(LinkError, match=r"steering_motor_angle is .* must be a finite number"):
        VehicleCommand(value, 0.0)
    with pytest.raises(LinkError, match="speed is"):
        VehicleCommand(0.0, value)


@pytest.mark.parametrize("age", [0.15, -0.15, 1e9])
def test_old_and_future_commands_are_refused(stream, age):
    refusal = stream.add(STANDSTILL, stamp=START - age, now=START, source=Source.JOINT_COMMANDS)
    assert "must be within 0.1 s" in refusal
    assert stream.counters.stale == 1
    assert stream.newest(START) is None


def test_a_command_without_a_stamp_is_refused(stream):
    refusal = stream.add(STANDSTILL, stamp=0.0, now=START, source=Source.CMD_VEL)
    assert refusal == "cmd_vel has no time stamp"


def test_a_command_is_fresh_for_100_ms(stream):
    assert add(stream, STANDSTILL, START) is None
    assert stream.counters.accepted == 1
    assert stream.newest(START + 0.1) == STANDSTILL
    assert stream.newest(START + 0.102) is None


def test_joint_commands_take_precedence_while_they_come(stream):
    twist = VehicleCommand(0.1, 0.5)
    add(stream, STANDSTILL, START)
    refusal = add(stream, twist, START, Source.CMD_VEL)
    assert refusal == "cmd_vel ignored while joint_commands are coming"
    assert stream.counters.refused == 1
    assert add(stream, twist, START + 0.2, Source.CMD_VEL) is None
    assert add(stream, STANDSTILL, START + 0.21) is None
    assert stream.newest(START + 0.21) == STANDSTILL


def test_a_command_is_repeated_at_the_rate_while_it_is_fresh(stream):
    add(stream, STANDSTILL, START)
    times = [START + k * 0.005 for k in range(100)]
    assert sent_at(stream, times) == pytest.approx([START + k * 0.02 for k in range(6)])


def test_a_new_command_and_a_change_of_enable_are_due_at_once(stream):
    add(stream, STANDSTILL, START)
    assert stream.due(START, repeat_rate=20.0, enabled=False) == STANDSTILL
    assert stream.due(START + 0.01, repeat_rate=20.0, enabled=False) is None
    assert stream.due(START + 0.01, repeat_rate=20.0, enabled=True) == STANDSTILL
    add(stream, VehicleCommand(0.1, 0.0), START + 0.02)
    assert stream.due(START + 0.02, repeat_rate=20.0, enabled=True) == VehicleCommand(0.1, 0.0)


def test_a_commander_at_1_khz_does_not_overload_the_line(stream):
    sent = 0
    for k in range(1000):
        now = START + k * 0.001
        add(stream, VehicleCommand(k * 1e-4, 0.0), now)
        sent += stream.due(now, repeat_rate=50.0, enabled=True) is not None
    assert 95 <= sent <= 110


def test_the_jitter_of_a_100_hz_commander_adds_up_to_no_lag(stream):
    rng = random.Random(5)
    arrivals = sorted(k * 0.01 + rng.choice((0.0, 0.0, 0.0, 0.012)) for k in range(2000))
    delayed = 0
    for k, arrival in enumerate(arrivals):
        add(stream, VehicleCommand(k * 1e-4, 0.0), START + arrival)
        delayed += stream.due(START + arrival, repeat_rate=50.0, enabled=True) is None
    assert delayed < 0.02 * len(arrivals)


def test_nothing_is_left_after_the_clock_jumped_back(stream):
    add(stream, STANDSTILL, START)
    assert stream.due(START, repeat_rate=50.0, enabled=False)
    stream.clear()
    assert stream.newest(1.0) is None
    add(stream, STANDSTILL, 1.0)
    assert stream.due(1.0, repeat_rate=50.0, enabled=False) == STANDSTILL
