"""``tricycle record``: records topics until Ctrl-C."""

import argparse
import json
import math
from datetime import datetime
from pathlib import Path

from tricycle_cli.argument_types import key_and_value, nonnegative_number
from tricycle_cli.operation.processes import run_in_foreground

EXAMPLE = """\
examples:
  tricycle record --output bags/first
  tricycle record --metadata vehicle_id=trike_7
  tricycle record --topics '*' --exclude '/camera/*'
  tricycle record --topics 'maneuver/*' odom /imu --split-duration 60 --compression lz4
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = "Starts the node trajectory_recorder and records until Ctrl-C."
    parser.epilog = EXAMPLE
    add = parser.add_argument
    add("--output", type=Path, metavar="DIR", help="bag to create (default: bags/<date and time>)")
    add("--topics", nargs="+", metavar="TOPIC", help="names; * and ? match anything")
    add("--exclude", nargs="+", metavar="TOPIC", help="names not to record, of those")
    add(
        "--metadata",
        type=key_and_value,
        nargs="+",
        metavar="KEY=VALUE",
        help="entries of the bag's metadata, as vehicle_id=trike_7",
    )
    add("--compression", choices=["zstd", "lz4", "none"], default="zstd", help="of chunks")
    new_file = "begin a new file after (default: never)"
    add("--split-size", type=nonnegative_number, default=0.0, metavar="MB", help=new_file)
    add("--split-duration", type=nonnegative_number, default=0.0, metavar="S", help=new_file)
    add(
        "--disk-reserve",
        type=nonnegative_number,
        default=100.0,
        metavar="MB",
        help="stop when no more of the disk is free (default: %(default)s)",
    )
    add(
        "--duration",
        type=nonnegative_number,
        metavar="S",
        help="stop after so many seconds of recording (wall time)",
    )
    add("--use-sim-time", action="store_true", help="stamp with /clock")
    add("--json", action="store_true", help="print one JSON object at the end")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Record, then say what was recorded.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from trajectory_recorder.bag.reader import BagReader
    from trajectory_recorder.bag.writer import check_new

    output = args.output or Path("bags") / datetime.now().astimezone().strftime("%Y-%m-%dT%H-%M-%S")
    check_new(output)
    parameters: dict[str, object] = {
        "record": True,
        "output": str(output),
        "compression": args.compression,
        "split_size": args.split_size,
        "split_duration": args.split_duration,
        "disk_reserve": args.disk_reserve,
        "exit_on_failure": True,
        "use_sim_time": args.use_sim_time,
    }
    for name in ("topics", "exclude", "metadata"):
        if given := getattr(args, name):
            parameters[name] = given
    duration = math.inf if args.duration is None else args.duration
    status = run_in_foreground("trajectory_recorder", parameters, duration=duration, since=output)
    if not output.exists():  # the node has said why
        return status
    with BagReader(output) as bag:
        messages = sum(topic.count for topic in bag.topics.values())
    if args.json:
        print(json.dumps({"bag": str(output), "messages": messages, "status": status}))
    else:
        print(f"{messages} messages in {output}")
    return status
