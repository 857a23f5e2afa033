"""Layout of a group: where each number of eight vehicles stands in one flat array.

A *group* is one flat float64 array that holds `LANES` vehicles: row `r` of vehicle `i` is element
`r * LANES + i`. One array with row offsets known at compile time lets LLVM turn the loop over the
lanes into vector instructions; separate arrays do not vectorise. Every constant is a row too, so
any of them may differ from vehicle to vehicle. Rows have names; their numbers follow.
"""

from collections import namedtuple
from collections.abc import Callable, Iterable, Mapping, Sized
from typing import Any

from tricycle_sim.vehicle.wheels import MOST_WHEELS

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
        Distance between one name's number and the next one's.
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
        Possible contents of each block; the longest one decides its length.
    """
    names = {}
    for name, choices in alternatives.items():
        names[name] = first
        first += max(len(choice) for choice in choices)
    return numbered(names)._make(names.values()), first


STATE = numbered(
    "x y z  q0 q1 q2 q3  u v w  p q r  torque integrator  spin kappa alpha",
)
"""Rows of the states; the last three are those of the first wheel, every other wheel's follow.

COM in the world [m]; unit quaternion body to world, scalar first; velocity [m/s] and angular rate
[rad/s] in the body frame; torque of the motor [N m]; integrator of the speed controller [rad].
Of each wheel: absolute spin about the axle [rad/s], relaxed longitudinal and lateral slip.
"""
WHEEL_STATES = 3
"""Rows from a state of one wheel to that of the next."""
STATES = STATE.spin + MOST_WHEELS * WHEEL_STATES
START, SUM, SLOPE = STATES, 2 * STATES, 3 * STATES
"""First rows of the states at the start of a step, of the weighted sum of slopes, of the slopes."""

EVALUATED = numbered("excess tilt  load friction_squared", first=4 * STATES)
"""Rows of what the last evaluation of the slopes saw; the last two of the first wheel.

Motor torque beyond the motor's limits [N m]; cosine of the body's tilt; wheel load [N]; square of
the force over the friction limit's.
"""
WHEEL_EVALUATED = 2
"""Rows from the load of one wheel to that of the next."""
ALIVE = EVALUATED.load + MOST_WHEELS * WHEEL_EVALUATED
"""1 until the vehicle has rolled over, then 0."""

EVENT_ROWS = 4
EVENT = numbered(
    "friction_squared motor rollover steering  least_load", first=ALIVE + 1, step=EVENT_ROWS
)
"""First of four rows of an event: value, tick, x, y.

Largest square of a tyre's force over its friction limit's, first saturation of the motor,
roll-over, first saturation of the steering, least load of the first wheel, which those of the other
wheels follow.
"""
COMMANDED = EVENT.least_load + MOST_WHEELS * EVENT_ROWS
"""First of the rows of a table's columns, where each vehicle has its own commands.

Eight columns of the steering, and the speed that is added to the motor's demand.
"""
COMMANDED_ROWS = 9
CONSTANTS = COMMANDED + COMMANDED_ROWS
"""First row of the constants; each compiled part brings its own block of them."""


def states_of(wheels: int) -> int:
    """Return how many rows of states a vehicle uses.

    Parameters
    ----------
    wheels : int
        Number of wheels.
    """
    return int(STATE.spin) + wheels * WHEEL_STATES


def of_wheels(first: int, step: int, wheels: int) -> slice:
    """Return the rows of a quantity of all wheels.

    Parameters
    ----------
    first : int
        Row of the quantity of the first wheel.
    step : int
        `WHEEL_STATES`, `WHEEL_EVALUATED` or `EVENT_ROWS`.
    wheels : int
        Number of wheels of the vehicle.
    """
    return slice(first, first + wheels * step, step)
