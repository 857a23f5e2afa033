"""A PLC's clock in the host's time, from PING and PONG; for stamping only.

Section 6 of docs/protocol.md. Host times are in seconds, the PLC's in microseconds, 32 bits.
"""

from __future__ import annotations

from collections import deque

_WRAP = 1 << 32  # us: 71.6 minutes
_SAMPLES = 16  # newest pings, of which the one that tells the offset best gives it
_SLEW = 0.01  # s of correction per s: twice what a UNO's ceramic resonator can be off
_FIRST_SLEW = 0.005  # s of correction per ping, of the first 16: half of a tick
_STEP = 0.05  # s: a larger error is not drift and is corrected at once


def elapsed_us(later: int, earlier: int) -> int:
    """Return the time between two readings of a PLC's clock [us], across its wrap.

    Parameters
    ----------
    later, earlier : int
        Readings [us], less than a wrap apart.

    Examples
    --------
    >>> elapsed_us(5, (1 << 32) - 5)
    10
    """
    return (later - earlier) % _WRAP


class PlcClock:
    """Maps the PLC's clock to the host's.

    The offset is that of the ping, among the last 16, with the shortest round trip plus 1 % of its
    age: half of either is what it may be off by, as the clocks drift by 0.5 % at most. It is
    approached at 1 % at most, and by half of a tick at each of the first 16 pings, whose replies
    may wait for a busy host: so stamps stay monotonic.

    Simulated time stands still between the simulation's ticks, and a reply may come before or after
    the next one: there the offset is that of the PING that reached the board soonest, by the time
    of its sending alone.

    Parameters
    ----------
    simulated : bool
        Whether the host's time is simulated.

    Attributes
    ----------
    round_trip : float or None
        Round trip of the newest ping without the PLC's part [s]; None before the first.
    """

    def __init__(self, *, simulated: bool = False) -> None:
        self.round_trip: float | None = None
        self._simulated = simulated
        self._last_us: int | None = None
        self._unwrapped_us = 0
        # (round trip, or in simulated time the offset; host time; offset)
        self._samples: deque[tuple[float, float, float]] = deque(maxlen=_SAMPLES)
        self._offset: float | None = None  # s, PLC minus host
        self._updated = 0.0

    @property
    def settled(self) -> bool:
        """Whether enough pings were answered to choose among."""
        return len(self._samples) == _SAMPLES

    def unwrap(self, t: int) -> float:
        """Return a reading [us] as seconds since the zero before the first reading."""
        if self._last_us is None:
            self._unwrapped_us = t
        else:
            # the nearest time with this reading: readings may arrive slightly out of order
            difference = elapsed_us(t, self._last_us)
            self._unwrapped_us += difference - (_WRAP if difference >= _WRAP // 2 else 0)
        self._last_us = t
        return self._unwrapped_us * 1e-6

    def add_ping(self, t0: float, t_rx: int, t_tx: int, t3: float) -> None:
        """Take one exchange.

        Parameters
        ----------
        t0 : float
            Host time at which PING was sent [s].
        t_rx, t_tx : int
            PLC times at which PING arrived and PONG was sent [us].
        t3 : float
            Host time at which PONG arrived [s].
        """
        settled = self.settled
        rx, tx = self.unwrap(t_rx), self.unwrap(t_tx)
        self.round_trip = (t3 - t0) - (tx - rx)
        if self._simulated:
            self._samples.append((rx - t0, t3, rx - t0))
        else:
            self._samples.append((self.round_trip, t3, (rx + tx) / 2 - (t0 + t3) / 2))
        *_, target = min(self._samples, key=lambda ping: ping[0] + _SLEW * (t3 - ping[1]))
        if self._offset is None or abs(target - self._offset) > _STEP:
            self._offset = target
        else:
            most = _SLEW * max(t3 - self._updated, 0.0) if settled else _FIRST_SLEW
            self._offset += min(max(target - self._offset, -most), most)
        self._updated = t3

    def to_host(self, t: int, *, received: float) -> float:
        """Return the host time of a PLC time; before the first ping it is the time of reception.

        Parameters
        ----------
        t : int
            PLC time [us].
        received : float
            Host time at which the message with it arrived [s]; the result is never later.
        """
        plc_time = self.unwrap(t)
        return received if self._offset is None else min(plc_time - self._offset, received)
