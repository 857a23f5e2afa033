"""``tricycle fleet``: parameters of several vehicles of one kind, and which of them is odd."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from tricycle_cli.arguments import BAG_HELP, add_topic_options, bag_argument, seed, topics_of
from tricycle_cli.progress import progress_bar
from tricycle_core.errors import BagError
from tricycle_sim.vehicle import load_vehicle

if TYPE_CHECKING:
    from collections.abc import Sequence

EXAMPLE = """\
examples:
  tricycle fleet bags/*/* --keep work --output fleet
  tricycle fleet bags/* --vehicles vehicle_id --keep work
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = (
        "Identifies each vehicle from its own bags, drive by drive, and from all of them the "
        "population: its mean, how far the vehicles are apart, and which one is odd."
    )
    parser.epilog = EXAMPLE
    add = parser.add_argument
    add("bags", metavar="BAG", nargs="+", type=bag_argument, help=BAG_HELP)
    add(
        "--vehicles",
        metavar="KEY",
        help="entry of the bags' metadata that names the vehicle (default: the folder of the bag)",
    )
    add("--vehicle", type=Path, metavar="FILE", help="vehicle YAML of all (default: the paper's)")
    add(
        "--keep",
        type=Path,
        required=True,
        metavar="DIR",
        help="where drives are kept once they are read: the same call goes on",
    )
    add("--workers", type=int, metavar="N", help="processes (default: one per processor)")
    add("--leave-out", action="store_true", help="leave bags out that cannot be used")
    add("--seed", type=seed, default=0, help="of the starts")
    add("--json", action="store_true", help="print one JSON object")
    add("--output", type=Path, metavar="DIR", help="write fleet.json and fleet.png")
    add_topic_options(parser, sensors=True)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Identify the fleet, print, write.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    from rich.console import Console

    from parameter_identification.fleet import identify_fleet
    from tricycle_cli.reports.static_figures import plot_fleet
    from tricycle_cli.reports.tables import population_table
    from tricycle_core.documents import check_folder, encode, write_whole

    if args.workers is not None and args.workers < 1:
        raise BagError(f"--workers {args.workers}: 1 or more are needed")
    vehicle = load_vehicle(args.vehicle)
    bags = _by_vehicle(args.bags, args.vehicles)
    if args.output is not None:
        check_folder(args.output)
    with (
        ProcessPoolExecutor(args.workers, mp_context=get_context("spawn")) as executor,
        progress_bar("identifying vehicles") as progress,
    ):
        fleet = identify_fleet(
            bags,
            vehicle,
            folder=args.keep,
            executor=executor,
            leave_out=args.leave_out,
            topics=topics_of(args),
            seed=args.seed,
            progress=progress,
        )
    console = Console(stderr=args.json, highlight=False)
    console.print(population_table(fleet))
    for parameter in vehicle.unknown:
        if parameter not in fleet.populations:
            console.print(f"{parameter}: too few vehicles show it")
    for name in fleet.odd:
        console.print(f"{name} is odd: far from what the others let expect", soft_wrap=True)
    for name, found in fleet.vehicles.items():
        if not found.white:
            console.print(
                f"{name}: residuals of {found.not_white} of {len(found.drives)} drives are NOT "
                "white: the model lacks something",
                soft_wrap=True,
            )
        for reason in found.left_out:
            console.print(f"{name}: left out: {reason}", soft_wrap=True)
    document = {
        "vehicles": {
            name: {"drives": len(found.drives), "parameters": encode(dict(found.parameters))}
            for name, found in fleet.vehicles.items()
        },
        "populations": encode(dict(fleet.populations)),
        "odd": list(fleet.odd),
    }
    if args.output is not None:
        args.output.mkdir(parents=True, exist_ok=True)
        plot_fleet(fleet, args.output / "fleet.png")
        write_whole(args.output / "fleet.json", json.dumps(document, allow_nan=False) + "\n")
        console.print(f"figure and numbers: {args.output}", soft_wrap=True)
    if args.json:
        print(json.dumps(document, allow_nan=False))
    return 0


def _by_vehicle(bags: Sequence[Path], key: str | None) -> dict[str, list[Path]]:
    """Bags by the vehicle that they name, in the order of the names."""
    from trajectory_recorder.bag.reader import BagReader

    found: dict[str, list[Path]] = {}
    for bag in bags:
        name = bag.absolute().parent.name
        if key is not None:
            with BagReader(bag) as reader:
                if key not in reader.metadata:
                    known = ", ".join(reader.metadata) or "none"
                    raise BagError(f"{bag}: its metadata has no {key!r}; there is: {known}")
                name = reader.metadata[key]
        found.setdefault(name, []).append(bag)
    return dict(sorted(found.items()))
