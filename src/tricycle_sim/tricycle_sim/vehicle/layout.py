"""Layout of a group: where each number of eight vehicles stands in one flat array.

A *group* is one flat float64 array that holds `LANES` vehicles: row `r` of vehicle `i` is element
`r * LANES + i`. One array with row offsets known at compile time lets LLVM turn the loop over the
lanes into vector instructions; separate arrays do not vectorise. Every constant is a row too, so
any of them may differ from vehicle to vehicle. Rows have names; their numbers follow.
"""

from collections import namedtuple
from collections.abc import Callable, Iterable, Mapping, Sized
from typing import Any

LANES = 8

Formulas = Mapping[str, Callable[[Any], Any]]
"""Constants of a compiled part by name, each as it follows from the constants of a `Vehicle`.

A formula may get arrays for unknown parameters and then returns one.
"""

StepFormulas = Mapping[str, Callable[[Any, float], float]]
"""Likewise, of a part whose constants depend on the length of its steps [s] too."""


def numbered(names: str | Iterable[str], first: int = 0, step: int = 1) -> Any:
    """Return numbers by name, as a named tuple that compiled code takes for constants.

    Parameters
    ----------
    names : str or iterable of str
        Names in order; in a string between blanks.
    first : int
        Number of the first name.
    step : int
        From one name's number to the next one's.
    """
    fields = names.split() if isinstance(names, str) else list(names)
    kind = namedtuple("Numbers", fields)  # type: ignore[misc]
    return kind(*range(first, first + step * len(fields), step))


def blocks(first: int, alternatives: Mapping[str, Iterable[Sized]]) -> tuple[Any, int]:
    """Return the first number of each block by name, and the number after the last one.

    Parameters
    ----------
    first : int
        Number of the first block.
    alternatives : mapping
        By block what may stand in it; the longest one decides its length.
    """
    names = {}
    for name, choices in alternatives.items():
        names[name] = first
        first += max(len(choice) for choice in choices)
    return numbered(names)._make(names.values()), first


STATE = numbered(
    """x y z  q0 q1 q2 q3  u v w  p q r  spin_left spin_right spin_rear
    kappa_left kappa_right kappa_rear  alpha_left alpha_right alpha_rear  torque integrator"""
)
"""Rows of the states.

COM in the world [m]; unit quaternion body to world, scalar first; velocity [m/s] and angular rate
[rad/s] in the body frame; absolute spins about the axles [rad/s]; relaxed longitudinal and lateral
slips; torque of the motor [N m]; integrator of the speed controller [rad].
"""
STATES = len(STATE)
START, SUM, SLOPE = STATES, 2 * STATES, 3 * STATES
"""First rows of the states at the start of a step, of the weighted sum of slopes, of the slopes."""

EVALUATED = numbered(
    "load_left load_right load_rear share_left share_right share_rear excess tilt",
    first=4 * STATES,
)
"""Rows of what the last evaluation of the slopes saw.

Wheel loads [N]; squared shares of the friction limit; motor torque beyond the motor's limits [N m];
cosine of the body's tilt.
"""
ALIVE = EVALUATED[-1] + 1
"""1 until the vehicle has rolled over, then 0."""

EVENT_ROWS = 4
EVENT = numbered(
    "least_load_left least_load_right least_load_rear friction motor rollover steering",
    first=ALIVE + 1,
    step=EVENT_ROWS,
)
"""First of four rows of an event: value, tick, x, y.

Least loads, largest friction share, first saturation of the motor, roll-over, first saturation of
the steering.
"""
CONSTANTS = EVENT[-1] + EVENT_ROWS
"""First row of the constants; each compiled part brings its own block of them."""
