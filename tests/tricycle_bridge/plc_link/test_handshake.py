"""HELLO until a PLC answers, and which PLC may be used."""

import random

import pytest

from tricycle_bridge.plc_link.handshake import Handshake
from tricycle_bridge.protocol.framing import Frame
from tricycle_bridge.protocol.messages import Board, HelloAck, layout


@pytest.fixture
def handshake():
    handshake = Handshake(Board.STEER, rng=random.Random(0))
    handshake.start(10.0)
    return handshake


def answer(board=Board.STEER, nonce=0, *, sender=None, major=2):
    ack = HelloAck(**dict.fromkeys(layout(HelloAck), 0) | {"board": board, "nonce": nonce})
    return Frame(ack, sender or board, 0, 7, major), ack


def test_every_second_hello_asks_for_any_board(handshake):
    assert handshake.due(9.99) is None
    hellos = [hello for k in range(100) if (hello := handshake.due(10.0 + k * 0.01))]
    assert [hello.board for hello in hellos] == [Board.STEER, Board.ANY] * 2 + [Board.STEER]
    assert len({hello.nonce for hello in hellos}) == len(hellos) == handshake.sent


def test_only_the_answer_to_the_last_hello_counts(handshake):
    old, new = handshake.due(10.0), handshake.due(10.2)
    assert not handshake.is_answered_by(answer(nonce=old.nonce)[1])
    assert handshake.is_answered_by(answer(nonce=new.nonce)[1])


def test_silence_is_reported_once_per_start(handshake):
    assert not handshake.falls_silent(12.9)
    assert [handshake.falls_silent(t) for t in (13.0, 13.1)] == [True, False]
    handshake.start(20.0)
    assert not handshake.falls_silent(20.1)
    assert handshake.falls_silent(23.0)


def test_a_session_is_never_the_old_one(handshake):
    session = 1
    for _ in range(1000):
        old, session = session, handshake.new_session(session)
        assert old != session
        assert 1 <= session <= 255


@pytest.mark.parametrize(
    ("frame_and_ack", "reason"),
    [
        (answer(), None),
        (answer(Board.DRIVE), "ports swapped: the drive PLC answers where the steer PLC should be"),
        (answer(sender=Board.DRIVE), "ports swapped: the drive PLC answers"),
        (
            answer(major=1),
            "the PLC speaks protocol version 1, this bridge 2: flash it with this version's firm",
        ),
    ],
)
def test_a_plc_that_cannot_be_used_is_refused(handshake, frame_and_ack, reason):
    refusal = handshake.refusal(*frame_and_ack)
    assert refusal is reason is None or refusal.startswith(reason)
