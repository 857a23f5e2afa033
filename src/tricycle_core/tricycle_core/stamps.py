"""ROS time stamps (builtin_interfaces/Time and Duration) as numbers."""

from typing import Protocol

SECOND = 1_000_000_000  # ns


class Stamp(Protocol):
    """A time or duration of ROS: whole seconds and nanoseconds, `nanosec` from 0 to 999 999 999."""

    sec: int
    nanosec: int


def nanoseconds_of(stamp: Stamp) -> int:
    """Return a stamp as nanoseconds, exactly.

    Parameters
    ----------
    stamp : Stamp
        Time or duration.
    """
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def seconds_of(stamp: Stamp) -> float:
    """Return a stamp in seconds; the rounding of a time since 1970 is 0.2 us.

    Parameters
    ----------
    stamp : Stamp
        Time or duration.
    """
    return float(stamp.sec) + float(stamp.nanosec) * 1e-9


def split_seconds(seconds: float) -> tuple[int, int]:
    """Return `sec` and `nanosec` of a time in seconds, rounded to nanoseconds.

    Parameters
    ----------
    seconds : float
        Time or duration [s].

    Examples
    --------
    >>> split_seconds(1.25)
    (1, 250000000)
    >>> split_seconds(-0.25)
    (-1, 750000000)
    """
    return divmod(round(seconds * 1e9), SECOND)
