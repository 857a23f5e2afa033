"""Figures of plans and drives as image files, readable in print and by the colour-blind."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as MatplotlibPath

from excitation_planner.area.area import Area
from excitation_planner.design.prior import UNIFORM_STD
from excitation_planner.indices.figure import Spread, draw_indices
from excitation_planner.plan import Index, Plan
from parameter_identification.estimation.intervals import half_width
from tricycle_core.documents import replacing
from tricycle_core.palette import BLUE, VERMILLION
from tricycle_core.poses import placed
from tricycle_core.quantities import FloatArray

if TYPE_CHECKING:
    from parameter_identification.fleet import Fleet
    from parameter_identification.judging.judgement import Judgement

REFERENCE, MEASURED = BLUE, VERMILLION
MARKS = 5.0  # s between the lines that join equal times

MOST_VEHICLES = 40  # in a figure of a fleet


def plot_plan(plan: Plan, path: Path) -> None:
    """Plot path, commands and Sobol' indices of a plan, and the deviations expected after its set.

    Parameters
    ----------
    plan : Plan
        Plan to show.
    path : Path
        Image to be written; its suffix gives the format.
    """
    right = "expected" if plan.predicted_std else "."
    figure = Figure(figsize=(10.4, 9.0), layout="constrained")
    panels = figure.subplot_mosaic(
        [["track", "indices"], ["angle", right], ["speed", right]], height_ratios=(1.7, 0.8, 0.8)
    )
    track, indices, angle, speed = (panels[k] for k in ("track", "indices", "angle", "speed"))
    values = ", ".join(f"{name} {value:.3g}" for name, value in plan.operation.items())
    place = f", drive {plan.number} of {plan.drives}" if plan.drives > 1 else ""
    figure.suptitle(
        f"{plan.maneuver.replace('_', ' ')} ({values}) for {plan.target}{place}", parse_math=False
    )
    legend: dict[str, Any] = {}
    if plan.area is None or plan.start_pose is None:
        track.plot(*plan.path.T, color="0.6", label="path of the rear axle, with lead-out")
        track.plot(plan.reference.x, plan.reference.y, color=REFERENCE, label="nominal trajectory")
        _draw_lead_in(track, plan, np.column_stack([plan.reference.x, plan.reference.y]))
    else:
        _draw_on_area(track, plan, plan.area, plan.start_pose)
        # above the ground, of which it would hide a part
        legend = {"loc": "lower left", "bbox_to_anchor": (0, 1), "ncols": 2, "columnspacing": 1}
    track.set(xlabel="x / m", ylabel="y / m")
    track.set_aspect("equal", adjustable="datalim")
    track.legend(fontsize="small", **legend)
    draw_indices(indices, list(plan.main), _spread(plan.main), _spread(plan.total))
    indices.set(xlabel="share of the variance of TE", title=f"H = {plan.cost:.3g}")
    commands = plan.commands
    angle.step(commands.time, commands.steering_motor_angle, where="post", color=REFERENCE)
    angle.set(xlabel="time / s", ylabel="steering motor angle / rad")
    speed.step(commands.time, commands.speed, where="post", color=REFERENCE)
    speed.set(xlabel="time / s", ylabel="speed set-point / (m/s)")
    if plan.predicted_std:
        expected = panels["expected"]
        left = [
            std / (UNIFORM_STD * (plan.unknown[name][1] - plan.unknown[name][0]))
            for name, std in plan.predicted_std.items()
        ]
        bars = expected.barh(range(len(left)), left, 0.6, color=REFERENCE)
        expected.bar_label(bars, [f"{share:.0%}" for share in left], padding=3)
        expected.set_yticks(range(len(left)), [n.replace("_", " ") for n in plan.predicted_std])
        expected.invert_yaxis()
        drives = "the drive" if plan.drives == 1 else f"{plan.drives} drives"
        expected.set(
            xlabel="expected standard deviation / that of the range", xlim=(0, 1.15),
            title=f"not known after {drives} (criterion {plan.criterion})",
        )  # fmt: skip
    for axes in panels.values():
        axes.grid(alpha=0.3)
    with replacing(path) as file:
        figure.savefig(file, dpi=150)


def _spread(indices: Mapping[str, Index]) -> Spread:
    """Indices (k,) and their intervals (k, 2)."""
    drawn = list(indices.values())
    return np.array([i.value for i in drawn]), np.array([[i.low, i.high] for i in drawn])


def _draw_on_area(
    axes: Axes, plan: Plan, area: Area, start_pose: tuple[float, float, float]
) -> None:
    """Draw the nominal trajectory on its area, with the ground that it may cover."""

    def fill(rings: Sequence[FloatArray], color: str, label: str) -> None:
        closed = [np.vstack([ring, ring[:1]]) for ring in rings]
        outline = MatplotlibPath.make_compound_path(*map(MatplotlibPath, closed))
        axes.add_patch(PathPatch(outline, facecolor=color, edgecolor="none", label=label))

    fill(plan.stopping_zone, "0.87", f"their stops, {plan.clearance:.2f} m to the border")
    fill(plan.tube, "0.72", "vehicles of the ranges")
    draw_borders(axes, area)
    x, y, heading = start_pose
    reference = np.column_stack([plan.reference.x, plan.reference.y])
    driven = placed(reference, x, y, heading)
    axes.plot(*driven.T, color=REFERENCE, label="nominal trajectory")
    _draw_lead_in(axes, plan, driven)
    tip = (x + 1.5 * math.cos(heading), y + 1.5 * math.sin(heading))
    axes.annotate("", tip, (x, y), arrowprops={"arrowstyle": "-|>", "color": REFERENCE})
    axes.plot(x, y, "o", color=REFERENCE, label="start")


def _draw_lead_in(axes: Axes, plan: Plan, driven: FloatArray) -> None:
    """Draw the part of the nominal trajectory (t, 2) that is steered closed loop."""
    if plan.lead_in > 0.0:
        led = driven[plan.reference.time <= plan.lead_in]
        label = f"lead-in, closed loop: {plan.lead_in:.1f} s"
        axes.plot(*led.T, color=MEASURED, linewidth=3.0, label=label)


def draw_borders(axes: Axes, area: Area) -> None:
    """Draw the polygons of an area.

    Parameters
    ----------
    axes : Axes
        Axes in metres.
    area : Area
        Area to draw.
    """
    for number, corners in enumerate((area.keep_in, *area.keep_out)):
        closed = np.vstack([corners, corners[:1]])
        names = {0: "keep in", 1: "keep out"}
        axes.plot(*closed.T, color=MEASURED if number else "0.2", label=names.get(number))


def plot_drives(drives: Mapping[str, Judgement], path: Path) -> None:
    """Nominal and driven trajectory of each drive, equal times joined, and the distance over time.

    Parameters
    ----------
    drives : mapping of str to Judgement
        Judgement by title.
    path : Path
        Image to be written; its suffix gives the format.
    """
    figure = Figure(figsize=(5.2 * len(drives), 7.6), layout="constrained")
    axes = figure.subplots(2, len(drives), height_ratios=(2.2, 1), squeeze=False)
    highest = max(float(1e3 * judgement.max) for judgement in drives.values())
    for (title, judgement), above, below in zip(drives.items(), axes[0], axes[1], strict=True):
        s = judgement.series
        above.plot(s.reference_x, s.reference_y, color=REFERENCE, label="nominal model")
        above.plot(s.x, s.y, color=MEASURED, linewidth=0.9, label="driven, as measured")
        step = round(MARKS / (s.time[1] - s.time[0]))
        for k in range(step, len(s.time), step):
            joined = ([s.reference_x[k], s.x[k]], [s.reference_y[k], s.y[k]])
            above.plot(*joined, color="0.2", linewidth=1.2, marker="o", markersize=3.5, zorder=3)
        label = f"same time, every {MARKS:g} s"
        above.plot([], [], color="0.2", linewidth=1.2, marker="o", markersize=3.5, label=label)
        above.set_title(f"{title}\nTE = {judgement.te:.4g} m²", parse_math=False)
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
    with replacing(path) as file:
        figure.savefig(file, dpi=150)


def fleet_figure(fleet: Fleet) -> Figure:
    """Plot each vehicle in its populations, the farthest from the others on top.

    Of many vehicles, only these are drawn.

    Parameters
    ----------
    fleet : Fleet
        Result of `identify_fleet`.
    """
    count, rows = max(1, len(fleet.populations)), min(len(fleet.vehicles), MOST_VEHICLES)
    figure = Figure(figsize=(4.6 * count, 1.8 + 0.28 * rows), layout="constrained")
    panels = figure.subplots(1, count, squeeze=False)[0]
    for (name, population), axes in zip(fleet.populations.items(), panels, strict=False):
        members = sorted(population.members, key=lambda m: abs(m.distance))[-MOST_VEHICLES:]
        mean, spread = population.mean.middle, population.spread.middle
        axes.axvspan(mean - spread, mean + spread, color="0.9", label="population: mean ± spread")
        axes.axvline(mean, color="0.6", linewidth=1.0)
        for row, m in enumerate(members):
            color = MEASURED if m.odd else REFERENCE
            half = half_width(fleet.level) * m.deviation
            low, high = m.own - half, m.own + half
            axes.plot([low, high], [row + 0.15] * 2, color="0.6", linewidth=1.0)
            axes.plot([m.value.low, m.value.high], [row - 0.1] * 2, color=color, linewidth=2.0)
            axes.plot(m.value.middle, row - 0.1, "o", color=color, markersize=4.0)
        axes.plot([], [], color="0.6", linewidth=1.0, label="from its own drives")
        axes.plot([], [], color=REFERENCE, linewidth=2.0, label="with the population")
        axes.plot([], [], color=MEASURED, linewidth=2.0, label="odd")
        axes.locator_params(axis="x", nbins=5)
        axes.set_yticks(range(len(members)), [m.vehicle for m in members], parse_math=False)
        unit = next(iter(fleet.vehicles.values())).parameters[name].unit
        axes.set_xlabel(name if unit == "1" else f"{name} / ({unit})")
        axes.grid(alpha=0.3)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure
