"""Types and units that all packages share: SI units, REP-103 axes, left positive."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

Progress = Callable[[int, int], None]
"""Called with the amounts of work done and in all, in whatever unit the caller counts."""


def with_deviation(estimate: float, std: float) -> str:
    """Return an estimate and its standard deviation as text, without powers of ten below 1e6.

    Parameters
    ----------
    estimate, std : float
        Estimate and standard deviation, in the same unit.

    Examples
    --------
    >>> with_deviation(1094.96, 117.09)
    '1095 ± 120'
    """
    return f"{float(f'{estimate:.4g}'):g} ± {float(f'{std:.2g}'):g}"


def with_unit(value: str, unit: str) -> str:
    """Return a value with its unit; that of ratios, 1, is left out.

    Parameters
    ----------
    value : str
        Number or numbers.
    unit : str
        Unit as in a vehicle file.

    Examples
    --------
    >>> with_unit("0.0045 to 0.0135", "1")
    '0.0045 to 0.0135'
    """
    return value if unit == "1" else f"{value} {unit}"
