"""Finding the PLC behind a port: HELLO until one answers, and whether it may be used (section 3).

Section numbers are those of docs/protocol.md. Times are seconds on one monotonic host clock.
"""

from __future__ import annotations

import random

from tricycle_bridge.protocol.framing import Frame
from tricycle_bridge.protocol.messages import MAJOR, MINOR, Board, Hello, HelloAck

HELLO_PERIOD = 0.2
"""Time between two HELLO [s]."""

HELLO_PATIENCE = 3.0
"""Time without an answer until it is reported [s]."""


class Handshake:
    """HELLO and its answer on one link, from each opening of the port or reboot of the PLC.

    Parameters
    ----------
    board : Board
        PLC expected behind the port.
    rng : random.Random
        Source of sessions and nonces.
    """

    def __init__(self, board: Board, *, rng: random.Random) -> None:
        self.board = board
        self.sent = 0  # HELLO since `start`
        self.begins_at = 0.0  # s
        self._rng = rng
        self._nonce = 0
        self._next_at = 0.0
        self._silence_reported = False

    def start(self, at: float) -> None:
        """Begin with the first HELLO at a time [s]."""
        self.sent = 0
        self.begins_at = self._next_at = at
        self._silence_reported = False

    def new_session(self, old: int) -> int:
        """Return a session other than the old one, from 1 to 255."""
        session = old
        while session == old:
            session = self._rng.randint(1, 255)
        return session

    def due(self, now: float) -> Hello | None:
        """Return the HELLO that is to be sent now, if any."""
        if now < self._next_at:
            return None
        # A PLC asked for another board stays silent, so every second HELLO asks for any board:
        # only its answer can show that the ports are swapped.
        wanted = self.board if self.sent % 2 == 0 else Board.ANY
        self.sent += 1
        self._nonce = self._rng.getrandbits(32)
        self._next_at = now + HELLO_PERIOD
        return Hello(MINOR, wanted, self._nonce)

    def falls_silent(self, now: float) -> bool:
        """Whether `HELLO_PATIENCE` has passed without an answer; True once per start."""
        if self._silence_reported or now - self.begins_at < HELLO_PATIENCE:
            return False
        self._silence_reported = True
        return True

    def is_answered_by(self, ack: HelloAck) -> bool:
        """Whether this is the answer to the last HELLO, not to an older one."""
        return ack.nonce == self._nonce

    def refusal(self, frame: Frame, ack: HelloAck) -> str | None:
        """Return why the PLC that answered cannot be used; None if it can.

        Parameters
        ----------
        frame : Frame
            Frame of the answer.
        ack : HelloAck
            Decoded answer.
        """
        if frame.major != MAJOR:
            return (
                f"the PLC speaks protocol version {frame.major}, this bridge {MAJOR}: "
                f"flash it with this version's firmware/ (docs/how-to-arduinos.md)"
            )
        if frame.board != self.board or ack.board != self.board:
            return (
                f"ports swapped: the {frame.board.plc_name} answers where the "
                f"{self.board.plc_name} should be"
            )
        return None
