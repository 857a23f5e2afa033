"""`tricycle demo`: from a plan to the parameters that are identified from its drive."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from excitation_planner.maneuver import family_by_name, family_names
from excitation_planner.planning import PlanRequest
from tricycle_cli.argument_types import at_least, parameter_name, real_time_factor
from tricycle_cli.options import (
    add_effects_option,
    add_overwrite_option,
    add_vehicle_option,
    check_output_files,
    describe_later,
    effects_asked,
)
from tricycle_cli.progress import progress_bar
from tricycle_core.documents import check_folder, write_whole
from tricycle_core.errors import BagError
from tricycle_core.optional import check_installed
from tricycle_sim.vehicle import UNKNOWN_PARAMETERS, Vehicle, load_vehicle

if TYPE_CHECKING:
    from collections.abc import Mapping

    from excitation_planner.plan import Plan
    from parameter_identification.identification import Identification
    from parameter_identification.judging.judgement import Judgement
    from tricycle_cli.reports.result_file import DemoResult

WRITTEN = (
    "plans/designed.json",
    "plans/random.json",
    "trajectories.png",
    "result.json",
    "report.html",
)

EXAMPLE = """\
example:
  tricycle demo --maneuver double-lane-change --target cornering_stiffness --seed 3
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = (
        "Plans an excitation maneuver and takes a random one of the same family beside "
        "it, drives both in simulation with hidden true parameters, through real nodes and serial "
        "devices, computes the trajectory error of each from its bag alone, and identifies the "
        "parameters from both."
    )
    parser.epilog = EXAMPLE
    add = parser.add_argument
    maneuver = add("--maneuver", default="circle")

    def describe() -> None:
        maneuver.help = f"family: {', '.join(family_names())}"

    describe_later(parser, describe)
    add(
        "--target",
        type=parameter_name,
        default=UNKNOWN_PARAMETERS[0],
        help="unknown parameter to excite",
    )
    add_vehicle_option(parser)
    add("--seed", type=at_least(0), default=0, help="of plan, random maneuver and hidden truth")
    add(
        "--real-time-factor",
        type=real_time_factor,
        default=10.0,
        help="largest; the nodes set the pace",
    )
    add(
        "--firmware",
        type=Path,
        metavar="DIR",
        help="drive the real firmware of this build on simulated UNOs (`make firmware`)",
    )
    add_effects_option(parser)
    add("--output", type=Path, default=Path("out/demo"), metavar="DIR")
    add_overwrite_option(parser)
    add("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Plan, drive, record, judge, identify; print the tables and say where everything is.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from excitation_planner.design.noise import SIMULATED
    from parameter_identification.drives.measured_from_bag import measured_drive
    from parameter_identification.drives.reader import read_drive
    from parameter_identification.identification import identify
    from parameter_identification.judging.judgement import judge_drive
    from tricycle_cli.operation.session import hidden_truth
    from tricycle_cli.reports.identification_files import FILES
    from tricycle_cli.reports.identification_page import save_identification
    from tricycle_cli.reports.remarks import remarks
    from tricycle_cli.reports.run_folder import read_run
    from tricycle_cli.reports.run_page import run_page
    from tricycle_cli.reports.static_figures import plot_drives
    from tricycle_cli.reports.tables import drives_table, parameter_table, table_console
    from tricycle_sim.plc.simulated_uno import check_build

    check_installed("rclpy", "a demo")
    effects = effects_asked(args)
    vehicle = load_vehicle(args.vehicle)
    request = PlanRequest(
        vehicle, family_by_name(args.maneuver), args.target, seed=args.seed, noise=SIMULATED
    )
    if args.firmware:
        check_build(args.firmware)
    output: Path = args.output
    earlier = (output / name for name in (*WRITTEN, *(f"identification/{name}" for name in FILES)))
    check_output_files(earlier, args)
    _make_room(output, overwrite=args.overwrite)

    plans = _plans(request, output / "plans")
    bags = {name: output / "bags" / name for name in plans}
    _drive(plans, bags, args)

    drives = {name: read_drive(bag) for name, bag in bags.items()}
    judgements = {name: judge_drive(drive) for name, drive in drives.items()}
    plot_drives(
        {_title(name, plan): judgements[name] for name, plan in plans.items()},
        output / "trajectories.png",
    )
    with progress_bar("identifying the parameters") as progress:
        measured = [measured_drive(drive, vehicle) for drive in drives.values()]
        identification = identify(
            measured,
            vehicle,
            **effects,
            profiles=True,
            seed=args.seed,
            progress=progress,
        )
    save_identification(identification, args.vehicle, output / "identification")

    truth = hidden_truth(vehicle, args.seed)
    expected = {name: _expected_error(request, plan, truth) for name, plan in plans.items()}
    result = _result(plans, expected, judgements, identification, truth).to_json()
    write_whole(output / "result.json", json.dumps(result, indent=2) + "\n")
    results = read_run(output, read=lambda bag: drives[bag.name])
    write_whole(output / "report.html", run_page(results, vehicle=vehicle))
    if args.json:
        print(json.dumps(result))
    console = table_console(stderr=args.json)
    console.print(drives_table(args.target, plans, expected, judgements))
    for name, plan in plans.items():
        if plan.verdict:
            console.print(f"{name}: {plan.verdict}")
    console.print(parameter_table(identification, truth))
    for remark in remarks(identification):
        console.print(remark, soft_wrap=True)
    for what, where in (
        *(("bags", "bags"), ("plans", "plans"), ("figure", "trajectories.png")),
        ("vehicle file with the estimates", "identification/vehicle.yaml"),
        ("report", "report.html"),
    ):
        console.print(f"{what}: {output / where}", soft_wrap=True)
    if not identification.parameters[args.target].identifiable:
        print(f"the drives do not show {args.target}, which they should", file=sys.stderr)
        return 1
    return 0


def _make_room(folder: Path, *, overwrite: bool) -> None:
    """Make an output folder, empty of an earlier demo's bags."""
    check_folder(folder)
    bags = folder / "bags"
    if bags.exists() and any(bags.iterdir()):
        if not overwrite:
            raise BagError(f"{bags}: holds bags already; choose another --output or --overwrite")
        shutil.rmtree(bags)
    folder.mkdir(parents=True, exist_ok=True)


def _plans(request: PlanRequest, folder: Path) -> dict[str, Plan]:
    """The designed maneuver and a random one, saved."""
    from excitation_planner.plan import save_plan
    from excitation_planner.planning import plan_at, plan_maneuver, random_feasible_point

    with progress_bar(f"planning {request.family.name} for {request.target}") as progress:
        designed = plan_maneuver(request, progress=progress)
        # a stream of its own: the truth is drawn from the seed alone
        random_x = random_feasible_point(request, np.random.default_rng([request.seed, 1]))
        plans = {"designed": designed, "random": plan_at(request, random_x)}
    for name, plan in plans.items():
        save_plan(plan, folder / f"{name}.json")
    return plans


def _drive(plans: Mapping[str, Plan], bags: Mapping[str, Path], args: argparse.Namespace) -> None:
    from tricycle_cli.operation.session import simulated_session

    with simulated_session(
        vehicle_file=args.vehicle,
        true_seed=args.seed,
        noise_seed=args.seed,
        real_time_factor=args.real_time_factor,
        folder=args.output,
        firmware=args.firmware,
    ) as drive:
        for name, plan in plans.items():
            with progress_bar(f"driving the {name} maneuver, ms") as progress:
                drive(plan, bags[name], progress)


def _result(
    plans: Mapping[str, Plan],
    expected: Mapping[str, float],
    judgements: Mapping[str, Judgement],
    found: Identification,
    truth: Mapping[str, float],
) -> DemoResult:
    from tricycle_cli.reports.result_file import DemoResult, DriveResult, ParameterResult

    drives = {
        name: DriveResult(
            x=plan.operation,
            main=plan.main[plan.target].value,
            total=plan.total[plan.target].value,
            cost=plan.cost,
            te_expected=expected[name],
            te_measured=judgements[name].te,
            te_corrected=judgements[name].te_corrected,
            rms=judgements[name].rms,
        )
        for name, plan in plans.items()
    }
    parameters = {
        name: ParameterResult(e.estimate, e.low, e.high, truth[name])
        for name, e in found.parameters.items()
    }
    return DemoResult(drives, parameters)


def _expected_error(request: PlanRequest, plan: Plan, truth: Mapping[str, float]) -> float:
    """Trajectory error [m²] of the model with the true parameters."""
    from excitation_planner.planning.replay import nominal_run, replayed_errors

    vehicle: Vehicle = request.vehicle
    x = np.array(list(plan.operation.values()))
    run = nominal_run(vehicle, request.family, x)
    return float(replayed_errors(vehicle, run, np.array([list(truth.values())]))[0])


def _title(name: str, plan: Plan) -> str:
    values = ", ".join(f"{key} {value:.3g}" for key, value in plan.operation.items())
    return f"{name} {plan.maneuver.replace('_', ' ')}: {values}"
