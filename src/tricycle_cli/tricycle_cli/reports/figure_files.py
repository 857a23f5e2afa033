"""The figures of a report as image files, drawn by Matplotlib from the same data."""

from collections.abc import Iterator, Sequence
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from tricycle_cli.reports.html_page import PlotBlock, Section
from tricycle_core.documents import replacing

WIDTH = 9.0  # inches, of a figure that a page shows alone
PX = 100.0  # of a page in an inch
MOST_LETTERS = 50  # of a maneuver in the name of a file, which may have 255 bytes
_DASHES = {"dash": "--", "dot": ":", "solid": "-", None: "-"}
_MARKERS = {"star": "*", "x-thin": "x"}


def figures_by_file(
    sections: Sequence[Section], folder: Path, suffix: str
) -> dict[Path, tuple[go.Figure, float]]:
    """Return every figure of a report and its width [inch], by the file that it is written to.

    Parameters
    ----------
    sections : sequence of Section
        Sections of the report.
    folder : Path
        Folder of the files.
    suffix : str
        Format: svg, pdf or png.
    """
    found = {}
    for title, block in ((s.title, b) for s in sections for b in s.blocks):
        if not isinstance(block, PlotBlock):
            continue
        for k, plot in enumerate(block.plots, start=1):
            number = f"_{k}" if len(block.plots) > 1 else ""
            maneuver = (title.rpartition(": ")[0] or title)[:MOST_LETTERS]
            name = "".join(
                c if c.isalnum() or c in "-_" else "_" for c in f"{maneuver}_{block.name}{number}"
            )
            file, others = folder / f"{name}.{suffix}", 1
            while file in found:
                others += 1
                file = folder / f"{name}-{others}.{suffix}"
            found[file] = plot, WIDTH if len(block.plots) == 1 else WIDTH / 2
    return found


def write_figures(sections: Sequence[Section], folder: Path, suffix: str) -> list[Path]:
    """Write every figure of a report to a file of its own; return the files.

    Parameters
    ----------
    sections : sequence of Section
        Sections of the report.
    folder : Path
        Folder of the files; made if it is missing.
    suffix : str
        Format: svg, pdf or png.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    figures = figures_by_file(sections, folder, suffix)
    for file, (plot, wide) in figures.items():
        with replacing(file) as temporary, rc_context({"svg.hashsalt": "figure"}):
            dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
            matplotlib_figure(plot, width=wide).savefig(
                temporary, format=suffix, dpi=150, metadata=dates.get(suffix)
            )
    return list(figures)


def matplotlib_figure(plot: go.Figure, *, width: float = WIDTH) -> Figure:
    """Return a figure of `interactive_figures` as one of Matplotlib.

    Parameters
    ----------
    plot : go.Figure
        Plotly figure of lines, marks, bars, contours, and lines across.
    width : float
        Width of the figure [inch].
    """
    figure = Figure(figsize=(width, (plot.layout.height or 400) / PX), layout="constrained")
    rows = sorted({_domain(plot, "y", k) for k in _axes(plot)}, reverse=True)
    columns = sorted({_domain(plot, "x", k) for k in _axes(plot)})
    grid = figure.subplots(len(rows), len(columns), squeeze=False, sharex="col", sharey="row")
    axes = {
        k: grid[rows.index(_domain(plot, "y", k))][columns.index(_domain(plot, "x", k))]
        for k in _axes(plot)
    }
    for trace in plot.data:
        _draw(axes[(trace.xaxis or "x")[1:]], trace, figure)
    for shape in plot.layout.shapes:
        _across(axes[shape.xref.split()[0][1:]], shape)
    for note in plot.layout.annotations:
        if note.showarrow and note.axref == "x":
            axes[""].annotate(
                "", (note.x, note.y), (note.ax, note.ay),
                arrowprops={"color": _colour(note.arrowcolor), "arrowstyle": "-|>", "lw": 1.5},
            )  # fmt: skip
    # a legend would hide a part of narrow or filled axes
    full = len(columns) > 1 or any(trace.type == "contour" for trace in plot.data)
    for k, one in axes.items():
        x, y = plot.layout[f"xaxis{k}"], plot.layout[f"yaxis{k}"]
        one.set(xlabel=_text(x.title.text), ylabel=_text(y.title.text))
        for axis, limits, scale in (
            (x, one.set_xlim, one.set_xscale),
            (y, one.set_ylim, one.set_yscale),
        ):
            if axis.type == "log":
                scale("log")
            if axis.range is not None:
                limits(*axis.range)
            if axis.rangemode == "tozero":
                limits(0.0, None)
        if y.autorange == "reversed":
            one.invert_yaxis()
        if y.scaleanchor:
            one.set_aspect("equal", adjustable="datalim")
        one.grid(alpha=0.3)
        if plot.layout.showlegend is not False and (named := one.get_legend_handles_labels())[0]:
            if full:
                entries = len(named[0])
                figure.legend(*named, fontsize="small", loc="outside upper left", ncols=entries)
            else:
                one.legend(fontsize="small")
    return figure


def _axes(plot: go.Figure) -> Iterator[str]:
    """Suffixes of the pairs of axes: "" of the first, "2" of the second."""
    return (key[5:] for key in plot.layout.to_plotly_json() if key.startswith("xaxis"))


def _domain(plot: go.Figure, axis: str, k: str) -> float:
    domain = plot.layout[f"{axis}axis{k}"].domain
    return round(domain[0], 3) if domain else 0.0


def _text(text: str | None) -> str:
    return unescape(text or "").replace("$", r"\$")


def _colour(colour: object) -> str | None:
    return to_hex(colour) if isinstance(colour, str) else None


def _draw(axes: Axes, trace: Any, figure: Figure) -> None:
    label = None if trace.showlegend is False else _text(trace.name)
    if trace.type == "bar":
        _bars(axes, trace, label)
    elif trace.type == "contour":
        z = np.ma.masked_invalid(np.asarray(trace.z, dtype=float))
        drawn = axes.contourf(trace.x, trace.y, z, cmap="cividis_r", alpha=0.8)
        axes.use_sticky_edges = False  # marks on its edge are seen whole
        axes.margins(0.02, tight=False)
        figure.colorbar(drawn, ax=axes, label=_text(trace.colorbar.title.text))
    else:
        mode = trace.mode or "lines"
        lines, marks = "lines" in mode, "markers" in mode
        marker = _MARKERS.get(trace.marker.symbol, "o") if marks else ""
        size = trace.marker.size if isinstance(trace.marker.size, int | float) else 5
        edge = trace.marker.line.color if marker == "x" else trace.marker.color
        axes.plot(
            np.asarray(trace.x, dtype=float), np.asarray(trace.y, dtype=float), label=label,
            color=_colour(trace.line.color if lines else edge),
            linestyle=_DASHES.get(trace.line.dash, "-") if lines else "",
            linewidth=trace.line.width or 1.5,
            drawstyle="steps-post" if trace.line.shape == "hv" else "default",
            marker=marker, markersize=0.7 * size,
        )  # fmt: skip


def _bars(axes: Axes, trace: Any, label: str | None) -> None:
    """One of the groups of horizontal bars that share an axis."""
    names = [_text(name) for name in trace.y]
    drawn = len(axes.containers) // 2  # bars and their errors
    at = np.arange(len(names)) + 0.4 * drawn - 0.2
    error = [trace.error_x.arrayminus, trace.error_x.array]
    axes.barh(at, trace.x, 0.38, xerr=error, color=_colour(trace.marker.color), label=label)
    axes.set_yticks(np.arange(len(names)), names)


def _across(axes: Axes, shape: Any) -> None:
    """A line or a band from edge to edge."""
    style: dict[str, Any] = {
        "color": _colour(shape.line.color),
        "linestyle": _DASHES.get(shape.line.dash, "-"),
    }
    if shape.type == "rect":
        axes.axvspan(shape.x0, shape.x1, color=_colour(shape.fillcolor), alpha=shape.opacity)
    elif shape.x0 == shape.x1:
        axes.axvline(shape.x0, **style)
    else:
        axes.axhline(shape.y0, linewidth=0.8, **style)
        axes.annotate(
            f"{shape.y0:.2f}", (0.01, shape.y0), xycoords=("axes fraction", "data"), va="bottom",
            fontsize="x-small",
        )  # fmt: skip
