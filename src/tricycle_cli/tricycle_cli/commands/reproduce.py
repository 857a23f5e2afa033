"""`tricycle reproduce`: the paper's tables and figures beside ours."""

from __future__ import annotations

import argparse
import json
import sys
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from paper_reproduction.published import ITEMS
from tricycle_cli.console import plain_console
from tricycle_cli.options import add_overwrite_option, check_output_files
from tricycle_cli.progress import progress_bar
from tricycle_core.documents import check_folder, replacing, write_whole

if TYPE_CHECKING:
    from paper_reproduction.comparison import Item

EXAMPLE = """\
examples:
  tricycle reproduce table1 --output out/paper
  tricycle reproduce all --output out/paper
  tricycle reproduce fig13 --faithful --json

writes report.html, and of each item a .png and an .svg, into the output folder
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = (
        "Computes the tables and figures of ASME IDETC2020-22257 and shows them beside "
        "the published numbers."
    )
    parser.epilog = EXAMPLE
    add = parser.add_argument
    add("items", nargs="*", choices=[*ITEMS, "all"], default="all", metavar="ITEM",
        help=f"all (default), or some of: {', '.join(ITEMS)}")  # fmt: skip
    add("--output", type=Path, default=Path("out/reproduce"), metavar="DIR")
    add_overwrite_option(parser)
    add(
        "--faithful",
        action="store_true",
        help="the paper's way as well: 4000 + 200 samples, Monte-Carlo indices (takes long)",
    )
    add("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Compute, save and print.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from excitation_planner.design.executors import process_pool
    from paper_reproduction.figures import draw
    from paper_reproduction.first_stage import PaperBudget
    from paper_reproduction.items import Reproduction
    from tricycle_cli.reports.comparison_page import comparison_page, comparison_table

    names = ITEMS if "all" in args.items else [name for name in ITEMS if name in args.items]
    report = args.output / "report.html"
    check_folder(args.output)
    pictures = {
        name: [args.output / f"{name}.{suffix}" for suffix in ("png", "svg")] for name in names
    }
    check_output_files((report, *chain.from_iterable(pictures.values())), args)
    args.output.mkdir(parents=True, exist_ok=True)
    items, figures = [], []
    reproduction = Reproduction(process_pool(), budget=PaperBudget() if args.faithful else None)
    for name in names:
        with progress_bar(name) as progress:
            items.append(reproduction.item(name, progress))
            progress(1, 1)
    for item in items:
        figures.append(draw(item))
        for picture in pictures[item.name]:
            with replacing(picture) as file:
                figures[-1].savefig(file, dpi=150)
    write_whole(report, comparison_page(items, figures))
    if args.json:
        print(json.dumps({item.name: _as_json(item) for item in items}))
    else:
        console = plain_console()
        for item in items:
            console.print(comparison_table(item))
            for finding in item.findings:
                console.print(f"- {finding}", highlight=False)
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
