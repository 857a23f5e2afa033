"""Simulated time at which a message was received."""

from bisect import bisect_right

KEPT = 20_000  # ticks


class ReceiptClock:
    """Time on /clock at which a message arrived, however late the message is processed.

    A recorder that reads its own clock when it gets to a message gives all that waited the same
    stamp.

    Parameters
    ----------
    kept : int
        Smallest number of ticks that are remembered.
    """

    def __init__(self, kept: int = KEPT) -> None:
        self._kept = kept
        self._received: list[int] = []
        self._times: list[int] = []

    @property
    def ticks(self) -> int:
        """Number of ticks that are remembered."""
        return len(self._times)

    @property
    def newest(self) -> int:
        """Time of receipt of the last tick [ns]; -1 before the first."""
        return self._received[-1] if self._received else -1

    def tick(self, received: int, time: int) -> None:
        """Take note of a tick of /clock, in order.

        Parameters
        ----------
        received : int
            When it was received, by the machine's clock [ns].
        time : int
            Simulated time that it brings [ns].
        """
        self._received.append(received)
        self._times.append(time)
        if len(self._received) > 2 * self._kept:
            del self._received[: -self._kept], self._times[: -self._kept]

    def at(self, received: int) -> int | None:
        """Return the simulated time of the last tick received until then [ns].

        The first tick kept where that is older, and None before any: there is no time yet.
        """
        if not self._times:
            return None
        return self._times[max(bisect_right(self._received, received) - 1, 0)]
