"""Figures of `tricycle reproduce`, readable in print and by the colour-blind."""

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from excitation_planner.design.problem import Search
from paper_reproduction.comparison import Item
from paper_reproduction.first_stage import Predictions
from paper_reproduction.math_model import Convergence, Table1, Verification
from paper_reproduction.tricycle import (
    NUMBERS,
    TARGETS,
    Bars,
    Costs,
    Screening,
    Trajectories,
)
from tricycle_core.palette import BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILLION

COLORS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE)
MARKERS = ("o", "s", "^", "D", "v")


def draw(item: Item[Any]) -> Figure:
    """Return the figure of an item.

    Parameters
    ----------
    item : Item
        Table or figure, reproduced.
    """
    figure: Figure = _DRAWINGS[item.name](item.data)
    return figure


def _figure(width: float, height: float, rows: int, columns: int) -> tuple[Figure, Any]:
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for one in axes.flat:
        one.grid(alpha=0.3)
        one.set_axisbelow(True)
    return figure, axes


def _table_1(data: Table1) -> Figure:
    figure, ((indices, monte_carlo),) = _figure(10.4, 4.2, 1, 2)
    _index_bars(
        indices,
        ("p1", "p2", "p3", "p4"),
        {
            "S, exact": data.exact.main,
            "S, ours": data.ours.main,
            "ST, exact": data.exact.total,
            "ST, ours": data.ours.total,
        },
    )
    indices.set_title(f"Indices; ours with {data.ours_samples} runs of f")
    exact = data.exact.main[0]
    monte_carlo.errorbar(
        data.samples, np.full(3, exact), data.random_std, fmt="none", color=GREY, capsize=6,
        label="exact ± deviation with random numbers",
    )  # fmt: skip
    monte_carlo.axhline(exact, color="k", linewidth=0.8)
    monte_carlo.plot(data.samples, data.published, "s", color=VERMILLION, label="published")
    monte_carlo.plot(data.samples, data.sobol, "o", color=BLUE, label="ours, one Sobol' sequence")
    monte_carlo.set(
        xscale="log", xlabel="base samples N of Eqs. 7–10", ylabel="S of p1", title="Monte Carlo"
    )
    monte_carlo.legend(fontsize="small")
    return figure


def _index_bars(axes: Axes, names: tuple[str, ...], groups: dict[str, Any]) -> None:
    """Vertical bars, one group per parameter."""
    width = 0.8 / len(groups)
    hatches = ("", "//", "", "//")
    for i, (label, values) in enumerate(groups.items()):
        at = np.arange(len(names)) + (i - (len(groups) - 1) / 2) * width
        color = (BLUE, BLUE, ORANGE, ORANGE)[i % 4]
        axes.bar(at, values, width, label=label, color=color, hatch=hatches[i % 4], edgecolor="w")
    axes.set_xticks(range(len(names)), [name.replace("_", "\n") for name in names])
    axes.set(ylabel="share of the variance", ylim=(0, 1))
    axes.legend(fontsize="small", ncols=2)


