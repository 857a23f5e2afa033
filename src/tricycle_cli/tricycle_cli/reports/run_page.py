"""The report of a run: one HTML page, the table first, then figures to zoom into."""

from collections.abc import Callable, Sequence

from excitation_planner.plan import Plan
from parameter_identification.identification_file import IdentificationDocument, ParameterEntry
from tricycle_cli.reports import interactive_figures as figures
from tricycle_cli.reports.html_page import PlotBlock, Section, TableBlock, html_page
from tricycle_cli.reports.run_folder import Maneuver, Run, wheel_loads
from tricycle_cli.reports.tables import shown_truth
from tricycle_core.errors import PlanError
from tricycle_core.quantities import Progress, with_deviation
from tricycle_sim.vehicle import Vehicle

Block = str | TableBlock | PlotBlock

LEGEND = (
    "x: what the maneuver is made of, in m, m/s, rad or Hz. TE: trajectory error, the mean squared "
    "distance from the nominal model's trajectory; less noise: without what the noise of the pose "
    "adds; rms is its root. Of the variance of TE when the unknown parameters vary, the target "
    "alone explains the share S, and with its interactions ST. H: the paper's cost of a maneuver, "
    "small where the target dominates."
)
PROFILES = (
    "Profile likelihood around the estimates: how much worse the fit becomes when a parameter is "
    "held. Shaded: the interval, where the rise stays below the grey line; dashed: the truth."
)


def run_page(run: Run, *, vehicle: Vehicle) -> str:
    """Return the report of a run as the text of an HTML file.

    Parameters
    ----------
    run : Run
        Run to show.
    vehicle : Vehicle
        Vehicle; wheel loads are shown for plans that were made for it.
    """
    return page_of(run, run_sections(run, vehicle=vehicle))


def page_of(run: Run, sections: Sequence[Section]) -> str:
    """Return sections as the text of an HTML file.

    Parameters
    ----------
    run : Run
        Run that the sections show.
    sections : sequence of Section
        Sections from `run_sections`.
    """
    return html_page(f"Run {run.folder.resolve().name}", sections, subtitle=_subtitle(run))


def run_sections(
    run: Run, *, vehicle: Vehicle, progress: Progress | None = None
) -> tuple[Section, ...]:
    """Return the sections of the report of a run.

    Parameters
    ----------
    run : Run
        Run to show.
    vehicle : Vehicle
        Vehicle; wheel loads are shown for plans that were made for it.
    progress : callable, optional
        Called with the number of maneuvers shown so far and of all.
    """
    results = _results(run) if run.maneuvers else []
    results += [_estimates(name, found) for name, found in run.identifications]
    sections = [Section("Results", (*results, *filter(None, [run.left_out])))]
    for done, maneuver in enumerate(run.maneuvers, start=1):
        sections.append(Section(_title(maneuver), tuple(_blocks(maneuver, vehicle))))
        if progress is not None:
            progress(done, len(run.maneuvers))
    sections += [
        Section(
            f"{name}: profiles of the estimates",
            (PlotBlock("profiles", figures.profiles(found), PROFILES),),
        )
        for name, found in run.identifications
        if any(p.profile is not None for p in found.parameters.values())
    ]
    return tuple(sections)


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
    table = TableBlock.without_empty_columns(list(columns), rows)
    failures = [maneuver.failure for maneuver in run.maneuvers if maneuver.failure]
    return [table, LEGEND, *failures]


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
                "trajectories",
                (figures.trajectories(plan, judgement),),
                "Trajectories in the frame of the reference: from the origin, heading +x.",
            )
        )
    if judgement is not None:
        blocks.append(
            PlotBlock(
                "error",
                (figures.error_over_time(judgement),),
                "Deviation from the nominal trajectory, and the mean of its square up to each "
                "time; the last one is TE (Eq. 14).",
            )
        )
    if plan is not None or maneuver.joints is not None:
        blocks.append(
            PlotBlock(
                "commands",
                (figures.commands(plan, maneuver.joints),),
                "Commands, held until the next one, and what the PLCs measured.",
            )
        )
    if plan is not None:
        try:
            loads = figures.wheel_loads(wheel_loads(vehicle, plan))
            blocks.append(
                PlotBlock(
                    "wheel_loads",
                    (loads,),
                    "Wheel loads of the nominal vehicle; a wheel at 0 has lifted.",
                )
            )
        except PlanError as error:
            blocks.append(f"No wheel loads: {error}")
        blocks += [
            _index_table(plan),
            PlotBlock(
                "indices",
                (figures.indices(plan),),
                "Sobol' indices of TE with their 95 % intervals.",
            ),
        ]
        if plan.search is not None:
            on_area = " On an area most costs are of a few vehicles; what does not fit has none."
            blocks.append(
                PlotBlock(
                    "search",
                    (figures.search_path(plan, plan.search),),
                    "Cost of the maneuvers that the search tried, and the best so far. Axes are in "
                    "m, m/s, rad or Hz." + (on_area if plan.area is not None else ""),
                )
            )
    return blocks


def _estimates(name: str, found: IdentificationDocument) -> TableBlock:
    def estimate(p: ParameterEntry) -> str:
        if not p.identifiable:
            return "not shown"
        deviation = p.standard_deviation
        return f"{p.estimate:.4g}" if deviation is None else with_deviation(p.estimate, deviation)

    rows = [
        (
            parameter,
            "" if p.unit == "1" else p.unit,
            f"{p.range[0]:.4g} … {p.range[1]:.4g}",
            estimate(p),
            f"{p.low:.4g} … {p.high:.4g}",
            "" if p.truth is None else shown_truth(p, p.truth),
        )
        for parameter, p in found.parameters.items()
    ]
    headings = ["parameter", "unit", "range", "estimate ± σ", f"{100 * found.level:g} %", "truth"]
    caption = f"{name}: estimates from the drives; ✗: the interval misses the truth"
    return TableBlock.without_empty_columns(headings, rows, caption)


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
