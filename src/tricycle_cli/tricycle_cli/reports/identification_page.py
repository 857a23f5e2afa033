"""Results of an identification as one HTML page and as figures."""

import math
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from parameter_identification.drives.measured import Sensor
from parameter_identification.estimation import chi_square
from parameter_identification.estimation.intervals import half_width
from parameter_identification.identification import DriveFit, Identification
from parameter_identification.identification_file import document_of, save_identification_file
from parameter_identification.identified_vehicle import (
    identified_vehicle,
    kind_of_drives,
    named_drives,
)
from tricycle_cli.reports.html_page import FigureBlock, Section, TableBlock, html_page
from tricycle_cli.reports.identification_files import IDENTIFICATION, REPORT, VEHICLE, remove_older
from tricycle_cli.reports.remarks import remarks
from tricycle_cli.reports.tables import HEADINGS, parameter_rows
from tricycle_core.documents import write_whole
from tricycle_core.palette import BLUE, GREEN, VERMILLION
from tricycle_core.quantities import with_deviation

CONDITIONS = {
    "time / s": "time",
    "speed / (m/s)": "speed",
    "steering set-point / rad": "steering_motor_angle",
    "lateral acceleration / (m/s²)": "lateral_acceleration",
}
"""Where on a drive the vehicle is: label of an axis, and what a `Lack` calls it."""
MOST_DRAWN = 6  # drives in a figure with a panel for each
LACK = (
    "what the model lacks, once a second, with the noise's 95 % interval: how far the vehicle is "
    "ahead of the model and to its left; where deviations act, how much faster it is and how much "
    "more it turns"
)


def drawn_drives(found: Identification) -> tuple[DriveFit, ...]:
    """Return the drives to show in figures; if there are many, those whose positions fit worst.

    Parameters
    ----------
    found : Identification
        Result of `identify`.
    """
    worst = sorted(found.drives, key=lambda drive: drive.after[Sensor.POSITION].rms)[-MOST_DRAWN:]
    return tuple(drive for drive in found.drives if any(drive is one for one in worst))


def trajectories_figure(found: Identification) -> Figure:
    """Return drives as measured, with the nominal vehicle and the estimates, and their distances.

    Parameters
    ----------
    found : Identification
        Result of `identify`.
    """
    drives = drawn_drives(found)
    figure = Figure(figsize=(5.6 * len(drives), 7.4), layout="constrained")
    grid = figure.subplots(2, len(drives), squeeze=False, height_ratios=(5, 2))
    for axes, distance, drive in zip(*grid, drives, strict=True):
        before, after = drive.before[Sensor.POSITION], drive.after[Sensor.POSITION]
        measured = after.values + after.residual
        axes.plot(*measured.T, ".", color="0.6", markersize=2, label="measured")
        axes.plot(*before.values.T, color=BLUE, label=f"before, rms {1e3 * before.rms:.0f} mm")
        axes.plot(*after.values.T, color=VERMILLION, label=f"after, rms {1e3 * after.rms:.0f} mm")
        axes.plot(*after.values[0], "o", color=GREEN, label="start")
        axes.set_title(drive.name, parse_math=False)
        axes.set(xlabel="x / m", ylabel="y / m")
        axes.set_aspect("equal", adjustable="datalim")
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small")
        for p, color in ((before, BLUE), (after, VERMILLION)):
            distance.plot(p.time, 1e3 * np.hypot(*p.residual.T), color=color, linewidth=0.8)
        distance.set(xlabel="time since the start / s", ylabel="distance / mm")
        distance.grid(alpha=0.3)
    return figure


def residuals_figure(found: Identification) -> Figure:
    """Return the residuals over time, a row per channel and a column per drive that is drawn.

    Parameters
    ----------
    found : Identification
        Result of `identify`.
    """
    drives = drawn_drives(found)
    predictions = [drive.after for drive in drives]
    every = ((s, c) for s in Sensor for p in predictions if s in p for c in p[s].channels)
    channels = list(dict.fromkeys(every))
    figure = Figure(figsize=(5.6 * len(drives), 1.7 * len(channels) + 0.8), layout="constrained")
    grid = figure.subplots(len(channels), len(drives), squeeze=False, sharex="col")
    for column, drive in zip(grid.T, drives, strict=True):
        tests = {t.channel: t for t in found.whiteness if t.drive == drive.name}
        column[0].set_title(drive.name, parse_math=False)
        column[-1].set_xlabel("time since the start / s")
        for axes, (sensor, channel) in zip(column, channels, strict=True):
            if sensor not in drive.after or channel not in drive.after[sensor].channels:
                axes.axis("off")
                continue
            p, test = drive.after[sensor], tests[channel]
            axes.plot(p.time, p.residual[:, p.channels.index(channel)], color=BLUE, linewidth=0.6)
            verdict = "at the sensor's steps" if math.isnan(test.p) else f"p = {test.p:.2g}"
            axes.set_ylabel(f"{channel} / {sensor.unit}", fontsize="small")
            axes.text(0.99, 0.95, verdict, transform=axes.transAxes, ha="right", va="top")
            axes.grid(alpha=0.3)
    return figure


