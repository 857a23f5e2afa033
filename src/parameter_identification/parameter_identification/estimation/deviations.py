"""Motions that deviate smoothly in time: in their speed and their turning."""

import math

import numpy as np

from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.compilation import compiled


@compiled
def deviated(motions: FloatArray, faster: FloatArray, turning: FloatArray) -> FloatArray:
    """Return motions with deviations that are linear between their knots.

    Parameters
    ----------
    motions : ndarray of float, shape (5, s, t)
        Position x, y [m], heading [rad], yaw rate [rad/s] and wheel speed [rad/s] of s vehicles on
        the ticks.
    faster : ndarray of float, shape (n, k)
        Share by which each of n >= s vehicles is faster, at evenly spaced knots. Those beyond the s
        motions deviate from the first one.
    turning : ndarray of float, shape (n, k)
        Curvature by which each vehicle turns more [1/m], at the same knots.

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
    deviating = np.empty((5, n, t))
    for i in range(n):
        own = i if i < s else 0
        x, y, heading = motions[0, own], motions[1, own], motions[2, own]
        deviating[0, i, 0], deviating[1, i, 0] = x[0], y[0]
        angle = 0.0
        for j in range(t):
            knot = min(int(j * per_tick), k - 2)
            weight = j * per_tick - knot
            share = 1.0 + (1.0 - weight) * faster[i, knot] + weight * faster[i, knot + 1]
            extra = (1.0 - weight) * turning[i, knot] + weight * turning[i, knot + 1]
            bent = extra * ahead[own, j]  # rad in a tick
            deviating[2, i, j] = heading[j] + angle
            deviating[3, i, j] = share * (motions[3, own, j] + bent / TICK)
            deviating[4, i, j] = share * motions[4, own, j]
            if j < t - 1:
                more = (share - 1.0) * (heading[j + 1] - heading[j]) + share * bent
                middle = angle + 0.5 * more
                cosine, sine = share * math.cos(middle), share * math.sin(middle)
                dx, dy = x[j + 1] - x[j], y[j + 1] - y[j]
                deviating[0, i, j + 1] = deviating[0, i, j] + cosine * dx - sine * dy
                deviating[1, i, j + 1] = deviating[1, i, j] + sine * dx + cosine * dy
                angle += more
    return deviating
