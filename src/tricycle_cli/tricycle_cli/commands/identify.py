"""`tricycle identify`: the unknown parameters and their intervals, from recorded drives."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

from tricycle_cli.argument_types import at_least, bag_argument, parameter_names, positive_number
from tricycle_cli.drives import is_table, read_drives
from tricycle_cli.options import (
    BAG_HELP,
    add_effects_option,
    add_other_vehicle_option,
    add_overwrite_option,
    add_topic_options,
    add_vehicle_option,
    add_workers_option,
    check_output_files,
    effects_asked,
    refuse_topics,
    topics_of,
)
from tricycle_cli.progress import progress_bar
from tricycle_cli.reports.identification_files import FILES, IDENTIFICATION, VEHICLE, remove_older
from tricycle_core.documents import check_folder, write_whole
from tricycle_core.errors import IdentificationError
from tricycle_core.optional import check_installed
from tricycle_sim.vehicle import load_vehicle

TABLE_WIDTH = 120  # characters; folded numbers cannot be read

EXAMPLE = """\
examples:
  tricycle identify out/demo/bags/*
  tricycle identify bags/circle bags/lane --held-out bags/check --output out/identified
  tricycle identify drive.csv --columns mapping.yaml --vehicle car.yaml --window 2
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = (
        "Fits the model to all drives together and prints each parameter with its "
        "interval. What the drives do not show is said and keeps its range."
    )
    parser.epilog = EXAMPLE
    add = parser.add_argument
    add(
        "drives",
        metavar="DRIVE",
        nargs="+",
        type=bag_argument,
        help=f"{BAG_HELP}; with --columns also .csv or .csv.gz",
    )
    add_vehicle_option(parser)
    add(
        "--parameters",
        type=parameter_names,
        metavar="NAME,NAME",
        help="show only these; the others are estimated too, so that the intervals count them "
        "(default: all unknown)",
    )
    add(
        "--hold-others",
        action="store_true",
        help="take what --parameters leaves out as known, at its nominal value",
    )
    add_other_vehicle_option(parser)
    add(
        "--held-out",
        type=bag_argument,
        metavar="DRIVE",
        nargs="+",
        default=[],
        help="drives to predict",
    )
    add_effects_option(
        parser,
        exceptions="; those of their set-points for tables; none for FMUs and drive by drive, "
        "where it takes minutes",
    )
    add(
        "--fmu",
        type=Path,
        metavar="MAPPING",
        help="simulate with the FMU of this mapping file in place of our own model",
    )
    add(
        "--inputs",
        choices=("either", "commands", "measured"),
        default="either",
        help="how steering and wheels move: as servo and speed loop of the file do under the "
        "commands, as measured, or as measured where they are of another kind (default: either)",
    )
    add("--robust", action="store_true", help="hold outliers back")
    add("--seed", type=at_least(0), default=0, help="of the starts")
    add("--json", action="store_true", help="print one JSON object")
    add(
        "--output",
        type=Path,
        metavar="DIR",
        help="write vehicle.yaml with the estimates, identification.json, figures and report.html",
    )
    add_overwrite_option(parser)
    add_topic_options(parser, sensors=True)
    add = parser.add_argument_group("tables (CSV), of which windows are taken").add_argument
    add("--columns", type=Path, metavar="FILE", help="mapping of their columns, YAML")
    add("--window", type=positive_number, metavar="S", help="length of a window (default: 2)")
    add(
        "--every",
        type=positive_number,
        metavar="S",
        help="grid on which windows begin (default: 0.5)",
    )
    add("--above", type=positive_number, metavar="M/S", help="speed in a window (default: 0.4)")
    add = parser.add_argument_group("hundreds of bags").add_argument
    add(
        "--drive-by-drive",
        type=Path,
        metavar="DIR",
        help="eliminate what each drive has of its own by itself, so that time and memory grow in "
        "proportion; with linear intervals, and effects where --effects names them. The drives "
        "read are kept in DIR: the same call goes on",
    )
    add_workers_option(parser)
    add("--leave-out", action="store_true", help="leave bags out that cannot be used")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Read the bags, identify, print, write.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    if args.output is not None:
        check_folder(args.output)
    _refuse_what_has_no_effect(args)
    if args.drive_by_drive is not None:
        return _drive_by_drive(args)
    from parameter_identification.drives.table import load_columns
    from parameter_identification.estimation.inputs import Inputs, effects_of_columns
    from parameter_identification.estimation.motions import Simulator
    from parameter_identification.estimation.problem import Loss
    from parameter_identification.estimation.redrawn import redraw_of
    from parameter_identification.identification import identify
    from parameter_identification.identification_file import document_of
    from tricycle_cli.reports.remarks import remarks, remarks_on_drives
    from tricycle_cli.reports.tables import parameter_table, table_console
    from tricycle_sim.vehicle.batch import CommandedBatch

    if args.output is not None:
        check_installed("jinja2", "the report of an identification")
        check_output_files((args.output / name for name in FILES), args)
    columns = None if args.columns is None else load_columns(args.columns)
    effects = effects_asked(args, "none" if args.fmu or columns else "weighed")
    if columns and not (args.effects or args.fmu):
        effects = {"effects": effects_of_columns(columns), "weighed": True}
    simulator: Simulator = CommandedBatch
    if args.fmu is not None:
        from tricycle_sim.fmi.batch import FmuSimulator

        simulator = FmuSimulator(args.fmu)
    vehicle = load_vehicle(args.vehicle)
    read = read_drives(args, vehicle, columns)
    redraw = None
    if args.fmu is None and all(drive.speed is not None for drive in read.used):
        redraw = redraw_of(read.tables)
    with progress_bar("identifying") as progress:
        identification = identify(
            read.used,
            vehicle,
            parameters=args.parameters,
            hold_others=args.hold_others,
            other_vehicle=args.other_vehicle,
            held_out=read.held_out,
            **effects,
            inputs=Inputs(args.inputs),
            simulator=simulator,
            loss=Loss.ROBUST if args.robust else Loss.SQUARED,
            profiles=True,
            redraw=redraw,
            seed=args.seed,
            progress=progress,
        )
    of_drives = remarks_on_drives(
        identification,
        read.used,
        read.held_out,
        tables=columns is not None,
        redrawn=redraw is not None,
    )
    console = table_console(stderr=args.json, width=TABLE_WIDTH)
    try:  # the reader of a pipe may leave
        if args.output is not None:
            from tricycle_cli.reports.identification_page import save_identification

            save_identification(identification, args.vehicle, args.output)
    finally:  # and a disk be full
        console.print(parameter_table(identification))
        for remark in (*remarks(identification), *read.remarks, *of_drives):
            console.print(remark, soft_wrap=True)
    if args.output is not None:
        console.print(f"vehicle file, figures and report: {args.output}", soft_wrap=True)
    if args.json:
        print(json.dumps(document_of(identification).to_json(), allow_nan=False))
    return 0


def _drive_by_drive(args: argparse.Namespace) -> int:
    """Identify from many bags, print, write."""
    from excitation_planner.design.executors import processes
    from parameter_identification.estimation.unknown import restrict
    from parameter_identification.identification_file import document_of, save_identification_file
    from parameter_identification.identified_vehicle import identified_vehicle
    from parameter_identification.many_drives import identify_many
    from tricycle_cli.reports.remarks import remarks_on_many
    from tricycle_cli.reports.tables import parameter_table, table_console

    others = {
        "--columns": args.columns,
        "--fmu": args.fmu,
        "--held-out": args.held_out,
        "--robust": args.robust,
        "--inputs": args.inputs != "either",
    }
    if wrong := [name for name, given in others.items() if given]:
        raise IdentificationError(f"--drive-by-drive: not together with {', '.join(wrong)}")
    effects = effects_asked(args, "none")
    if args.output is not None:
        check_output_files((args.output / name for name in FILES), args)
    vehicle = load_vehicle(args.vehicle)
    asked = restrict(vehicle, args.parameters or tuple(vehicle.unknown))
    with processes(args.workers) as executor, progress_bar("reading and fitting") as progress:
        identification = identify_many(
            args.drives,
            asked if args.hold_others else vehicle,
            folder=args.drive_by_drive,
            executor=executor,
            **effects,
            leave_out=args.leave_out,
            other_vehicle=args.other_vehicle,
            topics=topics_of(args),
            seed=args.seed,
            progress=progress,
        ).only(asked.unknown)
    if args.hold_others:
        held = {name: v for name, v in vehicle.nominal.items() if name not in asked.unknown}
        identification = replace(identification, fixed=held, vehicle_hash=vehicle.fingerprint)
    console = table_console(stderr=args.json, width=TABLE_WIDTH)
    document = document_of(identification)
    try:  # as above
        if args.output is not None:
            write_whole(args.output / VEHICLE, identified_vehicle(identification, args.vehicle))
            save_identification_file(document, args.output / IDENTIFICATION)
            remove_older(args.output, (VEHICLE, IDENTIFICATION))
    finally:
        console.print(parameter_table(identification))
        for remark in remarks_on_many(identification):
            console.print(remark, soft_wrap=True)
    if args.output is not None:
        console.print(f"vehicle file and numbers: {args.output}", soft_wrap=True)
    if args.json:
        print(json.dumps(document.to_json(), allow_nan=False))
    return 0


def _refuse_what_has_no_effect(args: argparse.Namespace) -> None:
    """Refuse options of tables without a table, of bags without a bag, of many drives for a few."""
    needed = {
        "--columns": (args.columns, ("window", "every", "above")),
        "--drive-by-drive": (args.drive_by_drive, ("workers", "leave_out")),
        "--parameters": (args.parameters, ("hold_others",)),
    }
    for option, (given, depending) in needed.items():
        for name in depending:
            if given is None and getattr(args, name) not in (None, False):
                raise IdentificationError(f"--{name.replace('_', '-')}: only with {option}")
    needs_table = args.columns is not None and args.drive_by_drive is None
    if needs_table and not any(map(is_table, [*args.drives, *args.held_out])):
        raise IdentificationError("--columns: no drive is a table, which ends in .csv or .csv.gz")
    if needs_table and all(map(is_table, [*args.drives, *args.held_out])):
        refuse_topics(args, "only for bags; every drive is a table")
