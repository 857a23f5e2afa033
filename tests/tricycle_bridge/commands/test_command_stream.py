"""Which command counts, and when it is due."""

import math
import random

import pytest

from tricycle_bridge.commands.command_stream import Commander, CommandStream, Source, VehicleCommand
from tricycle_core.errors import LinkError

START = 1000.0  # s
STANDSTILL = VehicleCommand(0.0, 0.0)
DRIVER = Commander(Source.JOINT_COMMANDS, "/maneuver_driver")
OTHER = Commander(Source.JOINT_COMMANDS, "/other")
TWIST = Commander(Source.CMD_VEL)


def sent_at(stream, times, *, repeat_rate=50.0):
    """Those of the times at which a command is due."""
    return [t for t in times if stream.due(t, repeat_rate=repeat_rate, enabled=False)]


def add(stream, command, now, commander=DRIVER):
    return stream.add(command, stamp=now, now=now, commander=commander)


@pytest.fixture
def stream():
    return CommandStream()


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_command_must_be_finite(value):
    with pytest.raises(LinkError, match=r"steering_motor_angle is .* must be a finite number"):
        VehicleCommand(value, 0.0)
    with pytest.raises(LinkError, match="speed is"):
        VehicleCommand(0.0, value)


@pytest.mark.parametrize(
    ("age", "refusal"),
    [
        (0.15, "is stamped 0.15 s ago, must be within 0.1 s: late, or its computer's clock is"),
        (1e9, "ago, must be within 0.1 s"),
        (-0.03, "is stamped 0.03 s ahead, must be within 0.02 s: its computer's clock is ahead"),
    ],
)
def test_old_and_future_commands_are_refused_as_a_problem_of_clocks(stream, age, refusal):
    said = stream.add(STANDSTILL, stamp=START - age, now=START, commander=DRIVER)
    assert said.startswith("joint_commands of /maneuver_driver is stamped")
    assert refusal in said
    assert stream.counters.stale == 1
    assert stream.newest(START) is None


def test_a_command_stamped_ahead_lives_no_longer_than_from_its_arrival(stream):
    assert stream.add(STANDSTILL, stamp=START + 0.015, now=START, commander=DRIVER) is None
    assert stream.newest(START + 0.1) == STANDSTILL
    assert stream.newest(START + 0.102) is None


def test_a_command_without_a_stamp_is_refused(stream):
    refusal = stream.add(STANDSTILL, stamp=0.0, now=START, commander=TWIST)
    assert refusal == "cmd_vel has no time stamp"


def test_a_command_is_fresh_for_100_ms(stream):
    assert add(stream, STANDSTILL, START) is None
    assert stream.counters.accepted == 1
    assert stream.newest(START + 0.1) == STANDSTILL
    assert stream.newest(START + 0.102) is None


def test_nobody_is_locked_out_of_a_vehicle_that_is_not_armed(stream):
    twist = VehicleCommand(0.1, 0.0)
    assert add(stream, STANDSTILL, START) is None
    assert add(stream, twist, START, TWIST) is None
    assert stream.newest(START) == twist
    assert (stream.commander, stream.conflict(START)) == (None, None)


@pytest.mark.parametrize("other", [OTHER, TWIST, Commander(Source.JOINT_COMMANDS)])
def test_who_commands_the_armed_vehicle_first_is_its_only_commander(stream, other):
    stream.lock()
    assert add(stream, STANDSTILL, START) is None
    refusal = add(stream, VehicleCommand(0.1, 0.5), START, other)
    assert refusal == f"{other} is refused: joint_commands of /maneuver_driver commands the vehicle"
    assert (stream.newest(START), stream.counters.refused) == (STANDSTILL, 1)
    assert stream.conflict(START + 0.9) == refusal
    assert stream.conflict(START + 1.1) is None
    assert add(stream, STANDSTILL, START + 5.0, other)  # however long the first one is silent
    stream.unlock()
    assert add(stream, STANDSTILL, START + 5.1, other) is None
    assert add(stream, STANDSTILL, START + 5.2) is None  # nobody is the only one any more


