"""`tricycle plan`: design an excitation maneuver, or show one."""

import argparse
import json
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from excitation_planner.maneuver import PlanError, family_by_name, family_names, operation_point
from excitation_planner.plan import Plan, load_plan, save_plan
from excitation_planner.planning import PlanRequest, plan_at, plan_maneuver
from tricycle_bringup.assignments import parse_assignments
from tricycle_bringup.figures import plot_plan
from tricycle_bringup.progress import progress_bar
from tricycle_sim.vehicle import UNKNOWN_PARAMETERS, load_vehicle

EXAMPLE = """\
examples:
  tricycle plan --maneuver circle --target cornering_stiffness --output out/plan
  tricycle plan --maneuver circle --target camber_stiffness --at radius=3 speed=0.8
  tricycle plan show out/plan/plan.json
"""


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "plan",
        help="design the maneuver that excites one parameter",
        description="Searches a maneuver family for the drive whose trajectory error depends on "
        "the target alone (cost H, Eq. 11), and verifies it with fresh samples.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("show", nargs="*", metavar="show FILE", help="print and plot a saved plan instead")
    add("--maneuver", default="circle", help=f"family: {', '.join(family_names())}")
    add("--target", default=UNKNOWN_PARAMETERS[0], help="unknown parameter to excite")
    add("--vehicle", type=Path, metavar="FILE", help="vehicle YAML (default: the paper's tricycle)")
    add("--at", nargs="+", metavar="NAME=VALUE", help="no search: plan this maneuver as it is")
    add("--seed", type=int, default=0, help="same seed, same plan")
    add("--samples", type=int, default=PlanRequest.samples, help="simulations per maneuver")
    add("--budget", type=int, default=PlanRequest.budget, help="largest number of simulations")
    add(
        "--noise-std",
        type=float,
        default=PlanRequest.noise_std,
        metavar="M",
        help="standard deviation of the measured position per axis; 0: the paper's cost",
    )
    add("--output", type=Path, default=Path("out/plan"), metavar="DIR")
    add("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Plan or show, print the table, save plan and figure."""
    if args.show:
        if args.show[0] != "show" or len(args.show) != 2:
            raise PlanError(
                f"{' '.join(args.show)!r}: want `tricycle plan show FILE`, or options only"
            )
        file = Path(args.show[1])
        plan, figure = load_plan(file), file.with_suffix(".png")
    else:
        request = PlanRequest(
            load_vehicle(args.vehicle),
            family_by_name(args.maneuver),
            args.target,
            samples=args.samples,
            budget=args.budget,
            seed=args.seed,
            noise_std=args.noise_std,
        )
        for warning in request.vehicle.warnings():
            print(f"warning: {warning}", file=sys.stderr)
        if args.at:
            x = operation_point(request.family, parse_assignments(args.at))
            plan = plan_at(request, x)
        else:
            with progress_bar(f"planning {request.family.name} for {args.target}") as progress:
                plan = plan_maneuver(request, progress=progress)
        file, figure = args.output / "plan.json", args.output / "plan.png"
        save_plan(plan, file)
    plot_plan(plan, figure)
    if args.json:
        print(json.dumps(_as_json(plan)))
    else:
        _print(plan)
    print(f"plan: {file}   figure: {figure}", file=sys.stderr)
    return 0


def _as_json(plan: Plan) -> dict[str, object]:
    return {
        "maneuver": plan.maneuver,
        "target": plan.target,
        "x": dict(plan.operation),
        "cost": plan.cost,
        "main": {name: index.value for name, index in plan.main.items()},
        "total": {name: index.value for name, index in plan.total.items()},
        "variance": plan.variance,
        "leave_one_out_q2": plan.leave_one_out_q2,
        "simulations": plan.simulations,
        "seconds": plan.seconds,
        "feasible": plan.feasible,
        "verdict": plan.verdict,
        "id": plan.id,
    }


def _print(plan: Plan) -> None:
    values = ", ".join(f"{name} = {value:.4g}" for name, value in plan.operation.items())
    table = Table(title=f"{plan.maneuver}: {values}")
    table.add_column("unknown parameter")
    for heading in ("S", "95 %", "ST", "95 %"):
        table.add_column(heading, justify="right")
    for name, main in plan.main.items():
        total = plan.total[name]
        table.add_row(
            f"{name}{' (target)' if name == plan.target else ''}",
            f"{main.value:.4f}",
            f"{main.low:.4f} … {main.high:.4f}",
            f"{total.value:.4f}",
            f"{total.low:.4f} … {total.high:.4f}",
        )
    console = Console()
    console.print(table)
    predicted = (
        "" if plan.predicted_cost is None else f" (the search had {plan.predicted_cost:.4f})"
    )
    console.print(
        f"H = {plan.cost:.4f}{predicted}, Q² = {plan.leave_one_out_q2:.6f}, "
        f"{plan.simulations} simulations in {plan.seconds:.1f} s, plan {plan.id}",
        highlight=False,
    )
    if plan.verdict:
        console.print(plan.verdict, highlight=False)
