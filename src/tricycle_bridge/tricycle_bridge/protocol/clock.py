"""A PLC's clock in the host's time, from PING and PONG (section 6). For stamping only."""

from __future__ import annotations

from collections import deque

_WRAP = 1 << 32  # us: 71.6 minutes
_SAMPLES = 16  # newest pings among which the quickest one is believed
_SLEW = 0.01  # s of correction per s: twice what a UNO's ceramic resonator can be off
_STEP = 0.05  # s: a larger error is not drift, so it is not slewed


def elapsed_us(later: int, earlier: int) -> int:
    """Microseconds between two readings of a PLC's 32-bit clock, across its wrap.

    >>> elapsed_us(5, (1 << 32) - 5)
    10
    """
    return (later - earlier) % _WRAP


class PlcClock:
    """Maps the PLC's 32-bit microseconds to the host's clock.

    The offset is that of the quickest of the last 16 pings, approached at most at 1 % so that
    stamps stay monotonic. All host times in seconds.
    """

    def __init__(self) -> None:
        self._last_us: int | None = None
        self._unwrapped_us = 0
        self._samples: deque[tuple[float, float]] = deque(maxlen=_SAMPLES)  # (rtt, offset)
        self._offset: float | None = None  # s, PLC minus host
        self._updated = 0.0
        self.round_trip: float | None = None  # s, of the newest ping

    def unwrap(self, t: int) -> float:
        """Seconds on the PLC's clock since its first reading's zero, without the wrap."""
        if self._last_us is None:
            self._unwrapped_us = t
        else:
            # the nearest time that reads t: readings may arrive slightly out of order
            difference = elapsed_us(t, self._last_us)
            self._unwrapped_us += difference - (_WRAP if difference >= _WRAP // 2 else 0)
        self._last_us = t
        return self._unwrapped_us * 1e-6

    def add_ping(self, t0: float, t_rx: int, t_tx: int, t3: float) -> None:
        """Take one exchange: PING at t0, heard at t_rx, answered at t_tx, PONG at t3."""
        rx, tx = self.unwrap(t_rx), self.unwrap(t_tx)
        self.round_trip = (t3 - t0) - (tx - rx)
        self._samples.append((self.round_trip, (rx + tx) / 2 - (t0 + t3) / 2))
        target = min(self._samples)[1]
        if self._offset is None or abs(target - self._offset) > _STEP:
            self._offset = target
        else:
            most = _SLEW * max(t3 - self._updated, 0.0)
            self._offset += min(max(target - self._offset, -most), most)
        self._updated = t3

    def to_host(self, t: int, *, received: float) -> float:
        """Host time of a PLC time; never later than the moment it was received.

        Before the first ping it is the time of reception.
        """
        plc_time = self.unwrap(t)
        return received if self._offset is None else min(plc_time - self._offset, received)
