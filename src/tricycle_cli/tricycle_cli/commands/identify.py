"""`tricycle identify`: the unknown parameters and their intervals, from recorded drives."""

import argparse
import json
from dataclasses import replace
from pathlib import Path

from tricycle_cli.arguments import seed
from tricycle_cli.progress import progress_bar
from tricycle_sim.vehicle import load_vehicle

TABLE_WIDTH = 120  # characters; folded numbers cannot be read

EXAMPLE = """\
examples:
  tricycle identify out/demo/bags/*
  tricycle identify bags/circle bags/lane --held-out bags/check --output out/identified
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = (
        "Fits the model to all bags together and prints each parameter with its "
        "interval by profile likelihood. What the drives do not show is said and keeps its range."
    )
    parser.epilog = EXAMPLE
    add = parser.add_argument
    add("bags", metavar="BAG", nargs="+", type=Path, help="rosbag2 directory, .mcap or .db3 file")
    add("--vehicle", type=Path, metavar="FILE", help="vehicle YAML (default: the paper's tricycle)")
    add(
        "--parameters",
        type=lambda text: tuple(text.replace("-", "_").split(",")),
        metavar="NAME,NAME",
        help="identify only these; the others keep their nominal values (default: all unknown)",
    )
    add("--held-out", type=Path, metavar="BAG", nargs="+", default=[], help="drives to predict")
    add(
        "--effects",
        default="none",
        metavar="all|none|NAME,NAME",
        help="what the real vehicle has beside the file (steering-zero, wheel-radius, "
        "sensor-forward, …) and is estimated too",
    )
    add("--robust", action="store_true", help="hold outliers back")
    add("--seed", type=seed, default=0, help="of the starts")
    add("--json", action="store_true", help="print one JSON object")
    add(
        "--output",
        type=Path,
        metavar="DIR",
        help="write vehicle.yaml with the estimates, identification.json, figures and report.html",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Read the bags, identify, print, write.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from rich.console import Console

    from parameter_identification.drives.measured import read_measured_drive
    from parameter_identification.estimation.problem import Loss
    from parameter_identification.identification import EFFECTS, identify
    from parameter_identification.identification_file import document_of
    from tricycle_cli.reports.identification_page import save_identification
    from tricycle_cli.reports.tables import parameter_table, remarks

    vehicle = load_vehicle(args.vehicle)
    with progress_bar("reading bags") as progress:
        bags, drives = [*args.bags, *args.held_out], []
        alike = len({bag.stem for bag in bags}) < len(bags)
        for done, bag in enumerate(bags, start=1):
            drive = read_measured_drive(bag, vehicle)
            drives.append(replace(drive, name=str(bag)) if alike else drive)
            progress(done, len(bags))
    with progress_bar("identifying") as progress:
        found = identify(
            drives[: len(args.bags)],
            vehicle,
            parameters=args.parameters,
            held_out=drives[len(args.bags) :],
            effects={"all": EFFECTS, "none": ()}.get(args.effects, args.effects.split(",")),
            loss=Loss.ROBUST if args.robust else Loss.SQUARED,
            profiles=True,
            seed=args.seed,
            progress=progress,
        )
    console = Console(stderr=args.json, highlight=False)
    console.width = max(console.width, TABLE_WIDTH)
    console.print(parameter_table(found))
    for remark in remarks(found):
        console.print(remark, soft_wrap=True)
    if args.output is not None:
        save_identification(found, args.vehicle, args.output)
        console.print(f"vehicle file, figures and report: {args.output}", soft_wrap=True)
    if args.json:
        print(json.dumps(document_of(found).to_json(), allow_nan=False))
    return 0
