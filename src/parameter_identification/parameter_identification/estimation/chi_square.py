"""The chi-square distribution: `scipy.stats`, which has it too, takes half a second to import."""

from __future__ import annotations

from scipy.special import chdtrc, gammaincinv


def quantile(probability: float, degrees: float) -> float:
    """Return the value below which a chi-square variable is with a probability.

    Parameters
    ----------
    probability : float
        From 0 to 1.
    degrees : float
        Degrees of freedom.

    Examples
    --------
    >>> round(quantile(0.95, 1), 2)
    3.84
    """
    return float(2.0 * gammaincinv(0.5 * degrees, probability))


def tail(value: float, degrees: float) -> float:
    """Return the probability that a chi-square variable is above a value.

    Parameters
    ----------
    value : float
        Value that the variable shall exceed.
    degrees : float
        Degrees of freedom.

    Examples
    --------
    >>> round(tail(3.84, 1), 2)
    0.05
    """
    return float(chdtrc(degrees, value))
