"""Tables for the terminal, and the numbers in them that pages show too."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from excitation_planner.design.prior import UNIFORM_STD
from excitation_planner.trajectory_error import POINTS
from parameter_identification.judging.judgement import Anchor, Judgement
from tricycle_cli.console import plain_console
from tricycle_core.quantities import with_deviation

if TYPE_CHECKING:
    from excitation_planner.plan import Plan
    from parameter_identification.estimation.population import Interval, Population
    from parameter_identification.estimation.results import IdentifiedParameters
    from parameter_identification.fleet import Fleet
    from parameter_identification.identification import Estimate, Identification
    from parameter_identification.identification_file import ParameterEntry
    from parameter_identification.many_drives import ManyDrives

HEADINGS = ("parameter", "unit", "range", "estimate ± 1σ", "interval", "truth")
"""Headings of the table of identified parameters."""

NARROWEST = 80
"""Characters of a table: in a narrower terminal its lines are folded, but its numbers are whole."""

WIDEST = 100_000
"""Characters of a table with a column per bag: it takes as many as its cells need."""

MOST_MEMBERS = 12  # of a list that are printed
MONTH = 30.0  # days, for which changes are shown


def table_console(*, stderr: bool = False, width: int = NARROWEST) -> Console:
    """Return what prints tables without cutting their cells.

    Parameters
    ----------
    stderr : bool
        Whether it prints there.
    width : int
        Least width [characters].
    """
    console = plain_console(stderr=stderr, highlight=False)
    console.width = max(console.width, width)
    return console


def plan_table(plan: Plan) -> Table:
    """Return the Sobol' indices of a plan, a row per unknown parameter.

    Parameters
    ----------
    plan : Plan
        Plan to show.
    """
    values = ", ".join(f"{name} = {value:.4g}" for name, value in plan.operation.items())
    title = f"{plan.maneuver} for {plan.target}: {values}"
    table = Table(title=title, box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("unknown parameter", no_wrap=True)
    for heading in ("S", "95 %", "ST", "95 %"):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, main in plan.main.items():
        total = plan.total[name]
        table.add_row(
            name,
            f"{main.value:.4f}",
            f"{main.low:.3f} … {main.high:.3f}",
            f"{total.value:.4f}",
            f"{total.low:.3f} … {total.high:.3f}",
            style="bold" if name == plan.target else None,
        )
    return table


def prediction_table(plan: Plan) -> Table:
    """Return how well each parameter will be known after all drives of the plan's set.

    Parameters
    ----------
    plan : Plan
        Any plan of the set, with `predicted_std`.
    """
    drives = "the drive" if plan.drives == 1 else f"the {plan.drives} drives"
    table = Table(title=f"expected after {drives}", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("unknown parameter", no_wrap=True)
    for heading in ("1σ", "of the range", "of the prior 1σ"):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, std in plan.predicted_std.items():
        low, high = plan.unknown[name]
        share = std / (high - low)
        table.add_row(name, f"{std:.3g}", f"{share:.1%}", f"{share / UNIFORM_STD:.0%}")
    return table


def drives_table(
    target: str,
    plans: Mapping[str, Plan],
    expected: Mapping[str, float],
    judgements: Mapping[str, Judgement],
) -> Table:
    """Return what was planned and what was measured, a row per maneuver.

    Parameters
    ----------
    target : str
        Unknown parameter that was to be excited.
    plans : mapping of str to Plan
        Plan of each maneuver.
    expected : mapping of str to float
        Trajectory error of the model with the true parameters [m²].
    judgements : mapping of str to Judgement
        Judgement of each drive.
    """
    table = Table(title=f"exciting {target}, TE in m²", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("maneuver", no_wrap=True)
    for heading in ("S", "ST", "H", "TE expected", "TE measured", "less noise", "rms/mm"):
        table.add_column(heading, justify="right", min_width=8 if heading[:2] == "TE" else None)
    for name, plan in plans.items():
        judgement = judgements[name]
        values = "\n".join(f"{key} {value:.3f}" for key, value in plan.operation.items())
        table.add_row(
            f"{name}\n{values}",
            f"{plan.main[target].value:.3f}",
            f"{plan.total[target].value:.3f}",
            f"{plan.cost:.3f}",
            f"{expected[name]:.5f}",
            f"{judgement.te:.5f}",
            f"{judgement.te_corrected:.5f}",
            f"{1e3 * judgement.rms:.1f}",
        )
    return table


def judgement_table(judgements: Sequence[Judgement]) -> Table:
    """Return the trajectory errors of drives, a column per bag.

    Parameters
    ----------
    judgements : sequence of Judgement
        Judgements to show.
    """
    table = Table("", *(judgement.bag.name for judgement in judgements))
    for column in table.columns[1:]:
        column.justify, column.no_wrap = "right", True

    def add(label: str, value: Callable[[Judgement], str]) -> None:
        table.add_row(label, *map(value, judgements))

    add("TE / m²", lambda j: f"{j.te:.5g}" + f" ± {j.te_deviation:.1g}" * (j.te_deviation > 0))
    add("TE less noise / m²", lambda j: f"{j.te_corrected:.5g}")
    add("rms distance / mm", lambda j: f"{1e3 * j.rms:.1f}")
    add("largest distance / mm", lambda j: f"{1e3 * j.max:.1f}")
    add("rms along, across / mm", lambda j: f"{1e3 * j.rms_along:.1f}, {1e3 * j.rms_cross:.1f}")
    add("rms in x, y / mm", lambda j: f"{1e3 * j.rms_x:.1f}, {1e3 * j.rms_y:.1f}")
    add("rms heading / °", lambda j: f"{math.degrees(j.rms_heading):.2f}")
    add("lag, not applied / ms", lambda j: _milliseconds(j.time_offset, j.time_offset_deviation))
    add("position noise / mm", lambda j: f"{1e3 * j.noise:.1f}")
    add("duration / s, points", lambda j: f"{j.duration:.2f}, {POINTS}")
    add("anchor", lambda j: j.anchor.value)
    add(
        "anchor / m, m, °",
        lambda j: (
            f"{j.anchor_pose.x:.3f}, {j.anchor_pose.y:.3f}, "
            f"{math.degrees(j.anchor_pose.heading):.2f}"
        ),
    )
    for anchor in Anchor:
        values = (f"{judgement.te_by_anchor[anchor]:.5g}" for judgement in judgements)
        table.add_row(f"TE at anchor {anchor.value} / m²", *values)
    return table


def parameter_rows(
    found: IdentifiedParameters, truth: Mapping[str, float] | None = None
) -> list[tuple[str, ...]]:
    """Return the cells of the table of parameters, under `HEADINGS`.

    Parameters
    ----------
    found : IdentifiedParameters
        Result of an identification.
    truth : mapping of str to float, optional
        Hidden true values where they are known; default: those that the bags hold.
    """
    known = found.truth if truth is None else truth
    return [
        (
            name,
            "" if e.unit == "1" else e.unit,
            f"{e.range[0]:.4g} – {e.range[1]:.4g}",
            with_deviation(e.estimate, e.standard_deviation) if e.identifiable else "not shown",
            f"{_short(e.low)} – {_short(e.high)}",
            shown_truth(e, known[name]) if name in known else "",
        )
        for name, e in found.parameters.items()
    ]


def shown_truth(found: Estimate | ParameterEntry, value: float) -> str:
    """Return a true value as text, and whether the interval of its estimate holds it.

    Parameters
    ----------
    found : Estimate or ParameterEntry
        Estimate with its interval.
    value : float
        True value.
    """
    return f"{value:.4g} {'✓' if found.low <= value <= found.high else '✗'}"


def _short(value: float) -> str:
    """Three digits, but no exponent for thousands."""
    return f"{value:.3g}" if abs(value) < 999.5 else f"{value:.4g}"


def parameter_table(
    found: Identification | ManyDrives, truth: Mapping[str, float] | None = None
) -> Table:
    """Return the table of parameters, with the hidden truth beside the estimates where it is known.

    Parameters
    ----------
    found : Identification or ManyDrives
        Result of an identification.
    truth : mapping of str to float, optional
        Hidden true values; default: those that the bags hold.
    """
    rows = parameter_rows(found, truth)
    # with SciPy, which judging does without
    from parameter_identification.identified_vehicle import named_drives

    title = f"identified from {named_drives(found)}; {100 * found.level:g} % intervals"
    table = Table(title=title, box=SIMPLE_HEAD, pad_edge=False, padding=0)
    table.add_column("parameter, range", no_wrap=True)  # below each other: it fits 80 columns
    for heading in ("estimate ± 1σ", "interval", "truth" if any(row[-1] for row in rows) else ""):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, unit, span, *cells in rows:
        table.add_row(f"{name}\n  {span} {unit}", *cells)
    return table


def population_table(fleet: Fleet) -> Table:
    """Return a table of shared values, populations, and each vehicle's values in them.

    Parameters
    ----------
    fleet : Fleet
        Result of `identify_fleet`.
    """
    title = f"{len(fleet.vehicles)} vehicles, {fleet.drives} drives; {fleet.level:.0%} intervals"
    table = Table(title=title, box=SIMPLE_HEAD, pad_edge=False, padding=0)
    table.add_column("parameter, vehicle", no_wrap=True)
    for heading in ("value", "interval", "from the others / σ"):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, e in fleet.shared.items():
        ends = f"{_short(e.low)} – {_short(e.high)}" if e.identifiable else "not shown"
        table.add_row(f"{name}: all vehicles", f"{e.estimate:.4g}", ends, "")
    for name, found in fleet.populations.items():
        _add_population(table, name, found, 1.0)
        if name in fleet.changes:
            _add_population(table, f"{name}, in {MONTH:.0f} days", fleet.changes[name], MONTH)
    return table


def _add_population(table: Table, name: str, found: Population, factor: float) -> None:
    def row(label: str, interval: Interval, far: str) -> None:
        shown = interval.scaled(factor)
        table.add_row(label, f"{shown.middle:.4g}", shown_interval(shown), far)

    row(f"{name}: mean", found.mean, "")
    row(f"{name}: spread", found.spread, "")
    farthest = sorted(found.members, key=lambda m: -abs(m.distance))
    for m in farthest[:MOST_MEMBERS]:
        row(f"  {m.vehicle}", m.value, f"{m.distance:+.1f}" + " ODD" * m.odd)
    if len(farthest) > MOST_MEMBERS:
        table.add_row(f"  {len(farthest) - MOST_MEMBERS} that are closer", "", "", "")


def shown_interval(interval: Interval | Estimate) -> str:
    """Return the ends of an interval as text.

    Parameters
    ----------
    interval : Interval or Estimate
        Interval of a population, a member or a vehicle.
    """
    return f"{_short(interval.low)} – {_short(interval.high)}"


def _milliseconds(seconds: float, deviation: float) -> str:
    if math.isnan(seconds):
        return "unknown"
    return f"{1e3 * seconds:.1f} ± {1e3 * deviation:.1f}"