def test_names_of_commanders():
    assert str(OTHER) == "joint_commands of /other"
    assert str(TWIST) == "cmd_vel"
    assert str(Commander(Source.JOINT_COMMANDS)) == "unnamed joint_commands"


def test_a_released_vehicle_is_the_next_commanders(stream):
    stream.lock()
    add(stream, STANDSTILL, START)
    stream.release(START)
    assert (stream.commander, stream.newest(START)) == (None, None)
    refusal = add(stream, STANDSTILL, START + 0.01)  # it goes on: no way to take over otherwise
    assert "it released the vehicle, and may command again after a pause of 0.1 s" in refusal
    assert stream.conflict(START + 0.01) is None
    assert add(stream, STANDSTILL, START + 0.02, OTHER) is None
    assert stream.commander == OTHER


def test_who_released_the_vehicle_may_command_again_after_a_pause(stream):
    stream.lock()
    add(stream, STANDSTILL, START)
    stream.release(START)
    assert add(stream, STANDSTILL, START + 0.09)
    assert add(stream, STANDSTILL, START + 0.18)
    assert add(stream, STANDSTILL, START + 0.29) is None


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


def test_standstill_is_due_at_the_rate_while_no_command_is_fresh(stream):
    def due(now):
        return stream.due(now, repeat_rate=50.0, enabled=False, standstill=lambda: STANDSTILL)

    times = [START + k * 0.005 for k in range(21)]
    assert [t for t in times if due(t)] == pytest.approx([START + k * 0.02 for k in range(6)])
    wanted = VehicleCommand(0.1, 0.0)
    add(stream, wanted, START + 0.1)
    assert due(START + 0.11) == wanted
    assert due(START + 0.21) == STANDSTILL


def test_commands_and_standstill_are_repeated_each_at_its_rate(stream):
    def due(now):
        return stream.due(
            now,
            repeat_rate=20.0,
            enabled=False,
            standstill=lambda: STANDSTILL,
            standstill_rate=100.0,
        )

    # the owner may act half a millisecond early
    assert [due(START + k * 0.01 - (k % 2) * 5e-4) for k in range(10)] == [STANDSTILL] * 10
    add(stream, VehicleCommand(0.1, 0.0), START + 0.1)
    times = [START + 0.1 + k * 0.005 for k in range(20)]
    assert [t for t in times if due(t)] == pytest.approx([START + 0.1, START + 0.15])


def test_commands_of_before_arming_do_not_count(stream):
    add(stream, VehicleCommand(0.3, 0.0), START)
    stream.begin(START)
    assert stream.newest(START + 0.01) is None
    assert stream.due(START + 0.01, repeat_rate=50.0, enabled=True) is None
    add(stream, STANDSTILL, START + 0.02)
    assert stream.newest(START + 0.02) == STANDSTILL


def test_a_message_that_cannot_be_obeyed_is_a_command_to_stand_still(stream):
    assert (stream.last, stream.last_commander) == (None, None)
    assert stream.refuse(STANDSTILL, "too fast", stamp=START, now=START, commander=DRIVER) is None
    assert stream.newest(START) == stream.last == STANDSTILL
    assert stream.last_commander == DRIVER
    late = stream.refuse(STANDSTILL, "too fast", stamp=START - 1.0, now=START, commander=DRIVER)
    assert "is stamped 1.00 s ago" in late
    counters = stream.counters
    assert (counters.accepted, counters.stale, counters.refused) == (0, 1, 1)


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
    stream.begin(START)
    stream.clear()
    assert stream.newest(1.0) is None
    add(stream, STANDSTILL, 1.0)
    assert stream.due(1.0, repeat_rate=50.0, enabled=False) == STANDSTILL
