"""Tables for the terminal, and the numbers in them that pages show too."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from excitation_planner.trajectory_error import POINTS
from parameter_identification.drives.measured import Input
from parameter_identification.estimation.intervals import with_deviation
from parameter_identification.judging.judgement import Anchor, Judgement
from tricycle_cli.console import plain_console
from tricycle_sim.effects import TYRE_ROUNDING

if TYPE_CHECKING:
    from excitation_planner.plan import Plan
    from parameter_identification.estimation.population import Interval, Population
    from parameter_identification.fleet import Fleet
    from parameter_identification.identification import Estimate, HeldOut, Identification
    from parameter_identification.many_drives import ManyDrives

HEADINGS = ("parameter", "unit", "range", "estimate ± 1σ", "interval", "truth")
"""Of the table of identified parameters."""

NARROWEST = 80
"""Characters of a table: in a narrower terminal its lines are folded, but its numbers are whole."""

WIDEST = 100_000
"""Characters of a table with a column per bag: it takes as many as its cells need."""

MOST_MEMBERS = 12  # of a list that are printed
MONTH = 30.0  # days, for which changes are shown
WORSE = 1.2
"""Error of a prediction, over that of the vehicle file, from which it is told."""

IMPROBABLE = 0.05
"""Probability of an effect below which the remarks only count it."""

FAR = 3.0  # standard deviations of an effect's prior beyond which its size is told as unexpected

OFTEN_OUTSIDE = 0.15  # of a drive more than expected: its samples err together

MUCH_FRICTION = 0.5
"""Share of a tyre's friction above which its stiffness depends on the law that it is given."""


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
        What to show.
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
        table.add_row(name, f"{std:.3g}", f"{share:.1%}", f"{share * math.sqrt(12.0):.0%}")
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
        What to show.
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
    found: Identification | ManyDrives, truth: Mapping[str, float] | None = None
) -> list[tuple[str, ...]]:
    """Return the cells of the table of parameters, under `HEADINGS`.

    Parameters
    ----------
    found : Identification or ManyDrives
        What was identified.
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
            _truth(e, known[name]) if name in known else "",
        )
        for name, e in found.parameters.items()
    ]


def _truth(e: Estimate, value: float) -> str:
    return f"{value:.4g} {'✓' if e.low <= value <= e.high else '✗'}"


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
        What was identified.
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


def remarks(found: Identification) -> list[str]:
    """Return what a reader must know besides the table, a line each.

    Parameters
    ----------
    found : Identification
        What `identify` found.
    """
    from parameter_identification.identified_vehicle import kind_of_drives

    drives = kind_of_drives(found)
    lines = [
        f"not shown by these {drives}: {combination} "
        f"(1σ is {combination.remaining:.0%} of the prior 1σ)"
        for combination in found.hidden
    ]
    if found.fixed:
        fixed = ", ".join(f"{name} {value:.4g}" for name, value in found.fixed.items())
        lines.append(f"taken as known: {fixed}. An error in them is in no interval")
    if Input.STEERING in found.measured:
        lines.append("the steering moved as measured, not as the file's servo by its commands")
    if Input.SPEED in found.measured:
        lines.append(
            "the wheels turned as measured, not as the file's speed loop by its commands; their "
            "speed tells nothing else"
        )
    lines += _not_asked_for(found)
    ends = {
        name: e
        for name, e in (*found.parameters.items(), *found.others.items())
        if min(abs(e.estimate - end) for end in e.range) <= 1e-9 * (e.range[1] - e.range[0])
    }
    if not any(found.identifiable.values()):
        cure = "the model contradicts them" if ends else "drive longer, or other maneuvers"
        lines.append(f"these {drives} show none of the parameters: {cure}")
    if ends:
        lines.append(
            f"at an end of the range: {', '.join(ends)}. Widen it in the vehicle file, or the "
            "model lacks something"
        )
    if contradicted := [name for name, e in ends.items() if (e.low, e.high) == e.range]:
        lines.append(f"the {drives} contradict the range: {', '.join(contradicted)}; so not shown")
    if not found.white:
        lines.append(
            f"residuals are NOT white ({_least_white(found)}): "
            "the model lacks an effect or a sensor drifts. "
            "The intervals count it as drifting noise; they do not cover a wrong model"
        )
    lines += _contradictions(found, drives)
    if found.missed:
        lines.append(
            f"one of the {drives} is {1e3 * found.missed:.1f} mm (rms) farther than expected from "
            "where the others predict it: the model lacks something. The intervals count how the "
            "estimates change without each of them, and as much again for what errs alike in all"
        )
    if found.deviations:
        names = ", ".join(effect.name for effect in found.deviations)
        lines.append(
            f"the vehicle moves as the model CANNOT ({names}): it has something that no effect "
            "stands for, as tyres that slide or play in the steering. The intervals do not count it"
        )
    counted = any(effect.name == TYRE_ROUNDING for effect in found.effects)
    if found.friction_used > MUCH_FRICTION and not counted:
        lines.append(
            f"a tyre used up to {found.friction_used:.0%} of its friction: stiffnesses are those "
            "of the vehicle file's tyre law. A tyre that bends otherwise may be stiffer at small "
            "slips; the intervals do not count it"
        )
    absent = [e for e in found.effects if e.acts is not None and e.acts < IMPROBABLE]
    lines += [f"effect: {effect}" for effect in found.effects if effect not in absent]
    if held := [e.name for e in found.effects if e.at_an_end]:
        lines.append(
            f"at an end of what is taken for possible: {', '.join(held)}. Correct the constant in "
            "the vehicle file and identify with --other-vehicle, or the model lacks something"
        )
    if far := [e.name for e in found.effects if abs(e.estimate) > FAR * e.prior]:
        lines.append(
            f"farther from the vehicle file than expected: {', '.join(far)}. Measure it, correct "
            "the file and identify with --other-vehicle, or the model lacks something"
        )
    if absent:
        lines.append(
            f"effects: {len(absent)} others, each with a probability below {IMPROBABLE:.0%} "
            "(identification.json)"
        )
    if found.rivals:
        lines.append(
            f"{len(found.rivals)} other set(s) of parameters fit as well; intervals hold them too"
        )
    if found.outliers:
        lines.append(
            f"{found.outliers} samples lie beyond 6 standard deviations: outliers, which count "
            "less with --robust, or what the model lacks"
        )
    return lines + [_remark_on_held_out(held, found.level) for held in found.held_out]


def _least_white(found: Identification) -> str:
    """How many residuals are not white, and which is the farthest from it."""
    coloured = found.coloured
    worst = max(coloured, key=lambda test: test.statistic / test.lags)
    count = f"{len(coloured)} of {len(found.whiteness)}"
    if len(coloured) == 1:
        return f"{count}: {worst.drive} {worst.channel}"
    return f"{count}, least of all {worst.drive} {worst.channel}; all: identification.json"


def _contradictions(found: Identification | ManyDrives, drives: str) -> list[str]:
    """A line where drives disagree."""
    from parameter_identification.estimation.doubt import CONTRADICTING, SCATTER

    if not found.scatter > CONTRADICTING:
        return []
    alike = "and as much again for" if len(found.drives) < SCATTER else "not"
    return [
        f"the {drives} contradict each other: they scatter up to {found.scatter:.1f} times as "
        f"much as their noise. The intervals count the scatter, {alike} what errs alike in all"
    ]


def _some(names: Sequence[str]) -> str:
    """The first names, and whether there are more."""
    more = ", …" if len(names) > MOST_MEMBERS else ""
    return f"{', '.join(names[:MOST_MEMBERS])}{more}"


def _not_asked_for(found: Identification | ManyDrives) -> list[str]:
    if not found.others:
        return []
    names = ", ".join(found.others)
    return [f"not asked for, but counted as unknown: {names} (--hold-others takes them as known)"]


def _remark_on_held_out(held: HeldOut, level: float) -> str:
    band = ""
    if held.expected is not None and held.inside is not None:
        band = (
            f"; expected {1e3 * held.expected:.1f} mm, inside its {level:.0%} band for "
            f"{held.inside:.0%} of the samples"
        )
        if held.inside < level - OFTEN_OUTSIDE:
            band += "; it is OUTSIDE: this vehicle moves as the model CANNOT"
    if held.rms_estimated > WORSE * held.rms_nominal:
        band += "; WORSE than by the vehicle file"
    return (
        f"{held.name}, not used: predicted to {1e3 * held.rms_estimated:.1f} mm (rms; before "
        f"{1e3 * held.rms_nominal:.1f} mm, noise and drift alone {1e3 * held.noise:.1f} mm{band})"
    )


def remarks_on_many(found: ManyDrives) -> list[str]:
    """Return what a reader must know besides the table, a line each.

    Parameters
    ----------
    found : ManyDrives
        What `identify_many` found.
    """
    hidden = [name for name, e in found.parameters.items() if not e.identifiable]
    lines = [f"not shown by these drives: {', '.join(hidden)}"] if hidden else []
    lines += _not_asked_for(found)
    if not found.white:
        lines.append(
            f"residuals of {found.not_white} of {len(found.drives)} drives are NOT white: the "
            "model lacks an effect or a sensor drifts. More drives do not mend that"
        )
    lines += _contradictions(found, "drives")
    lines += [f"effect: {effect}" for effect in found.effects]
    lines += _not_whole([drive.name for drive in found.drives if not drive.complete])
    lines += [f"left out: {reason}" for reason in found.left_out]
    return lines


def _not_whole(drives: Sequence[str]) -> list[str]:
    if not drives:
        return []
    return [
        f"bags that are not whole (cut off before the drive's end, or a file or messages are "
        f"missing), used as far as they go: {len(drives)} ({_some(drives)})"
    ]


def population_table(fleet: Fleet) -> Table:
    """Return what is shared, the populations, and what each vehicle is in them.

    Parameters
    ----------
    fleet : Fleet
        What `identify_fleet` found.
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
        Of a population, a member or a vehicle.
    """
    return f"{_short(interval.low)} – {_short(interval.high)}"


def remarks_on_fleet(fleet: Fleet) -> list[str]:
    """Return what a reader must know besides the table, a line each, outliers first.

    Parameters
    ----------
    fleet : Fleet
        What `identify_fleet` found.
    """
    from parameter_identification.many_drives import few_coloured

    lines = []
    for name in fleet.odd:
        where = ", ".join(
            f"{'the change of ' * rate}{parameter} ({m.distance:+.1f} σ)"
            for parameter, rate, m in fleet.outliers
            if m.vehicle == name
        )
        lines.append(f"{name} is odd: far from what the others let expect in {where}")
    parameters = next(iter(fleet.vehicles.values())).parameters
    known = {*fleet.populations, *fleet.shared, *fleet.own}
    lines += [f"{name}: too few vehicles show it" for name in parameters if name not in known]
    coloured = [
        f"{name} ({found.not_white} of {len(found.drives)} drives)"
        for name, found in fleet.vehicles.items()
        if not found.white
    ]
    if coloured:
        lines.append(
            f"residuals of {len(coloured)} vehicles are NOT white: the model lacks something, or a "
            f"parameter changes from drive to drive: {_some(coloured)}"
        )
    # a vehicle with few drives cannot show it alone
    if not coloured and not few_coloured(fleet.not_white, fleet.drives):
        lines.append(
            f"residuals of {fleet.not_white} of all {fleet.drives} drives are NOT white: the model "
            "lacks something, or vehicles differ in what they are said to share"
        )
    lines += _not_whole(
        [
            f"{name}/{drive.name}"
            for name, found in fleet.vehicles.items()
            for drive in found.drives
            if not drive.complete
        ]
    )
    return lines + [f"left out: {reason}" for reason in fleet.left_out]


def _milliseconds(seconds: float, deviation: float) -> str:
    if math.isnan(seconds):
        return "unknown"
    return f"{1e3 * seconds:.1f} ± {1e3 * deviation:.1f}"
