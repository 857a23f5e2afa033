"""`tricycle plan`: design excitation maneuvers, or show one."""

from __future__ import annotations

import argparse
import json
import math
import sys
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

from excitation_planner.design.criteria import Criterion
from excitation_planner.design.noise import SIMULATED
from excitation_planner.maneuver import family_names, operation_point, shown_ranges
from excitation_planner.planning import PlanRequest
from tricycle_cli.argument_types import at_least, parameter_name, parse_assignments
from tricycle_cli.options import (
    add_area_option,
    add_lead_in_option,
    add_noise_options,
    add_overwrite_option,
    add_range_options,
    add_vehicle_option,
    check_output_files,
    describe_later,
    families_of,
    noise_of,
    refuse_given,
    search_boxes,
    warn_about,
)
from tricycle_cli.progress import progress_bar
from tricycle_core.documents import check_folder
from tricycle_core.errors import PlanError
from tricycle_core.optional import check_installed
from tricycle_sim.effects import named_effects
from tricycle_sim.vehicle import UNKNOWN_PARAMETERS, load_vehicle

if TYPE_CHECKING:
    from collections.abc import Sequence

    from excitation_planner.plan import Plan

DEFAULTS = {
    "maneuver": "circle",
    "effects": "none",
    "seed": 0,
    "samples": PlanRequest.samples,
    "budget": PlanRequest.budget,
    "output": Path("out/plan"),
}
"""Options of planning, which `show` refuses: so their defaults are not the parser's."""

OF_SHOW = ("show", "json", "overwrite", "run")  # arguments that it takes
MOST_MANEUVERS = 6  # of a set: twelve operation parameters are all that the search can do well

