"""Results of a fleet's identification as one HTML page: outliers first."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from markupsafe import Markup

from parameter_identification.estimation.intervals import half_width
from parameter_identification.estimation.population import Member, Population
from parameter_identification.fleet import DAY, Course, Fleet, course
from tricycle_cli.reports.html_page import FigureBlock, Section, TableBlock, html_page
from tricycle_cli.reports.remarks import remarks_on_fleet
from tricycle_cli.reports.static_figures import MOST_VEHICLES, fleet_figure
from tricycle_cli.reports.tables import MONTH, shown_interval
from tricycle_core.documents import replacing, write_whole
from tricycle_core.quantities import FloatArray, with_deviation

REPORT, DOCUMENT, FIGURE = FILES = "report.html", "fleet.json", "fleet.png"
"""Names of the files that `save_fleet` writes."""
WIDTH, HEIGHT, EDGE = 128, 36, 3  # of a sparkline, in its own units
AHEAD = (
    4.0  # spreads of the population, or deviations of a vehicle, that a sparkline shows at least
)


def fleet_page(fleet: Fleet) -> str:
    """Return the page as the text of one HTML file.

    Parameters
    ----------
    fleet : Fleet
        Result of `identify_fleet`.
    """
    first, last = _span(fleet)
    sections = [
        Section("Odd vehicles", (_outliers(fleet),)),
        Section("Population", (_populations(fleet), *_figure(fleet))),
        Section("Vehicles", (*_legend(fleet), _vehicles(fleet))),
    ]
    if remarks := remarks_on_fleet(fleet):
        sections.append(Section("Remarks", tuple(remarks)))
    return html_page(
        f"{len(fleet.vehicles)} vehicles",
        sections,
        subtitle=f"{fleet.drives} drives in {_days(last - first)} days, "
        f"from {_date(first)} to {_date(last)}; {fleet.level:.0%} intervals",
    )


def _days(seconds: float) -> str:
    days = seconds / DAY
    return f"{days:.0f}" if days >= 10.0 else f"{days:.3g}"


def _date(time: float) -> str:
    return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%d")


def _span(fleet: Fleet) -> tuple[float, float]:
    times = [share.began for found in fleet.vehicles.values() for share in found.drives]
    return min(times), max(times)


def _units(fleet: Fleet) -> dict[str, str]:
    found = next(iter(fleet.vehicles.values())).parameters
    return {name: e.unit for name, e in found.items()}


def _outliers(fleet: Fleet) -> TableBlock | str:
    units = _units(fleet)
    rows = []
    for name, rate, m in fleet.outliers:
        found = (fleet.changes if rate else fleet.populations)[name]
        factor = MONTH if rate else 1.0
        own = with_deviation(factor * m.own, factor * m.deviation)
        others = f"{factor * found.mean.middle:.4g}, spread {factor * found.spread.middle:.2g}"
        what = f"change of {name} per {MONTH:.0f} days" if rate else name
        unit = "" if units[name] == "1" else units[name]
        rows.append((m.vehicle, what, own, others, unit, f"{m.distance:+.1f} ✗"))
    if not rows:
        return "None: no vehicle that is compared is farther away than chance lets expect."
    headings = (
        "vehicle",
        "parameter",
        "from its drives",
        "the others",
        "unit",
        "distance / σ",
    )
    return TableBlock(headings, tuple(rows))


def _populations(fleet: Fleet) -> TableBlock:
    rows = []
    for name, unit in _units(fleet).items():
        shown = "" if unit == "1" else unit
        if name in fleet.shared:
            e = fleet.shared[name]
            value = f"{e.estimate:.4g} ({shown_interval(e)})" if e.identifiable else "not shown"
            rows.append((name, shown, "same in all", value, "", "", ""))
        elif name in fleet.own:
            rows.append((name, shown, "each its own", "", "", "", ""))
        elif name in fleet.populations:
            change = (
                _of_population(fleet.changes[name], MONTH) if name in fleet.changes else ("", "")
            )
            both = _of_population(fleet.populations[name], 1.0)
            shows = len(fleet.populations[name].members)
            rows.append((name, shown, f"population of {shows}", *both, *change))
        else:
            rows.append((name, shown, "too few show it", "", "", "", ""))
    headings = ("parameter", "unit", "", "mean", "spread")
    more = (f"change per {MONTH:.0f} days", "its spread")
    if fleet.changes:
        caption = f"those that change: on {_date(fleet.when)}, the middle of the drives"
        return TableBlock((*headings, *more), tuple(rows), caption)
    return TableBlock(headings, tuple(row[:-2] for row in rows))


def _of_population(found: Population, factor: float) -> tuple[str, str]:
    mean, spread = (i.scaled(factor) for i in (found.mean, found.spread))
    return (
        f"{mean.middle:.4g} ({shown_interval(mean)})",
        f"{spread.middle:.4g} ({shown_interval(spread)})",
    )


def _figure(fleet: Fleet) -> tuple[FigureBlock, ...]:
    if not fleet.populations:
        return ()
    farthest = "" if len(fleet.vehicles) <= MOST_VEHICLES else f"the {MOST_VEHICLES} farthest; "
    caption = (
        f"vehicles in their population, the oddest on top; {farthest}grey: its own drives alone"
    )
    return (FigureBlock.of(fleet_figure(fleet), alt="vehicles and population", caption=caption),)


# ---- the vehicles ----


def _legend(fleet: Fleet) -> tuple[str, ...]:
    rate = "; dashed: level and change" if fleet.changes else ""
    return (
        "Each dot: what one drive says of the parameter, the others being those of all drives of "
        "the vehicle, with its interval, over the time of all drives; band: mean and spread of the "
        f"population{rate}. Below: value and interval, with what the other vehicles tell. A column "
        "has the same scale in all rows.",
    )


def _vehicles(fleet: Fleet) -> TableBlock:
    names = list(_units(fleet))
    span = _span(fleet)
    courses = {v: {p: course(found, p) for p in names} for v, found in fleet.vehicles.items()}
    usual = [v for v in courses if v not in (*fleet.beyond, *fleet.odd)] or list(courses)
    scales = {p: _scale(fleet, p, [courses[v][p] for v in usual]) for p in names}
    members = {p: {m.vehicle: m for m in found.members} for p, found in fleet.populations.items()}
    changes = {p: {m.vehicle: m for m in found.members} for p, found in fleet.changes.items()}
    rows = []
    for vehicle in _oddest_first(fleet):
        cells: list[str] = []
        for p in names:
            member, change = (of.get(p, {}).get(vehicle) for of in (members, changes))
            picture = _sparkline(fleet, p, courses[vehicle][p], span, scales[p], member, change)
            odd = any(m is not None and m.odd for m in (member, change))
            text = _value(fleet, vehicle, p, member, change)
            cells.append(picture + Markup("<small>{}</small>").format(text) + (" ✗" if odd else ""))
        rows.append((vehicle, str(len(fleet.vehicles[vehicle].drives)), *cells))
    headings = tuple(p.replace("_", " ") for p in names)
    return TableBlock(("vehicle", "drives", *headings), tuple(rows))


def _oddest_first(fleet: Fleet) -> list[str]:
    first = [*fleet.beyond, *fleet.odd]
    farthest = dict.fromkeys(fleet.vehicles, 0.0)
    for found in (*fleet.populations.values(), *fleet.changes.values()):
        for m in found.members:
            farthest[m.vehicle] = max(farthest[m.vehicle], abs(m.distance))
    return first + sorted(set(farthest) - set(first), key=lambda vehicle: -farthest[vehicle])


def _value(
    fleet: Fleet, vehicle: str, parameter: str, member: Member | None, change: Member | None
) -> Markup:
    e = fleet.vehicles[vehicle].parameters[parameter]
    lines = ["not shown"]
    if parameter in fleet.shared:
        lines = ["as in all"]
    elif member is not None:
        lines = [f"{member.value.middle:.4g}", shown_interval(member.value)]
    elif e.identifiable:
        lines = [f"{e.estimate:.4g}", shown_interval(e)]
    if change is not None:
        lines.append(f"{MONTH * change.value.middle:+.2g} in {MONTH:.0f} d")
    return Markup("<br>").join(lines)


def _scale(fleet: Fleet, parameter: str, courses: list[Course]) -> tuple[float, float]:
    """Values at the bottom and top of a column of sparklines."""
    values = np.concatenate([c.values for c in courses])
    deviation = float(np.median(np.concatenate([c.deviations for c in courses])))
    low, high = np.quantile(values, [0.02, 0.98])
    found = fleet.populations.get(parameter)
    if found is not None:
        reach = AHEAD * found.spread.middle
        low, high = min(low, found.mean.middle - reach), max(high, found.mean.middle + reach)
    low, high = low - deviation, high + deviation
    least, most = next(iter(fleet.vehicles.values())).parameters[parameter].range
    wide = (
        most - least
    )  # a parameter that the drives do not show has estimates far beyond its range
    return max(float(low), least - 0.2 * wide), min(float(high), most + 0.2 * wide)


def _sparkline(
    fleet: Fleet,
    parameter: str,
    seen: Course,
    span: tuple[float, float],
    scale: tuple[float, float],
    member: Member | None,
    change: Member | None,
) -> Markup:
    """Estimates over time as a small SVG; what is beyond the scale ends at its edge."""

    def across(times: FloatArray) -> FloatArray:
        if span[1] > span[0]:
            share = (times - span[0]) / (span[1] - span[0])
        else:
            share = (np.arange(len(times)) + 0.5) / len(times)
        return np.asarray(EDGE + (WIDTH - 2 * EDGE) * share)

    def down(values: FloatArray) -> FloatArray:
        share = np.clip((values - scale[0]) / (scale[1] - scale[0]), 0.0, 1.0)
        return np.asarray(HEIGHT - EDGE - (HEIGHT - 2 * EDGE) * share)

    half = half_width(fleet.level) * seen.deviations
    x, y = across(seen.times), down(seen.values)
    ends = zip(x, down(seen.values - half), down(seen.values + half), strict=True)
    bars = "".join(f"M{a:.0f} {low:.1f}V{high:.1f}" for a, low, high in ends)
    dots = "".join(f"M{a:.0f} {b:.1f}h0" for a, b in zip(x, y, strict=True))
    inside = ""
    if parameter in fleet.populations:
        population = fleet.populations[parameter]
        top, bottom = down(
            population.mean.middle + population.spread.middle * np.array([1.0, -1.0])
        )
        inside = f'<rect y="{top:.1f}" width="{WIDTH}" height="{max(bottom - top, 0.5):.1f}"/>'
    inside += f'<path d="{bars}"/>'
    if member is not None and change is not None and span[1] > span[0]:
        days = (np.array(span) - fleet.when) / DAY
        (a, b), (c, d) = (
            across(np.array(span)),
            down(member.value.middle + change.value.middle * days),
        )
        inside += f'<path class="line" d="M{a:.0f} {c:.1f}L{b:.0f} {d:.1f}"/>'
    inside += f'<path class="dot" d="{dots}"/>'
    return Markup(  # noqa: S704 - numbers only
        f'<svg class="spark" viewBox="0 0 {WIDTH} {HEIGHT}" preserveAspectRatio="none" '
        f'aria-hidden="true">{inside}</svg>'
    )


def save_fleet(fleet: Fleet, document: str, folder: Path) -> None:
    """Write `report.html`, `fleet.json` and `fleet.png`.

    Parameters
    ----------
    fleet : Fleet
        Result of `identify_fleet`.
    document : str
        Content of `fleet.json`.
    folder : Path
        Folder of the files; made if it is missing.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / REPORT, fleet_page(fleet))
    write_whole(folder / DOCUMENT, document + "\n")
    with replacing(folder / FIGURE) as file:
        fleet_figure(fleet).savefig(file, dpi=150)
