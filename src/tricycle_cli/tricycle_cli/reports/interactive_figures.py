"""Interactive figures of a report, in colours that read on light and on dark ground.

Text that comes from files is escaped: Plotly takes labels for HTML.
"""

import itertools
from html import escape

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from excitation_planner.plan import Plan, SearchHistory
from parameter_identification.drives.recorded import JointStates
from parameter_identification.estimation import chi_square
from parameter_identification.identification_file import IdentificationDocument, ParameterEntry
from parameter_identification.judging.judgement import Judgement
from tricycle_cli.reports.run_folder import WheelLoads
from tricycle_core.palette import BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILLION
from tricycle_core.quantities import FloatArray

POINTS = 1000  # of a curve; a screen cannot show more
MARKS = 5.0  # s between the lines that join equal times
SMOOTHED = 0.5  # s over which a line drawn over noise is the mean
HEIGHT = 400  # px
_EDGE = {"width": 1, "color": "white"}  # of marks


def trajectories(plan: Plan | None, judgement: Judgement | None) -> go.Figure:
    """Return path, nominal and driven trajectory, equal times of the last two joined.

    Parameters
    ----------
    plan : Plan, optional
        Plan of the drive.
    judgement : Judgement, optional
        Judgement of the drive.
    """
    figure = _figure(height=560)
    if plan is not None:
        x, y = _thinned(*plan.path.T)
        figure.add_scatter(x=x, y=y, name="path of the rear axle", line=_line(GREY, width=1))
    if judgement is not None:
        s = judgement.series
        time, x0, y0, x, y = _thinned(s.time, s.reference_x, s.reference_y, s.x, s.y)
        _over_time(figure, time, x0, y0, name="nominal model", line=_line(BLUE))
        _over_time(figure, time, x, y, name="driven, as measured", line=_line(VERMILLION, width=1))
        step = float(s.time[1] - s.time[0])
        smooth = [_smoothed(v - v0, step) for v, v0 in ((s.x, s.reference_x), (s.y, s.reference_y))]
        factor = _enlargement(s.reference_x, s.reference_y, judgement.max)
        if factor > 1:
            _, dx, dy = _thinned(s.time, *smooth)
            far_x, far_y = x0 + factor * dx, y0 + factor * dy
            marks = np.searchsorted(time, np.arange(MARKS, time[-1], MARKS))
            gap = np.full(len(marks), np.nan)
            figure.add_scatter(
                x=np.column_stack([x0[marks], far_x[marks], gap]).ravel(),
                y=np.column_stack([y0[marks], far_y[marks], gap]).ravel(),
                name=f"same time, every {MARKS:g} s", mode="lines", line=_line(GREY, dash="dot"),
                hoverinfo="skip",
            )  # fmt: skip
            figure.add_scatter(
                x=far_x, y=far_y, name=f"driven, deviation ×{factor}, {SMOOTHED:g} s mean",
                line=_line(PURPLE), hoverinfo="skip",
            )  # fmt: skip
        _mark_start(figure, x0, y0)
    elif plan is not None:
        reference = plan.reference
        time, x, y = _thinned(reference.time, reference.x, reference.y)
        _over_time(figure, time, x, y, name="nominal model", line=_line(BLUE))
        _mark_start(figure, x, y)
    figure.update_xaxes(title="x / m", constrain="domain")
    figure.update_yaxes(title="y / m", scaleanchor="x")
    return figure


def _mark_start(figure: go.Figure, x: FloatArray, y: FloatArray) -> None:
    """Mark where a trajectory begins, and where it leads from there."""
    figure.add_scatter(
        x=x[:1], y=y[:1], name="start", mode="markers", hoverinfo="skip",
        marker={"size": 11, "color": GREEN, "line": _EDGE},
    )  # fmt: skip
    away = np.hypot(x - x[0], y - y[0])
    tip = int(np.argmax(away > 0.08 * away.max()))
    figure.add_annotation(
        x=x[tip], y=y[tip], ax=x[0], ay=y[0], axref="x", ayref="y", text="", showarrow=True,
        arrowhead=2, arrowsize=1.2, arrowwidth=2, arrowcolor=GREEN,
    )  # fmt: skip


def _enlargement(x: FloatArray, y: FloatArray, deviation: float) -> int:
    """Return the largest round factor for deviations of at most a tenth of the trajectory."""
    extent = max(float(np.ptp(x)), float(np.ptp(y)))
    wanted = 0.1 * extent / deviation if deviation > 0.0 else 1.0
    return max((k for k in (1, 2, 5, 10, 20, 50, 100) if k <= wanted), default=1)


