"""Figure of Sobol' indices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tricycle_core.palette import BLUE, VERMILLION
from tricycle_core.quantities import FloatArray

Spread = tuple[FloatArray, FloatArray]
"""Indices (k,) and their intervals (k, 2)."""


def draw_indices(axes: Any, names: Sequence[str], main: Spread, total: Spread) -> None:
    """Draw a bar per index, with its interval.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Axes that are drawn on.
    names : sequence of str, length k
        The unknown parameters, from the top.
    main, total : (ndarray (k,), ndarray (k, 2))
        Indices and their 95 % intervals.
    """
    for offset, color, label, (values, intervals) in (
        (-0.2, BLUE, "main index S", main),
        (0.2, VERMILLION, "total index ST", total),
    ):
        spread = abs(intervals - values[:, None]).T
        at = [k + offset for k in range(len(names))]
        axes.barh(at, values, 0.38, xerr=spread, color=color, label=label)
    axes.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
    axes.invert_yaxis()
    axes.set(xlabel="share of the variance of the output", xlim=(0, 1))
    axes.legend(fontsize="small")
    axes.grid(alpha=0.3)
