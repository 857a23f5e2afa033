"""`tricycle simulate`: replay commands on the vehicle, write its trajectory."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from excitation_planner.maneuver import (
    family_by_name,
    family_names,
    operation_point,
    with_ranges,
)
from tricycle_cli.argument_types import at_least, file_ending_in, parse_assignments
from tricycle_cli.options import (
    add_overwrite_option,
    add_range_options,
    add_vehicle_option,
    check_output_files,
    describe_later,
    ranges_of,
    refuse_given,
    warn_about,
)
from tricycle_cli.progress import progress_bar
from tricycle_core.errors import CommandsError, InfeasibleManeuver, PlanError, VehicleError
from tricycle_core.optional import check_installed
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands, load_commands
from tricycle_sim.trajectory_files import PICTURES, SUFFIXES, plot_trajectory, save_trajectory
from tricycle_sim.vehicle import Vehicle, load_vehicle

if TYPE_CHECKING:
    from tricycle_sim.vehicle.feasibility import Event, Feasibility

EXAMPLE = """\
examples:
  tricycle simulate --commands drive.csv --output drive_out.csv --plot
  tricycle simulate --maneuver circle radius=3 speed=0.8 --output circle.parquet
  tricycle simulate --commands drive.csv --set cornering_stiffness=700 --output soft.mcap
  tricycle simulate --commands drive.csv --samples 50 --seed 1 --output spread.parquet