def lack_figure(found: Identification) -> Figure:
    """Return what the model lacks over time, speed, steering and lateral acceleration.

    Parameters
    ----------
    found : Identification
        Result of `identify`, with `lack` of every drive.
    """
    lacks = {drive.name: drive.lack for drive in found.drives if drive.lack is not None}
    names = list(dict.fromkeys(name for lack in lacks.values() for name in lack.values))
    figure = Figure(figsize=(11.2, 2.6 * len(names) + 0.4), layout="constrained")
    grid = figure.subplots(len(names), 4, squeeze=False, sharey="row", sharex="col")
    for row, name in zip(grid, names, strict=True):
        for axes, of in zip(row, CONDITIONS.values(), strict=True):
            for drive, lack in lacks.items():
                if name in lack.values:
                    bars = half_width(found.level) * lack.standard_deviations[name]
                    options = {"fmt": ".", "elinewidth": 0.6, "markersize": 4, "label": drive}
                    axes.errorbar(getattr(lack, of), lack.values[name], bars, **options)
            axes.axhline(0.0, color="0.4", linewidth=0.6)
            axes.grid(alpha=0.3)
        row[0].set_ylabel(name)
    for axes, label in zip(grid[-1], CONDITIONS, strict=True):
        axes.set_xlabel(label)
    if len(lacks) <= MOST_DRAWN:
        for text in grid[0, 0].legend(fontsize="small").get_texts():
            text.set_parse_math(False)
    return figure


def profiles_figure(found: Identification) -> Figure:
    """Return the profile likelihood of each parameter with its interval and, if known, the truth.

    Parameters
    ----------
    found : Identification
        Result of `identify`.
    """
    profiled = [
        (name, e, e.profile) for name, e in found.parameters.items() if e.profile is not None
    ]
    columns = min(3, len(profiled))
    rows = math.ceil(len(profiled) / columns)
    figure = Figure(figsize=(3.7 * columns, 2.9 * rows), layout="constrained")
    allowed = chi_square.quantile(found.level, 1)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, (name, e, profile) in zip(grid, profiled, strict=False):
        axes.plot(profile.values, profile.rise, "o-", color=BLUE, markersize=3)
        axes.axhline(allowed, color="0.6", linewidth=0.8)
        axes.annotate(
            f"{allowed:.2f}", (0.01, allowed), xycoords=("axes fraction", "data"), va="bottom",
            fontsize="x-small", color="0.4",
        )  # fmt: skip
        axes.axvspan(e.low, e.high, color=BLUE, alpha=0.12)
        reach = 0.5 * (e.high - e.low)
        seen = [e.low - reach, e.high + reach]
        if name in found.truth:
            seen = [min(seen[0], found.truth[name]), max(seen[1], found.truth[name])]
            axes.axvline(found.truth[name], color=VERMILLION, linestyle="--", label="truth")
            axes.legend(fontsize="small")
        axes.set_xlim(max(seen[0], e.range[0]), min(seen[1], e.range[1]))
        axes.set_ylim(0, 2 * allowed)
        axes.locator_params(axis="x", nbins=5)
        unit = "" if e.unit == "1" else f" / {e.unit}"
        axes.set_xlabel(f"{name.replace('_', ' ')}{unit}", fontsize="small")
    for axes in grid[len(profiled) :]:
        axes.axis("off")
    figure.supylabel("rise of the cost")
    return figure


def identification_page(found: Identification) -> str:
    """Return the page as the text of one HTML file.

    Parameters
    ----------
    found : Identification
        Result of `identify`.
    """
    names = found.names
    correlation = TableBlock(
        ("parameter", *names),
        tuple(
            (name, *(f"{value:.2f}" for value in row))
            for name, row in zip(names, found.correlation, strict=True)
        ),
        caption="correlation of the estimates",
    )
    noise = TableBlock(
        ("sensor", "white", "drift", "correlation time", "unit"),
        tuple(
            (s.value, f"{n.white:.3g}", f"{n.drift:.2g}", f"{n.drift_time:.2g} s", s.unit)
            for s, n in found.noise.items()
        ),
        caption="noise, estimated from the residuals",
    )
    units = {
        channel: sensor.unit
        for drive in found.drives
        for sensor, p in drive.after.items()
        for channel in p.channels
    }
    tests = TableBlock(
        ("drive", "channel", "rms", "unit", "correlation", "p"),
        tuple(
            (
                *(t.drive, t.channel, f"{t.rms:.3g}", units[t.channel]),
                *(_number(t.correlation, ".2f"), _number(t.p, ".2g")),
            )
            for t in found.whiteness
        ),
        caption="Ljung-Box test of the residuals; p is missing where a sensor's steps are coarser",
    )
    drawn = len(drawn_drives(found))
    count = f"{len(found.drives)} {kind_of_drives(found)}"
    few = "" if drawn == len(found.drives) else f"; of {count} the worst {drawn}"
    sections = [
        Section(
            "Parameters",
            (
                TableBlock.without_empty_columns(HEADINGS, parameter_rows(found)),
                *remarks(found),
            ),
        ),
        Section(
            "Trajectories",
            (
                _block(
                    trajectories_figure(found),
                    f"measured; nominal and identified vehicle, and how far they are away{few}",
                ),
            ),
        ),
    ]
    if any(e.profile is not None for e in found.parameters.values()):
        caption = "profile likelihood; shaded: interval; grey: its level"
        sections.append(Section("Profiles", (_block(profiles_figure(found), caption), correlation)))
    sections += [
        Section(
            "Residuals", (_block(residuals_figure(found), f"measured less predicted{few}"), tests)
        ),
        Section("Noise and start", (noise, *(_start(drive) for drive in found.drives))),
    ]
    if any(drive.lack is not None for drive in found.drives):
        block = _block(lack_figure(found), LACK)
        sections.insert(-1, Section("What the model lacks", (block,)))
    title = f"Identified from {named_drives(found)}"
    return html_page(title, sections, subtitle=f"vehicle {found.vehicle}")


def _start(drive: DriveFit) -> TableBlock:
    rows = tuple(
        (name, with_deviation(n.estimate, n.standard_deviation), n.unit)
        for name, n in drive.nuisances.items()
    )
    return TableBlock(("nuisance", "estimate", "unit"), rows, caption=drive.name)


def _number(value: float, form: str) -> str:
    return "" if math.isnan(value) else format(value, form)


def _block(figure: Figure, caption: str) -> FigureBlock:
    return FigureBlock.of(figure, alt=caption, caption=caption)


def save_identification(found: Identification, vehicle_file: Path | None, folder: Path) -> None:
    """Write `vehicle.yaml` with the estimates, `report.html`, figures and `identification.json`.

    Figures of an earlier identification that this one has not are removed. If a text or a figure
    cannot be made, the numbers alone are written, and all of an earlier identification is removed.

    Parameters
    ----------
    found : Identification
        Result of `identify`.
    vehicle_file : Path, optional
        File of the vehicle that was identified with; None: the packaged one.
    folder : Path
        Folder of the files; made if it is missing.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    files: dict[str, str | bytes] = {}
    try:
        files = _files(found, vehicle_file)
    finally:  # the numbers took the longest
        for name, content in files.items():
            write_whole(folder / name, content)
        remove_older(folder, files)
        save_identification_file(document_of(found), folder / IDENTIFICATION)


def _files(found: Identification, vehicle_file: Path | None) -> dict[str, str | bytes]:
    """Contents of the files but the numbers, by name."""
    figures = {
        "trajectories": trajectories_figure(found),
        "residuals": residuals_figure(found),
    }
    if any(drive.lack is not None for drive in found.drives):
        figures["lack"] = lack_figure(found)
    if any(e.profile is not None for e in found.parameters.values()):
        figures["profiles"] = profiles_figure(found)
    return {
        VEHICLE: identified_vehicle(found, vehicle_file),
        REPORT: identification_page(found),
        **{f"{name}.png": _image(figure) for name, figure in figures.items()},
    }


def _image(figure: Figure) -> bytes:
    file = BytesIO()
    figure.savefig(file, format="png", dpi=150)
    return file.getvalue()
