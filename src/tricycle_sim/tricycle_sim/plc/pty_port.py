"""A serial device that is a pseudo-terminal: what the bridge opens, a PLC emulator serves."""

from __future__ import annotations

import contextlib
import fcntl
import os
import tty
from pathlib import Path

from tricycle_core.closing import Closing
from tricycle_core.errors import LinkError

_READ_SIZE = 4096  # bytes


class PtyPort(Closing):
    """The PLC's end of a pty; the other end is the serial device at `path`.

    Reads and writes never block.

    Parameters
    ----------
    link : path, optional
        Path at which the serial device appears (a symbolic link, replaced atomically); None: only
        at its ``/dev/pts/...`` path.

    Attributes
    ----------
    dropped : int
        Frames that the line did not take.
    plugged : bool
        Whether the device exists.

    Raises
    ------
    LinkError
        If something else than a symbolic link is at `link`, or that of another process that lives.
    """

    def __init__(self, link: str | os.PathLike[str] | None = None) -> None:
        self._link = None if link is None else Path(link)
        if self._link is not None and self._link.exists() and not self._link.is_symlink():
            raise LinkError(f"{self._link} is not a link to a serial device: it is not replaced")
        if self._link is not None and _is_served(self._link):
            raise LinkError(
                f"{self._link} is the serial device of another simulation: end that one, or choose "
                "another path"
            )
        self.dropped = 0
        self.plug()

    @property
    def path(self) -> Path:
        """Path that the host opens."""
        return self._link or self._device

    def fileno(self) -> int:
        """File descriptor of the PLC's end, for `selectors`."""
        return self._controller

    def plug(self) -> None:
        """Create the device and publish it."""
        self._controller, self._terminal = os.openpty()
        # The terminal's end stays open here: without one the controller reads EIO.
        tty.setraw(self._terminal)
        fcntl.lockf(self._terminal, fcntl.LOCK_EX)  # not flock, by which a host locks its port
        os.set_blocking(self._controller, False)
        self._device = Path(os.ttyname(self._terminal))
        self.plugged = True
        if self._link is not None:
            self._link.parent.mkdir(parents=True, exist_ok=True)
            temporary = self._link.with_name(f".{self._link.name}.{os.getpid()}")
            temporary.unlink(missing_ok=True)
            temporary.symlink_to(self._device)
            temporary.replace(self._link)

    def unplug(self) -> None:
        """Remove the device, as pulling its cable does: the host reads an error."""
        if not self.plugged:
            return
        self.plugged = False
        if self._link is not None:
            with contextlib.suppress(OSError):
                if self._link.readlink() == self._device:
                    self._link.unlink()
        os.close(self._controller)
        os.close(self._terminal)

    close = unplug

    def read(self) -> bytes:
        """Return what the host has written, or nothing."""
        if not self.plugged:
            return b""
        try:
            return os.read(self._controller, _READ_SIZE)
        except (BlockingIOError, InterruptedError):
            return b""

    def write(self, data: bytes) -> bool:
        """Write to the host; False, and counted, where the line is full and drops data."""
        if not data or not self.plugged:
            return self.plugged
        try:
            written = os.write(self._controller, data)
        except (BlockingIOError, InterruptedError):
            written = 0
        if written < len(data):
            self.dropped += 1
            return False
        return True


def _is_served(link: Path) -> bool:
    """Whether a link leads to a pty that another process serves; one that was killed leaves it."""
    try:
        device = os.open(link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        fcntl.lockf(device, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(device)
    return False