def _smoothed(values: FloatArray, step: float) -> FloatArray:
    """Means over `SMOOTHED`, narrower at the ends."""
    half = max(round(0.5 * SMOOTHED / step), 1)
    sums = np.concatenate([[0.0], np.cumsum(values)])
    first = np.maximum(np.arange(len(values)) - half, 0)
    last = np.minimum(np.arange(len(values)) + half + 1, len(values))
    means: FloatArray = (sums[last] - sums[first]) / (last - first)
    return means


def commands(plan: Plan | None, joints: JointStates | None) -> go.Figure:
    """Return the commands of a plan and what the joints did, over the time since the start.

    Parameters
    ----------
    plan : Plan, optional
        Plan of the drive.
    joints : JointStates, optional
        Joint states that the PLCs measured.
    """
    figure = _figure(rows=2)
    if plan is not None:
        time = plan.commands.time
        for row, value in ((1, plan.commands.steering_motor_angle), (2, plan.commands.speed)):
            figure.add_scatter(
                x=time, y=value, name="command", line=_line(BLUE, shape="hv"),
                legendgroup="command", showlegend=row == 1, row=row, col=1,
            )  # fmt: skip
    if joints is not None:
        speed = joints.wheel_rate * (1.0 if plan is None else plan.tyre_radius)
        for row, value in ((1, joints.steering_motor_angle), (2, speed)):
            there = ~np.isnan(value)  # each joint may come in messages of its own
            time, seen = _thinned(joints.time[there], value[there])
            figure.add_scatter(
                x=time, y=seen, name="measured", line=_line(VERMILLION), legendgroup="measured",
                showlegend=row == 1, row=row, col=1,
            )  # fmt: skip
    figure.update_yaxes(title="steering motor / rad", row=1, col=1)
    title = "rear wheel / (rad/s)" if plan is None else "speed / (m/s)"
    figure.update_yaxes(title=title, row=2, col=1)
    return _in_time(figure)


def error_over_time(judgement: Judgement) -> go.Figure:
    """Return the distance from the reference, its parts, and the trajectory error up to each time.

    Parameters
    ----------
    judgement : Judgement
        Judgement of the drive.
    """
    s = judgement.series
    so_far = np.cumsum(s.distance**2) / np.arange(1, len(s.distance) + 1)
    step = float(s.time[1] - s.time[0])
    smooth = (_smoothed(v, step) for v in (s.distance, s.along, s.cross))
    time, distance, te, *means = _thinned(s.time, s.distance, so_far, *smooth)
    figure = _figure(rows=2)
    figure.add_scatter(
        x=time, y=1e3 * distance, name="distance, as measured", line=_line(GREY, width=0.7),
        row=1, col=1,
    )  # fmt: skip
    for name, value, color in zip(
        ("distance", "along the way", "to the left"),
        means,
        (VERMILLION, GREEN, PURPLE),
        strict=True,
    ):
        figure.add_scatter(
            x=time, y=1e3 * value, name=f"{name}, {SMOOTHED:g} s mean", line=_line(color),
            row=1, col=1,
        )  # fmt: skip
    if judgement.noise > 0.0:
        floor = np.full(2, 1e3 * judgement.noise * np.sqrt(2.0))
        figure.add_scatter(
            x=time[[0, -1]], y=floor, name="noise alone, rms of the distance", mode="lines",
            line=_line(GREY, dash="dash"), row=1, col=1,
        )  # fmt: skip
    figure.add_scatter(x=time, y=te, name="TE so far", line=_line(BLUE), row=2, col=1)
    figure.update_yaxes(title="deviation / mm", row=1, col=1)
    figure.update_yaxes(title="TE so far / m²", rangemode="tozero", row=2, col=1)
    return _in_time(figure)


def wheel_loads(loads: WheelLoads) -> go.Figure:
    """Return the vertical load of each wheel over time.

    Parameters
    ----------
    loads : WheelLoads
        Wheel loads of the nominal vehicle.
    """
    figure = _figure()
    time, *values = _thinned(loads.time, *loads.by_wheel.values())
    colors = itertools.cycle((BLUE, VERMILLION, GREEN, ORANGE))
    for name, value, color in zip(loads.by_wheel, values, colors, strict=False):
        figure.add_scatter(x=time, y=value, name=name, line=_line(color))
    figure.update_yaxes(title="wheel load / N", rangemode="tozero")
    return _in_time(figure)


