"""``tricycle bag``: what a bag holds, parts and merging of bags, recovery of damaged ones."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tricycle_cli.argument_types import bag_argument, nonnegative_number, positive_number
from tricycle_cli.console import plain_console
from tricycle_cli.options import BAG_HELP
from tricycle_cli.progress import progress_bar

if TYPE_CHECKING:
    from trajectory_recorder.bag.topics import OfferedQos

EXAMPLE = """\
examples:
  tricycle bag info out/demo/bags/designed
  tricycle bag convert first second --output both
  tricycle bag convert first --output part --topics '/maneuver/*' /odom --start 5 --duration 20
  tricycle bag recover torn_bag --output torn_bag_recovered
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
    add_verb = partial(verbs.add_parser, formatter_class=parser.formatter_class)  # with defaults
    info = add_verb("info", help="time, files, topics, types, counts, metadata")
    info.add_argument("bag", metavar="BAG", type=bag_argument, help=BAG_HELP)
    info.add_argument("--json", action="store_true", help="print one JSON object")
    info.set_defaults(run=run_info)
    new = add_verb("convert", help="write parts of bags, or several bags, as a new one")
    add = new.add_argument
    add("bags", metavar="BAG", nargs="+", type=bag_argument, help=BAG_HELP)
    add("--output", metavar="DIR", type=Path, required=True, help="directory to create (MCAP)")
    names = "names; * and ? match anything (default: all)"
    add("--topics", nargs="+", metavar="TOPIC", default=["*"], help=names)
    add("--exclude", nargs="+", metavar="TOPIC", default=[], help="names to leave out, of those")
    add(
        "--start",
        type=nonnegative_number,
        default=0.0,
        metavar="S",
        help="leave out so many seconds",
    )
    add(
        "--duration",
        type=positive_number,
        metavar="S",
        help="keep so many (default: to the end)",
    )
    add("--compression", choices=["zstd", "lz4", "none"], default="zstd", help="of chunks")
    new_file = "begin a new file after (default: 0, never)"
    add("--split-size", type=nonnegative_number, default=0.0, metavar="MB", help=new_file)
    add("--split-duration", type=nonnegative_number, default=0.0, metavar="S", help=new_file)
    add("--json", action="store_true", help="print one JSON object")
    new.set_defaults(run=run_convert)
    again = add_verb("recover", help="copy what is readable of a damaged bag to a new one")
    again.add_argument("bag", metavar="BAG", type=bag_argument, help=BAG_HELP)
    again.add_argument(
        "--output", metavar="DIR", type=Path, required=True, help="directory to create (MCAP)"
    )
    again.add_argument("--json", action="store_true", help="print one JSON object")
    again.set_defaults(run=run_recover)


