"""Framing against the vectors of the specification and against damaged lines."""

import dataclasses
import random
import zlib

import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st

from tricycle_bridge.protocol import messages as m
from tricycle_bridge.protocol.framing import DecoderCounters, Frame, FrameDecoder, encode
from tricycle_bridge.protocol.messages import Board, DriveCommand, Pong, SteerCommand

# (wire bytes, message, board, seq, session), section 8 of the specification
VECTORS = [
    ("034f01025a0a0f78563412fe599c1000", m.Hello(0, 15, 0x12345678), Board.ANY, 0, 0x5A),
    ("054101015a0a0178563412b2d7cf7d00", m.Hello(0, 1, 0x12345678), Board.STEER, 1, 0x5A),
    ("0d4102025a040302014801f4e000", m.Ping(0x01020304), Board.STEER, 2, 0x5A),
    ("0a4203035a01fe07a531052daf03f100", m.Control.of(m.Op.ARM, 7, 0x31), Board.DRIVE, 3, 0x5A),
    ("0a4103045a02fd08a531051f05a68900", m.Control.of(m.Op.ESTOP, 8, 0x31), Board.STEER, 4, 0x5A),
    ("064110055a0106b80be80331053c8983e500",
     SteerCommand(1, 0, 3000, 1000, 0x31), Board.STEER, 5, 0x5A),
    ("034110010101010101010101053bf9e57e00", SteerCommand(0, 0, 0, 0, 0), Board.STEER, 0, 0),
    ("114111155a581bd007302a90335c97f4d100",
     m.SteerSetup(7000, 2000, 10800, 13200), Board.STEER, 21, 0x5A),
    ("0b4220065a0101e803e80301023105979eb05500",
     DriveCommand(1, 1, 1000, 1000, 0, 0, 0x31), Board.DRIVE, 6, 0x5A),
    ("124221165aa00fdc05953b160dac0ddc05fa09f401bc0210a4c0da010101055e203a3800",
     m.DriveSetup(4000, 1500, 15253, 3350, 3500, 1500, 250, 500, 700, 42000, 56000, 0, 0),
     Board.DRIVE, 22, 0x5A),
    ("094205075a6ca36dd200", m.StatsRequest(), Board.DRIVE, 7, 0x5A),
    ("0b5182095a0403020150c30103ccc30105ea6bc37f00",
     Pong(0x01020304, 50000, 50124), Board.STEER, 9, 0x5A),
    ("0b5282055a040302010c80010370800105e305ec2e00",
     Pong(0x01020304, 32780, 32880), Board.DRIVE, 5, 0x5A),
    ("055181045a030102010301010aefbeadde785634120302c805e710962300",
     m.HelloAck(0, 1, 2, 0, 0, 1, 1, 0xDEADBEEF, 0x12345678, 3, 200), Board.STEER, 4, 0x5A),
    ("0751830a5a0103060242909cc200", m.Ack(1, 3, 0, 2), Board.STEER, 10, 0x5A),
    ("0e51840d5a581bd007302a9033c8029609ae1eb30118cf207800",
     m.SteerLimits(7000, 2000, 10800, 13200, 200, 150, 7854, 435), Board.STEER, 13, 0x5A),
]  # fmt: skip


def _decoder_for(wire_id: int, board: m.Board, session: int) -> FrameDecoder:
    ours = m.Board.STEER if board is m.Board.ANY else board
    decoder = FrameDecoder(ours, host=m.from_plc(wire_id))
    decoder.session = session
    return decoder


def _all_decoders() -> list[FrameDecoder]:
    decoders = [FrameDecoder(b, host=h) for b in (m.Board.STEER, m.Board.DRIVE) for h in (0, 1)]
    for decoder in decoders:
        decoder.session = 0x5A
    return decoders


@pytest.mark.parametrize(("wire", "message", "board", "seq", "session"), VECTORS)
def test_vectors_encode(wire, message, board, seq, session):
    assert encode(message, board=board, seq=seq, session=session).hex() == wire


@pytest.mark.parametrize(("wire", "message", "board", "seq", "session"), VECTORS)
def test_vectors_decode(wire, message, board, seq, session):
    frames = _decoder_for(message.ID, board, session).feed(bytes.fromhex(wire))
    if session == 0:
        assert frames == []  # a PLC without a session obeys nobody
    else:
        assert frames == [Frame(message, board, seq, session, m.MAJOR)]


ALL_WIRES = [bytes.fromhex(v[0]) for v in VECTORS] + [
    encode(state(**dict.fromkeys(m.layout(state), 1)), board=state.BOARD, seq=11, session=0x5A)
    for state in (m.SteerState, m.DriveState)
]


