"""A film of driven maneuvers: the vehicle beside the nominal one, and the distance over time."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.animation import PillowWriter
from matplotlib.figure import Figure

from excitation_planner.area.tube import footprint_of
from parameter_identification.judging.judgement import Judgement
from tricycle_cli.reports.static_figures import MEASURED, REFERENCE
from tricycle_core.documents import replacing
from tricycle_core.poses import placed
from tricycle_core.quantities import Progress
from tricycle_sim.vehicle import Vehicle

FRAMES = 10  # per second


def write_film(
    judgements: Sequence[Judgement],
    vehicle: Vehicle,
    path: Path,
    *,
    speed: float,
    progress: Progress,
) -> None:
    """Write a GIF of drives beside one another, all begun at the same time.

    Parameters
    ----------
    judgements : sequence of Judgement
        Judgements of the drives.
    vehicle : Vehicle
        Vehicle; its wheels give the size of the rectangles.
    path : Path
        File that is written.
    speed : float
        Seconds of the drive per second.
    progress : callable
        Called with the number of frames done and of all.
    """
    corners = footprint_of(vehicle)
    figure = Figure(figsize=(4.2 * len(judgements), 5.0), layout="constrained")
    axes = figure.subplots(2, len(judgements), height_ratios=(2.6, 1), squeeze=False)
    highest = max(1e3 * judgement.max for judgement in judgements)
    moving = []
    for judgement, track, distance in zip(judgements, axes[0], axes[1], strict=True):
        s = judgement.series
        track.plot(s.reference_x, s.reference_y, color=REFERENCE, linewidth=0.8, alpha=0.5)
        track.set_title(judgement.bag.name, parse_math=False)
        track.set(xlabel="x / m", ylabel="y / m")
        track.set_aspect("equal", adjustable="datalim")
        distance.set(xlabel="time / s", ylabel="distance / mm", ylim=(0, 1.05 * highest))
        distance.set_xlim(0, s.time[-1])
        (line,) = track.plot([], [], color=MEASURED, linewidth=0.9)
        (curve,) = distance.plot([], [], color=MEASURED, linewidth=0.9)
        heading = s.reference_heading if np.isnan(s.heading).any() else s.heading
        for x, y, angle, color, label in (
            (s.reference_x, s.reference_y, s.reference_heading, REFERENCE, "nominal"),
            (s.x, s.y, heading, MEASURED, "driven"),
        ):
            (outline,) = track.plot([], [], color=color, label=label)
            ring = placed(corners[[0, 1, 2, 3, 0]], x, y, angle)
            track.update_datalim(ring.reshape(-1, 2))
            moving.append((s.time, outline, ring))
        track.autoscale_view()
        track.legend(loc="upper right", fontsize="small")
        moving += [(s.time, line, np.stack([s.x, s.y], axis=1))]
        moving += [(s.time, curve, np.stack([s.time, 1e3 * s.distance], axis=1))]
    longest = max(judgement.duration for judgement in judgements)
    times = np.arange(0.0, longest + speed / FRAMES, speed / FRAMES)
    writer = PillowWriter(fps=FRAMES)
    with replacing(path) as new:
        writer.setup(figure, str(new), dpi=80)
        for number, time in enumerate(times, start=1):
            if number == 2:
                figure.set_layout_engine(None)  # stays as laid out; "none" draws each frame twice
            for s_time, artist, points in moving:
                k = min(int(np.searchsorted(s_time, time)), len(s_time) - 1)
                artist.set_data(*(points[k] if points.ndim == 3 else points[: k + 1]).T)
            writer.grab_frame()
            progress(number, len(times))
        writer.finish()  # writes the file
