"""Judged drives in files for other tools, and in a figure."""

from collections.abc import Sequence
from enum import Enum
from itertools import chain, count
from pathlib import Path

import numpy as np

from parameter_identification.judging.judgement import Judgement, TimeSeries
from tricycle_core.documents import replacing
from tricycle_core.palette import BLUE, GREEN, ORANGE
from tricycle_core.quantities import FloatArray

PICTURES = (".png", ".pdf", ".svg")


class ExportFormat(Enum):
    """Format of exported trajectories."""

    TUM = "tum"  # two files, `time x y z qx qy qz qw`, as evo and others read them
    CSV = "csv"  # one file with everything in `TimeSeries`, its names as header


def exported_files(
    bags: Sequence[Path], directory: Path, export_format: ExportFormat
) -> list[tuple[Path, ...]]:
    """Return the files of each drive: that of its bag's name, with a number where it is taken.

    Parameters
    ----------
    bags : sequence of Path
        Bags of the drives.
    directory : Path
        Directory of the files.
    export_format : ExportFormat
        One file as CSV; in the format of TUM measured and reference.
    """
    endings = {ExportFormat.CSV: [".csv"], ExportFormat.TUM: [".tum", "_reference.tum"]}
    files: list[tuple[Path, ...]] = []
    for name in (bag.resolve().stem for bag in bags):
        used = set(chain.from_iterable(files))
        for stem in chain([name], (f"{name}_{number}" for number in count(2))):
            own = tuple(directory / f"{stem}{end}" for end in endings[export_format])
            if used.isdisjoint(own):
                files.append(own)
                break
    return files


def export(
    judgements: Sequence[Judgement], directory: Path, export_format: ExportFormat
) -> list[Path]:
    """Save each drive at the points of Eq. 14, in the frame of its reference.

    Parameters
    ----------
    judgements : sequence of Judgement
        Drives to save, one or two files each (`exported_files`).
    directory : Path
        Created if need be; files of the same name are replaced.
    export_format : ExportFormat
        Format of the files; numbers are written with all their digits.

    Returns
    -------
    files : list of Path
        Files that were written.
    """
    directory.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    files = exported_files([judgement.bag for judgement in judgements], directory, export_format)
    for paths, judgement in zip(files, judgements, strict=True):
        s, header = judgement.series, ""
        if export_format is ExportFormat.CSV:
            tables, header = [np.column_stack(list(vars(s).values()))], ",".join(vars(s))
        else:
            tables = [
                _tum(s.time, s.x, s.y, s.heading),
                _tum(s.time, s.reference_x, s.reference_y, s.reference_heading),
            ]
        for path, table in zip(paths, tables, strict=True):
            delimiter = "," if header else " "
            with replacing(path) as file:
                np.savetxt(file, table, "%.17g", delimiter, header=header, comments="")
            written.append(path)
    return written


def _tum(time: FloatArray, x: FloatArray, y: FloatArray, heading: FloatArray) -> FloatArray:
    half = np.nan_to_num(heading) / 2
    zero = np.zeros_like(time)
    return np.column_stack([time, x, y, zero, zero, zero, np.sin(half), np.cos(half)])


def plot(judgements: Sequence[Judgement], path: Path) -> None:
    """Save a figure: the trajectories, and their deviations over time, one row per drive.

    Parameters
    ----------
    judgements : sequence of Judgement
        Drives to show.
    path : Path
        File to write; its suffix is one of `PICTURES`.
    """
    # The backend is for files, and importing it takes a while: only who plots pays.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.2 * len(judgements)), layout="constrained")
    FigureCanvasAgg(figure)
    rows = figure.subplots(len(judgements), 2, squeeze=False)
    for (plane, deviation), judgement in zip(rows, judgements, strict=True):
        s: TimeSeries = judgement.series
        plane.plot(s.reference_x, s.reference_y, color="0.6", linewidth=3, label="reference")
        plane.plot(s.x, s.y, color=BLUE, linewidth=1, label="measured")
        error = f"TE {judgement.te:.4g} m², rms {1e3 * judgement.rms:.0f} mm"
        plane.set_title(f"{judgement.bag.name}: {error}", parse_math=False)
        plane.set(xlabel="x / m", ylabel="y / m")
        plane.set_aspect("equal", "datalim")
        # the distance hides the others, of which it is made, where it is drawn after them
        for label, color, width, alpha, values in (
            ("distance", "0.75", 1.6, 1.0, s.distance),
            ("along the reference", ORANGE, 0.7, 0.8, s.along),
            ("across, to the left", GREEN, 0.7, 0.65, s.cross),
        ):
            line = {"color": color, "linewidth": width, "alpha": alpha, "label": label}
            deviation.plot(s.time, 1e3 * values, **line)
        deviation.set(xlabel="time since the start event / s", ylabel="deviation / mm")
        deviation.grid(alpha=0.3)
        for axes, columns in (
            (plane, 2),
            (deviation, 3),
        ):  # beside the curves, which it would cover
            axes.legend(
                loc="upper center",
                bbox_to_anchor=(0.5, -0.13),
                ncols=columns,
                columnspacing=1.2,
                frameon=False,
            )
    with replacing(path) as file:
        figure.savefig(file, dpi=120)