def indices(plan: Plan) -> go.Figure:
    """Return the Sobol' indices S and ST of every unknown parameter, with their 95 % intervals.

    Parameters
    ----------
    plan : Plan
        Plan of the drive.
    """
    figure = _figure(height=110 + 52 * len(plan.main))
    for name, by_name, color in (
        ("main index S", plan.main, BLUE),
        ("total index ST", plan.total, VERMILLION),
    ):
        drawn = list(by_name.values())
        figure.add_bar(
            orientation="h", name=name, marker_color=color,
            y=[escape(parameter) for parameter in by_name],
            x=[index.value for index in drawn],
            error_x={
                "type": "data", "color": GREY, "thickness": 1.5,
                "array": [index.high - index.value for index in drawn],
                "arrayminus": [index.value - index.low for index in drawn],
            },
        )  # fmt: skip
    figure.update_layout(barmode="group")
    figure.update_xaxes(title="share of the variance of TE", rangemode="tozero")
    figure.update_yaxes(autorange="reversed")
    return figure


def search_path(plan: Plan, search: SearchHistory) -> go.Figure:
    """Return the cost of every maneuver that the search tried, over x, and the best one so far.

    Parameters
    ----------
    plan : Plan
        Plan of the drive.
    search : SearchHistory
        Maneuvers that the search evaluated.
    """
    names = [escape(name) for name in plan.operation]
    chosen = list(plan.operation.values())
    drivable = np.isfinite(search.cost)
    order = np.arange(1, len(search.cost) + 1)
    cost_name = plan.criterion.upper()
    texts = np.array(
        [f"no. {i}, {cost_name} = {cost:.4g}" for i, cost in zip(order, search.cost, strict=True)]
    )
    left_out = "cannot be driven" + (" or does not fit" if plan.area is not None else "")
    if len(names) != 2:
        return _cost_by_axis(search, names, chosen, texts, cost_name, left_out)
    figure = _figure(height=520)
    x, y = search.x.T
    cost = search.cost[drivable]
    by_decades = bool(np.all(cost > 0.0))  # D is a logarithm already
    found = search.x[drivable], np.log10(cost) if by_decades else cost
    scale = f"log₁₀ {cost_name}" if by_decades else cost_name
    if drivable.sum() > 3 and np.all(np.ptp(found[0], axis=0) > 0.0):
        grid = [np.linspace(v.min(), v.max(), 80) for v in (x, y)]
        from scipy.interpolate import griddata

        surface = griddata(*found, tuple(np.meshgrid(*grid)), rescale=True)
        figure.add_contour(
            x=grid[0], y=grid[1], z=surface, colorscale="Cividis", reversescale=True, opacity=0.8,
            line_width=0.5, hoverinfo="skip",
            colorbar={"title": scale, "thickness": 14},
        )  # fmt: skip
    figure.add_scatter(
        x=x[drivable], y=y[drivable], name="tried", mode="markers", text=texts[drivable],
        hoverinfo="text+x+y", marker={"size": 6, "color": VERMILLION, "line": _EDGE},
    )  # fmt: skip
    best = search.cost <= np.minimum.accumulate(search.cost)
    best &= drivable
    figure.add_scatter(
        x=x[best], y=y[best], name="best so far", mode="lines+markers", text=texts[best],
        hoverinfo="text+x+y", line=_line(PURPLE), marker={"size": 8, "line": _EDGE},
    )  # fmt: skip
    if not drivable.all():
        figure.add_scatter(
            x=x[~drivable], y=y[~drivable], name=left_out, mode="markers",
            marker={"size": 8, "symbol": "x-thin", "line": {"width": 2, "color": GREY}},
        )  # fmt: skip
    figure.add_scatter(
        x=chosen[:1], y=chosen[1:], name="the plan", mode="markers",
        text=[f"{cost_name} = {plan.criterion_cost:.4g}"], hoverinfo="text+x+y",
        marker={"size": 16, "symbol": "star", "color": PURPLE, "line": _EDGE},
    )  # fmt: skip
    figure.update_xaxes(title=names[0])
    figure.update_yaxes(title=names[1])
    return figure


def profiles(found: IdentificationDocument) -> tuple[go.Figure, ...]:
    """Return the profile likelihood of each parameter; interval, its level and truth marked.

    Parameters
    ----------
    found : IdentificationDocument
        Content of an `identification.json`.
    """
    allowed = chi_square.quantile(found.level, 1)
    drawn = []
    for name, parameter in found.parameters.items():
        if parameter.profile is None:
            continue
        figure = _figure(height=300)
        figure.update_layout(showlegend=False)
        x, y = parameter.profile.values, parameter.profile.rise
        figure.add_scatter(x=x, y=y, mode="lines+markers", line=_line(BLUE))
        figure.add_vrect(parameter.low, parameter.high, fillcolor=BLUE, opacity=0.15, line_width=0)
        figure.add_hline(
            allowed, line={"color": GREY, "width": 1}, annotation_text=f"{allowed:.2f}",
            annotation_font_size=11, annotation_position="top left",
        )  # fmt: skip
        if parameter.truth is not None:
            figure.add_vline(parameter.truth, line={"color": VERMILLION, "dash": "dash"})
        unit = "" if parameter.unit in ("", "1") else f" / ({parameter.unit})"
        figure.update_xaxes(
            title=escape(f"{name}{unit}"), range=_around(parameter), exponentformat="power",
            nticks=5,
        )  # fmt: skip
        figure.update_yaxes(title="rise of the cost", range=(0.0, 3.0 * allowed))
        drawn.append(figure)
    return tuple(drawn)


