"""What a decoder counts, the longest frame that it takes, and what fits into a field."""

import zlib

import pytest
from cobs import cobs

from tricycle_bridge.protocol.framing import DELIMITER, DecoderCounters, FrameDecoder
from tricycle_bridge.protocol.messages import (
    MAJOR,
    MAX_PAYLOAD,
    Board,
    Control,
    DriveState,
    Ping,
    SteerCommand,
    echo_of,
    layout,
)
from tricycle_core.errors import LinkError


def frame(payload_bytes):
    """A PING of a newer minor version, with a payload of this many bytes."""
    raw = bytes([MAJOR << 5 | Board.STEER, Ping.ID, 0, 7]) + bytes(payload_bytes)
    return cobs.encode(raw + zlib.crc32(raw).to_bytes(4, "little")) + DELIMITER


def plc_decoder():
    decoder = FrameDecoder(Board.STEER, host=False)
    decoder.session = 7
    return decoder


def test_a_fresh_decoder_has_no_session_and_counted_nothing():
    decoder = FrameDecoder(Board.STEER, host=True)
    assert decoder.session == 0
    assert set(vars(decoder.counters).values()) == {0}
    assert decoder.counters.rejected == 0


def test_every_way_to_be_rejected_counts():
    counters = DecoderCounters(1000, length=1, cobs=2, crc=4, version=8, unknown=16, session=32)
    assert counters.rejected == 63


@pytest.mark.parametrize("chunk", [1, 7, 1000])
def test_the_longest_frame_is_taken_and_one_byte_more_is_not(chunk):
    for payload, outcome in ((MAX_PAYLOAD, "ok"), (MAX_PAYLOAD + 1, "length")):
        decoder, data = plc_decoder(), frame(payload)
        for start in range(0, len(data), chunk):
            decoder.feed(data[start : start + chunk])
        assert vars(decoder.counters) == vars(DecoderCounters(**{outcome: 1}))


def test_noise_without_a_delimiter_is_not_hoarded():
    decoder = plc_decoder()
    for _ in range(1000):
        decoder.feed(b"\x55" * 100)
    assert decoder.pending == 50


def test_fields_hold_what_their_bytes_can():
    types = {wire.name: wire for m in (SteerCommand, DriveState) for wire in layout(m).values()}
    assert {name: (wire.low, wire.high) for name, wire in types.items()} == {
        "u8": (0, 255),
        "u16": (0, 65_535),
        "i16": (-32_768, 32_767),
        "u32": (0, 4_294_967_295),
        "i32": (-2_147_483_648, 2_147_483_647),
    }


@pytest.mark.parametrize("name", layout(SteerCommand))
@pytest.mark.parametrize("end", ["low", "high"])
def test_the_one_value_that_does_not_fit_is_named(name, end):
    fields = layout(SteerCommand)
    values = {field: getattr(wire, end) for field, wire in fields.items()}
    SteerCommand(**values).payload()  # the last that fit
    values[name] += 1 if end == "high" else -1
    with pytest.raises(LinkError, match=rf"SteerCommand.{name} = .* does not fit"):
        SteerCommand(**values).payload()


@pytest.mark.parametrize(
    ("op", "inverted_op", "guard", "right"),
    [
        (1, 0xFE, 0xA5, True),
        (4, 0xFB, 0xA5, True),
        (1, 0xFF, 0xA5, False),
        (1, 0xFE, 0xA4, False),
        (1, 0xFF, 0xA4, False),
    ],
)
@pytest.mark.parametrize("number", [0, 255])
def test_an_operation_is_guarded_by_each_of_its_bytes(op, inverted_op, guard, right, number):
    assert Control(op, inverted_op, number, guard, 77).guarded is right
    assert Control.of(op, number, 77) == Control(op, ~op & 0xFF, number, 0xA5, 77)
    assert Control.of(op).guarded


@pytest.mark.parametrize(
    ("t", "echo"),
    [(0, 0), (1023, 0), (1024, 1), (5_000_000, 4882), (1 << 26, 0), (0xFFFFFFFF, 0xFFFF)],
)
def test_an_echo_counts_units_of_1024_us_and_wraps(t, echo):
    assert echo_of(t) == echo