commands.csv has the columns time, steering_motor_angle, speed in s, rad, m/s;
each row is held until the next, the last one ends the drive. The vehicle starts
at rest at the origin, heading +x.
"""

_LONG = 10_000_000  # vehicle steps that take longer than a moment
_MOST_ROWS = 10_000_000  # in memory they take about 6 GB


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = (
        "Replays a command history on the simulated vehicle and writes a row of its "
        "state every 10 ms."
    )
    parser.epilog = EXAMPLE
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--commands", type=Path, metavar="FILE.csv", help="commands to replay")
    maneuver = source.add_argument("--maneuver", nargs="+", metavar=("NAME", "PARAMETER=VALUE"))

    def describe() -> None:
        maneuver.help = (
            "make the commands: the vehicle of the file, without --set, drives this maneuver of "
            f"{', '.join(family_names())}"
        )

    describe_later(parser, describe)
    add_range_options(parser)
    add = parser.add_argument
    add_vehicle_option(parser)
    add("--set", nargs="+", action="extend", default=[], metavar="NAME=VALUE", help="constants")
    add(
        "--samples",
        type=at_least(1),
        metavar="N",
        help="draw N vehicles from the unknown's ranges",
    )
    add("--seed", type=at_least(0), default=0, help="of the draw")
    add("--output", type=_output, required=True, metavar="FILE", help=", ".join(SUFFIXES))
    add(
        "--plot",
        nargs="?",
        type=file_ending_in(*PICTURES),
        const=Path(),
        metavar="PICTURE",
        help="save a picture too",
    )
    add_overwrite_option(parser)
    add("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Simulate, save and say what came out.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from tricycle_sim.vehicle.batch import simulate

    nominal = load_vehicle(args.vehicle)
    values = parse_assignments(args.set)
    vehicle = nominal.replace(**values)
    if args.samples is not None and (drawn := values.keys() & vehicle.unknown.keys()):
        names = ", ".join(sorted(drawn))
        raise VehicleError(f"--set: {names} is unknown, and --samples draws it: leave out one")
    commands = _commands(args, nominal)
    if args.samples is not None:
        warn_about(vehicle, args)
    picture = args.output.with_suffix(".png") if args.plot == Path() else args.plot
    if picture is not None:
        check_installed("matplotlib", "a picture")
    check_output_files(filter(None, (args.output, picture)), args)
    _check_size(args.samples or 1, commands)
    parameters = None if args.samples is None else _draw(vehicle, args.samples, args.seed)
    steps = (args.samples or 1) * commands.duration / TICK
    bar = progress_bar("simulating") if steps > _LONG else contextlib.nullcontext()
    with bar as progress:
        trajectory = simulate(vehicle, commands, parameters, progress=progress)
    rows = save_trajectory(trajectory, args.output, vehicle=vehicle, parameters=parameters)
    if picture is not None:
        plot_trajectory(trajectory, picture)
    result = {
        "output": str(args.output),
        "plot": None if picture is None else str(picture),
        "rows": rows,
        "samples": len(trajectory.x),
        "duration": float(trajectory.time[-1]),
        **_feasibility(trajectory.feasibility),
    }
    if args.json:
        print(json.dumps(result))
    else:
        _print(result)
    return 0


def _commands(args: argparse.Namespace, vehicle: Vehicle) -> Commands:
    if args.commands is not None:
        refuse_given(args, ("range", "ranges"), "only with --maneuver")
        if args.output.exists() and args.output.samefile(args.commands):
            raise CommandsError(f"{args.output}: --output would overwrite the commands")
        return load_commands(args.commands)
    from excitation_planner.planning.replay import nominal_run

    name, *values = args.maneuver
    (family,) = with_ranges([family_by_name(name)], ranges_of(args))
    point = operation_point(family, parse_assignments(values))
    try:
        return nominal_run(vehicle, family, point).commands
    except InfeasibleManeuver as error:
        raise PlanError(f"{family.name}: cannot be driven: {error}") from error


def _check_size(samples: int, commands: Commands) -> None:
    from tricycle_sim.setpoints import tick_count

    rows = samples * (tick_count(commands.duration) + 1)
    if rows > _MOST_ROWS:
        raise CommandsError(
            f"{samples} vehicle(s) for {commands.duration:g} s: {rows} rows are more than the "
            f"{_MOST_ROWS} that fit: simulate fewer"
        )


def _feasibility(feasibility: Feasibility) -> dict[str, Any]:
    """Return why samples are infeasible, and the worst values with time and place."""
    return {
        "feasible": int(feasibility.feasible.sum()),
        "reasons": [
            {"sample": sample, "reason": reason}
            for sample in np.flatnonzero(~feasibility.feasible).tolist()
            for reason in feasibility.reasons(sample)
        ],
        "least_load": {
            wheel: _worst(event, np.argmin) for wheel, event in feasibility.least_load.items()
        },
        "friction_used": _worst(feasibility.friction),
        "motor_saturated": _worst(feasibility.motor_saturated),
    }


def _worst(
    event: Event, worst: Callable[[FloatArray], np.intp] = np.argmax
) -> dict[str, float] | None:
    """Return the event of the sample to which the worst happened; None if it never did."""
    if not event.happened.any():
        return None
    sample = int(worst(event.value))
    values = {name: float(getattr(event, name)[sample]) for name in ("value", "time", "x", "y")}
    return {"sample": sample, **values}


def _print(result: Mapping[str, Any]) -> None:
    def place(event: Mapping[str, float]) -> str:
        return (
            f"at {event['time']:.2f} s, x = {event['x']:.2f} m, y = {event['y']:.2f} m"
            f" (vehicle {event['sample']})"
        )

    print(
        f"{result['rows']} rows of {result['samples']} vehicle(s), {result['duration']:.2f} s: "
        f"{result['output']}"
    )
    if result["plot"] is not None:
        print(f"picture: {result['plot']}")
    for wheel, event in result["least_load"].items():
        print(f"smallest load {wheel}: {event['value']:.1f} N {place(event)}")
    if event := result["friction_used"]:
        print(f"largest share of a wheel's friction: {event['value']:.0%} {place(event)}")
    if event := result["motor_saturated"]:
        print(f"motor saturated: {event['value']:.1f} N m missing {place(event)}")
    reasons = result["reasons"]
    for item in reasons[:10]:
        print(f"infeasible, vehicle {item['sample']}: {item['reason']}", file=sys.stderr)
    if len(reasons) > 10:
        print(f"... and {len(reasons) - 10} more (--json lists all)", file=sys.stderr)


def _draw(vehicle: Vehicle, samples: int, seed: int) -> FloatArray:
    """Uniform samples (n, k) of the unknown parameters."""
    rng = np.random.default_rng(seed)
    low, high = np.array(list(vehicle.unknown.values())).reshape(-1, 2).T
    return rng.uniform(low, high, (samples, len(low)))


def _output(text: str) -> Path:
    path = file_ending_in(*SUFFIXES)(text)
    if path.suffix == ".parquet":
        try:  # also whether it takes this NumPy
            importlib.import_module("pyarrow").array(np.zeros(1))
        except ImportError as error:
            raise argparse.ArgumentTypeError(f"{text}: needs pyarrow: {error}") from None
    return path
