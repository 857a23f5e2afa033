"""Types of arguments that several subcommands take; what does not fit is said before any work."""

from argparse import ArgumentTypeError


def seed(text: str) -> int:
    """Return a seed of the random streams, a whole number from 0.

    Raises
    ------
    ArgumentTypeError
        If it is none.
    """
    if not (text.isascii() and text.isdigit()):
        raise ArgumentTypeError(f"{text!r} must be a whole number from 0")
    return int(text)


def real_time_factor(text: str) -> float:
    """Return a largest ratio of simulated to wall time, 0 (no limit) to 1000.

    Raises
    ------
    ArgumentTypeError
        If it is none.
    """
    try:
        factor = float(text)
    except ValueError:
        factor = -1.0
    if not 0.0 <= factor <= 1000.0:
        raise ArgumentTypeError(f"{text!r} must be from 0 (as fast as it runs) to 1000")
    return factor
