"""`tricycle campaign`: plan, drive and identify in turns until the targets are known."""

from __future__ import annotations

import argparse
import contextlib
import json
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

from excitation_planner.area.area import load_area
from excitation_planner.design.noise import SIMULATED, MeasurementNoise
from excitation_planner.maneuver import family_names
from tricycle_cli.argument_types import at_least, parameter_names, real_time_factor
from tricycle_cli.campaign.request import WAY_BACK, CampaignRequest
from tricycle_cli.console import plain_console
from tricycle_cli.options import (
    OF_SIMULATION,
    add_area_option,
    add_effects_option,
    add_lead_in_option,
    add_noise_options,
    add_range_options,
    add_topic_options,
    add_vehicle_option,
    describe_later,
    effects_asked,
    families_of,
    noise_of,
    refuse_given,
    search_boxes,
    topics_of,
    warn_about,
)
from tricycle_cli.progress import progress_bar
from tricycle_core.documents import write_whole
from tricycle_core.errors import NodeError, PlanError
from tricycle_core.optional import check_installed
from tricycle_core.timing import TICK
from tricycle_sim.effects import named_effects
from tricycle_sim.vehicle import load_vehicle

if TYPE_CHECKING:
    from rich.console import Console

    from tricycle_cli.campaign.cycle import Campaign
    from tricycle_cli.operation.session import DrivePlan

EXAMPLE = """\
examples:
  tricycle campaign --targets cornering_stiffness,camber_stiffness --tolerance 5% \\
      --output out/campaign --true-seed 1
  tricycle campaign --targets cornering_stiffness --tolerance 5% --area yard.yaml \\
      --output out/yard
  tricycle campaign --targets cornering_stiffness --tolerance 2% --vehicle-nodes \\
      --vehicle mine.yaml --output out/mine --pose /localization/odometry
"""


