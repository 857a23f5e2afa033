"""Frames of TBP v2: ``COBS(header payload crc32) 00`` to messages and back (sections 1 and 2).

Section numbers are those of docs/protocol.md.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from cobs import cobs  # type: ignore[import-untyped]

from tricycle_bridge.protocol.messages import (
    BOARD_MASK,
    FROM_PLC,
    MAJOR,
    MAJOR_SHIFT,
    MAX_PAYLOAD,
    MESSAGES,
    Board,
    Hello,
    HelloAck,
    Message,
    from_plc,
    payload_struct,
)

DELIMITER = b"\0"
_HEADER = struct.Struct("<BBBB")  # ver_node, id, seq, sess
_CRC = struct.Struct("<I")
_RESIDUE = 0x2144DF1C  # the CRC of any bytes followed by their CRC, little endian
_MIN_RAW = _HEADER.size + _CRC.size
_MAX_RAW = _MIN_RAW + MAX_PAYLOAD
_MAX_ENCODED = _MAX_RAW + 1  # COBS adds one byte to anything this short


class Frame(NamedTuple):
    """A message with its header.

    Attributes
    ----------
    message : Message
        Decoded message.
    board : Board
        PLC that sent or receives it.
    seq : int
        Sequence number, 0 to 255.
    session : int
        Session, 0 to 255; 0 = none.
    major : int
        Protocol version of the sender.
    """

    message: Message
    board: Board
    seq: int
    session: int
    major: int


@dataclass
class DecoderCounters:
    """Results of decoding the segments between delimiters.

    Attributes
    ----------
    ok : int
        Decoded frames.
    length : int
        Segments that are too long or too short, or whose payload is shorter than in the message
        table.
    cobs, crc : int
        Segments with a COBS error, and with a wrong checksum.
    version : int
        Frames of another major version.
    unknown : int
        Frames for another board, in the other direction, or with an id that is not in the message
        table.
    session : int
        Frames of another session.
    """

    ok: int = 0
    length: int = 0
    cobs: int = 0
    crc: int = 0
    version: int = 0
    unknown: int = 0
    session: int = 0

    @property
    def rejected(self) -> int:
        """Segments that yielded no frame."""
        return self.length + self.cobs + self.crc + self.version + self.unknown + self.session


def encode(message: Message, *, board: Board, seq: int, session: int, major: int = MAJOR) -> bytes:
    """Encode one frame with its closing delimiter.

    Parameters
    ----------
    message : Message
        Message to send; its id determines the direction bit.
    board : Board
        PLC that sends or receives it; `Board.ANY` in a HELLO to any board.
    seq : int
        Sequence number, 0 to 255.
    session : int
        Session, 0 to 255.
    major : int
        Protocol version, 0 to 7.

    Returns
    -------
    wire : bytes
        Bytes for the line.

    Raises
    ------
    LinkError
        If a value does not fit its field.
    """
    direction = FROM_PLC if from_plc(message.ID) else 0
    ver_node = major << MAJOR_SHIFT | direction | board
    raw = _HEADER.pack(ver_node, message.ID, seq, session) + message.payload()
    return bytes(cobs.encode(raw + _CRC.pack(zlib.crc32(raw)))) + DELIMITER


class FrameDecoder:
    """Turns a stream of bytes, cut anywhere, into frames.

    It never raises, and keeps at most one segment of 50 bytes. The first rule of section 1 that a
    segment breaks is counted.

    Parameters
    ----------
    board : Board
        PLC of this link. A host accepts HELLO_ACK from any board (to report swapped ports), a PLC
        accepts HELLO to `Board.ANY`.
    host : bool
        True on the host, which receives the PLC's messages; False on a PLC.

    Attributes
    ----------
    counters : DecoderCounters
        Numbers of segments, by the result of decoding.
    session : int
        The present session, kept by the owner; 0 = none.
    """

    def __init__(self, board: Board, *, host: bool) -> None:
        self.counters = DecoderCounters()
        self.session = 0
        self._board = board
        self._host = host
        self._partial = b""
        self._table: dict[int, tuple[int, Callable[[bytes], Message]]] = {
            m.ID: (payload_struct(m).size, m.from_payload)
            for m in MESSAGES
            if from_plc(m.ID) == host and m.BOARD in (board, Board.ANY)
        }
        # The one message that is taken also from another major, board or session (section 3).
        self._greeting = HelloAck.ID if host else Hello.ID
        self._greeting_boards = (Board.STEER, Board.DRIVE) if host else (Board.ANY,)

    @property
    def pending(self) -> int:
        """Bytes of the segment that is not complete yet; at most 50."""
        return len(self._partial)

    def reset(self) -> None:
        """Forget an incomplete segment, after the port was opened again."""
        self._partial = b""

    def feed(self, data: bytes) -> list[Frame]:
        """Take bytes from the line; return the frames that they complete."""
        segments = data.split(DELIMITER)
        segments[0] = self._partial + segments[0]
        # One byte more than a legal segment is enough to know that it is too long.
        self._partial = segments.pop()[: _MAX_ENCODED + 1]
        return [
            frame
            for segment in segments
            if segment and (frame := self._decode(segment)) is not None
        ]

    def _decode(self, segment: bytes) -> Frame | None:
        counters = self.counters
        if len(segment) > _MAX_ENCODED:
            counters.length += 1
            return None
        try:
            raw = cobs.decode(segment)
        except cobs.DecodeError:
            counters.cobs += 1
            return None
        if len(raw) < _MIN_RAW:
            counters.length += 1
            return None
        if zlib.crc32(raw) != _RESIDUE:
            counters.crc += 1
            return None

        ver_node, message_id, seq, session = raw[:4]
        major, board = ver_node >> MAJOR_SHIFT, ver_node & BOARD_MASK
        greeting = message_id == self._greeting
        if major != MAJOR and not greeting:
            counters.version += 1
            return None
        entry = self._table.get(message_id)
        if (
            entry is None
            or bool(ver_node & FROM_PLC) != self._host
            or not (board == self._board or (greeting and board in self._greeting_boards))
        ):
            counters.unknown += 1
            return None
        # A host takes session 0 too, because that is what a rebooted PLC sends. A PLC without a
        # session takes nothing.
        session_fits = session in (self.session, 0) if self._host else session == self.session != 0
        if not (session_fits or greeting):
            counters.session += 1
            return None
        size, from_payload = entry
        if len(raw) - _MIN_RAW < size:
            counters.length += 1
            return None
        counters.ok += 1
        sender = self._board if board == self._board else Board(board)
        return Frame(from_payload(raw[4:-4]), sender, seq, session, major)
