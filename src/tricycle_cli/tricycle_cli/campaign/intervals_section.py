"""What the report page of a campaign's folder has of the campaign: intervals expected and found."""

from pathlib import Path

from parameter_identification.estimation.intervals import half_width
from tricycle_cli.campaign.state_file import CampaignState, Step
from tricycle_cli.reports.html_page import Section, TableBlock
from tricycle_core.errors import PlanError

TITLE = "Intervals expected and found"
HEADINGS = ("after", "parameter", "unit", "estimate", "expected", "found", "found / expected")
CAPTION = (
    "95 % intervals after each drive, identified together with those before it. Expected: 1.96 "
    "times the standard deviation that the plan predicted. Found / expected: ratio of the widths. "
    "A plan counts the effects of --plan-effects, an identification those of --effects."
)


def intervals_section(folder: Path) -> Section | None:
    """Return a table of the interval that each drive of a campaign was to give, and that it gave.

    Parameters
    ----------
    folder : Path
        Folder of a campaign, or any other.

    Returns
    -------
    section : Section or None
        None without a campaign in the folder, or before its first identification.
    """
    file = folder / "campaign.json"
    if not file.exists():
        return None
    try:
        steps = CampaignState.read(file).steps
    except PlanError as error:  # the page shows what else is there
        return Section(TITLE, (f"Not shown: {error}",))
    rows = [row for number, step in enumerate(steps, start=1) for row in _rows(number, step)]
    return Section(TITLE, (TableBlock(HEADINGS, tuple(rows), CAPTION),)) if rows else None


def _rows(number: int, step: Step) -> list[tuple[str, ...]]:
    """A row per parameter; the first one names the drive."""
    rows, after = list[tuple[str, ...]](), f"{number}: {step.maneuver.replace('_', ' ')}"
    found = {} if step.identification is None else step.identification.parameters
    for name, entry in found.items():
        half = half_width() * step.predicted_std.get(name, 0.0)
        rows.append(
            (
                after,
                f"{name} (target)" if name == step.target else name,
                "" if entry.unit == "1" else entry.unit,
                f"{entry.estimate:.4g}" if entry.identifiable else "not shown",
                f"±\u00a0{half:.3g}" if half else "",
                f"{entry.low:.4g} … {entry.high:.4g}",
                f"{(entry.high - entry.low) / (2.0 * half):.2f}" if half else "",
            )
        )
        after = ""
    return rows
