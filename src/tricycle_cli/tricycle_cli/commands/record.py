"""``tricycle record``: records topics until Ctrl-C."""

import argparse
import json
import math
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path

from trajectory_recorder.bag.reader import BagReader
from tricycle_cli.operation.processes import executable
from tricycle_core.errors import BagError

STOP_PERIOD = 0.1  # s between signals to a node that is to end

EXAMPLE = """\
examples:
  tricycle record --output bags/first
  tricycle record --topics 'maneuver/*' odom /imu --split-duration 60 --compression lz4
"""


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "record",
        help="record topics to a bag until Ctrl-C",
        description="Starts the node trajectory_recorder and records until Ctrl-C.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--output", type=Path, metavar="DIR", help="bag to create (default: bags/<date and time>)")
    add("--topics", nargs="+", metavar="TOPIC", help="names; * and ? match anything")
    add("--compression", choices=["zstd", "lz4", "none"], default="zstd", help="of chunks")
    new_file = "begin a new file after (default: never)"
    add("--split-size", type=not_negative, default=0.0, metavar="MB", help=new_file)
    add("--split-duration", type=not_negative, default=0.0, metavar="S", help=new_file)
    add(
        "--disk-reserve",
        type=not_negative,
        default=100.0,
        metavar="MB",
        help="stop when no more of the disk is free (default: %(default)s)",
    )
    add("--duration", type=not_negative, metavar="S", help="stop after seconds of wall time")
    add("--use-sim-time", action="store_true", help="stamp with /clock")
    add("--json", action="store_true", help="print one JSON object at the end")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Record, then say what was recorded."""
    output = args.output or Path("bags") / datetime.now().astimezone().strftime("%Y-%m-%dT%H-%M-%S")
    if output.exists():
        raise BagError(f"{output} exists: a bag is not overwritten, choose another name")
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
    if args.topics:
        parameters["topics"] = args.topics
    status = run_in_foreground("trajectory_recorder", parameters, duration=args.duration)
    if not output.exists():  # the node has said why
        return status
    with BagReader(output) as bag:
        messages = sum(topic.count for topic in bag.topics.values())
    if args.json:
        print(json.dumps({"bag": str(output), "messages": messages, "status": status}))
    else:
        print(f"{messages} messages in {output}")
    return status


def run_in_foreground(
    name: str,
    parameters: Mapping[str, object],
    *,
    remappings: Sequence[str] = (),
    duration: float | None = None,
) -> int:
    """Run a node until it ends, or SIGINT or SIGTERM ends it by way of this process.

    Parameters
    ----------
    name : of its executable
    parameters : by name
    remappings : of its names, ``/old:=/new``
    duration : s after which it is ended

    Returns
    -------
    Its exit status.
    """
    command = [executable(name), "--ros-args"]
    for key, value in parameters.items():
        command += ["-p", f"{key}:={json.dumps(value)}"]  # JSON is YAML
    for remapping in remappings:
        command += ["-r", remapping]
    stopped: list[int] = []
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # inherited: until it is up, Ctrl-C kills no node
    with subprocess.Popen(command) as process:  # noqa: S603 - our own executables
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda number, _: stopped.append(number))
        end = math.inf if duration is None else time.monotonic() + duration
        while True:
            try:
                return process.wait(STOP_PERIOD)
            except subprocess.TimeoutExpired:
                if stopped or time.monotonic() >= end:
                    process.send_signal(signal.SIGINT)  # again, until the node is up to take it


def not_negative(text: str) -> float:
    """Parse a number for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r}: needs a number, 0 or more")
    return value
