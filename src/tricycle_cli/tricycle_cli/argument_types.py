"""Types of arguments: what a text on the command line becomes, or why it is refused."""

from __future__ import annotations

import math
import re
from argparse import ArgumentTypeError
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from trajectory_recorder.bag.location import bag_path
from tricycle_core.errors import BagError, ExcitationError, PlanError

if TYPE_CHECKING:
    from parameter_identification.drives.poses import Datum


def bag_argument(text: str) -> Path:
    """Return where a bag is.

    Parameters
    ----------
    text : str
        Path or URL.

    Raises
    ------
    ArgumentTypeError
        If it is a URL that cannot be read here.
    """
    try:
        return bag_path(text)
    except BagError as error:
        raise ArgumentTypeError(str(error)) from error


def at_least(least: int) -> Callable[[str], int]:
    """Return an argument type for whole numbers.

    Parameters
    ----------
    least : int
        Smallest number that it accepts.
    """

    def parse(text: str) -> int:
        if not (text.isascii() and text.isdigit()) or int(text) < least:
            raise ArgumentTypeError(f"{text!r}: needs a whole number, {least} or more")
        return int(text)

    return parse


def file_ending_in(*suffixes: str) -> Callable[[str], Path]:
    """Return an argument type for files whose format their name tells.

    Parameters
    ----------
    suffixes : str
        Suffixes that it accepts, with the dot.
    """

    def parse(text: str) -> Path:
        if Path(text).suffix not in suffixes:
            one_of = "one of " if len(suffixes) > 1 else ""
            raise ArgumentTypeError(f"{text}: needs to end in {one_of}{', '.join(suffixes)}")
        return Path(text)

    return parse


def positive_number(text: str) -> float:
    """Return a finite number above 0.

    Parameters
    ----------
    text : str
        Text of the argument.

    Raises
    ------
    ArgumentTypeError
        If the text is not such a number.
    """
    value = _number(text)
    if not 0.0 < value < math.inf:
        raise ArgumentTypeError(f"{text!r}: needs a number above 0")
    return value


def nonnegative_number(text: str) -> float:
    """Return a finite number from 0.

    Parameters
    ----------
    text : str
        Text of the argument.

    Raises
    ------
    ArgumentTypeError
        If the text is not such a number.
    """
    value = _number(text)
    if not 0.0 <= value < math.inf:
        raise ArgumentTypeError(f"{text!r}: needs a number, 0 or more")
    return value


def real_time_factor(text: str) -> float:
    """Return the largest ratio of simulated to wall time, from 0 (no limit) to 1000.

    Parameters
    ----------
    text : str
        Text of the argument.

    Raises
    ------
    ArgumentTypeError
        If it is not a number of that range.
    """
    factor = _number(text)
    if not 0.0 <= factor <= 1000.0:
        raise ArgumentTypeError(f"{text!r}: must be from 0 (as fast as it runs) to 1000")
    return factor


def namespace(text: str) -> str:
    """Return a namespace of ROS nodes.

    Parameters
    ----------
    text : str
        Argument; empty: none.

    Raises
    ------
    ArgumentTypeError
        If no node can have it.
    """
    if not re.fullmatch(r"(/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*)?", text, re.ASCII):
        raise ArgumentTypeError(f"'{text}' is not a namespace, as in first or /yard/first")
    return text


def key_and_value(text: str) -> str:
    """Return a text as it is given, as the recorder takes entries of metadata.

    Parameters
    ----------
    text : str
        ``key=value``.

    Raises
    ------
    ArgumentTypeError
        If it has no key or no ``=``.
    """
    if text.find("=") < 1:
        raise ArgumentTypeError(f"{text!r}: needs key=value")
    return text


def parameter_name(text: str) -> str:
    """Return the name of a parameter; it may be typed with `-` or `_`.

    Parameters
    ----------
    text : str
        Text of the argument.
    """
    return text.replace("-", "_")


def parameter_names(text: str) -> tuple[str, ...]:
    """Return names of parameters, typed as for `parameter_name`.

    Parameters
    ----------
    text : str
        Names, separated by commas.

    Examples
    --------
    >>> parameter_names("front.cornering-stiffness,yaw_inertia")
    ('front.cornering_stiffness', 'yaw_inertia')
    """
    return tuple(map(parameter_name, text.split(",")))


def datum(text: str) -> Datum:
    """Return the origin of positions on the earth.

    Parameters
    ----------
    text : str
        Latitude and longitude [deg], then perhaps the altitude [m], separated by commas.

    Raises
    ------
    ArgumentTypeError
        If the text is not such a place.
    """
    from parameter_identification.drives.poses import Datum

    try:
        return Datum(*(float(number) for number in text.split(",")))
    except ExcitationError as error:  # a ValueError, too
        raise ArgumentTypeError(str(error)) from error
    except (ValueError, TypeError) as error:
        raise ArgumentTypeError(f"{text!r}: needs LAT,LON or LAT,LON,ALT") from error


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
            raise PlanError(f"{pair!r}: needs name=number") from None
        if name in values:
            raise PlanError(f"{name} is given twice")
        values[name] = value
    return values


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
