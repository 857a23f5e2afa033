"""`tricycle report`: one HTML file that shows a run."""

import argparse
import json
from pathlib import Path

from tricycle_cli.progress import progress_bar
from tricycle_core.documents import write_whole
from tricycle_sim.vehicle import load_vehicle

EXAMPLE = """\
examples:
  tricycle report out/demo
  tricycle report out/plan --output plan.html
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = (
        "Reads the plans and bags in the directory of a demo, a plan, a drive or an "
        "identification, or a single bag, and writes one HTML file that opens offline."
    )
    parser.epilog = EXAMPLE
    add = parser.add_argument
    add("directory", type=Path, metavar="DIR", help="of the run, or a bag")
    add("--output", type=Path, metavar="FILE", help="default: DIR/report.html, or DIR/run.html")
    add("--vehicle", type=Path, metavar="FILE", help="vehicle YAML (default: the paper's tricycle)")
    add("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Read the run, write its page, say where it is.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from tricycle_cli.reports.run_folder import IDENTIFIED, read_run
    from tricycle_cli.reports.run_page import run_page

    vehicle = load_vehicle(args.vehicle)
    found = read_run(args.directory)
    with progress_bar("reporting") as progress:
        page = run_page(found, vehicle=vehicle, progress=progress)
    # identify keeps its own report beside its result
    name = "run.html" if (args.directory / IDENTIFIED).exists() else "report.html"
    output: Path = args.output or args.directory / name
    write_whole(output, page)
    if args.json:
        print(json.dumps({"report": str(output), "maneuvers": [m.name for m in found.maneuvers]}))
    else:
        print(f"report: {output}")
    return 0
