"""The two serial ports: one I/O thread reads both, writes never block.

The only module that imports `serial`. Reading all ports in one thread takes less CPU time than a
thread per port, and delivers sooner.
"""

from __future__ import annotations

import contextlib
import os
import select
import termios
import threading
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import serial

from tricycle_bridge.protocol.messages import BAUD, Board
from tricycle_core.closing import Closing

RETRY_PERIOD = 0.1  # s between attempts to open a port
IDLE_PERIOD = 0.05  # s between notifications while nothing arrives
_READ_SIZE = 4096  # bytes
_MAX_WAITING = 64 * 1024  # bytes per port that wait to be taken; further bytes are dropped

# What pyserial and the system raise when a device goes away; termios.error is not an OSError, and
# closing during a read raises TypeError.
_GONE = (OSError, serial.SerialException, termios.error, TypeError)


class Opened(NamedTuple):
    """A port was opened.

    Attributes
    ----------
    board : Board
        Board of the port.
    """

    board: Board


class Received(NamedTuple):
    """Bytes arrived.

    Attributes
    ----------
    board : Board
        Board of the port.
    data : bytes
        Received bytes.
    """

    board: Board
    data: bytes


class Closed(NamedTuple):
    """A port went away, or could not be opened.

    Attributes
    ----------
    board : Board
        Board of the port.
    reason : str
        Why, for a person.
    """

    board: Board
    reason: str


PortEvent = Opened | Received | Closed


class _Port:
    """An open serial device and its file descriptor."""

    def __init__(self, path: str, baud: int) -> None:
        # Opening clears the driver's buffer, and resets a real UNO (DTR). With an inter-byte
        # timeout an end of file means that the device is gone: without new bytes it would block.
        self.device = serial.Serial(
            path, baud, timeout=0.0, inter_byte_timeout=0.0, write_timeout=0, exclusive=True
        )
        self.fd = self.device.fileno()
        self.cut = False  # the last frame was written in part
        os.set_blocking(self.fd, False)

    def close(self) -> None:
        with contextlib.suppress(*_GONE):
            self.device.close()


