"""`tricycle simulate`: replay commands on the vehicle, write its trajectory."""

import argparse
import contextlib
import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from excitation_planner.errors import InfeasibleManeuver
from excitation_planner.maneuver import PlanError, family_by_name, family_names, operation_point
from excitation_planner.replay import nominal_run
from tricycle_bringup.progress import progress_bar
from tricycle_sim.commands import Commands, load_commands
from tricycle_sim.output import SUFFIXES, plot_trajectory, save_trajectory
from tricycle_sim.simulation import Trajectory, simulate
from tricycle_sim.vehicle import Vehicle, VehicleError, load_vehicle

EXAMPLE = """\
examples:
  tricycle simulate --commands drive.csv --output drive_out.csv --plot
  tricycle simulate --maneuver circle radius=3 speed=0.8 --output circle.parquet
  tricycle simulate --commands drive.csv --set cornering_stiffness=700 --output soft.mcap
  tricycle simulate --commands drive.csv --samples 50 --seed 1 --output spread.parquet

commands.csv has the columns time, steering_motor_angle, speed in s, rad, m/s; each row is held
until the next, the last one ends the drive. The vehicle starts at rest at the origin, heading +x.
"""

_LONG = 10_000_000  # vehicle steps that take longer than a moment


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "simulate",
        help="replay commands on the 9-DOF vehicle, write its trajectory",
        description="Replays a command history on the simulated vehicle and writes a row of its "
        "state every 10 ms.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--commands", type=Path, metavar="FILE.csv", help="commands to replay")
    source.add_argument(
        "--maneuver",
        nargs="+",
        metavar=("NAME", "PARAMETER=VALUE"),
        help="make the commands: the vehicle of the file, without --set, drives this maneuver of "
        f"{', '.join(family_names())}",
    )
    add = parser.add_argument
    add("--vehicle", type=Path, metavar="FILE", help="vehicle YAML (default: the paper's tricycle)")
    add("--set", nargs="+", action="extend", default=[], metavar="NAME=VALUE", help="constants")
    add("--samples", type=_count, metavar="N", help="draw N vehicles from the unknown's ranges")
    add("--seed", type=int, default=0, help="of the draw (default: %(default)s)")
    add("--output", type=_output, required=True, metavar="FILE", help=", ".join(SUFFIXES))
    add("--plot", nargs="?", type=Path, const=Path(), metavar="PICTURE", help="save a picture too")
    add("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Simulate, save and say what came out."""
    nominal = load_vehicle(args.vehicle)
    vehicle = nominal.replace(**_assignments("--set", args.set, VehicleError))
    commands = _commands(args, nominal)
    parameters = None if args.samples is None else _draw(vehicle, args.samples, args.seed)
    steps = (args.samples or 1) * commands.duration * 100
    bar = progress_bar("simulating") if steps > _LONG else contextlib.nullcontext()
    with bar as progress:
        trajectory = simulate(vehicle, commands, parameters, progress=progress)
    rows = save_trajectory(trajectory, args.output, vehicle=vehicle, parameters=parameters)
    picture = None
    if args.plot is not None:
        picture = args.output.with_suffix(".png") if args.plot == Path() else args.plot
        plot_trajectory(trajectory, picture)
    _report(trajectory, args, rows, picture)
    return 0


def _report(
    trajectory: Trajectory, args: argparse.Namespace, rows: int, picture: Path | None
) -> None:
    feasible = trajectory.feasibility.feasible
    reasons = [
        (sample, reason)
        for sample in np.flatnonzero(~feasible).tolist()
        for reason in trajectory.feasibility.reasons(sample)
    ]
    result = {
        "output": str(args.output),
        "plot": None if picture is None else str(picture),
        "rows": rows,
        "samples": len(feasible),
        "duration": float(trajectory.time[-1]),
        "feasible": int(feasible.sum()),
        "reasons": [{"sample": sample, "reason": reason} for sample, reason in reasons],
        "friction_used": float(trajectory.feasibility.friction.value.max()),
        "motor_saturated": int(trajectory.feasibility.motor_saturated.happened.sum()),
    }
    if args.json:
        print(json.dumps(result))
        return
    print(f"{rows} rows of {len(feasible)} vehicle(s), {trajectory.time[-1]:.2f} s: {args.output}")
    if picture is not None:
        print(f"picture: {picture}")
    print(f"largest share of a wheel's friction used: {result['friction_used']:.0%}")
    if result["motor_saturated"]:
        print(f"motor saturated: {result['motor_saturated']} of {len(feasible)}")
    for sample, reason in reasons[:10]:
        print(f"infeasible, vehicle {sample}: {reason}", file=sys.stderr)
    if len(reasons) > 10:
        print(f"... and {len(reasons) - 10} more (--json lists all)", file=sys.stderr)


def _commands(args: argparse.Namespace, vehicle: Vehicle) -> Commands:
    if args.commands is not None:
        return load_commands(args.commands)
    name, *values = args.maneuver
    family = family_by_name(name)
    point = operation_point(family, _assignments("--maneuver", values, PlanError))
    try:
        return nominal_run(vehicle, family, point).commands
    except InfeasibleManeuver as error:
        raise PlanError(f"{family.name}: cannot be driven: {error}") from error


def _assignments(option: str, items: list[str], error: type[ValueError]) -> dict[str, float]:
    """Parse name=value items; raise `error` for another form."""
    values: dict[str, float] = {}
    for item in items:
        name, _, value = item.partition("=")
        try:
            values[name] = float(value)
        except ValueError:
            raise error(f"{option} {item}: needs name=number") from None
    return values


def _draw(vehicle: Vehicle, samples: int, seed: int) -> NDArray[np.float64]:
    """Uniform samples (n, k) of the unknown parameters."""
    rng = np.random.default_rng(seed)
    low, high = np.array(list(vehicle.unknown.values())).reshape(-1, 2).T
    return rng.uniform(low, high, (samples, len(low)))


def _count(text: str) -> int:
    if not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"'{text}' is not a number of samples, 1 or more")
    return int(text)


def _output(text: str) -> Path:
    path = Path(text)
    if path.suffix not in SUFFIXES:
        raise argparse.ArgumentTypeError(f"{text}: needs to end in one of {', '.join(SUFFIXES)}")
    if path.suffix == ".parquet" and importlib.util.find_spec("pyarrow") is None:
        raise argparse.ArgumentTypeError(f"{text}: Parquet needs the package pyarrow")
    return path
