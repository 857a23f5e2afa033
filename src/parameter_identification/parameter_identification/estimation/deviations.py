"""Motions that deviate smoothly in time: in their speed, their turning and their start."""

import math

import numpy as np

from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.compilation import compiled
from tricycle_sim.vehicle.laws import inlined

START = np.array([0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0])
"""Knots of the deviation of a start from rest [s]: boards and motor are known least at low speed.

It vanishes at the first and at the last.
"""
START_KNOTS = len(START) - 2
SLOWEST = 0.02
"""Speed below which what a start adds does not turn the vehicle: its path is no curve yet [m/s]."""


@inlined
def _at_start(knots: FloatArray, interval: int, time: float) -> float:
    """By how much a vehicle is faster at first [m/s], in an interval of `START`."""
    before = knots[interval - 1] if interval > 0 else 0.0
    after = knots[interval] if interval < START_KNOTS else 0.0
    share = (time - START[interval]) / (START[interval + 1] - START[interval])
    faster: float = before + share * (after - before)
    return faster


@compiled
def deviated(
    motions: FloatArray,
    faster: FloatArray,
    turning: FloatArray,
    starting: FloatArray,
    radius: float,
) -> FloatArray:
    """Return motions with deviations that are linear between their knots.

    Parameters
    ----------
    motions : ndarray of float, shape (5, s, t)
        Position x, y [m], heading [rad], yaw rate [rad/s] and wheel speed [rad/s] of s vehicles on
        the ticks.
    faster : ndarray of float, shape (n, k)
        By which share each of n >= s vehicles is faster, at evenly spaced knots. Those beyond the s
        motions deviate from the first one.
    turning : ndarray of float, shape (n, k)
        How much more it turns [1/m], at the same knots.
    starting : ndarray of float, shape (n, START_KNOTS)
        By how much it is faster at first [m/s], at the inner ones of `START`.
    radius : float
        Of the driven wheel [m].

    Returns
    -------
    ndarray of float, shape (5, n, t)
        As `motions`.
    """
    s, t = motions.shape[1:]
    n, k = faster.shape
    per_tick = (k - 1) / (t - 1)
    ahead = np.empty((s, t))  # way in a tick [m]
    for i in range(s):
        x, y, heading = motions[0, i], motions[1, i], motions[2, i]
        for j in range(t - 1):
            dx, dy = x[j + 1] - x[j], y[j + 1] - y[j]
            ahead[i, j] = dx * math.cos(heading[j]) + dy * math.sin(heading[j])
        ahead[i, t - 1] = ahead[i, t - 2]
    found = np.empty((5, n, t))
    for i in range(n):
        own = i if i < s else 0
        x, y, heading = motions[0, own], motions[1, own], motions[2, own]
        found[0, i, 0], found[1, i, 0] = x[0], y[0]
        angle, interval = 0.0, 0
        for j in range(t):
            knot = min(int(j * per_tick), k - 2)
            weight = j * per_tick - knot
            share = 1.0 + (1.0 - weight) * faster[i, knot] + weight * faster[i, knot + 1]
            extra = (1.0 - weight) * turning[i, knot] + weight * turning[i, knot + 1]
            if interval < START_KNOTS and j * TICK >= START[interval + 1]:
                interval += 1
            way, turned = ahead[own, j], 0.0
            if j < t - 1:
                turned = heading[j + 1] - heading[j]
            first = 0.0  # way that the start adds
            if j * TICK < START[-1]:
                first = TICK * _at_start(starting[i], interval, j * TICK)
            bend = turned / way if way > SLOWEST * TICK else 0.0
            found[2, i, j] = heading[j] + angle
            rate = motions[3, own, j] + (bend * first + extra * (way + first)) / TICK
            found[3, i, j] = share * rate
            found[4, i, j] = share * (motions[4, own, j] + first / (TICK * radius))
            if j < t - 1:
                more = (share - 1.0) * turned + share * (bend * first + extra * (way + first))
                middle = angle + 0.5 * more
                cosine, sine = share * math.cos(middle), share * math.sin(middle)
                dx, dy = x[j + 1] - x[j], y[j + 1] - y[j]
                if first != 0.0:
                    dx += first * math.cos(heading[j])
                    dy += first * math.sin(heading[j])
                found[0, i, j + 1] = found[0, i, j] + cosine * dx - sine * dy
                found[1, i, j + 1] = found[1, i, j] + sine * dx + cosine * dy
                angle += more
    return found
