"""Values of arguments that several subcommands take."""

import math
from argparse import ArgumentTypeError
from collections.abc import Sequence

from tricycle_core.errors import PlanError


def seed(text: str) -> int:
    """Return a seed of the random streams, a whole number from 0.

    Parameters
    ----------
    text : str
        Argument.

    Raises
    ------
    ArgumentTypeError
        If it is another text.

    Examples
    --------
    >>> seed("7")
    7
    """
    if not (text.isascii() and text.isdigit()):
        raise ArgumentTypeError(f"{text!r} must be a whole number from 0")
    return int(text)


def real_time_factor(text: str) -> float:
    """Return the largest ratio of simulated to wall time, from 0 (no limit) to 1000.

    Parameters
    ----------
    text : str
        Argument.

    Raises
    ------
    ArgumentTypeError
        If it is outside that range, or no number.
    """
    factor = _number(text)
    if not 0.0 <= factor <= 1000.0:
        raise ArgumentTypeError(f"{text!r} must be from 0 (as fast as it runs) to 1000")
    return factor


def not_negative(text: str) -> float:
    """Return a finite number from 0.

    Parameters
    ----------
    text : str
        Argument.

    Raises
    ------
    ArgumentTypeError
        If it is another text.
    """
    value = _number(text)
    if not 0.0 <= value < math.inf:
        raise ArgumentTypeError(f"{text!r}: needs a number, 0 or more")
    return value


def parse_assignments(pairs: Sequence[str]) -> dict[str, float]:
    """Return numbers by name.

    Parameters
    ----------
    pairs : sequence of str
        Texts of the form `name=value`.

    Raises
    ------
    PlanError
        If a text has another form, or a name comes twice.

    Examples
    --------
    >>> parse_assignments(["radius=3", "speed=0.8"])
    {'radius': 3.0, 'speed': 0.8}
    """
    values: dict[str, float] = {}
    for pair in pairs:
        name, _, text = pair.partition("=")
        try:
            value = float(text)
        except ValueError:
            raise PlanError(f"{pair!r}: want name=number") from None
        if name in values:
            raise PlanError(f"{name} is given twice")
        values[name] = value
    return values


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
