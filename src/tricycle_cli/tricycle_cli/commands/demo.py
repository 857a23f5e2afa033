"""`tricycle demo`: the whole way, from a plan to the parameters that its bag tells."""

import argparse
import json
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from excitation_planner.maneuver import family_by_name, family_names
from excitation_planner.plan import Plan, save_plan
from excitation_planner.planning import PlanRequest, plan_at, plan_maneuver, random_feasible_point
from excitation_planner.planning.replay import nominal_run, replayed_errors
from parameter_identification.drives.measured import read_measured_drive
from parameter_identification.identification import identify
from parameter_identification.judging.judgement import Judgement, judge
from tricycle_cli.argument_types import real_time_factor, seed
from tricycle_cli.operation.session import make_room, simulated_session
from tricycle_cli.progress import progress_bar
from tricycle_cli.reports.figures import plot_drives
from tricycle_cli.reports.identification_report import parameter_table, remarks, save_identification
from tricycle_cli.reports.run_data import read_run
from tricycle_cli.reports.run_report import report_page
from tricycle_sim.plc.simulated_uno import check_build
from tricycle_sim.vehicle import UNKNOWN_PARAMETERS, Vehicle, draw_truth, load_vehicle

EXAMPLE = """\
example:
  tricycle demo --maneuver double-lane-change --target cornering_stiffness --seed 3
"""


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "demo",
        help="plan a maneuver, drive it and a random one on emulated PLCs, judge, identify",
        description="Plans an excitation maneuver and takes a random one of the same family beside "
        "it, drives both in simulation with hidden true parameters, through real nodes and serial "
        "devices, computes the trajectory error of each from its bag alone, and identifies the "
        "parameters from both.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--maneuver", default="circle", help=f"family: {', '.join(family_names())}")
    add("--target", default=UNKNOWN_PARAMETERS[0], help="unknown parameter to excite")
    add("--vehicle", type=Path, metavar="FILE", help="vehicle YAML (default: the paper's tricycle)")
    add("--seed", type=seed, default=0, help="of plan, random maneuver and hidden truth")
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
    add("--output", type=Path, default=Path("out/demo"), metavar="DIR")
    add("--overwrite", action="store_true", help="replace the bags of an earlier demo")
    add("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Plan, drive, record, judge; print the table and say where everything is."""
    vehicle = load_vehicle(args.vehicle)
    request = PlanRequest(vehicle, family_by_name(args.maneuver), args.target, seed=args.seed)
    if args.firmware:
        check_build(args.firmware)
    output: Path = args.output
    make_room(output, overwrite=args.overwrite)

    with progress_bar(f"planning {request.family.name} for {args.target}") as progress:
        designed = plan_maneuver(request, progress=progress)
        # a stream of its own: the truth is drawn from the seed alone
        random_x = random_feasible_point(request, np.random.default_rng([args.seed, 1]))
        plans = {"designed": designed, "random": plan_at(request, random_x)}
    for name, plan in plans.items():
        save_plan(plan, output / "plans" / f"{name}.json")

    bags = {name: output / "bags" / name for name in plans}
    with simulated_session(
        vehicle_file=str(args.vehicle.absolute()) if args.vehicle else "",
        true_seed=args.seed,
        real_time_factor=args.real_time_factor,
        folder=output,
        firmware=args.firmware,
    ) as drive:
        for name, plan in plans.items():
            with progress_bar(f"driving the {name} maneuver, ms") as progress:
                drive(plan, bags[name], progress)

    judgements = {name: judge(bag) for name, bag in bags.items()}
    plot_drives(
        {_title(name, plan): judgements[name] for name, plan in plans.items()},
        output / "trajectories.png",
    )
    with progress_bar("identifying the parameters") as progress:
        drives = [read_measured_drive(bag, vehicle) for bag in bags.values()]
        found = identify(drives, vehicle, profiles=True, seed=args.seed, progress=progress)
    save_identification(found, args.vehicle, output / "identification")

    truth = draw_truth(vehicle, np.random.default_rng(args.seed))
    expected = {name: _expected_error(request, plan, truth) for name, plan in plans.items()}
    result: dict[str, object] = {
        name: {
            "x": dict(plan.operation),
            "main": plan.main[args.target].value,
            "total": plan.total[args.target].value,
            "cost": plan.cost,
            "te_expected": expected[name],
            "te_measured": judgements[name].te,
            "te_corrected": judgements[name].te_corrected,
            "rms": judgements[name].rms,
        }
        for name, plan in plans.items()
    }
    result["parameters"] = {
        name: {"estimate": e.estimate, "low": e.low, "high": e.high, "truth": truth[name]}
        for name, e in found.parameters.items()
    }
    (output / "result.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    report = output / "report.html"
    report.write_text(report_page(read_run(output), vehicle=vehicle), encoding="utf-8")
    if args.json:
        print(json.dumps(result))
    console = Console(stderr=args.json, highlight=False)
    console.print(_table(args.target, plans, expected, judgements))
    for name, plan in plans.items():
        if plan.verdict:
            console.print(f"{name}: {plan.verdict}")
    console.print(parameter_table(found, truth))
    for remark in remarks(found):
        console.print(remark, soft_wrap=True)
    for what, where in (
        *(("bags", "bags"), ("plans", "plans"), ("figure", "trajectories.png")),
        *(
            ("vehicle file with the estimates", "identification/vehicle.yaml"),
            ("report", report.name),
        ),
    ):
        console.print(f"{what}: {output / where}", soft_wrap=True)
    return 0


def _expected_error(request: PlanRequest, plan: Plan, truth: dict[str, float]) -> float:
    """TE of the model with the true parameters, m^2."""
    vehicle: Vehicle = request.vehicle
    x = np.array(list(plan.operation.values()))
    run = nominal_run(vehicle, request.family, x)
    return float(replayed_errors(vehicle, run, np.array([list(truth.values())]))[0])


def _title(name: str, plan: Plan) -> str:
    values = ", ".join(f"{key} {value:.3g}" for key, value in plan.operation.items())
    return f"{name} {plan.maneuver.replace('_', ' ')}: {values}"


def _table(
    target: str,
    plans: dict[str, Plan],
    expected: dict[str, float],
    judgements: dict[str, Judgement],
) -> Table:
    table = Table(title=f"exciting {target}, TE in m²", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("maneuver", no_wrap=True)
    for heading in ("S", "ST", "H", "TE expected", "TE measured", "less noise", "rms/mm"):
        table.add_column(heading, justify="right", min_width=8 if heading[:2] == "TE" else None)
    for name, plan in plans.items():
        judgement = judgements[name]
        values = "\n".join(f"{key} {value:.3f}" for key, value in plan.operation.items())
        table.add_row(
            f"{name}\n{values}",
            f"{plan.main[target].value:.3f}",
            f"{plan.total[target].value:.3f}",
            f"{plan.cost:.3f}",
            f"{expected[name]:.5f}",
            f"{judgement.te:.5f}",
            f"{judgement.te_corrected:.5f}",
            f"{1e3 * judgement.rms:.1f}",
        )
    return table
