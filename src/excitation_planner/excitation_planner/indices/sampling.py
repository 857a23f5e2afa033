"""Points at which a simulator is sampled.

n: points, k: axes.
"""

from __future__ import annotations

import math

import numpy as np

from excitation_planner.box import Box
from excitation_planner.indices.direction_numbers import AXES, BITS, direction_numbers
from tricycle_core.errors import DesignError
from tricycle_core.quantities import FloatArray


def check_seed(seed: object) -> None:
    """Raise if a value cannot be the seed of samples.

    Parameters
    ----------
    seed : object
        What was given as the seed.

    Raises
    ------
    DesignError
        If it is not a whole number, or below 0.
    """
    if not isinstance(seed, int | np.integer) or isinstance(seed, bool) or seed < 0:
        raise DesignError(f"seed = {seed!r}: must be a whole number, 0 or more")


def sobol_sequence(n: int, k: int, *, seed: int | None = 0) -> FloatArray:
    """Return the first points (n, k) of a Sobol' sequence in the unit box.

    Parameters
    ----------
    n, k : int
        Numbers of points and of axes.
    seed : int, optional
        Scrambles the sequence (0 is a seed); ``None`` gives the unscrambled one of the paper.
    """
    if k > AXES:
        return _by_scipy(n, k, seed)
    digits, first = direction_numbers(k), np.zeros(k, dtype=np.int64)
    weights = 1 << np.arange(BITS, dtype=np.int64)
    if seed is not None:  # Matousek's linear scrambling and a digital shift
        rng = np.random.default_rng(seed)
        first = rng.integers(2, size=(k, BITS), dtype=np.uint32) @ weights
        mixing = np.tril(rng.integers(2, size=(k, BITS, BITS), dtype=np.uint32), -1)
        mixing += np.eye(BITS, dtype=np.uint32)
        digits = digits @ mixing.swapaxes(1, 2) & 1
    numbers = digits @ weights[::-1]
    # in the order of the reflected Gray code: each power of two mirrors those before it
    points = first[None]
    for number in numbers.T[: max(0, math.ceil(math.log2(n)))]:
        points = np.concatenate([points, points[::-1] ^ number])
    found: FloatArray = points[:n].astype(np.float64) * 0.5**BITS
    return found


def _by_scipy(n: int, k: int, seed: int | None) -> FloatArray:
    from scipy.stats import qmc  # takes half a second to import

    # a power of two is drawn because scipy warns of anything else; its first n points are the same
    exponent = max(0, math.ceil(math.log2(n)))
    sequence = qmc.Sobol(k, scramble=seed is not None, seed=seed)
    points: FloatArray = sequence.random_base2(exponent)[:n]
    return points


def training_points(n: int, k: int, *, seed: int = 0) -> FloatArray:
    """Return points (n, k) of the unit box to train a metamodel on, denser towards the faces.

    A Sobol' sequence u blended half and half with its arcsine-distributed image (1 - cos pi u)/2:
    a metamodel is worst at the faces, where it has neighbours on one side only.

    Parameters
    ----------
    n, k : int
        Numbers of points and of axes.
    seed : int
        Scrambles the sequence.
    """
    u = sobol_sequence(n, k, seed=seed)
    points: FloatArray = 0.5 * u + 0.25 * (1.0 - np.cos(np.pi * u))
    return points


def parameter_samples(unknown: Box, samples: int, *, seed: int) -> FloatArray:
    """Return points (samples, k) of the unit box to simulate at.

    Parameters
    ----------
    unknown : Box
        Unknown parameters.
    samples : int
        Number of points, at least k + 2.
    seed : int
        Scrambles the sequence.

    Raises
    ------
    DesignError
        If the samples are too few for a metamodel.
    """
    unknown.check_samples(samples)
    return training_points(samples, len(unknown), seed=seed)


def all_corners(dimensions: int) -> FloatArray:
    """Return all corners (2^k, k) of the unit box.

    Parameters
    ----------
    dimensions : int
        Number k of axes.
    """
    numbers = np.arange(2**dimensions)[:, None]
    found: FloatArray = ((numbers >> np.arange(dimensions)) & 1).astype(float)
    return found


def corners(dimensions: int, *, seed: int) -> FloatArray:
    """Return at most 16 corners (n, k) of the unit box: up to k = 4 all, beyond a random choice.

    Parameters
    ----------
    dimensions : int
        Number k of axes.
    seed : int
        Seed of the random choice.
    """
    if dimensions <= 4:
        return all_corners(dimensions)
    return np.random.default_rng(seed).integers(0, 2, size=(16, dimensions)).astype(float)
