"""Dubins paths: the shortest ways of bounded curvature from pose to pose, forwards or backwards.

L. E. Dubins, "On curves of minimal length with a constraint on average curvature, and with
prescribed initial and terminal positions and tangents", American Journal of Mathematics 79 (1957)
497-516: such a way is made of three arcs of the smallest radius, or of two and a straight line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tricycle_core.poses import Pose, along_arc
from tricycle_core.quantities import FloatArray

WORDS = ("LSL", "RSR", "LSR", "RSL", "RLR", "LRL")
"""Left arc, straight line, right arc: the kinds of Dubins paths."""

ROUND_OFF = 3e-7
"""Length below which an arc is left out [m]: the vehicle would stop for it and turn its wheels."""

_SIGN = {"L": 1.0, "S": 0.0, "R": -1.0}


@dataclass(frozen=True)
class Arc:
    """A way of constant curvature.

    Attributes
    ----------
    start : (float, float, float)
        Pose at its beginning [m, m, rad].
    curvature : float
        Turn per metre driven forwards, left positive [1/m].
    length : float
        Negative: driven backwards [m].
    """

    start: Pose
    curvature: float
    length: float

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return poses x, y, heading on it, or on its continuation.

        Parameters
        ----------
        s : ndarray of float, shape (n,)
            Distance from the start, with the sign of the length [m].
        """
        *_, heading = self.start
        x, y, turn = along_arc(*self.start, self.curvature, s)
        return x, y, heading + turn

    @property
    def end(self) -> Pose:
        """Pose at its end."""
        x, y, heading = self.at(np.array(self.length))
        return float(x), float(y), float(heading)


def dubins_lengths(start: FloatArray, goal: FloatArray, radius: float) -> FloatArray:
    """Return the lengths of the three parts of every Dubins word between all poses.

    Parameters
    ----------
    start : ndarray of float, shape (n, 3)
        x, y, heading of the start poses [m, m, rad].
    goal : ndarray of float, shape (m, 3)
        x, y, heading of the goal poses [m, m, rad].
    radius : float
        Radius of the arcs [m].

    Returns
    -------
    lengths : ndarray of float, shape (6, 3, n, m)
        Lengths by the order of `WORDS` [m]; infinite where a word does not connect the poses.
    """
    dx = (goal[:, 0] - start[:, None, 0]) / radius
    dy = (goal[:, 1] - start[:, None, 1]) / radius
    d, course = np.hypot(dx, dy), np.arctan2(dy, dx)
    a, b = start[:, None, 2] - course, goal[:, 2] - course
    sa, ca, sb, cb, cab = np.sin(a), np.cos(a), np.sin(b), np.cos(b), np.cos(a - b)

    def root(square: FloatArray) -> FloatArray:
        # of touching arcs round-off makes a tiny negative number
        return np.sqrt(np.where(square > -1e-12, np.maximum(square, 0.0), np.nan))

    def turn(cosine: FloatArray) -> FloatArray:
        inside = np.abs(cosine) <= 1.0
        return np.where(inside, 2.0 * np.pi - np.arccos(np.where(inside, cosine, 0.0)), np.nan)

    lsl, rsr = np.arctan2(cb - ca, d + sa - sb), np.arctan2(ca - cb, d - sa + sb)
    p_lsr = root(d**2 - 2.0 + 2.0 * cab + 2.0 * d * (sa + sb))
    p_rsl = root(d**2 - 2.0 + 2.0 * cab - 2.0 * d * (sa + sb))
    p_rlr = turn((6.0 - d**2 + 2.0 * cab + 2.0 * d * (sa - sb)) / 8.0)
    p_lrl = turn((6.0 - d**2 + 2.0 * cab - 2.0 * d * (sa - sb)) / 8.0)
    lsr = np.arctan2(-ca - cb, d + sa + sb) - np.arctan2(-2.0, p_lsr)
    rsl = np.arctan2(ca + cb, d - sa - sb) - np.arctan2(2.0, p_rsl)
    t_rlr = a - rsr + 0.5 * p_rlr
    t_lrl = -a + lsl + 0.5 * p_lrl
    words = [
        (lsl - a, root(2.0 + d**2 - 2.0 * cab + 2.0 * d * (sa - sb)), b - lsl),
        (a - rsr, root(2.0 + d**2 - 2.0 * cab - 2.0 * d * (sa - sb)), rsr - b),
        (lsr - a, p_lsr, lsr - b),
        (a - rsl, p_rsl, b - rsl),
        (t_rlr, p_rlr, a - b - t_rlr + p_rlr),
        (t_lrl, p_lrl, b - a - t_lrl + p_lrl),
    ]
    lengths = radius * np.array([[_positive(t), p, _positive(q)] for t, p, q in words])
    missing = np.isnan(lengths).any(axis=1, keepdims=True)
    return np.where(missing, np.inf, lengths)


def dubins_arcs(start: Pose, word: str, lengths: FloatArray, radius: float) -> tuple[Arc, ...]:
    """Return the arcs of a Dubins path from its start; those shorter than `ROUND_OFF` are left out.

    Parameters
    ----------
    start : (float, float, float)
        Start pose [m, m, rad].
    word : str
        One of `WORDS`.
    lengths : ndarray of float, shape (3,)
        Lengths of its parts [m]; negative: driven backwards.
    radius : float
        Radius of the arcs [m].
    """
    arcs = []
    for letter, length in zip(word, lengths.tolist(), strict=True):
        if abs(length) > ROUND_OFF:
            arcs.append(Arc(start, _SIGN[letter] / radius, length))
            start = arcs[-1].end
    return tuple(arcs)


def _positive(angle: FloatArray) -> FloatArray:
    """Angle in [0, 2 pi); a whole turn that comes from round-off is 0."""
    turned: FloatArray = np.mod(angle, math.tau)
    # the root of a round-off error of 1e-16 is 1e-8
    return np.where(turned > math.tau - 1e-7, 0.0, turned)
