"""Readings of the two boards, joined by tick."""

import pytest

from tricycle_bridge.measurements.joint_pairing import JointPairing, JointReading, joint_reading
from tricycle_bridge.protocol.messages import (
    Board,
    DriveLimits,
    DriveState,
    SteerLimits,
    SteerState,
    layout,
)
from tricycle_core.joints import JOINTS, REAR_WHEEL_JOINT, STEERING_JOINT

STEER, DRIVE = Board.STEER, Board.DRIVE
TICK = 0.01  # s


def message(kind, **values):
    return kind(**dict.fromkeys(layout(kind), 0) | values)


def reading(board, position=0.0, velocity=0.0):
    return JointReading(STEERING_JOINT if board is STEER else REAR_WHEEL_JOINT, position, velocity)


def add(pairing, board, *stamps, partner_up=True):
    for stamp in stamps:
        pairing.add(board, reading(board), stamp, partner_up=partner_up)


@pytest.fixture
def pairing():
    return JointPairing()


def test_the_steering_reading_is_in_rad():
    state = message(SteerState, angle=2000, rate=-500)
    assert joint_reading(state, None, 0.335, 0.015) == JointReading(
        STEERING_JOINT, pytest.approx(0.2), pytest.approx(-0.5)
    )


def test_the_wheel_turns_by_its_travel_over_the_tyre_radius():
    state = message(DriveState, hall_count=100, speed=670)
    limits = message(DriveLimits, pulse=15000)
    assert joint_reading(state, limits, 0.5, 0.015) == JointReading(
        REAR_WHEEL_JOINT, pytest.approx(3.0), pytest.approx(1.34)
    )


def test_a_board_that_is_not_set_up_yet_counts_another_travel_per_pulse():
    state = message(DriveState, hall_count=100, speed=6700)
    limits = message(DriveLimits, pulse=15000)
    assert joint_reading(state, limits, 0.05, 0.0015) == JointReading(
        REAR_WHEEL_JOINT, pytest.approx(3.0), pytest.approx(13.4)
    )


@pytest.mark.parametrize("limits", [None, message(SteerLimits)])
def test_without_the_travel_per_pulse_there_is_no_wheel_reading(limits):
    assert joint_reading(message(DriveState), limits, 0.335, 0.015) is None


@pytest.mark.parametrize("first", [STEER, DRIVE])
def test_two_readings_of_a_tick_are_one_in_the_order_of_the_joints(pairing, first):
    second = DRIVE if first is STEER else STEER
    add(pairing, first, 1.0)
    assert pairing.take() == []
    add(pairing, second, 1.002)
    (readings,) = pairing.take()
    assert readings.stamp == 1.002
    assert tuple(joint.name for joint in readings.joints) == JOINTS


def test_the_older_reading_is_carried_to_the_time_of_the_newer(pairing):
    pairing.add(STEER, reading(STEER, 0.1, 2.0), 1.0, partner_up=True)
    add(pairing, DRIVE, 1.004)
    (readings,) = pairing.take()
    assert readings.joints[0].position == pytest.approx(0.1 + 2.0 * 0.004)
    assert readings.joints[0].velocity == 2.0


def test_a_reading_without_a_partner_in_its_tick_is_reported_alone(pairing):
    add(pairing, STEER, 1.0, 1.01)
    add(pairing, DRIVE, 1.011)
    assert [(r.stamp, len(r.joints)) for r in pairing.take()] == [(1.0, 1), (1.011, 2)]
    add(pairing, DRIVE, 1.03)
    add(pairing, STEER, 1.02)  # of a tick before that of the waiting one
    assert [(r.stamp, len(r.joints)) for r in pairing.take()] == [(1.02, 1)]


def test_readings_do_not_wait_for_a_board_that_is_not_connected(pairing):
    add(pairing, STEER, 1.0, 1.01)
    add(pairing, STEER, 1.02, partner_up=False)
    assert [r.stamp for r in pairing.take()] == [1.0, 1.01, 1.02]


@pytest.mark.parametrize("burst", [2, 20])
def test_bursts_of_ticks_are_paired_tick_by_tick(pairing, burst):
    for start in range(0, 8 * burst, burst):
        ticks = [(start + k) * TICK for k in range(burst)]
        add(pairing, STEER, *ticks)
        add(pairing, DRIVE, *(t + 0.003 for t in ticks))
    readings = pairing.take()
    assert len(readings) == 8 * burst
    assert {len(r.joints) for r in readings} == {2}


def test_what_waits_can_be_forgotten(pairing):
    add(pairing, STEER, 1.0)
    pairing.clear()
    add(pairing, DRIVE, 1.0)
    assert pairing.take() == []


# ---- both boards behind the bridge ----


@pytest.mark.parametrize("burst", [2, 20])
def test_boards_that_speak_in_bursts_are_still_paired(driving, burst):
    """One port is read as a whole before the other one."""
    held = {STEER: b"", DRIVE: b""}
    receive = driving.bridge.receive
    driving.bridge.receive = lambda board, data, now: held.__setitem__(board, held[board] + data)
    driving.readings.clear()
    for _ in range(8):
        driving.step(burst)
        for board in (STEER, DRIVE):
            receive(board, held.pop(board), driving.now)
            held[board] = b""
    driving.step()
    assert len(driving.readings) == 8 * burst
    assert {len(reading.joints) for reading in driving.readings} == {2}
    stamps = [reading.stamp for reading in driving.readings]
    assert stamps == sorted(stamps)
