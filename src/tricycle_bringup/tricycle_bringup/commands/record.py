"""``tricycle record``: records topics until Ctrl-C."""

import argparse
import json
import signal
import subprocess
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

from trajectory_recorder.bag_reader import BagReader
from trajectory_recorder.topics import BagError
from tricycle_bringup.processes import executable

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
    add("--split-size", type=float, default=0.0, metavar="MB", help="begin a new file after")
    add("--split-duration", type=float, default=0.0, metavar="S", help="begin a new file after")
    add("--duration", type=float, metavar="S", help="stop after so many seconds of wall time")
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
        "use_sim_time": args.use_sim_time,
    }
    if args.topics:
        parameters["topics"] = args.topics
    status = run_in_foreground("trajectory_recorder", parameters, duration=args.duration)
    if status:
        return status
    with BagReader(output) as bag:
        messages = sum(topic.count for topic in bag.topics.values())
    if args.json:
        print(json.dumps({"bag": str(output), "messages": messages}))
    else:
        print(f"{messages} messages in {output}")
    return 0


def run_in_foreground(
    name: str, parameters: Mapping[str, object], *, duration: float | None = None
) -> int:
    """Run a node until it ends, or SIGINT or SIGTERM ends it by way of this process.

    Returns
    -------
    Its exit status.
    """
    command = [executable(name), "--ros-args"]
    for key, value in parameters.items():
        command += ["-p", f"{key}:={json.dumps(value)}"]  # JSON is YAML
    with subprocess.Popen(command) as process:  # noqa: S603 - our own executables
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: process.send_signal(signal.SIGINT))
        try:
            return process.wait(duration)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGINT)
            return process.wait()