class SerialPorts(Closing):
    """Keeps both ports open, tries again while one does not exist, and passes on what they receive.

    Parameters
    ----------
    paths : mapping of Board to str
        Serial device of each board.
    notify : callable
        Called in the I/O thread when `take_events` has something new, and every `IDLE_PERIOD` while
        it has not; it may call every method but `close`.
    ended : callable
        Called in the I/O thread when an exception in `notify` ends it.
    baud : int
        Bits per second.
    """

    def __init__(
        self,
        paths: Mapping[Board, str],
        notify: Callable[[], None],
        *,
        ended: Callable[[], None] = lambda: None,
        baud: int = BAUD,
    ) -> None:
        self._paths = dict(paths)
        self._notify = notify
        self._ended = ended
        self._baud = baud
        self._ports: dict[Board, _Port] = {}
        self._retry_at = dict.fromkeys(paths, 0.0)
        self._reopen: dict[Board, str] = {}
        self._events: list[PortEvent] = []
        self._waiting = dict.fromkeys(paths, 0)  # bytes in _events
        self._taken = False  # the events, since the I/O thread looked
        self._lock = threading.Lock()
        self._poll = select.poll()
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_write, False)
        self._poll.register(self._wake_read, select.POLLIN)
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="serial ports", daemon=True)
        self._thread.start()

    def take_events(self) -> list[PortEvent]:
        """Return what happened since the last call, oldest first.

        It reads the ports itself, because on a busy machine the I/O thread may run much later.
        """
        with self._lock:
            self._read_all()
            events, self._events = self._events, []
            self._waiting = dict.fromkeys(self._waiting, 0)
            self._taken = True
        return events

    def write(self, board: Board, frames: list[bytes]) -> int:
        """Write frames; return how many were dropped because the port is full, gone or closed.

        Parameters
        ----------
        board : Board
            Board to write to.
        frames : list of bytes
            Frames with their delimiters.
        """
        with self._lock:
            port = self._ports.get(board)
            if port is None:
                return len(frames)
            for done, frame in enumerate(frames):
                # the delimiter ends a damaged frame, which fails its CRC
                data = b"\0" + frame if port.cut else frame
                try:
                    port.cut = os.write(port.fd, data) < len(data)
                    if port.cut:
                        return len(frames) - done
                except BlockingIOError:
                    return len(frames) - done
                except _GONE as error:
                    self._ask_reopen(board, f"{self._paths[board]}: {error}")
                    return len(frames) - done
        return 0

    def reopen(self, board: Board, reason: str) -> None:
        """Close a port and open it again.

        Parameters
        ----------
        board : Board
            Board of the port.
        reason : str
            Why, for the event `Closed`.
        """
        with self._lock:
            self._ask_reopen(board, reason)

    def close(self) -> None:
        """Close both ports and end the thread."""
        if self._stopping:
            return
        self._stopping = True
        self._wake()
        self._thread.join()
        for board in list(self._ports):  # not by the thread: after its death a stop can be written
            self._close(board, "closed")
        os.close(self._wake_read)
        os.close(self._wake_write)

    # ---- the I/O thread ----

    def _run(self) -> None:
        try:
            while not self._stopping:
                self._look()
        finally:
            if not self._stopping:
                self._ended()

    def _look(self) -> None:
        """Open what is closed; wait for the ports and have the owner take what arrived."""
        if len(self._ports) < len(self._paths):
            now = time.monotonic()
            for board in self._paths:
                if board not in self._ports and now >= self._retry_at[board]:
                    self._open(board)
        if self._events:
            self._notify()
        for fd, _ in self._poll.poll(self._patience() * 1e3):
            if fd == self._wake_read:
                os.read(fd, _READ_SIZE)
        if self._stopping:
            return
        self._taken = False
        self._notify()
        if not self._taken:  # the owner does so later, and the line must not be full until then
            with self._lock:
                self._read_all()
        if self._reopen:
            with self._lock:
                reopen, self._reopen = self._reopen, {}
            for board, reason in reopen.items():
                self._close(board, reason)

    def _patience(self) -> float:
        """Longest time to wait for an event [s]."""
        closed = [self._retry_at[board] for board in self._paths if board not in self._ports]
        if not closed:
            return IDLE_PERIOD
        return min(max(min(closed) - time.monotonic(), 0.0), IDLE_PERIOD)

    def _open(self, board: Board) -> None:
        path = self._paths[board]
        try:
            port = _Port(path, self._baud)
        except _GONE as error:
            self._retry_at[board] = time.monotonic() + RETRY_PERIOD
            with self._lock:
                self._events.append(Closed(board, _open_problem(path, error)))
            return
        with self._lock:
            self._ports[board] = port
            self._events.append(Opened(board))
        self._poll.register(port.fd, select.POLLIN)

    def _close(self, board: Board, reason: str) -> None:
        with self._lock:
            port = self._ports.pop(board, None)
        if port is None:
            return
        self._poll.unregister(port.fd)
        port.close()
        self._retry_at[board] = time.monotonic() + RETRY_PERIOD
        with self._lock:
            self._events.append(Closed(board, reason))

    # ---- with the lock held ----

    def _read_all(self) -> None:
        """Read what the ports have received; have those closed that are gone."""
        for board, port in self._ports.items():
            try:
                data = os.read(port.fd, _READ_SIZE)
                gone = "" if data else "end of file, the device was unplugged"
            except BlockingIOError:
                continue
            except _GONE as error:
                data, gone = b"", str(error)
            if gone:
                self._ask_reopen(board, f"{self._paths[board]}: {gone}")
            elif self._waiting[board] <= _MAX_WAITING:
                self._waiting[board] += len(data)
                self._events.append(Received(board, data))

    def _ask_reopen(self, board: Board, reason: str) -> None:
        self._reopen[board] = reason
        self._wake()

    def _wake(self) -> None:
        with contextlib.suppress(BlockingIOError):
            os.write(self._wake_write, b"\0")


def _open_problem(path: str, error: Exception) -> str:
    if not os.path.exists(path):  # noqa: PTH110 - a device path, kept as the user wrote it
        return f"{path} does not exist"
    if not os.access(path, os.R_OK | os.W_OK):
        return f"{path}: no permission (is the user in the group dialout?)"
    if isinstance(error, BlockingIOError) or "lock" in str(error):
        return f"{path} is in use by another program"
    if "Could not configure port" in str(error) or os.path.isdir(path):  # noqa: PTH112 - as above
        return f"{path} is no serial port"
    return f"{path}: {' '.join(str(error).split())}"
