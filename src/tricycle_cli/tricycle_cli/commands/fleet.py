"""`tricycle fleet`: parameters of several vehicles of one kind, and which of them is odd."""

from __future__ import annotations

import argparse
import json
import tempfile
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from tricycle_cli.argument_types import at_least, parameter_names
from tricycle_cli.options import (
    BAG_HELP,
    add_other_vehicle_option,
    add_overwrite_option,
    add_topic_options,
    add_vehicle_option,
    add_workers_option,
    check_output_files,
    topics_of,
)
from tricycle_cli.progress import progress_bar
from tricycle_core.errors import BagError, naming
from tricycle_sim.vehicle import load_vehicle

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from parameter_identification.fleet import Fleet

T = TypeVar("T")

TABLE_WIDTH = 100  # characters; folded numbers cannot be read

EXAMPLE = """\
examples:
  tricycle fleet identify 'bags/**' --vehicles vehicle_id --output fleet
  tricycle fleet identify 'bags/**' --shared yaw_inertia --changing cornering_stiffness
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.epilog = EXAMPLE
    verbs = parser.add_subparsers(metavar="VERB", required=True)
    summary = "estimate the parameters of each vehicle, and their population"
    identify = verbs.add_parser(
        "identify", help=summary, epilog=EXAMPLE, formatter_class=parser.formatter_class
    )
    identify.description = (
        "Identifies each vehicle from its own bags, drive by drive, and from all of them the "
        "population: its mean, how far the vehicles are apart, and which one is odd."
    )
    add = identify.add_argument
    add(
        "bags",
        metavar="BAG",
        nargs="+",
        help=f"{BAG_HELP}; a pattern, as 'bags/**' in quotes, stands for all bags that it matches",
    )
    add(
        "--vehicles",
        metavar="KEY",
        help="entry of the bags' metadata that names the vehicle (default: the folder of the bag)",
    )
    add_vehicle_option(identify, "vehicle YAML of all")
    add(
        "--shared",
        type=parameter_names,
        default=[],
        metavar="NAME,NAME",
        help="parameters that are the same in all vehicles, estimated from all drives together",
    )
    add(
        "--own",
        type=parameter_names,
        default=[],
        metavar="NAME,NAME",
        help="parameters of each vehicle that tell nothing of another one; the rest is drawn from "
        "a population",
    )
    add(
        "--changing",
        type=parameter_names,
        default=[],
        metavar="NAME,NAME",
        help="parameters of the population that change over the months, each vehicle's at its own "
        "rate (tyre wear)",
    )
    add(
        "--effects",
        default="none",
        metavar="all|none|NAME,NAME",
        help="what the real vehicles have beside the file, each its own, and is estimated too",
    )
    add(
        "--keep",
        type=Path,
        metavar="DIR",
        help="where drives are kept once they are read, so that the same call goes on (default: "
        "drives in the output; without one nothing is kept)",
    )
    add_workers_option(identify)
    add("--leave-out", action="store_true", help="leave bags out that cannot be used")
    add_other_vehicle_option(identify)
    add("--seed", type=at_least(0), default=0, help="of the starts")
    add("--json", action="store_true", help="print one JSON object")
    add(
        "--output",
        type=Path,
        metavar="DIR",
        help="write report.html, fleet.json and fleet.png",
    )
    add_overwrite_option(identify)
    add_topic_options(identify, sensors=True)
    identify.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Identify the fleet, print, write.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from excitation_planner.design.executors import processes
    from parameter_identification.fleet import identify_fleet
    from parameter_identification.many_bags import some_of
    from trajectory_recorder.bag.location import find_bags
    from tricycle_cli.reports.fleet_page import FILES, save_fleet
    from tricycle_cli.reports.remarks import remarks_on_fleet
    from tricycle_cli.reports.tables import population_table, table_console
    from tricycle_core.documents import check_folder
    from tricycle_sim.effects import named_effects

    effects = named_effects(args.effects)
    vehicle = load_vehicle(args.vehicle)
    if args.output is not None:
        check_folder(args.output)
        check_output_files((args.output / name for name in FILES), args)
    named = dict.fromkeys(bag for text in args.bags for bag in find_bags(text))
    left_out: list[str] = []
    unusable = left_out if args.leave_out else None
    if args.vehicles is None:
        bags = _by_folder(named, unusable)
    else:
        bags = _by_entry(named, args.vehicles, unusable)
    if not bags:
        raise BagError(f"no bag can be used{some_of(left_out)}")
    with ExitStack() as stack:
        keep = args.keep or (args.output and args.output / "drives")
        folder = keep or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        executor = stack.enter_context(processes(args.workers))
        fleet = identify_fleet(
            dict(sorted(bags.items())),
            vehicle,
            folder=folder,
            shared=args.shared,
            own=args.own,
            changing=args.changing,
            effects=effects,
            executor=executor,
            leave_out=args.leave_out,
            other_vehicle=args.other_vehicle,
            topics=topics_of(args),
            seed=args.seed,
            progress=stack.enter_context(progress_bar("reading drives, fitting vehicles")),
        )
    fleet = replace(fleet, left_out=(*left_out, *fleet.left_out))
    console = table_console(stderr=args.json, width=TABLE_WIDTH)
    document = json.dumps(_document(fleet), allow_nan=False)
    try:  # the reader of a pipe may leave
        if args.output is not None:
            save_fleet(fleet, document, args.output)
    finally:  # and a disk be full
        console.print(population_table(fleet))
        for remark in remarks_on_fleet(fleet):
            console.print(remark, soft_wrap=True)
    if args.output is not None:
        console.print(f"report, figure and numbers: {args.output}", soft_wrap=True)
    if args.json:
        print(document)
    return 0


def _document(fleet: Fleet) -> dict[str, Any]:
    from tricycle_core.documents import encode, finite_or_none

    return {
        "vehicles": {
            name: {
                "drives": len(found.drives),
                "not_white": found.not_white,
                "scatter": finite_or_none(found.scatter),
                "parameters": encode(dict(found.parameters)),
            }
            for name, found in fleet.vehicles.items()
        },
        "populations": encode(dict(fleet.populations)),
        "changes_per_day": encode(dict(fleet.changes)),
        "shared": encode(dict(fleet.shared)),
        "own": list(fleet.own),
        "when": finite_or_none(fleet.when),
        "odd": list(fleet.odd),
        "beyond": encode(dict(fleet.beyond)),
        "left_out": list(fleet.left_out),
    }


def _by_folder(bags: Iterable[Path], left_out: list[str] | None) -> dict[str, list[Path]]:
    """Bags by the folder that each is in; those that are none are an error, or left out."""
    found: dict[str, list[Path]] = {}
    folders: dict[str, Path] = {}
    for bag, folder in _named(bags, _folder, left_out):
        if (other := folders.setdefault(folder.name, folder)) != folder:
            raise BagError(
                f"{other} and {folder}: two folders of bags have one name, which is that of the "
                "vehicle: rename one, or name vehicles by an entry of the metadata (--vehicles)"
            )
        found.setdefault(folder.name, []).append(bag)
    return found


def _by_entry(bags: Iterable[Path], key: str, left_out: list[str] | None) -> dict[str, list[Path]]:
    """Bags by an entry of their metadata; those that have none are an error, or left out."""
    found: dict[str, list[Path]] = {}
    for bag, name in _named(bags, partial(_entry, key), left_out):
        found.setdefault(name, []).append(bag)
    return found


def _named(
    bags: Iterable[Path], name: Callable[[Path], T], left_out: list[str] | None
) -> Iterator[tuple[Path, T]]:
    """Bags with the name of their vehicle; those without one are an error, or left out."""
    for bag in bags:
        try:
            found = name(bag)
        except (BagError, OSError) as error:
            if left_out is None:
                raise
            left_out.append(naming(error, bag))
        else:
            yield bag, found


def _folder(bag: Path) -> Path:
    """Folder that a bag is in."""
    from trajectory_recorder.bag.location import bag_at, is_remote
    from trajectory_recorder.bag.reader import BagReader

    whole = bag if is_remote(bag) else bag_at(bag)  # of a file of a bag
    if whole is None:
        with BagReader(bag):  # says why it is none
            whole = bag
    return whole.absolute().parent


def _entry(key: str, bag: Path) -> str:
    from trajectory_recorder.bag.reader import BagReader

    with BagReader(bag) as reader:
        if name := reader.metadata.get(key, "").strip():
            return name
        if key in reader.metadata:
            raise BagError(f"{bag}: {key!r} of its metadata is empty")
        known = ", ".join(reader.metadata) or "none"
        raise BagError(f"{bag}: its metadata has no {key!r}; there is: {known}")
