"""The report of a run: one HTML page, the table first, then figures to zoom into."""

from collections.abc import Callable

from excitation_planner.plan import Plan
from parameter_identification.identification_file import IdentificationDocument
from tricycle_cli.reports import interactive_figures as figures
from tricycle_cli.reports.html_page import PlotBlock, Section, TableBlock, html_page
from tricycle_cli.reports.run_folder import Maneuver, Run, wheel_loads
from tricycle_core.errors import PlanError
from tricycle_core.quantities import Progress
from tricycle_sim.vehicle import Vehicle

Block = str | TableBlock | PlotBlock


def run_page(run: Run, *, vehicle: Vehicle, progress: Progress | None = None) -> str:
    """Return the report of a run as the text of an HTML file.

    Parameters
    ----------
    run : Run
        What to show.
    vehicle : Vehicle
        For the wheel loads of plans that were made for it.
    progress : callable, optional
        Called with the numbers of maneuvers shown and in all.
    """
    sections = [Section("Results", tuple(_results(run)))] if run.maneuvers else []
    for done, maneuver in enumerate(run.maneuvers):
        if progress is not None:
            progress(done, len(run.maneuvers))
        sections.append(Section(_title(maneuver), tuple(_blocks(maneuver, vehicle))))
    sections += [
        Section(f"Identified: {name}", tuple(_identified(found)))
        for name, found in run.identifications
    ]
    return html_page(f"Run {run.folder.resolve().name}", sections, subtitle=_subtitle(run))


def _subtitle(run: Run) -> str:
    plans = [maneuver.plan for maneuver in run.maneuvers if maneuver.plan is not None]
    vehicles = sorted({f"{plan.vehicle} ({plan.vehicle_hash[:12]})" for plan in plans})
    software = sorted({plan.software for plan in plans})
    parts = [f"vehicle {', '.join(vehicles)}", f"planned by version {', '.join(software)}"]
    return "; ".join(parts) if plans else str(run.folder)


def _title(maneuver: Maneuver) -> str:
    if maneuver.plan is None:
        return maneuver.name
    return f"{maneuver.name}: {maneuver.plan.maneuver.replace('_', ' ')} for {maneuver.plan.target}"


def _results(run: Run) -> list[Block]:
    """The table of all maneuvers: a row each."""
    columns: dict[str, Callable[[Maneuver], str]] = {
        "maneuver": lambda m: m.name,
        "x": lambda m: "" if m.plan is None else _operation(m.plan),
        "S": lambda m: "" if m.plan is None else f"{m.plan.main[m.plan.target].value:.3f}",
        "ST": lambda m: "" if m.plan is None else f"{m.plan.total[m.plan.target].value:.3f}",
        "H": lambda m: "" if m.plan is None else f"{m.plan.cost:.4g}",
        "TE expected / m²": lambda m: "" if m.te_expected is None else f"{m.te_expected:.5g}",
        "TE measured / m²": lambda m: "" if m.judgement is None else f"{m.judgement.te:.5g}",
        "less noise / m²": lambda m: (
            "" if m.judgement is None else f"{m.judgement.te_corrected:.5g}"
        ),
        "rms / mm": lambda m: "" if m.judgement is None else f"{1e3 * m.judgement.rms:.1f}",
        "largest / mm": lambda m: "" if m.judgement is None else f"{1e3 * m.judgement.max:.1f}",
    }
    rows = [[text(maneuver) for text in columns.values()] for maneuver in run.maneuvers]
    shown = [k for k in range(len(columns)) if any(row[k] for row in rows)]
    headings = list(columns)
    table = TableBlock(
        tuple(headings[k] for k in shown), tuple(tuple(row[k] for k in shown) for row in rows)
    )
    failures = [maneuver.failure for maneuver in run.maneuvers if maneuver.failure]
    return [table, *failures]


def _operation(plan: Plan) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in plan.operation.items())


def _blocks(maneuver: Maneuver, vehicle: Vehicle) -> list[Block]:
    plan, judgement = maneuver.plan, maneuver.judgement
    blocks: list[Block] = []
    if maneuver.failure:
        blocks.append(f"Not judged: {maneuver.failure}")
    if plan is not None and plan.verdict:
        blocks.append(plan.verdict)
    if plan is not None or judgement is not None:
        blocks.append(
            PlotBlock(
                figures.trajectories(plan, judgement),
                "Trajectories in the frame of the reference: from the origin, heading +x.",
            )
        )
    if judgement is not None:
        blocks.append(
            PlotBlock(
                figures.error_over_time(judgement),
                "Deviation from the nominal trajectory, and the mean of its square up to each "
                "time; the last one is TE (Eq. 14).",
            )
        )
    if plan is not None or maneuver.joints is not None:
        blocks.append(
            PlotBlock(
                figures.commands(plan, maneuver.joints),
                "Commands, held until the next one, and what the PLCs measured.",
            )
        )
    if plan is not None:
        try:
            loads = figures.wheel_loads(wheel_loads(vehicle, plan))
            blocks.append(
                PlotBlock(
                    loads,
                    "Wheel loads of the nominal vehicle; a wheel at 0 has lifted.",
                )
            )
        except PlanError as error:
            blocks.append(f"No wheel loads: {error}")
        blocks += [
            _index_table(plan),
            PlotBlock(figures.indices(plan), "Sobol' indices of TE with their 95 % intervals."),
        ]
        if plan.search is not None:
            blocks.append(
                PlotBlock(
                    figures.search_path(plan, plan.search),
                    "Cost of the maneuvers that the search tried, and the best so far.",
                )
            )
    return blocks


def _identified(found: IdentificationDocument) -> list[Block]:
    rows = tuple(
        (
            name,
            p.unit,
            f"{p.range[0]:.4g} … {p.range[1]:.4g}",
            f"{p.estimate:.4g}" if p.identifiable else "not shown",
            f"{p.low:.4g} … {p.high:.4g}",
            "" if p.truth is None else f"{p.truth:.4g}",
        )
        for name, p in found.parameters.items()
    )
    headings = ("parameter", "unit", "range", "estimate", f"{found.level:.0%}", "truth")
    blocks: list[Block] = [TableBlock(headings, rows)]
    if any(p.profile is not None for p in found.parameters.values()):
        caption = "Profile likelihood; shaded: the interval; grey: its level; dashed: the truth."
        blocks.append(PlotBlock(figures.profiles(found), caption))
    return blocks


def _index_table(plan: Plan) -> TableBlock:
    rows = []
    for name, main in plan.main.items():
        total, (low, high) = plan.total[name], plan.unknown[name]
        rows.append(
            (
                f"{name}{' (target)' if name == plan.target else ''}",
                f"{low:g} … {high:g}",
                f"{main.value:.4f}",
                f"{main.low:.4f} … {main.high:.4f}",
                f"{total.value:.4f}",
                f"{total.low:.4f} … {total.high:.4f}",
            )
        )
    return TableBlock(
        ("unknown parameter", "range", "S", "95 %", "ST", "95 %"),
        tuple(rows),
        f"H = {plan.cost:.4f}, Q² = {plan.leave_one_out_q2:.6f}, {plan.simulations} simulations in "
        f"{plan.seconds:.1f} s, seed {plan.seed}, plan {plan.id}",
    )
