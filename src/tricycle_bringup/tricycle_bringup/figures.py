"""Figures of a run, readable in print and by the colour-blind."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")  # files only: works without a display

from matplotlib import pyplot as plt

from parameter_identification.judge import Judgement

REFERENCE, MEASURED = "#0072B2", "#D55E00"  # Okabe and Ito's blue and vermillion
MARKS = 5.0  # s between the lines that join equal times


def plot_drives(drives: Mapping[str, Judgement], path: Path) -> None:
    """Nominal and driven trajectory of each drive, equal times joined, and the distance over time.

    Parameters
    ----------
    drives
        Judgement by title.
    path
        Image to be written; its suffix gives the format.
    """
    figure, axes = plt.subplots(
        2, len(drives), figsize=(5.2 * len(drives), 7.6), height_ratios=(2.2, 1), squeeze=False,
        layout="constrained",
    )  # fmt: skip
    highest = max(float(1e3 * judgement.max) for judgement in drives.values())
    for (title, judgement), above, below in zip(drives.items(), axes[0], axes[1], strict=True):
        s = judgement.series
        above.plot(s.reference_x, s.reference_y, color=REFERENCE, label="nominal model")
        above.plot(s.x, s.y, color=MEASURED, linewidth=0.9, label="driven, as measured")
        step = round(MARKS / (s.time[1] - s.time[0]))
        for k in range(step, len(s.time), step):
            joined = ([s.reference_x[k], s.x[k]], [s.reference_y[k], s.y[k]])
            above.plot(*joined, color="0.3", linewidth=0.8)
        above.plot([], [], color="0.3", linewidth=0.8, label=f"same time, every {MARKS:g} s")
        above.set_title(f"{title}\nTE = {judgement.te:.4g} m²")
        above.set_xlabel("x / m")
        above.set_ylabel("y / m")
        above.set_aspect("equal", adjustable="datalim")
        above.grid(alpha=0.3)
        above.legend(loc="best", fontsize="small")
        below.plot(s.time, 1e3 * s.distance, color=MEASURED, linewidth=0.9)
        below.set_ylim(0, 1.05 * highest)
        below.set_xlabel("time since the start / s")
        below.set_ylabel("distance / mm")
        below.grid(alpha=0.3)
    figure.savefig(path, dpi=150)
    plt.close(figure)