def test_no_damaged_vector_yields_a_frame():
    for wire in ALL_WIRES:
        for bit in range(8 * len(wire)):
            damaged = bytearray(wire)
            damaged[bit // 8] ^= 1 << bit % 8
            for decoder in _all_decoders():
                assert decoder.feed(b"\0" + damaged + b"\0") == []
        for length in range(len(wire)):
            for decoder in _all_decoders():
                assert decoder.feed(wire[:length]) == []
                if length < len(wire) - 1:
                    assert decoder.feed(b"\0") == []


def test_another_major_is_heard_only_in_the_greeting():
    plc = FrameDecoder(m.Board.STEER, host=False)
    plc.session = 7
    assert plc.feed(encode(m.Ping(1), board=m.Board.STEER, seq=0, session=7, major=1)) == []
    assert plc.counters == DecoderCounters(version=1)
    hello = m.Hello(0, 1, 5)
    (frame,) = plc.feed(encode(hello, board=m.Board.STEER, seq=0, session=9, major=1))
    assert (frame.message, frame.major) == (hello, 1)


_WRONG = {
    "length": [b"\x01" * 50 + b"\0", cobs.encode(b"1234567") + b"\0"],
    "cobs": [b"\x09abc\0"],
    "crc": [cobs.encode(b"12345678") + b"\0"],
    "unknown": [
        encode(m.Ping(1), board=m.Board.DRIVE, seq=0, session=7),  # another board
        encode(m.Pong(1, 2, 3), board=m.Board.STEER, seq=0, session=7),  # another direction
        encode(m.DriveCommand(0, 0, 0, 0, 0, 0, 0), board=m.Board.STEER, seq=0, session=7),
        encode(m.Ping(1), board=m.Board.ANY, seq=0, session=7),  # only HELLO may go to any
    ],
    "session": [
        encode(m.Ping(1), board=m.Board.STEER, seq=0, session=8),
        encode(m.Ping(1), board=m.Board.STEER, seq=0, session=0),
    ],
}


@pytest.mark.parametrize(("counter", "wire"), [(k, w) for k, ws in _WRONG.items() for w in ws])
def test_each_rule_has_its_counter(counter, wire):
    plc = FrameDecoder(m.Board.STEER, host=False)
    plc.session = 7
    assert plc.feed(b"\0\0" + wire) == []
    assert plc.counters == DecoderCounters(**{counter: 1})


def test_a_shorter_payload_is_counted_and_a_longer_one_accepted():
    def wire(payload: bytes) -> bytes:
        raw = bytes([0x41, m.Ping.ID, 0, 7]) + payload
        return cobs.encode(raw + zlib.crc32(raw).to_bytes(4, "little")) + b"\0"

    plc = FrameDecoder(m.Board.STEER, host=False)
    plc.session = 7
    assert plc.feed(wire(b"abc")) == []
    assert plc.counters == DecoderCounters(length=1)
    (frame,) = plc.feed(wire(b"\x04\x03\x02\x01 newer"))
    assert frame.message == m.Ping(0x01020304)


def test_a_host_hears_a_plc_that_lost_its_session():
    host = FrameDecoder(m.Board.STEER, host=True)
    host.session = 7
    event = m.Event(0, 0, 1, 0)
    (frame,) = host.feed(encode(event, board=m.Board.STEER, seq=0, session=0))
    assert frame.session == 0


def _messages(cls):
    fields = {n: st.integers(w.low, w.high) for n, w in m.layout(cls).items()}
    return st.builds(cls, **fields)


any_message = st.sampled_from(m.MESSAGES).flatmap(_messages)


@pytest.mark.slow
@given(any_message, st.integers(0, 255), st.integers(1, 255), st.randoms(use_true_random=False))
def test_every_message_survives_the_line_however_it_is_cut(message, seq, session, rng):
    board = m.Board.DRIVE if message.BOARD is m.Board.ANY else message.BOARD
    wire = encode(message, board=board, seq=seq, session=session)
    assert wire.count(0) == 1
    assert len(wire) == len(message.payload()) + 10
    decoder = _decoder_for(message.ID, board, session)
    frames = []
    while wire:
        cut = rng.randint(1, len(wire))
        frames += decoder.feed(wire[:cut])
        wire = wire[cut:]
    assert frames == [Frame(message, board, seq, session, m.MAJOR)]


@given(st.binary(max_size=300), st.binary(max_size=300))
def test_noise_never_raises_is_bounded_and_loses_no_delimited_frame(before, after):
    decoder = FrameDecoder(m.Board.DRIVE, host=False)
    decoder.session = 7
    good = encode(m.Ping(5), board=m.Board.DRIVE, seq=3, session=7)
    frames = decoder.feed(before + b"\0" + good + after)
    assert frames == [Frame(m.Ping(5), m.Board.DRIVE, 3, 7, m.MAJOR)]
    assert decoder.pending <= 50
    segments = [s for s in (before + b"\0" + after).split(b"\0")[:-1] if s]
    assert decoder.counters.rejected == len(segments)


def test_a_value_that_does_not_fit_names_its_field():
    command = dataclasses.replace(m.SteerCommand(0, 0, 0, 0, 0), angle=40000)
    with pytest.raises(m.LinkError, match=r"SteerCommand.angle = 40000 does not fit i16"):
        encode(command, board=m.Board.STEER, seq=0, session=1)


def test_random_noise_yields_no_frame():
    rng = random.Random(0)
    for decoder in _all_decoders():
        assert decoder.feed(rng.randbytes(200_000)) == []
