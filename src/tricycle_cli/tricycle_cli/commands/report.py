"""`tricycle report`: one HTML file that shows a run."""

import argparse
import json
from functools import partial
from pathlib import Path

from tricycle_cli.options import (
    add_overwrite_option,
    add_topic_options,
    add_vehicle_option,
    check_output_files,
    topics_of,
)
from tricycle_cli.progress import progress_bar
from tricycle_core.documents import check_folder, write_whole
from tricycle_sim.vehicle import load_vehicle

EXAMPLE = """\
examples:
  tricycle report out/demo
  tricycle report out/plan --output plan.html
  tricycle report out/demo --figures out/figures --format pdf
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = (
        "Reads the plans and bags in the directory of a demo, a plan, a drive, a campaign or an "
        "identification, or a single bag, and writes one HTML file that opens offline."
    )
    parser.epilog = EXAMPLE
    add = parser.add_argument
    add("directory", type=Path, metavar="DIR", help="of the run, or a bag")
    add("--output", type=Path, metavar="FILE", help="default: DIR/report.html, or DIR/run.html")
    add_vehicle_option(parser)
    add("--figures", type=Path, metavar="FOLDER", help="write every figure to a file in it, too")
    add("--format", choices=["svg", "pdf", "png"], default="svg", help="of the figures")
    add_overwrite_option(parser)
    add("--json", action="store_true", help="print one JSON object")
    add_topic_options(parser, sensors=True)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Read the run, write its page, say where it is.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from parameter_identification.drives.reader import read_drive
    from tricycle_cli.campaign.intervals_section import intervals_section
    from tricycle_cli.reports.identification_files import IDENTIFICATION
    from tricycle_cli.reports.run_folder import read_run
    from tricycle_cli.reports.run_page import page_of, run_sections

    vehicle = load_vehicle(args.vehicle)
    if args.figures is not None:
        check_folder(args.figures)
    found = read_run(args.directory, read=partial(read_drive, topics=topics_of(args)))
    # identify keeps its own report beside its result
    name = "run.html" if (args.directory / IDENTIFICATION).exists() else "report.html"
    output: Path = args.output or args.directory / name
    check_output_files([output], args)
    with progress_bar("reporting") as progress:
        results, *others = run_sections(found, vehicle=vehicle, progress=progress)
        campaign = intervals_section(args.directory)
        sections = [results, *filter(None, [campaign]), *others]
        page = page_of(found, sections)
    files = []
    if args.figures is not None:
        from tricycle_cli.reports.figure_files import figures_by_file, write_figures

        check_output_files(figures_by_file(sections, args.figures, args.format), args)
    write_whole(output, page)
    if args.figures is not None:
        files = write_figures(sections, args.figures, args.format)
    if args.json:
        said = {"report": str(output), "maneuvers": [m.name for m in found.maneuvers]}
        print(json.dumps(said | ({"figures": [str(file) for file in files]} if files else {})))
    else:
        print(f"report: {output}")
        if files:
            print(f"{len(files)} figures: {args.figures}")
    return 0
