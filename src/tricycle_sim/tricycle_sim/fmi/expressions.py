"""Formulas of a vehicle's constants as expressions in C."""

from typing import Any

import numpy as np

_BINARY = {"add": "({} + {})", "subtract": "({} - {})", "multiply": "({} * {})"}
_UFUNCS = {
    **_BINARY,
    "divide": "({} / {})",
    "minimum": "fmin({}, {})",
    "maximum": "fmax({}, {})",
    "power": "pow({}, {})",
    "negative": "(-{})",
    "absolute": "fabs({})",
    **{name: f"{name}({{}})" for name in ("sin", "cos", "tan", "sqrt", "exp", "log")},
}


def literal(value: float) -> str:
    """Return a number in C, to the last bit.

    Parameters
    ----------
    value : float
        Finite number.
    """
    return float(value).hex()


class Expression(np.lib.mixins.NDArrayOperatorsMixin):
    """Symbolic value: arithmetic and NumPy's functions on it write C text instead of computing.

    Parameters
    ----------
    text : str
        The expression in C.
    """

    def __init__(self, text: str) -> None:
        self.text = text

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **_: Any) -> Any:
        """Return the expression of a NumPy function."""
        pattern = _UFUNCS.get(ufunc.__name__)
        if method != "__call__" or pattern is None:
            return NotImplemented
        return Expression(pattern.format(*map(c_text, inputs)))


def c_text(value: Any) -> str:
    """Return an expression or a number in C.

    Parameters
    ----------
    value : Expression or float
        Result of a formula.
    """
    return value.text if isinstance(value, Expression) else literal(value)