def _around(parameter: ParameterEntry) -> tuple[float, float]:
    """The interval with half of its width either side, and the truth, within the range."""
    reach = 0.5 * (parameter.high - parameter.low)
    seen = [parameter.low - reach, parameter.high + reach]
    if parameter.truth is not None:
        seen += [parameter.truth - 0.2 * reach, parameter.truth + 0.2 * reach]
    return max(min(seen), parameter.range[0]), min(max(seen), parameter.range[1])


def _cost_by_axis(
    search: SearchHistory,
    names: list[str],
    chosen: list[float],
    texts: NDArray[np.str_],
    cost: str,
    left_out: str,
) -> go.Figure:
    figure = make_subplots(rows=1, cols=len(names), shared_yaxes=True, horizontal_spacing=0.03)
    figure.update_layout(_layout(HEIGHT))
    drivable = np.isfinite(search.cost)
    known = search.cost[drivable]
    by_decades = bool(np.all(known > 0.0))  # D is a logarithm already
    the_plan = {"color": PURPLE, "dash": "dash"}
    above = np.max(
        known * (known / known.min()) ** 0.1 if by_decades else known + 0.1 * np.ptp(known)
    )
    for column, name in enumerate(names):
        where = {"row": 1, "col": column + 1}
        figure.add_scatter(
            x=search.x[drivable, column], y=known, name="tried", mode="markers",
            marker={"size": 6, "color": VERMILLION}, text=texts[drivable], showlegend=column == 0,
            **where,
        )  # fmt: skip
        if not drivable.all():
            figure.add_scatter(
                x=search.x[~drivable, column], y=np.full(np.sum(~drivable), above), name=left_out,
                mode="markers", hoverinfo="x", showlegend=column == 0,
                marker={"size": 8, "symbol": "x-thin", "line": {"width": 1, "color": GREY}},
                **where,
            )  # fmt: skip
        figure.add_vline(chosen[column], line=the_plan, **where)
        figure.update_xaxes(title=name, **where)
    figure.add_scatter(x=[None], y=[None], name="the plan", mode="lines", line=the_plan)
    if by_decades:
        figure.update_yaxes(type="log")
    figure.update_yaxes(title=cost, row=1, col=1)
    return figure


def _layout(height: int) -> dict[str, object]:
    return {
        "template": "none",
        "height": height,
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "margin": {"l": 70, "r": 20, "t": 30, "b": 50},
        "legend": {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0},
        "hoverlabel": {"bgcolor": "white", "font": {"color": "black"}, "namelength": -1},
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": GREY, "activecolor": BLUE},
        "font": {"family": "system-ui, sans-serif", "size": 13},
    }


def _figure(*, rows: int = 1, height: int = HEIGHT) -> go.Figure:
    figure = make_subplots(rows=rows, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    figure.update_layout(_layout(height))
    clear = {"ticks": "outside", "ticklen": 5, "tickcolor": "rgba(0,0,0,0)"}  # of the other axis
    figure.update_xaxes(showgrid=True, automargin=True, **clear)
    figure.update_yaxes(showgrid=True, automargin=True, **clear)
    return figure


def _in_time(figure: go.Figure) -> go.Figure:
    """Label the lowest axis; hovering shows all curves at that time."""
    figure.update_layout(hovermode="x unified")
    axes = list(figure.select_xaxes())
    axes[-1].update(title="time since the start / s")
    return figure


def _over_time(
    figure: go.Figure, time: FloatArray, x: FloatArray, y: FloatArray, **style: object
) -> None:
    figure.add_scatter(
        x=x,
        y=y,
        customdata=time,
        hovertemplate="%{customdata:.2f} s: %{x:.3f}, %{y:.3f} m",
        **style,
    )


def _line(
    color: str, *, width: float = 1.8, dash: str = "solid", shape: str = "linear"
) -> dict[str, object]:
    return {"color": color, "width": width, "dash": dash, "shape": shape}


def _thinned(*arrays: FloatArray) -> tuple[FloatArray, ...]:
    """Return at most `POINTS` of the values, both ends among them, rounded for display."""
    size = len(arrays[0])
    kept = np.unique(np.linspace(0, size - 1, min(size, POINTS)).round().astype(int))
    return tuple(np.round(array[kept], 6) for array in arrays)
