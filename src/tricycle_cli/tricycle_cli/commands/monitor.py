"""`tricycle monitor`: a live run in the terminal."""

import argparse
import json
import time

from tricycle_cli.argument_types import namespace
from tricycle_cli.console import plain_console
from tricycle_core.errors import NodeError

EXAMPLE = """\
examples:
  tricycle monitor
  ROS_DOMAIN_ID=7 tricycle monitor --namespace left
  tricycle monitor --json
"""

REFRESH = 0.2  # s between pictures
PATIENCE = 5.0  # s that --json waits for what every run says


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = (
        "Listens on ROS_DOMAIN_ID and shows the state of the links and of the "
        "maneuver, its progress, and the speeds, until Ctrl-C."
    )
    parser.epilog = EXAMPLE
    add = parser.add_argument
    add(
        "--namespace",
        type=namespace,
        default="",
        metavar="NAME",
        help="of the tricycle (default: none)",
    )
    add("--json", action="store_true", help="print what is heard as one JSON object and end")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Show the run until Ctrl-C, or print the present state once.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from rich.live import Live

    from tricycle_cli.operation.dashboard import screen
    from tricycle_cli.operation.monitor_node import Monitor
    from tricycle_cli.operation.processes import asked_domain

    console = plain_console()
    drawn = console.is_terminal and not console.is_dumb_terminal
    if not (args.json or drawn):
        raise NodeError("monitor draws in a terminal; into a file or a pipe: --json")
    domain = asked_domain() or 0
    where = f"domain {domain}" + (f", namespace {args.namespace}" if args.namespace else "")
    with Monitor(domain=domain, namespace=args.namespace) as monitor:
        dashboard = monitor.dashboard
        if args.json:
            deadline = time.monotonic() + PATIENCE
            while time.monotonic() < deadline and not dashboard.complete:
                monitor.listen(REFRESH)
            if dashboard.heard is None:
                raise NodeError(f"{where}: nothing heard in {PATIENCE:.0f} s; is the run on it?")
            print(json.dumps(dashboard.snapshot()))
            return 0
        try:
            with Live(console=console, auto_refresh=False, screen=True) as live:
                while True:
                    live.update(screen(dashboard, now=time.monotonic(), where=where), refresh=True)
                    monitor.listen(REFRESH)
        except KeyboardInterrupt:
            return 0
