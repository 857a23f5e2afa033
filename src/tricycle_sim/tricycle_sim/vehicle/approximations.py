"""Elementary functions without branches and calls, which eight lanes evaluate at once."""

import math

from tricycle_sim.vehicle.laws import inlined


@inlined
def arctan(t: float) -> float:
    """Return atan(t) for |t| <= 1 to 1e-15.

    Parameters
    ----------
    t : float
        Tangent, -1 to 1.
    """
    # odd polynomial through the Chebyshev nodes of t^2 in [0, 1]
    z = t * t
    even = -1.93423475928923e-05
    even = even * z + 0.00021423810738603946
    even = even * z - 0.0011252544302234645
    even = even * z + 0.003751138483965141
    even = even * z - 0.00899108054265826
    even = even * z + 0.01671959606350739
    even = even * z - 0.02556862364437174
    even = even * z + 0.03387126702700675
    even = even * z - 0.040811247503178855
    even = even * z + 0.04668745304848529
    even = even * z - 0.052374234719188166
    even = even * z + 0.058768281144872724
    even = even * z - 0.06665764910689723
    even = even * z + 0.07692198997458294
    even = even * z - 0.09090899793217341
    even = even * z + 0.11111110578002083
    even = even * z - 0.14285714266926733
    even = even * z + 0.1999999999964796
    even = even * z - 0.333333333333307
    return t * (even * z + 1.0)


@inlined
def arctan_positive(t: float) -> float:
    """Return atan(t) for t >= 0 to 1e-15.

    Parameters
    ----------
    t : float
        Tangent, 0 or more.
    """
    steep = t > 1.0
    angle = arctan(1.0 / t if steep else t)
    return 0.5 * math.pi - angle if steep else angle


@inlined
def sine(x: float) -> float:
    """Return sin(x) for 0 <= x <= pi to 1e-15.

    Parameters
    ----------
    x : float
        Angle, 0 to pi [rad].
    """
    y = min(x, math.pi - x)
    z = y * y
    even = -1.0 / 121645100408832000.0  # the series up to y^19
    even = even * z + 1.0 / 355687428096000.0
    even = even * z - 1.0 / 1307674368000.0
    even = even * z + 1.0 / 6227020800.0
    even = even * z - 1.0 / 39916800.0
    even = even * z + 1.0 / 362880.0
    even = even * z - 1.0 / 5040.0
    even = even * z + 1.0 / 120.0
    even = even * z - 1.0 / 6.0
    return y * (even * z + 1.0)
