"""The `tricycle` command: one subcommand per step, each a module of `commands`."""

import argparse
import logging
import signal
import sys
from collections.abc import Sequence
from importlib import import_module

from tricycle_core import __version__
from tricycle_core.errors import ExcitationError

COMMANDS = (
    "demo",
    "plan",
    "campaign",
    "reproduce",
    "drive",
    "simulate",
    "record",
    "replay",
    "judge",
    "identify",
    "report",
    "monitor",
    "bag",
    "vehicle",
    "plc",
)


def parser(names: Sequence[str] = COMMANDS) -> argparse.ArgumentParser:
    """The command line with these subcommands."""
    top = argparse.ArgumentParser(
        prog="tricycle",
        description="Plan, drive, record and judge excitation maneuvers of an X-by-wire tricycle.",
    )
    top.add_argument("--version", action="version", version=__version__)
    subparsers = top.add_subparsers(metavar="COMMAND", required=True)
    for name in names:
        import_module(f"tricycle_cli.commands.{name}").add_parser(subparsers)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; a user's mistake is one line on stderr and status 2."""
    words = sys.argv[1:] if argv is None else list(argv)
    logging.basicConfig(format="%(message)s")
    logging.getLogger("tricycle_sim").setLevel(logging.INFO)  # says when it compiles the vehicle
    # SIGTERM ends a run as Ctrl-C does: in order, with its child processes
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    # importing them all takes seconds; only the help of the whole needs it
    wanted = words[:1] if words[:1] and words[0] in COMMANDS else COMMANDS
    try:
        arguments = parser(wanted).parse_args(words)
        status: int = arguments.run(arguments)
    except BrokenPipeError:  # `tricycle … | head`
        return 0
    except KeyboardInterrupt:
        print("tricycle: interrupted", file=sys.stderr)
        return 130
    except (ExcitationError, OSError) as error:
        # what files say of themselves may hold line breaks or terminal escapes
        line = "".join(c if c.isprintable() else " " for c in str(error))
        print(f"tricycle: {line}", file=sys.stderr)
        return 2
    return status
