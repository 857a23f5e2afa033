"""Finding out which PLC is behind a serial port."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Iterator

from tricycle_bridge.plc_link.link import LinkEvent, PlcLink
from tricycle_bridge.protocol.messages import BAUD, Board
from tricycle_bridge.serial_port import Closed, Opened, Received, SerialPorts
from tricycle_core.closing import Closing
from tricycle_core.errors import LinkError

_POLL = 0.01  # s


class PortProbe(Closing):
    """The PLC behind one port, whichever it is. The handshake disarms it; it is never armed.

    Parameters
    ----------
    path : str
        Path of the serial device.
    baud : int
        Bits per second.
    boot_wait : float
        Silence after opening [s]: a UNO resets then and stays in its bootloader.

    Attributes
    ----------
    link : PlcLink
        Link to the board that is expected so far; another one after the other board answered.
    """

    def __init__(self, path: str, *, baud: int = BAUD, boot_wait: float = 2.0) -> None:
        self._path = path
        self._ready = threading.Event()
        self._ports = SerialPorts({Board.ANY: path}, self._ready.set, baud=baud)
        self.link = PlcLink(Board.STEER, rng=random.SystemRandom(), boot_wait=boot_wait)

    def handshake(self, *, timeout: float = 5.0) -> PlcLink:
        """Return the link once it is up.

        Parameters
        ----------
        timeout : float
            Longest time to wait [s].

        Raises
        ------
        LinkError
            The port cannot be opened, or no PLC of this protocol version answers.
        """
        for _ in self.events(timeout):
            if self.link.up:
                return self.link
        if self.link.answered_by is not None and self.link.problem:
            raise LinkError(f"{self._path}: {self.link.problem}")
        counters = self.link.decoder.counters
        raise LinkError(
            f"{self._path}: no PLC answers within {timeout:g} s ({counters.ok} good frames, "
            f"{counters.rejected} rejected): right port, power and baud rate?"
        )

    def events(self, seconds: float) -> Iterator[LinkEvent]:
        """Yield what happens on the link.

        Parameters
        ----------
        seconds : float
            How long to listen [s].

        Raises
        ------
        LinkError
            The port cannot be opened, or goes away, or its PLC has not answered for long.
        """
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self._ready.wait(_POLL)
            self._ready.clear()
            now = time.monotonic()
            for event in self._ports.take_events():
                match event:
                    case Opened():
                        self.link.opened(now)
                    case Received():
                        yield from self.link.receive(event.data, now)
                    case Closed():
                        raise LinkError(event.reason)
            yield from self.link.poll(now)
            if self.link.answered_by not in (None, self.link.board):
                self._change_board(now)
            if self.link.wants_reopen:
                raise LinkError(f"{self._path}: {self.link.down_reason}")
            self._ports.write(Board.ANY, self.link.take_frames())

    def _change_board(self, now: float) -> None:
        other = Board.DRIVE if self.link.board is Board.STEER else Board.STEER
        self.link = PlcLink(other, rng=random.SystemRandom())
        self.link.opened(now)

    def close(self) -> None:
        """Close the port."""
        self._ports.close()
