"""Check of the sign and unit of measured values, by values that are expected."""

import math

from tricycle_core.quantities import FloatArray

ALIKE = 0.9  # cosine from which two quantities differ by a factor
OPPOSITE = -0.7  # cosine from which a sign is wrong


def contradiction(
    given: FloatArray,
    expected: FloatArray,
    *,
    least: float,
    factor: float,
    least_slope: float = 0.0,
) -> str:
    """Return how the sign or unit of values contradicts those expected, in words; else "".

    Parameters
    ----------
    given, expected : ndarray of float, shape (m,)
        Measured and expected values of one quantity, in one unit.
    least : float
        Root mean square of those expected up to which nothing is concluded.
    factor : float
        From which the unit is another one.
    least_slope : float
        Share of those expected that values of the wrong sign have at least.
    """
    energy, own = float(expected @ expected), float(given @ given)
    if not energy > least**2 * len(expected):
        return ""
    if own == 0.0:  # who measures nothing writes zeros
        return "is 0 times"
    slope = float(given @ expected) / energy
    cosine = float(given @ expected) / math.sqrt(energy * own)
    if slope < -least_slope and cosine < OPPOSITE:
        return "has the opposite sign of"
    if abs(cosine) > ALIKE and not 1.0 / factor < abs(slope) < factor:
        return f"is {slope:.2g} times"
    return ""