def run_info(args: argparse.Namespace) -> int:
    """Print what the bag holds.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from rich.table import Table

    from trajectory_recorder.bag.reader import NOT_WHOLE, BagReader

    with BagReader(args.bag) as bag:
        start, end = bag.span or (0, 0)
        names = [file.name for file in bag.files]
        summary = {
            "bag": str(bag.path),
            "storage": bag.kind,
            "files": names,
            "bytes": bag.size,
            "start": start * 1e-9,
            "end": end * 1e-9,
            "duration": (end - start) * 1e-9,
            "complete": bag.complete,
            "messages": sum(topic.count for topic in bag.topics.values()),
            "metadata": bag.metadata,
            "topics": {t.name: {"type": t.type, "messages": t.count} for t in bag.topics.values()},
        }
        topics = sorted(bag.topics.values(), key=lambda topic: topic.name)
    if args.json:
        print(json.dumps(summary))
        return 0
    fetched = f" ({bag.fetched / 1e6:.3f} MB fetched)" if bag.fetched else ""
    console = plain_console()
    console.print(f"files     {', '.join(names)} ({bag.kind})", highlight=False)
    console.print(f"size      {bag.size / 1e6:.3f} MB{fetched}", highlight=False)
    console.print(f"start     {_time(start)}", highlight=False)
    console.print(f"end       {_time(end)}", highlight=False)
    console.print(f"duration  {summary['duration']:.3f} s", highlight=False)
    # whole names at 80 columns: the usual quality of service and the kind of type are left out
    table = Table("count", "topic", "type", "", box=None, pad_edge=False)
    table.columns[0].justify = "right"
    for column in table.columns[1:]:
        column.overflow = "fold"
    for topic in topics:
        kind = topic.type.replace("/msg/", "/")
        table.add_row(str(topic.count), topic.name, kind, ", ".join(_unusual(topic.qos)))
    console.print(table)
    torn = "" if summary["complete"] else f"; {NOT_WHOLE}"
    console.print(f"{summary['messages']} messages{torn}", highlight=False)
    for key, value in bag.metadata.items():
        console.print(f"{key}: {value}", highlight=False)
    return 0


def _unusual(offered: Sequence[OfferedQos]) -> list[str]:
    """Return in words how a quality of service differs from reliable and volatile."""
    words = {"latched" if qos.latched else "" for qos in offered}
    words |= {"" if qos.reliability == "reliable" else qos.reliability for qos in offered}
    return sorted(word.replace("_", " ") for word in words - {""})


def _time(stamp: int) -> str:
    """Stamp in seconds, and as a date unless it is a simulation's."""
    seconds = f"{stamp * 1e-9:.3f} s"
    if stamp < 1e17:  # 1973
        return seconds
    date = datetime.fromtimestamp(stamp * 1e-9, UTC).isoformat(sep=" ", timespec="milliseconds")
    return f"{seconds} ({date})"


def run_convert(args: argparse.Namespace) -> int:
    """Write the messages wanted to a new bag.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from trajectory_recorder.bag.conversion import convert
    from trajectory_recorder.bag.reader import NOT_WHOLE, BagReader
    from trajectory_recorder.bag.writer import Compression
    from trajectory_recorder.topic_patterns import chosen

    names: set[str] = set()
    for path in args.bags:
        with BagReader(path) as bag:
            names |= bag.topics.keys()
            if not bag.complete:
                print(f"{path}: {NOT_WHOLE}", file=sys.stderr)
            _tell_attachments(path, bag.attachments)
    topics = chosen(names, args.topics, args.exclude)
    with progress_bar("converting") as progress:
        messages = convert(
            args.bags,
            args.output,
            topics=topics,
            start=args.start,
            duration=math.inf if args.duration is None else args.duration,
            compression=Compression(args.compression.replace("none", "")),
            split_size=round(args.split_size * 1e6),
            split_duration=args.split_duration,
            progress=progress,
        )
    if args.json:
        print(json.dumps({"bag": str(args.output), "messages": messages}))
    else:
        print(f"{messages} messages in {args.output}")
    return 0


def _tell_attachments(bag: Path, number: int) -> None:
    if number:
        print(f"{bag}: attachments, which are not copied: {number}", file=sys.stderr)


def run_recover(args: argparse.Namespace) -> int:
    """Copy what is readable.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from trajectory_recorder.bag.reader import NOT_WHOLE
    from trajectory_recorder.bag.recovery import recover

    with progress_bar("recovering") as progress:
        found = recover(args.bag, args.output, progress=progress)
    for chunk in found.damage:
        print(f"left out: {chunk}", file=sys.stderr)
    if not found.complete:
        print(f"{args.bag}: {NOT_WHOLE}", file=sys.stderr)
    _tell_attachments(args.bag, found.attachments)
    if args.json:
        result = {
            "bag": str(args.output),
            "messages": found.messages,
            "damaged_chunks": len(found.damage),
            "complete": found.complete,
        }
        print(json.dumps(result))
    else:
        print(f"{found.messages} messages recovered to {args.output}")
    return 0
