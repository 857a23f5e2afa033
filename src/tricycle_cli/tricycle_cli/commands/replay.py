"""``tricycle replay``: publishes a bag's messages as they were recorded."""

import argparse
import json
import re
import sys
from collections.abc import Collection, Iterable

from tricycle_cli.argument_types import bag_argument, nonnegative_number, positive_number
from tricycle_cli.operation.processes import run_in_foreground
from tricycle_cli.options import BAG_HELP
from tricycle_core.errors import BagError, hint

EXAMPLE = """\
examples:
  tricycle replay out/demo/bags/designed
  tricycle replay out/demo/bags/designed --rate 4 --loop --topics /odom 'maneuver/*'
  tricycle replay out/demo/bags/designed --remap /odom:=/recorded/odom
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = (
        "Starts the node bag_replayer; its services ~/pause, ~/resume and ~/step hold and move "
        "it; its parameter start, set while it plays, jumps to another time."
    )
    parser.epilog = EXAMPLE
    add = parser.add_argument
    add("bag", metavar="BAG", type=bag_argument, help=BAG_HELP)
    add(
        "--rate", type=nonnegative_number, default=1.0, help="recorded s per s; 0: as fast as taken"
    )
    add(
        "--start",
        type=nonnegative_number,
        default=0.0,
        metavar="S",
        help="skip so many recorded seconds",
    )
    add(
        "--duration",
        type=positive_number,
        metavar="S",
        help="play so many recorded seconds (default: to the end)",
    )
    add("--topics", nargs="+", metavar="TOPIC", help="names to play; * and ? match anything")
    add("--exclude", nargs="+", metavar="TOPIC", help="names not to play, of those")
    add(
        "--remap",
        nargs="+",
        type=_remapping,
        default=[],
        metavar="/OLD:=/NEW",
        help="publish under other names",
    )
    add("--loop", action="store_true", help="begin again at the end")
    add("--paused", action="store_true", help="wait for ~/resume or ~/step")
    add("--json", action="store_true", help="print one JSON object at the end")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Play to the end, or until Ctrl-C.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from trajectory_recorder.bag.reader import NOT_WHOLE, BagReader

    with BagReader(args.bag) as bag:  # a bag that cannot be read is a mistake said at once
        _check_remapped(args.remap, bag.topics)
        if not bag.complete:
            print(f"{args.bag}: {NOT_WHOLE}", file=sys.stderr)
    parameters: dict[str, object] = {
        name: getattr(args, name) for name in ("rate", "start", "loop", "paused")
    }
    parameters["duration"] = args.duration or 0.0  # to the end
    parameters["bag"] = str(args.bag)
    for name in ("topics", "exclude"):
        if topics := getattr(args, name):
            parameters[name] = topics
    status = run_in_foreground("bag_replayer", parameters, remappings=args.remap)
    if args.json:
        print(json.dumps({"bag": str(args.bag), "status": status}))
    return status


def _check_remapped(remappings: Iterable[str], topics: Collection[str]) -> None:
    """Refuse other names for topics that the node does not publish."""
    for remapping in remappings:
        old = remapping.partition(":=")[0]
        if old not in topics and old != "/clock" and not old.startswith("/bag_replayer/"):
            raise BagError(
                f"--remap {remapping}: no topic of the bag is {old}; {hint(old, topics)}"
            )


def _remapping(text: str) -> str:
    if not re.fullmatch(r"(/\w+)+:=(/\w+)+", text):
        raise argparse.ArgumentTypeError(f"{text!r}: needs /old:=/new")
    return text
