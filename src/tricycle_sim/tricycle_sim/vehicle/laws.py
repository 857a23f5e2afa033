"""The law of a vehicle's part: the constants it reads, their rows in a group, its function.

Each part declares the constants that it reads, with unit and bounds; a vehicle file has exactly
those that its parts read.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from tricycle_core.errors import VehicleError
from tricycle_core.quantities import with_unit

_Function = TypeVar("_Function", bound=Callable[..., Any])


@dataclass(frozen=True)
class Constant:
    """A number of a vehicle: its name, unit, and the interval it lies in.

    Attributes
    ----------
    name, unit : str
        Name and unit as in a vehicle file.
    low, high : float
        Bounds; `low` itself is excluded unless `zero`.
    default : float or None
        Value if the file does not give one; None: the file must give it.
    per_wheel : bool
        Whether wheels or axles may have their own value: `front.tyre_radius`.
    setting : bool
        Whether it is a setting of the boards or of plans: the motion of a vehicle under given
        set-points does not depend on it, and it cannot be unknown.
    """

    name: str
    unit: str
    low: float = 0.0
    high: float = math.inf
    zero: bool = False
    default: float | None = None
    per_wheel: bool = False
    setting: bool = False

    def check(self, where: str, value: float) -> None:
        """Raise a `VehicleError` unless a value lies between the bounds.

        Parameters
        ----------
        where : str
            Entry of the vehicle file, for the message.
        value : float
            Value in the constant's unit.
        """
        low, high = self.low, self.high
        inside = (low <= value if self.zero else low < value) and value <= high
        if not inside or not math.isfinite(value):
            end = "]" if math.isfinite(high) else ")"
            bounds = f"{'[' if self.zero else '('}{low:g}, {high:g}{end}"
            if self.unit == "rad":
                bounds += f" ({math.degrees(low):.3g} to {math.degrees(high):.3g} deg)"
            raise VehicleError(f"{where}: {with_unit(f'{value:g}', self.unit)} is not in {bounds}")


def positive(name: str, unit: str, **how: Any) -> Constant:
    """Return a constant above 0.

    Parameters
    ----------
    name, unit : str
        Name and unit, as in `Constant`.
    **how : object
        Further attributes of the constant.
    """
    return Constant(name, unit, **how)


def not_negative(name: str, unit: str, **how: Any) -> Constant:
    """Return a constant of 0 or more.

    Parameters
    ----------
    name, unit : str
        Name and unit, as in `Constant`.
    **how : object
        Further attributes of the constant.
    """
    return Constant(name, unit, zero=True, **how)


def between(name: str, unit: str, low: float, high: float, **how: Any) -> Constant:
    """Return a constant of a closed interval.

    Parameters
    ----------
    name, unit : str
        Name and unit, as in `Constant`.
    low, high : float
        Ends of the interval, both included.
    **how : object
        Further attributes of the constant.
    """
    return Constant(name, unit, low=low, high=high, zero=True, **how)


def any_number(name: str, unit: str, **how: Any) -> Constant:
    """Return a constant without bounds.

    Parameters
    ----------
    name, unit : str
        Name and unit, as in `Constant`.
    **how : object
        Further attributes of the constant.
    """
    return Constant(name, unit, low=-math.inf, **how)


@dataclass(frozen=True)
class Law:
    """One way in which a part of a vehicle may behave.

    Attributes
    ----------
    function : callable or None
        Compiled into the equations; None: the numbers say it all.
    rows : mapping of str to callable
        Each number that the function reads, as it follows from the constants of a vehicle; of the
        servo also from the length of its steps.
    constants : tuple of Constant
        Constants that the law reads, beyond those that its part always reads.
    """

    function: Callable[..., Any] | None
    rows: Mapping[str, Callable[..., Any]]
    constants: tuple[Constant, ...] = ()


def inlined(function: _Function) -> _Function:
    """Mark a function that `tricycle_sim.compilation` compiles into its callers.

    Parameters
    ----------
    function : callable
        Function with scalars, tuples, arrays or other such functions for arguments.
    """
    function.is_inlined = True  # type: ignore[attr-defined]
    return function