SIMULATED_POSES = ("odom", "ground_truth", "tf")
"""Topics with poses that the nodes of a simulation publish and record."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = (
        "Plans the drive that will teach the least known target most, drives and "
        "records it, identifies from all bags so far, and plans again with what is known, until "
        "the 95 % interval of every target is within the tolerance. After an interruption the "
        "same command goes on. With --vehicle-nodes it drives the nodes that vehicle.launch.py "
        "has started, and asks for the vehicle to be at its start and armed before every drive."
    )
    add = parser.add_argument
    add(
        "--targets",
        required=True,
        type=parameter_names,
        metavar="NAME[,NAME…]",
        help="unknown parameters to be known",
    )
    add(
        "--tolerance",
        required=True,
        metavar="5%",
        help="half width of the 95 %% interval, as a share of the estimate",
    )
    add(
        "--output",
        type=Path,
        default=Path("out/campaign"),
        metavar="DIR",
        help="the campaign's folder (default: %(default)s)",
    )
    maneuver = add("--maneuver", default="circle,double_lane_change", metavar="NAME[,NAME…]")

    def describe() -> None:
        maneuver.help = f"families to choose from: {', '.join(family_names())}"
        parser.epilog = f"{EXAMPLE}\n{search_boxes()}"

    describe_later(parser, describe)
    add_range_options(parser)
    add_vehicle_option(parser)
    add_area_option(parser)
    add_lead_in_option(parser)
    add(
        "--return",
        action="store_true",
        dest="back",
        help="drive to the start of each drive by itself, closed loop at walking pace",
    )
    add(
        "--stop-early",
        action="store_true",
        help="end a drive as soon as every target is within the tolerance; identification_monitor "
        "looks once a second of wall time, so a simulation should not be much faster",
    )
    add("--most-drives", type=int, default=CampaignRequest.most_drives, help="end after so many")
    add(
        "--budget",
        type=int,
        default=CampaignRequest.budget,
        help="largest number of simulations of the search, per plan and family",
    )
    add("--seed", type=at_least(0), default=0, help="of the plans")
    add_noise_options(parser, {"": SIMULATED, "with --vehicle-nodes ": MeasurementNoise()})
    add("--true-seed", type=at_least(0), help="of the simulation's hidden true parameters")
    add(
        "--real-time-factor",
        type=real_time_factor,
        help="largest; the nodes set the pace (default: 10.0)",
    )
    add("--vehicle-nodes", action="store_true", help="drive the vehicle whose nodes are running")
    add_effects_option(parser)
    add(
        "--plan-effects",
        default="none",
        metavar="all|none|NAME,NAME",
        help="of the same: what plans count as not known either (default: none)",
    )
    add("--json", action="store_true", help="print one JSON object")
    add_topic_options(parser, sensors=True)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the campaign to its end; status 1 when a target is not within the tolerance then.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from tricycle_cli.campaign.cycle import Campaign

    if args.vehicle_nodes:
        refuse_given(args, ("true_seed", "real_time_factor"), OF_SIMULATION)
    elif args.pose is not None and args.pose.removeprefix("/") not in SIMULATED_POSES:
        raise PlanError(
            f"--pose {args.pose}: the nodes of a simulation publish poses on "
            f"{', '.join(SIMULATED_POSES)} only"
        )
    check_installed("rclpy", "a campaign")
    check_installed("matplotlib", "the report of a campaign")
    vehicle = load_vehicle(args.vehicle)
    request = CampaignRequest(
        vehicle,
        families_of(args.maneuver, args),
        args.targets,
        _share(args.tolerance),
        most_drives=args.most_drives,
        budget=args.budget,
        seed=args.seed,
        noise=noise_of(args, MeasurementNoise() if args.vehicle_nodes else SIMULATED),
        true_seed=None if args.vehicle_nodes else args.true_seed or 0,
        area=None if args.area is None else load_area(args.area),
        **effects_asked(args),
        plan_effects=named_effects(args.plan_effects, planned=True),
    )
    campaign = Campaign(args.output, request)
    campaign.read_by(topics_of(args, campaign.topics))
    warn_about(vehicle, args, request.area)
    console = plain_console(stderr=True)
    if campaign.steps:
        console.print(_progress_of(campaign), soft_wrap=True)
    if campaign.driven:  # which needs no vehicle any more
        _identify(campaign, console)
    try:
        if not campaign.finished:
            with _session(args, campaign) as drive:
                while not campaign.finished:
                    _drive(campaign, drive, console, stop_early=args.stop_early)
                    _identify(campaign, console)
    except NodeError as error:
        if not campaign.finished:
            raise
        _report(args, campaign, console)
        raise NodeError(f"{error}; the report of the campaign is written") from error
    _report(args, campaign, console)
    return 1 if campaign.missing() else 0


def _report(args: argparse.Namespace, campaign: Campaign, console: Console) -> None:
    """Write what the campaign has found, and print it."""
    from tricycle_cli.campaign.results import (
        campaign_report,
        campaign_table,
        plot_campaign,
        plot_yard,
    )
    from tricycle_cli.operation.session import hidden_truth
    from tricycle_cli.reports.tables import table_console

    request = campaign.request
    truth = None
    if request.true_seed is not None:
        truth = hidden_truth(request.vehicle, request.true_seed)
    report, table = campaign_report(campaign, truth), campaign_table(campaign, truth)
    write_whole(args.output / "report.json", json.dumps(report, indent=1) + "\n")
    text = StringIO()
    plain_console(file=text, width=120).print(table)
    write_whole(args.output / "report.txt", text.getvalue())
    plot_campaign(campaign, truth, args.output / "report.png")
    if request.area is not None:
        plot_yard(campaign, request.area, args.output / "yard.png")
    if args.json:
        print(json.dumps(report))
    else:
        table_console().print(table)
    missing = campaign.missing()
    console.print(
        f"{len(campaign.steps)} drives, {report['driving_seconds']:.0f} s; "
        + (
            f"not within the tolerance: {', '.join(missing)}"
            if missing
            else "all targets are known"
        ),
        highlight=False,
    )
    console.print(
        f"report: {args.output}/report.json, .txt, .png; bags: {args.output}/bags",
        highlight=False,
        soft_wrap=True,
    )


def _progress_of(campaign: Campaign) -> str:
    """Say with how many drives a campaign goes on."""
    planned, driven = len(campaign.steps), sum(step.driven for step in campaign.steps)
    drives = "1 planned drive" if planned == 1 else f"{planned} planned drives"
    return f"{campaign.folder}: going on after {drives}, {driven} driven"


def _share(text: str) -> float:
    """Share from `5%` or `0.05`."""
    try:
        return float(text[:-1]) / 100.0 if text.endswith("%") else float(text)
    except ValueError:
        raise PlanError(f"tolerance {text!r}: needs a share, as 5% or 0.05") from None


@contextlib.contextmanager
def _session(args: argparse.Namespace, campaign: Campaign) -> Iterator[DrivePlan]:
    """Nodes to drive on: those of a simulation, started for this, or those of the vehicle.

    The noise of a simulation depends on the number of drives before, which it must not repeat.
    """
    from tricycle_cli.operation.session import running_session, simulated_session

    if not args.vehicle_nodes:
        with simulated_session(
            vehicle_file=args.vehicle,
            true_seed=args.true_seed or 0,
            noise_seed=len(campaign.steps),
            real_time_factor=10.0 if args.real_time_factor is None else args.real_time_factor,
            folder=args.output / "session",
            back=_way_back(args),
            monitor=args.stop_early,
        ) as drive:
            yield drive
        return
    with running_session(
        campaign.request.vehicle, ask=True, back=_way_back(args), pose=campaign.topics.pose
    ) as drive:
        yield drive


def _way_back(args: argparse.Namespace) -> Path | None:
    return args.output / WAY_BACK if args.back else None


def _drive(
    campaign: Campaign, drive: DrivePlan, console: Console, *, stop_early: bool = False
) -> None:
    """Plan and drive once, or what is left of that."""
    campaign.plan(progress_bar)
    number = len(campaign.steps)
    for problem in campaign.left_out:
        console.print(f"drive {number}: without {problem}", highlight=False, soft_wrap=True)
    step = campaign.steps[-1]
    values = ", ".join(f"{name} {value:.3g}" for name, value in step.operation.items())
    console.print(f"drive {number}: {step.maneuver} ({values}) for {step.target}", highlight=False)
    with progress_bar(f"driving {step.maneuver}, ms") as progress:
        campaign.drive(drive, progress, stop_early=stop_early)


def _identify(campaign: Campaign, console: Console) -> None:
    """Identify from all bags, and say what is known now."""
    step = campaign.steps[-1]
    with progress_bar("identifying") as progress:
        known = campaign.identify(progress=progress)
    driven = campaign.steps[-1].duration
    if driven < step.duration - TICK:  # the bag's is rounded
        console.print(
            f"  ended early, after {driven:.1f} of {step.duration:.1f} s: every target seemed known"
        )
    for name in campaign.request.targets:
        console.print(
            f"  {name}: {known[name].estimate:.4g} ± {known[name].share:.2%}", highlight=False
        )
