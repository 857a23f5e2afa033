"""`tricycle vehicle`: write a vehicle file, check it, show what follows from it."""

import argparse
import json
import shlex
import sys
from pathlib import Path
from typing import Any

import yaml

from tricycle_cli.argument_types import file_ending_in
from tricycle_cli.completion import HelpFormatter
from tricycle_cli.console import plain_console
from tricycle_cli.options import add_overwrite_option, check_output_files
from tricycle_core.documents import write_whole
from tricycle_core.errors import VehicleError
from tricycle_core.optional import check_installed
from tricycle_core.timing import TICK
from tricycle_sim.vehicle import Vehicle, load_vehicle, parse_vehicle, warnings_about

EXAMPLE = """\
examples:
  tricycle vehicle new my_vehicle.yaml
  tricycle vehicle check my_vehicle.yaml --draw my_vehicle.svg
  tricycle vehicle show bridge my_vehicle.yaml > bridge.yaml
  tricycle vehicle export-fmu my_vehicle.yaml --output my_vehicle.fmu
"""

SHOWN = {
    "urdf": "model for RViz and robot_state_publisher",
    "foxglove": "layout with the model in it",
    "bridge": "parameter file of the bridge, where no launch file fills it in",
}
"""What `vehicle show` prints, by its name."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.epilog = EXAMPLE
    verbs = parser.add_subparsers(metavar="VERB", required=True)
    new = _verb(verbs, "new", "write a first vehicle file: asks some twenty questions")
    new.add_argument("output", type=Path, metavar="OUTPUT", help="YAML to write")
    new.add_argument(
        "--from",
        dest="source",
        metavar="FILE",
        help="take the numbers of this vehicle file, or of the shipped vehicle of this name, "
        "instead of asking",
    )
    add_overwrite_option(new)
    new.set_defaults(run=run_new)
    check = _verb(verbs, "check", "validate a vehicle file and warn about what is odd")
    _add_file(check)
    check.add_argument(
        "--draw",
        type=file_ending_in(".svg", ".png", ".pdf"),
        metavar="PICTURE",
        help="draw it from above, to scale: SVG, PNG or PDF",
    )
    add_overwrite_option(check)
    check.add_argument("--json", action="store_true", help="print one JSON object")
    check.set_defaults(run=run_check)
    show = _verb(verbs, "show", "print what follows from a vehicle file, for other programs")
    show.add_argument(
        "what", choices=SHOWN, help="; ".join(f"{name}: {about}" for name, about in SHOWN.items())
    )
    _add_file(show)
    show.set_defaults(run=run_show)
    export = _verb(
        verbs, "export-fmu", "write it as an FMU 2.0 for co-simulation that needs no Python"
    )
    _add_file(export)
    fmu = file_ending_in(".fmu")
    export.add_argument("--output", type=fmu, required=True, metavar="OUTPUT", help="FMU to write")
    add_overwrite_option(export)
    export.set_defaults(run=run_export_fmu)


def _verb(verbs: Any, name: str, summary: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = verbs.add_parser(
        name, help=summary, epilog=EXAMPLE, formatter_class=HelpFormatter
    )
    return parser


def _add_file(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file", nargs="?", type=Path, metavar="FILE", help="vehicle YAML (default: the packaged)"
    )


def run_new(args: argparse.Namespace) -> int:
    """Write a vehicle file.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.

    Raises
    ------
    VehicleError
        If the file exists, there is no terminal to ask at, or the answers do not make a vehicle:
        nothing is written then.
    """
    from tricycle_cli.new_vehicle import ask, from_answers, from_file

    check_output_files([args.output], args)
    if args.source is not None:
        text = from_file(args.source, args.output.stem)
    elif not sys.stdin.isatty():
        raise VehicleError(
            "vehicle new asks questions, and this is not a terminal: give --from FILE"
        )
    else:
        try:
            text = from_answers(ask(input, lambda problem: print(f"  {problem}", file=sys.stderr)))
        except EOFError:
            raise VehicleError("the questions were not answered: nothing is written") from None
    parse_vehicle(text.encode(), f"{args.output}, not written")
    write_whole(args.output, text)
    command = shlex.join(["tricycle", "vehicle", "check", str(args.output)])
    print(f"{args.output}: written; look at it with: {command}")
    return 0


def run_export_fmu(args: argparse.Namespace) -> int:
    """Write the vehicle as an FMU.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.

    Raises
    ------
    VehicleError
        If the file exists, or there is no C compiler.
    """
    from tricycle_sim.fmi.export import export_fmu

    check_output_files([args.output], args)
    vehicle = load_vehicle(args.file)
    for name in export_fmu(vehicle, args.output):
        print(f"{name}: unknown, but no parameter of the FMU: it is compiled in", file=sys.stderr)
    print(f"{args.output}: written")
    return 0


def run_check(args: argparse.Namespace) -> int:
    """Validate, and print what is odd; a wrong file raises `VehicleError`.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from rich.table import Table

    from tricycle_sim.vehicle.stability import LIMIT, check_step, fastest_mode

    vehicle = load_vehicle(args.file)
    check_step(vehicle, TICK)
    if args.draw is not None:
        _draw(vehicle, args)  # before anything is printed: it may be refused
    fastest, _ = fastest_mode(vehicle)
    warnings = (*warnings_about(vehicle), *_about_the_boards(vehicle))
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
    console = plain_console(highlight=False)
    console.print(f"{vehicle.name}: valid (hash {vehicle.fingerprint})")
    table = Table("unknown parameter", "low", "nominal", "high", "unit")
    for name, (low, high) in vehicle.unknown.items():
        nominal, unit = vehicle.nominal[name], vehicle.unit(name)
        table.add_row(name, f"{low:g}", f"{nominal:g}", f"{high:g}", unit)
    console.print(table)
    console.print("wheel loads at rest: " + ", ".join(f"{w} {n:.1f} N" for w, n in loads.items()))
    console.print(
        f"fastest motion: {fastest:.0f} rad/s; steps of {1e3 * TICK:g} ms allow {LIMIT / TICK:.0f}"
    )
    for warning in warnings:
        console.print(f"warning: {warning}", style="yellow", soft_wrap=True)
    if args.draw is not None:
        console.print(f"figure: {args.draw}", soft_wrap=True)
    return 0


def _draw(vehicle: Vehicle, args: argparse.Namespace) -> None:
    from tricycle_cli.reports.vehicle_drawing import draw_vehicle

    path: Path = args.draw
    check_installed("matplotlib", "a drawing")
    check_output_files([path], args)
    draw_vehicle(vehicle, path)


def _about_the_boards(vehicle: Vehicle) -> tuple[str, ...]:
    from tricycle_bringup.configuration import beyond_the_boards, bridge_settings

    try:
        bridge_settings(vehicle)
    except VehicleError as error:
        return (str(error),)
    return beyond_the_boards(vehicle)


def run_show(args: argparse.Namespace) -> int:
    """Print what follows from a vehicle file.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from tricycle_bringup.configuration import bridge_parameters
    from tricycle_bringup.layout import foxglove_layout
    from tricycle_bringup.urdf import tricycle_urdf

    vehicle = load_vehicle(args.file)
    if args.what == "bridge":
        parameters = bridge_parameters("" if args.file is None else str(args.file))
        section = {"/**/tricycle_bridge": {"ros__parameters": parameters}}
        print(yaml.safe_dump(section, sort_keys=False), end="")
    else:
        text = {"urdf": tricycle_urdf, "foxglove": foxglove_layout}[args.what](vehicle)
        print(text, end="")
    return 0
