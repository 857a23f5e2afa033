"""Types and units that all packages share: SI units, REP-103 axes, left positive."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

Progress = Callable[[int, int], None]
"""Called with the amounts of work done and in all, in whatever unit the caller counts."""
