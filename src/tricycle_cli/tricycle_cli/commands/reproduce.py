"""`tricycle reproduce`: the paper's tables and figures beside ours."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from excitation_planner.design.executors import process_pool
from paper_reproduction import PaperBudget
from paper_reproduction.comparison import Item
from paper_reproduction.figures import draw
from paper_reproduction.first_stage import Predictions
from paper_reproduction.items import NAMES, Reproduction
from tricycle_cli.progress import progress_bar
from tricycle_cli.reports.html_page import FigureBlock, Section, TableBlock, html_page

EXAMPLE = """\
examples:
  tricycle reproduce table1 --output out/paper
  tricycle reproduce all --output out/paper
  tricycle reproduce fig13 --faithful --json

writes report.html, and of each item a .png and an .svg, into the output directory
"""
READING = (
    "The wheelbase of Table 2 (1.43 m) is not the sum of the two distances to the centre of mass "
    "(0.724 m + 0.719 m = 1.443 m): the two distances are used.",
    "The speed range of the circle is printed as [0.6, 0.1]: read as 0.6 to 1.0 m/s.",
    "A ratio of right to left wheel angle of 0.8 at 0° cannot be: a symmetric linkage has 1 there, "
    "and inner and outer wheel change places with the side. Read as the ratio of outer to inner "
    "angle, 0.8 near straight ahead and 0.6 at 45°.",
    "Algorithm 1 stops when the largest Kriging variance is at most 0.01 of its mean. A largest "
    "value is never below the mean, so the whole budget is always spent.",
)


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "reproduce",
        help="the paper's tables and figures, computed again",
        description="Computes the tables and figures of ASME IDETC2020-22257 and shows them beside "
        "the published numbers.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("items", nargs="*", choices=[*NAMES, "all"], default="all", metavar="ITEM",
        help=f"all (default), or some of: {', '.join(NAMES)}")  # fmt: skip
    add("--output", type=Path, default=Path("out/reproduce"), metavar="DIR")
    add(
        "--faithful",
        action="store_true",
        help="the paper's way as well: 4000 + 200 samples, Monte-Carlo indices (takes long)",
    )
    add("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Compute, save and print."""
    names = NAMES if "all" in args.items else [name for name in NAMES if name in args.items]
    args.output.mkdir(parents=True, exist_ok=True)
    items, figures = [], []
    with process_pool() as pool:
        reproduction = Reproduction(pool, budget=PaperBudget() if args.faithful else None)
        for name in names:
            with progress_bar(name) as progress:
                items.append(reproduction.item(name, progress))
                progress(1, 1)
    for item in items:
        figures.append(draw(item))
        for suffix in ("png", "svg"):
            figures[-1].savefig(args.output / f"{item.name}.{suffix}", dpi=150)
    report = args.output / "report.html"
    report.write_text(_page(items, figures), encoding="utf-8")
    if args.json:
        print(json.dumps({item.name: _as_json(item) for item in items}))
    else:
        _print(items)
    print(f"report: {report}", file=sys.stderr)
    return 0


def _as_json(item: Item[Any]) -> dict[str, Any]:
    return {
        "published": {c.quantity: c.published for c in item.comparisons},
        "ours": {c.quantity: c.ours for c in item.comparisons},
        "verdict": item.verdict,
        "verdicts": {c.quantity: str(c.agreement) for c in item.comparisons},
        "findings": list(item.findings),
    }


def _number(value: float | str) -> str:
    if isinstance(value, str):
        return value
    return f"1 − {1 - value:.1e}" if 0.99999 < value < 1 else f"{value:.6g}"


def _rows(item: Item[Any]) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (c.quantity, _number(c.published), _number(c.ours), str(c.agreement))
        for c in item.comparisons
    )


def _print(items: list[Item[Any]]) -> None:
    for item in items:
        table = Table("", "published", "ours", "", title=item.title)
        for row in _rows(item):
            table.add_row(*row)
        console = Console()
        console.print(table)
        for finding in item.findings:
            console.print(f"- {finding}", highlight=False)


def _page(items: list[Item[Any]], figures: list[Figure]) -> str:
    overview = TableBlock(("", "verdict"), tuple((item.title, item.verdict) for item in items))
    sections = [Section("Overview", (overview,)), Section("How the paper was read", READING)]
    for item, figure in zip(items, figures, strict=True):
        table = TableBlock(("", "published", "ours", "verdict"), _rows(item))
        picture = FigureBlock.of(figure, alt=f"{item.title}: {item.verdict}", caption=item.title)
        sections.append(Section(item.title, (table, picture, *_statistics(item), *item.findings)))
    return html_page(
        "The paper, reproduced",
        sections,
        subtitle="ASME IDETC2020-22257: published numbers beside those of this suite",
    )


def _statistics(item: Item[Any]) -> tuple[TableBlock, ...]:
    """Error statistics of a metamodel as a table."""
    if not isinstance(item.data, Predictions):
        return ()
    headings = ("metamodel", "R²", "RAAE", "RMAE", "mean error", "std of error", "mean output",
                "std of output")  # fmt: skip
    rows = tuple(
        (label, _number(s.r2), *(f"{value:.2e}" for value in (s.raae, s.rmae, s.mean, s.std)),
         f"{s.output_mean:.4g}", f"{s.output_std:.4g}")
        for label, s in item.data.statistics.items()
    )  # fmt: skip
    unit = "no unit" if item.data.unit == "1" else item.data.unit
    return (TableBlock(headings, rows, f"Errors at the validation points; outputs in {unit}"),)
