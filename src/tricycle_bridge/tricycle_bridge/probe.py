"""What is on a serial port: for the person with the cable in hand."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Iterator
from types import TracebackType
from typing import Self

from tricycle_bridge.link import LinkEvent, PlcLink
from tricycle_bridge.protocol.messages import BAUD, Board
from tricycle_bridge.serial_port import Closed, Opened, Received, SerialPorts
from tricycle_core.errors import LinkError

_POLL = 0.01  # s


class PortProbe:
    """The PLC on one port, whichever it is. Its handshake disarms it; it is never armed.

    Parameters
    ----------
    path
        Serial device.
    baud
        Bits per second.
    boot_wait
        Seconds of silence after opening: a UNO resets then and stays in its bootloader.
    """

    def __init__(self, path: str, *, baud: int = BAUD, boot_wait: float = 2.0) -> None:
        self._path = path
        self._boot_wait = boot_wait
        self._ready = threading.Event()
        self._ports = SerialPorts({Board.ANY: path}, self._ready.set, baud=baud)
        self.link = PlcLink(Board.STEER, rng=random.SystemRandom(), boot_wait=boot_wait)

    def handshake(self, *, timeout: float = 5.0) -> PlcLink:
        """Return the link, up.

        Raises
        ------
        LinkError
            The port cannot be opened, or no PLC of our protocol version answers.
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
        """Yield what happens on the link for so long.

        Raises
        ------
        LinkError
            The port cannot be opened, or goes away.
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
            self._ports.write(Board.ANY, self.link.take_frames())

    def _change_board(self, now: float) -> None:
        other = Board.DRIVE if self.link.board is Board.STEER else Board.STEER
        self.link = PlcLink(other, rng=random.SystemRandom())
        self.link.opened(now)

    def close(self) -> None:
        """Close the port."""
        self._ports.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
