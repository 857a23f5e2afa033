"""Check of the sign and unit of measured values, by values that are expected."""

import math

import numpy as np

from tricycle_core.quantities import FloatArray

ALIKE = 0.9  # cosine from which two quantities differ by a factor
CURVED = 0.2  # of its size, by which a path is off one that is no longer like it
MIRRORED = 0.3  # of what a path is off, by which its mirror image is at most
OPPOSITE = -0.7  # cosine from which a sign is wrong


def path_contradiction(
    given: FloatArray, expected: FloatArray, *, factor: float, turns: bool
) -> str:
    """Return how positions in a frame of their own contradict those expected, in words; else "".

    Parameters
    ----------
    given, expected : ndarray of float, shape (m, 2)
        Measured and expected positions at the same times.
    factor : float
        From which the unit is another one.
    turns : bool
        Whether it is certain to which side the path turns: it may be a mirror image then.
    """
    z, w = (path @ [1.0, 1.0j] for path in (given, expected))
    z, w = z - z.mean(), w - w.mean()
    energy, own = float(np.vdot(w, w).real), float(np.vdot(z, z).real)
    if energy == 0.0 or own == 0.0:
        return ""
    # rotation and scaling of the expected path, and what they leave of the measured one
    scales = [abs(np.vdot(path, z)) / energy for path in (w, w.conj())]
    plain, mirrored = (math.sqrt(max(1.0 - s**2 * energy / own, 0.0)) for s in scales)
    if turns and plain > CURVED and mirrored < MIRRORED * plain:
        return "are the mirror image of"
    if plain < CURVED and not 1.0 / factor < scales[0] < factor:
        return f"are {scales[0]:.2g} times"
    return ""


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
