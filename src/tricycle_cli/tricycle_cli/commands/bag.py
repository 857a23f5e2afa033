"""``tricycle bag``: what a bag holds, and recovery of torn and damaged ones."""

import argparse
import json
import sys
from pathlib import Path

from tricycle_cli.progress import progress_bar

EXAMPLE = """\
examples:
  tricycle bag info out/demo/bags/circle
  tricycle bag recover torn_bag torn_bag_recovered
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
    info = verbs.add_parser("info", help="topics, types, counts and metadata")
    info.add_argument("bag", metavar="BAG", type=Path, help="rosbag2 directory or file")
    info.add_argument("--json", action="store_true", help="print one JSON object")
    info.set_defaults(run=run_info)
    again = verbs.add_parser("recover", help="copy what is readable of a damaged bag to a new one")
    again.add_argument("bag", metavar="BAG", type=Path)
    again.add_argument("output", metavar="OUTPUT", type=Path, help="directory to create")
    again.add_argument("--json", action="store_true", help="print one JSON object")
    again.set_defaults(run=run_recover)


def run_info(args: argparse.Namespace) -> int:
    """Print what the bag holds.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from rich.console import Console
    from rich.table import Table

    from trajectory_recorder.bag.reader import BagReader

    with BagReader(args.bag) as bag:
        found = {
            "bag": str(bag.path),
            "complete": bag.complete,
            "messages": sum(topic.count for topic in bag.topics.values()),
            "metadata": bag.metadata,
            "topics": {t.name: {"type": t.type, "messages": t.count} for t in bag.topics.values()},
        }
        topics = sorted(bag.topics.values(), key=lambda topic: topic.name)
    if args.json:
        print(json.dumps(found))
        return 0
    console = Console()
    table = Table("topic", "type", "messages", "offered")
    table.columns[2].justify = "right"
    for topic in topics:
        offered = sorted({f"{qos.reliability}, {qos.durability}" for qos in topic.qos})
        table.add_row(topic.name, topic.type, str(topic.count), "; ".join(offered))
    console.print(table)
    torn = "" if found["complete"] else "; cut off: the recorder was killed"
    console.print(f"{found['messages']} messages{torn}", highlight=False)
    for key, value in bag.metadata.items():
        console.print(f"{key}: {value}", highlight=False)
    return 0


def run_recover(args: argparse.Namespace) -> int:
    """Copy what is readable.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from trajectory_recorder.bag.recovery import recover

    with progress_bar("recovering") as progress:
        messages, damage = recover(args.bag, args.output, progress=progress)
    for chunk in damage:
        print(f"left out: {chunk}", file=sys.stderr)
    if args.json:
        found = {"bag": str(args.output), "messages": messages, "damaged_chunks": len(damage)}
        print(json.dumps(found))
    else:
        print(f"{messages} messages recovered to {args.output}")
    return 0