def _predictions(data: Predictions) -> Figure:
    figure, ((scatter, errors),) = _figure(10.4, 4.6, 1, 2)
    unit = "" if data.unit == "1" else f" / {data.unit}"
    low = min(float(pair[1].min()) for pair in data.validation.values())
    high = max(float(pair[1].max()) for pair in data.validation.values())
    distances = [np.abs(predicted - true) for predicted, true in data.validation.values()]
    # a few errors are tiny by chance
    smallest = min(float(np.quantile(error, 0.02)) for error in distances)
    bins = np.geomspace(max(smallest, 1e-300), max(float(e.max()) for e in distances), 60).tolist()
    for i, (label, (predicted, true)) in enumerate(data.validation.items()):
        shown = slice(None, None, max(1, len(true) // 1500))
        r2 = data.statistics[label].r2
        scatter.plot(
            true[shown], predicted[shown], MARKERS[i], color=COLORS[i], markersize=3, alpha=0.6,
            label=f"{label}: 1 − R² = {1 - r2:.1e}",
        )  # fmt: skip
        errors.hist(
            np.maximum(np.abs(predicted - true), bins[0]), bins, histtype="step", color=COLORS[i],
            linewidth=1.5, label=f"{label}: RAAE = {data.statistics[label].raae:.1e}",
            linestyle=("-", "--", "-.", ":")[i % 4],
        )  # fmt: skip
    scatter.plot([low, high], [low, high], color="k", linewidth=0.8)
    scatter.set(xlabel=f"simulated{unit}", ylabel=f"predicted{unit}")
    errors.set(
        xlabel=f"|predicted − simulated|{unit}, the smallest gathered at the left",
        ylabel="validation points",
        xscale="log",
    )
    scatter.legend(fontsize="small", markerscale=2)
    errors.set_ylim(top=errors.get_ylim()[1] * (1.1 + 0.08 * len(data.validation)))
    errors.legend(fontsize="small", loc="upper center")
    return figure


def _convergence(data: Convergence) -> Figure:
    figure, ((axes,),) = _figure(7.8, 4.6, 1, 1)
    for i, (label, (runs, errors)) in enumerate(data.curves.items()):
        axes.loglog(runs, errors, marker=MARKERS[i], color=COLORS[i], label=label)
    low, high = data.published_error
    axes.fill_between(
        [data.published_runs, 2 * data.published_runs], low, high, color=ORANGE, alpha=0.6,
        label="published: converged, N > 500 000",
    )  # fmt: skip
    axes.set(xlabel="runs of f, or of its metamodel", ylabel="largest error of an index")
    axes.legend(fontsize="small")
    return figure


def _verification(data: Verification) -> Figure:
    figure, ((history, bars),) = _figure(12.4, 4.8, 1, 2)
    for i, (label, costs) in enumerate(data.histories.items()):
        best = np.minimum.accumulate(np.where(np.isfinite(costs), costs, np.inf))
        history.plot(
            np.arange(1, len(best) + 1), best, color=COLORS[i], label=label,
            linestyle=("-", "--", "-.", ":")[i % 4],
        )  # fmt: skip
    history.set(
        xscale="log",
        xlabel="evaluations of the cost",
        ylabel=f"best H of {data.target} so far",
        title="History: each search by its own indices",
    )
    _log_if_wide(history)
    history.legend(fontsize="small")
    labels = list(data.optima)
    width = 0.8 / len(labels)
    for i, label in enumerate(labels):
        _, indices, cost = data.optima[label]
        at = np.arange(4) + (i - (len(labels) - 1) / 2) * width
        bars.bar(at, indices.total, width, color=COLORS[i], alpha=0.4)
        bars.bar(at, indices.main, width, color=COLORS[i], label=f"{label}: H = {cost:.3f}")
    bars.set_xticks(range(4), ["p1", "p2", "p3", "p4"])
    bars.set(
        ylabel="share of the variance",
        ylim=(0, 1.35),
        title="Exact S (solid), ST (pale) and H without noise at the optima",
    )
    bars.legend(fontsize="small", ncols=2, loc="upper center")
    return figure


def _screening(data: Screening) -> Figure:
    labels = list(data.rows)
    figure, ((axes,),) = _figure(9.6, 0.36 * len(labels) + 1.6, 1, 1)
    at = np.arange(len(labels))
    two = [float(row.main[:2].sum()) for row in data.rows.values()]
    bound = [1 - float(row.total[2:].sum()) for row in data.rows.values()]
    axes.barh(at, [float(r.main[0]) for r in data.rows.values()], 0.7, color=BLUE,
              label="S of cornering stiffness")  # fmt: skip
    axes.barh(at, [float(r.main[1]) for r in data.rows.values()], 0.7, color=ORANGE,
              left=[float(r.main[0]) for r in data.rows.values()],
              label="S of camber stiffness")  # fmt: skip
    axes.barh(at, np.subtract(bound, two), 0.7, left=two, color=GREEN, hatch="//", edgecolor="w",
              label="the two together (interaction)")  # fmt: skip
    axes.barh(at, np.subtract(1, bound), 0.7, left=bound, color=GREY, label="all others, at most")
    axes.set_yticks(at, labels)
    axes.invert_yaxis()
    axes.set(xlim=(0, 1), xlabel="share of the variance of TE")
    _legend_above(figure, axes.get_legend_handles_labels(), columns=2)
    return figure


def _random_and_designed(data: dict[tuple[str, int], Bars]) -> Figure:
    figure, grid = _figure(11.6, 8.4, 2, 2)
    for axes, target in zip(grid, TARGETS, strict=True):
        for one, k in zip(axes, NUMBERS, strict=True):
            _bars(one, data[target, k], target, k)
    _legend_above(figure, grid[0, 0].get_legend_handles_labels(), columns=5)
    return figure


def _bars(axes: Axes, bars: Bars, target: str, k: int) -> None:
    for i, (name, color) in enumerate((("random", ORANGE), ("designed", BLUE))):
        result = bars.indices[name]
        for j, (kind, index, interval) in enumerate(
            (
                ("S", result.main, result.main_interval),
                ("ST", result.total, result.total_interval),
            )
        ):
            at = np.arange(k) + (2 * i + j - 1.5) * 0.2
            spread = np.abs(interval.T - index)
            axes.bar(
                at, index, 0.2, yerr=spread, color=color, alpha=1 - 0.5 * j,
                label=f"{kind}, {name}", error_kw={"linewidth": 0.8},
            )  # fmt: skip
            if name in bars.faithful:
                paper = (bars.faithful[name].main, bars.faithful[name].total)[j]
                label = "the paper's way" if (i, j) == (0, 0) else None
                axes.plot(at, paper, "D", color="k", markersize=4, fillstyle="none", label=label)
    names = [name.replace("_", "\n") for name in bars.names]
    axes.set_xticks(range(k), names, fontsize=7.5 if k > 2 else 9)
    costs = ", ".join(f"{cost:.3g} {name}" for name, cost in bars.costs.items())
    axes.set(ylim=(0, 1), ylabel="share of the variance of TE")
    axes.set_title(f"for {target.replace('_', ' ')}, k = {k}: H = {costs}", fontsize="medium")


def _trajectories(data: dict[tuple[str, str], Trajectories]) -> Figure:
    figure, grid = _figure(12.4, 7.6, 2, 3)
    for row, family in zip(grid, ("circle", "double_lane_change"), strict=True):
        words = family.replace("_", " ")
        for axes, name in zip(row, ("random", "designed"), strict=False):
            drive = data[family, name]
            axes.plot(*drive.soft.T, color=BLUE, label="lowest cornering stiffness")
            axes.plot(*drive.stiff.T, color=VERMILLION, linestyle="--", label="highest")
            if family == "circle":
                axes.set_aspect("equal", adjustable="datalim")
            axes.set(xlabel="x / m", ylabel="y / m", title=f"{words}, {name}")
        axes = row[2]
        for name, color, style in (("random", ORANGE, "--"), ("designed", GREEN, "-")):
            drive = data[family, name]
            axes.plot(drive.time, 100 * drive.distance, color=color, linestyle=style, label=name)
        axes.set(xlabel="time / s", ylabel="distance of the two / cm", title=f"{words}: distance")
        axes.legend(fontsize="small")
    _legend_above(figure, grid[0, 0].get_legend_handles_labels(), columns=2)
    return figure


def _costs(data: Costs) -> Figure:
    figure, grid = _figure(13.2, 8.0, 2, 3)
    x_name, y_name = (f"{name} / {_UNITS[name]}" for name in data.operation.names)
    for row, target in zip(grid, TARGETS, strict=True):
        words = target.replace("_", " ")
        for axes, k in zip(row, NUMBERS, strict=False):
            design = data.designs[target, k, Search.DIRECT]
            asked = [e for e in design.history if np.isfinite(e.cost)]
            lost = [e.x for e in design.history if not np.isfinite(e.cost)]
            drawn = axes.scatter(
                *np.array([e.x for e in asked]).T, c=[e.cost for e in asked],
                norm=_norm([e.cost for e in asked]), cmap="cividis", s=26,
            )  # fmt: skip
            figure.colorbar(drawn, ax=axes, label="H")
            if lost:
                axes.plot(*np.array(lost).T, "x", color=GREY, label="infeasible")
            axes.plot(*design.x, "s", color=VERMILLION, markersize=11, fillstyle="none",
                      markeredgewidth=1.8, label="DIRECT")  # fmt: skip
            axes.plot(*data.designs[target, k, Search.ADAPTIVE].x, "*", color=PURPLE, markersize=13,
                      markeredgecolor="w", label="ours")  # fmt: skip
            if (target, k) in data.faithful:
                points, costs = data.faithful[target, k]
                axes.plot(*points[np.argmin(costs)], "D", color="k", markersize=9,
                          fillstyle="none", label="the paper's way")  # fmt: skip
            axes.set(xlabel=x_name, ylabel=y_name, title=f"{words}, k = {k}")
            _widen(axes, data)
        _history(row[2], data, target, words)
    _legend_above(figure, _all_handles(grid[:, :2]), columns=4)
    return figure


_UNITS = {"radius": "m", "speed": "(m/s)", "d1": "m", "d2": "m"}


def _widen(axes: Axes, data: Costs) -> None:
    """Leave room for markers on the faces of the box."""
    (x_low, y_low), (x_high, y_high) = data.operation.low, data.operation.high
    axes.set_xlim(x_low - 0.05 * (x_high - x_low), x_high + 0.05 * (x_high - x_low))
    axes.set_ylim(y_low - 0.05 * (y_high - y_low), y_high + 0.05 * (y_high - y_low))


def _history(axes: Axes, data: Costs, target: str, words: str) -> None:
    for k, style in zip(NUMBERS, ("--", "-"), strict=True):
        for search, color, label in (
            (Search.DIRECT, VERMILLION, "DIRECT on H"),
            (Search.ADAPTIVE, PURPLE, "ours"),
        ):
            costs = [e.cost for e in data.designs[target, k, search].history]
            axes.plot(
                np.minimum.accumulate(costs),
                color=color,
                linestyle=style,
                label=f"{label}, k = {k}",
            )
        if (target, k) in data.faithful:
            costs = data.faithful[target, k][1].tolist()
            axes.plot(
                np.minimum.accumulate(costs), color="k", linestyle=style,
                label=f"DIRECT, the paper's way, k = {k}",
            )  # fmt: skip
    axes.set(xlabel="evaluations", ylabel="best H so far", title=f"for {words}")
    _log_if_wide(axes)
    axes.legend(fontsize="x-small")


def _norm(values: list[float]) -> Normalize:
    """Colours by the logarithm where the values span more than a factor of ten."""
    wide = max(values) > 10 * min(values)
    return LogNorm(min(values), max(values)) if wide else Normalize(min(values), max(values))


def _log_if_wide(axes: Axes) -> None:
    """Logarithmic ordinate where the curves span more than a factor of ten."""
    drawn = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in axes.lines])
    drawn = drawn[np.isfinite(drawn)]
    if drawn.max() > 10 * drawn.min():
        axes.set_yscale("log")


def _legend_above(figure: Figure, entries: tuple[list[Any], list[str]], columns: int) -> None:
    """Legend above all axes; Matplotlib 3.6, that of ROS 2 Jazzy's Ubuntu, has no "outside"."""
    legend = figure.legend(*entries, loc="upper center", ncols=columns, fontsize="small")
    height = legend.get_window_extent().height / figure.bbox.height
    figure.set_layout_engine("constrained", rect=(0.0, 0.0, 1.0, 0.99 - height))


def _all_handles(grid: Any) -> tuple[list[Any], list[str]]:
    """Legend entries of all axes, each label once."""
    found: dict[str, Any] = {}
    for axes in grid.flat:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    return list(found.values()), list(found)


_DRAWINGS: dict[str, Callable[[Any], Figure]] = {
    "table1": _table_1,
    "fig5": _predictions,
    "fig6": _convergence,
    "fig8": _verification,
    "fig9": _verification,
    "screening": _screening,
    "fig13": _predictions,
    "fig14": _random_and_designed,
    "fig15": _random_and_designed,
    "fig16": _trajectories,
    "fig17": _costs,
    "fig18": _costs,
}
