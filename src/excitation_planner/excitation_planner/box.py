"""Boxes with a name on each axis: ranges of operation parameters x and unknown parameters p."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tricycle_core.errors import DesignError
from tricycle_core.quantities import FloatArray

Bounds = Mapping[str, tuple[float, float]]  # name -> (low, high)


@dataclass(frozen=True)
class Box:
    """Axis-aligned box with a name on each axis.

    Attributes
    ----------
    names : tuple of str, length k
        One per axis.
    low, high : tuple of float, length k
        Limits, ``low < high`` on every axis.

    Raises
    ------
    DesignError
        No axis, a name given twice, or a range that is not finite or upside down.
    """

    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.names:
            raise DesignError("a box needs at least one parameter: {name: (low, high), ...}")
        if not len(self.names) == len(self.low) == len(self.high):
            raise DesignError("a box needs one name, one low and one high limit per axis")
        if len(set(self.names)) < len(self.names):
            raise DesignError(f"a box names a parameter twice: {', '.join(self.names)}")
        for name, low, high in zip(self.names, self.low, self.high, strict=True):
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise DesignError(
                    f"{name}: range ({low:g}, {high:g}) must be finite with low < high"
                )

    @classmethod
    def of(cls, bounds: Box | Bounds) -> Box:
        """Box from ``{name: (low, high), ...}``; a Box is returned as it is."""
        if isinstance(bounds, Box):
            return bounds
        ranges = []
        for name, limits in bounds.items():
            try:
                low, high = map(float, () if isinstance(limits, str) else limits)
            except (TypeError, ValueError):
                raise DesignError(f"{name}: a range is (low, high), not {limits!r}") from None
            ranges.append((low, high))
        return cls(
            tuple(bounds), tuple(low for low, _ in ranges), tuple(high for _, high in ranges)
        )

    def __len__(self) -> int:
        return len(self.names)

    def index(self, name: str) -> int:
        """Axis of the parameter ``name``; DesignError lists the names there are."""
        if name not in self.names:
            raise DesignError(f"unknown parameter {name!r}; one of: {', '.join(self.names)}")
        return self.names.index(name)

    def check_samples(self, samples: int) -> None:
        """Raise DesignError where a metamodel over this box needs more samples."""
        if not isinstance(samples, int | np.integer) or samples < len(self) + 2:
            need = f"{len(self)} unknown parameters need {len(self) + 2} at least"
            raise DesignError(f"samples = {samples!r}: {need}")

    def bounds(self) -> dict[str, tuple[float, float]]:
        """Return the box as ``{name: (low, high), ...}``."""
        return dict(zip(self.names, zip(self.low, self.high, strict=True), strict=True))

    def from_unit(self, U: ArrayLike) -> FloatArray:
        """Map points (..., k) of the unit box into this one."""
        low, high = np.array(self.low), np.array(self.high)
        points: FloatArray = np.clip(low + np.asarray(U, dtype=float) * (high - low), low, high)
        return points

    def to_unit(self, P: ArrayLike) -> FloatArray:
        """Map points (..., k) of this box into the unit box."""
        low, high = np.array(self.low), np.array(self.high)
        unit: FloatArray = (np.asarray(P, dtype=float) - low) / (high - low)
        return unit
