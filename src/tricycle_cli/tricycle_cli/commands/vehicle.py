"""`tricycle vehicle`: check a vehicle file."""

import argparse
import json
from pathlib import Path

from tricycle_core.timing import TICK
from tricycle_sim.vehicle import load_vehicle, warnings_about

EXAMPLE = """\
example:
  tricycle vehicle check my_tricycle.yaml
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
    check = verbs.add_parser(
        "check",
        help="validate a vehicle file and warn about what is physically impossible",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    check.add_argument(
        "file", nargs="?", type=Path, metavar="FILE", help="vehicle YAML (default: the packaged)"
    )
    check.add_argument("--json", action="store_true", help="print one JSON object")
    check.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Validate, and print what is doubtful; a wrong file raises `VehicleError`.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from rich.console import Console
    from rich.table import Table

    from tricycle_sim.vehicle.stability import LIMIT, check_step, fastest_mode

    vehicle = load_vehicle(args.file)
    check_step(vehicle, TICK)
    fastest, _ = fastest_mode(vehicle)
    warnings = warnings_about(vehicle)
    names = [wheel.name for wheel in vehicle.wheels]
    loads = dict(zip(names, vehicle.static_loads(), strict=True))
    if args.json:
        result = {
            "name": vehicle.name,
            "hash": vehicle.fingerprint,
            "unknown": {name: list(limits) for name, limits in vehicle.unknown.items()},
            "nominal": vehicle.nominal,
            "static_loads": loads,
            "fastest_mode": fastest,
            "warnings": list(warnings),
        }
        print(json.dumps(result))
        return 0
    console = Console(highlight=False)
    console.print(f"{vehicle.name}: valid (hash {vehicle.fingerprint})")
    table = Table("unknown parameter", "low", "nominal", "high", "unit")
    for name, (low, high) in vehicle.unknown.items():
        table.add_row(
            name, f"{low:g}", f"{vehicle.nominal[name]:g}", f"{high:g}", vehicle.unit(name)
        )
    console.print(table)
    console.print("wheel loads at rest: " + ", ".join(f"{w} {n:.1f} N" for w, n in loads.items()))
    console.print(
        f"fastest motion: {fastest:.0f} rad/s; steps of {1e3 * TICK:g} ms allow {LIMIT / TICK:.0f}"
    )
    for warning in warnings:
        console.print(f"warning: {warning}", style="yellow", soft_wrap=True)
    return 0