EXAMPLE = """\
examples:
  tricycle plan --maneuver circle --target cornering_stiffness --output out/plan
  tricycle plan --maneuver circle,double-lane-change --target camber_stiffness
  tricycle plan --maneuver circle --maneuvers 2 --criterion a --yaw-rate-std 0.002
  tricycle plan --maneuver circle --range radius=3:12 speed=0.5:1.5
  tricycle plan --criterion h --noise-std 0 --at radius=3 speed=0.8
  tricycle plan show out/plan/plan.json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = (
        "Searches maneuver families for the drives that will teach the target best, "
        "and verifies them with fresh samples. Says beforehand how well each parameter will be "
        "known."
    )
    add = parser.add_argument
    add("show", nargs="*", metavar="show FILE", help="print and plot a saved plan instead")
    maneuver = add("--maneuver", metavar="NAME[,NAME…]")

    def describe() -> None:
        names = ", ".join(family_names())
        maneuver.help = f"families, driven one after the other: {names} (default: circle)"
        parser.epilog = f"{EXAMPLE}\n{search_boxes()}"

    describe_later(parser, describe)
    add("--maneuvers", type=int, metavar="N", help="how many to drive, of these families in turn")
    add_range_options(parser)
    add(
        "--target",
        type=parameter_name,
        help="unknown parameter to excite (default: the first cornering stiffness)",
    )
    add(
        "--criterion",
        choices=[criterion.value for criterion in Criterion],
        help="what is minimised: h the paper's cost of the target (Eq. 11), c the expected "
        "variance of the target, d the volume and a the sum of the variances of all parameters "
        "(default: c; h with --noise-std 0)",
    )
    add_vehicle_option(parser)
    add_area_option(parser)
    add_lead_in_option(parser)
    add(
        "--effects",
        metavar="all|none|NAME,NAME",
        help="what the real vehicle may have beside the file (steering-zero, wheel-radius, …), "
        "counted by the criteria c, d and a as not known either (default: none)",
    )
    add("--at", nargs="+", metavar="NAME=VALUE", help="no search: plan this maneuver as it is")
    add("--seed", type=at_least(0), help="same seed, same plan")
    for option, text in (
        ("samples", "for criterion h: simulations per maneuver"),
        ("budget", "largest number of simulations of the search"),
    ):
        add(f"--{option}", type=int, help=f"{text} (default: {DEFAULTS[option]})")
    add_noise_options(parser, {"": SIMULATED})
    add("--output", type=Path, metavar="DIR", help="for plan and figure (default: out/plan)")
    add_overwrite_option(parser)
    add("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Plan or show, print the table, save plan and figure.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from excitation_planner.plan import load_plan, save_plan

    check_installed("matplotlib", "the figure of a plan")
    if args.show:
        if args.show[0] != "show" or len(args.show) != 2:
            raise PlanError(
                f"{' '.join(args.show)!r}: needs `tricycle plan show FILE`, or options only"
            )
        of_planning = [name for name in vars(args) if name not in OF_SHOW]
        refuse_given(args, of_planning, "`plan show FILE` plans nothing; leave it out")
        plans = {Path(args.show[1]): load_plan(Path(args.show[1]))}
    else:
        for name, default in DEFAULTS.items():
            if getattr(args, name) is None:
                setattr(args, name, default)
        request = _request(args)
        earlier = _earlier_plans(args.output)
        check_output_files([*earlier, *_earlier_plans(args.output, ".png")], args)
        plans = _planned(request, args)
        for file, plan in plans.items():
            save_plan(plan, file)
        for file in earlier:  # a set of fewer drives must not leave one of the last set behind
            file.with_suffix(".png").unlink(missing_ok=True)
            if file not in plans:
                file.unlink()
    from tricycle_cli.reports.static_figures import plot_plan

    try:  # the reader of a pipe may leave
        for file, plan in plans.items():
            if not args.show or args.overwrite or not file.with_suffix(".png").exists():
                plot_plan(plan, file.with_suffix(".png"))
    finally:  # and a folder be read-only
        _print(list(plans.values()), args)
    for file in plans:
        print(f"plan: {file}   figure: {file.with_suffix('.png')}", file=sys.stderr)
    return 0


def _print(plans: Sequence[Plan], args: argparse.Namespace) -> None:
    """Print the plans of a set."""
    from tricycle_cli.reports.tables import plan_table, prediction_table, table_console

    first, *others = plans
    if args.json:
        print(json.dumps(_as_json(first) | {"others": [_as_json(plan) for plan in others]}))
    else:
        console = table_console()
        for plan in plans:
            console.print(plan_table(plan))
            console.print(_summary(plan), soft_wrap=True)
        if first.predicted_std:
            console.print(prediction_table(first))
            console.print(f"if these measure it: {first.noise}", soft_wrap=True)
            if first.effects:
                console.print(
                    f"counted as not known either: {', '.join(first.effects)}", soft_wrap=True
                )
        console.print(_search_summary(first), soft_wrap=True)
        if first.verdict:
            console.print(first.verdict, soft_wrap=True)


def _earlier_plans(folder: Path, suffix: str = ".json") -> list[Path]:
    return sorted([*folder.glob(f"plan{suffix}"), *folder.glob(f"plan-[0-9]{suffix}")])


def _request(args: argparse.Namespace) -> PlanRequest:
    from excitation_planner.area.area import load_area

    families = families_of(args.maneuver, args)
    count = len(families) if args.maneuvers is None else args.maneuvers
    if not len(families) <= count <= MOST_MANEUVERS:
        raise PlanError(f"--maneuvers {count}: must be from {len(families)} to {MOST_MANEUVERS}")
    first, *others = (families[i % len(families)] for i in range(count))
    noise, vehicle = noise_of(args, SIMULATED), load_vehicle(args.vehicle)
    stiffnesses = [name for name in vehicle.unknown if name.endswith(UNKNOWN_PARAMETERS[0])]
    target = args.target or next(iter([*stiffnesses, *vehicle.unknown]), UNKNOWN_PARAMETERS[0])
    default = Criterion.C if noise.noise_std > 0.0 else Criterion.H
    return PlanRequest(
        vehicle,
        first,
        target,
        criterion=default if args.criterion is None else Criterion(args.criterion),
        others=tuple(others),
        samples=args.samples,
        budget=args.budget,
        seed=args.seed,
        noise=noise,
        area=None if args.area is None else load_area(args.area),
        effects=named_effects(args.effects, planned=True),
    )


def _planned(request: PlanRequest, args: argparse.Namespace) -> dict[Path, Plan]:
    """Plans by the files they go to."""
    from excitation_planner.planning import plan_at, plan_set

    x = None
    if args.at:
        if request.others:
            raise PlanError("--at plans one maneuver: give one --maneuver, and no --maneuvers")
        x = operation_point(request.family, parse_assignments(args.at))
    check_folder(args.output)
    warn_about(request.vehicle, args, request.area)
    if x is not None:
        return {args.output / "plan.json": plan_at(request, x)}
    # half a second of imports, while the compiled vehicle leaves the interpreter to others
    Thread(target=import_module, args=("tricycle_cli.reports.static_figures",)).start()
    names = ", ".join(family.name for family in request.families)
    with progress_bar(f"planning {names} for {request.target}") as progress:
        plans = plan_set(request, progress=progress)
    if len(plans) == 1:
        return {args.output / "plan.json": plans[0]}
    return {args.output / f"plan-{plan.number}.json": plan for plan in plans}


def _as_json(plan: Plan) -> dict[str, object]:
    return {
        "maneuver": plan.maneuver,
        "target": plan.target,
        "x": dict(plan.operation),
        "ranges": dict(plan.ranges),
        "cost": plan.cost,
        "criterion": plan.criterion.value,
        "criterion_cost": plan.criterion_cost,
        "predicted_std": dict(plan.predicted_std),
        "main": {name: index.value for name, index in plan.main.items()},
        "total": {name: index.value for name, index in plan.total.items()},
        "variance": plan.variance,
        "leave_one_out_q2": plan.leave_one_out_q2,
        "simulations": plan.simulations,
        "seconds": plan.seconds,
        "feasible": plan.feasible,
        "verdict": plan.verdict,
        "space": dict(zip(("along", "across", "stop"), plan.space, strict=True)),
        "start_pose": plan.start_pose,
        "clearance": plan.clearance,
        "id": plan.id,
    }


def _summary(plan: Plan) -> str:
    along, across, stop = plan.space
    at_limit = [
        f"{name} at the end of its range"
        for name, (low, high) in plan.ranges.items()
        if min(plan.operation[name] - low, high - plan.operation[name]) < 1e-3 * (high - low)
    ]
    room = f"needs {along:.1f} m x {across:.1f} m, and up to {stop:.1f} m more to stop"
    if plan.area is not None and plan.start_pose is not None:
        x, y, heading = plan.start_pose
        origin = ""
        if plan.area.datum is not None:
            latitude, longitude = plan.area.datum
            origin = f", its origin at latitude {latitude:.10g}°, longitude {longitude:.10g}°"
        room = (
            f"starts at x {x:.2f} m, y {y:.2f} m, heading {math.degrees(heading):.1f}° "
            f"in {plan.area.frame}{origin}; {plan.clearance:.2f} m to the border are left, "
            "wherever and by whatever it is stopped"
        )
    box = ", ".join([shown_ranges(plan.ranges), *at_limit])
    searched = plan.search is not None
    return (
        f"{f'search box: {box} (--range sets it)' if searched else f'allowed: {box}'}\n"
        f"H = {plan.cost:.4f}, Q² = {plan.leave_one_out_q2:.6f}, "
        f"{plan.commands.duration:.1f} s to drive, plan {plan.id}\n{room}"
    )


def _search_summary(plan: Plan) -> str:
    """Return in words how the maneuvers of the plan's set were found."""
    predicted = (
        ""
        if plan.predicted_cost is None
        else f" ({plan.predicted_cost:.4g} in the search), {plan.simulations} simulations"
    )
    return (
        f"criterion {plan.criterion} = {plan.criterion_cost:.4g}{predicted} in {plan.seconds:.1f} s"
    )
