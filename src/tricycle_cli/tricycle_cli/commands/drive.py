"""`tricycle drive`: drive a plan, on a simulation of its own or on nodes that run already."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from tricycle_cli.argument_types import at_least, namespace, real_time_factor
from tricycle_cli.options import OF_SIMULATION, add_vehicle_option, refuse_given
from tricycle_cli.progress import progress_bar
from tricycle_core.documents import check_folder
from tricycle_core.errors import BagError, InfeasibleManeuver, JudgeError, PlanError
from tricycle_sim.plants import OWN
from tricycle_sim.vehicle import load_vehicle

if TYPE_CHECKING:
    from excitation_planner.plan import Plan
    from tricycle_sim.vehicle import Vehicle

EXAMPLE = """\
examples:
  tricycle drive out/plan/plan.json --true-seed 1 --bag out/bag
  tricycle drive out/plan/plan.json --vehicle-nodes --bag out/bag
  tricycle drive out/plan/plan.json --repeat 3 --mirror --return --bag out/drives
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = (
        "Starts the simulation and all nodes, drives the plan open loop and records "
        "it. With --vehicle-nodes it uses the nodes that vehicle.launch.py has started instead: "
        "arm the vehicle first (service tricycle_bridge/arm), and keep the e-stop in hand. Ctrl-C "
        "aborts the maneuver: the vehicle stops, and the bag is closed. Of several drives "
        "(--repeat, --mirror) each has its bag in the folder --bag; on the vehicle each waits for "
        "Enter. After an interruption the same command drives those that are missing. With "
        "--return the vehicle drives to the start of each by itself."
    )
    parser.epilog = EXAMPLE
    add = parser.add_argument
    add("plan", type=Path, metavar="PLAN", help="plan.json of `tricycle plan`")
    add("--bag", type=Path, default=Path("out/bag"), metavar="DIR", help="bag to be recorded")
    add("--repeat", type=int, default=1, metavar="N", help="drive it so often")
    add("--mirror", action="store_true", help="drive its mirror image too, after each drive of it")
    add(
        "--return",
        action="store_true",
        dest="back",
        help="drive back to the start, closed loop at walking pace, after each drive; recorded in "
        "the next bag, and that of the last drive in a folder beside --bag",
    )
    add_vehicle_option(parser, "vehicle YAML, also of the running nodes")
    add("--plant", metavar="NAME", help=f"what the simulation drives (default: {OWN})")
    add("--true-seed", type=at_least(0), help="of the simulation's hidden true parameters")
    add(
        "--real-time-factor",
        type=real_time_factor,
        help="largest; the nodes set the pace (default: 1.0)",
    )
    add(
        "--other-vehicle",
        action="store_true",
        help="drive a plan of another vehicle: one that differs in what shapes the commands",
    )
    add("--vehicle-nodes", action="store_true", help="drive the vehicle whose nodes are running")
    add("--namespace", type=namespace, default="", metavar="NAME", help="of those nodes")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Drive the plan as often as asked for, and print the paths of the bags.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from excitation_planner.plan import load_plan
    from excitation_planner.planning import check_vehicle
    from trajectory_recorder.bag.writer import check_new
    from tricycle_cli.operation.session import running_session, simulated_session
    from tricycle_sim.plants.installed import check_plant

    if args.namespace and not args.vehicle_nodes:
        raise PlanError("--namespace is of the vehicle's nodes: give --vehicle-nodes too")
    if args.vehicle_nodes:
        refuse_given(args, ("plant", "true_seed", "real_time_factor"), OF_SIMULATION)
    if args.repeat < 1:
        raise PlanError(f"--repeat {args.repeat}: a plan is driven once or more often")
    series = args.repeat > 1 or args.mirror
    if not (series and args.bag.is_dir()):
        check_new(args.bag)
    plant = OWN if args.plant is None else args.plant
    check_plant(plant)
    plan, vehicle = load_plan(args.plan), load_vehicle(args.vehicle)
    check_folder(args.bag.parent)
    if not args.other_vehicle:
        try:
            check_vehicle(plan, vehicle)
        except PlanError as error:
            raise PlanError(f"{error}, give its file (--vehicle), or --other-vehicle") from error
    drives = _series(plan, vehicle, args) if series else [(plan, args.bag)]
    whole = args.bag if args.bag.name not in ("", "..") else args.bag.resolve()
    back = whole.with_name(f"{whole.name}.way_back") if args.back else None
    if back is not None:
        check_new(back / drives[-1][1].name)
    session = (
        running_session(
            None if args.other_vehicle else vehicle,
            args.namespace,
            ask=series,
            back=back,
        )
        if args.vehicle_nodes
        else simulated_session(
            vehicle_file=args.vehicle,
            true_seed=args.true_seed or 0,
            real_time_factor=1.0 if args.real_time_factor is None else args.real_time_factor,
            folder=whole.with_name(f"{whole.name}.session"),
            plant=plant,
            back=back,
        )
    )
    with session as drive:
        for one, bag in drives:
            bag.parent.mkdir(parents=True, exist_ok=True)
            with progress_bar(f"driving {plan.maneuver}, ms") as progress:
                drive(one, bag, progress)
            judge = shlex.join(["tricycle", "judge", str(bag), *_pose_option(bag)])
            print(f"bag: {bag}   judge it: {judge}")
    return 0


def _series(plan: Plan, vehicle: Vehicle, args: argparse.Namespace) -> list[tuple[Plan, Path]]:
    """Repeats of a plan, and of its mirror image, with their bags; without those already driven."""
    from excitation_planner.planning.mirror import mirrored

    plans = {"": plan}
    if args.mirror:
        try:
            plans["-mirrored"] = mirrored(plan, vehicle)
        except InfeasibleManeuver as error:
            raise PlanError(f"{args.plan}: {error}; leave out --mirror") from error
    drives = [
        (one, args.bag / f"{number}{side}")
        for number in range(1, args.repeat + 1)
        for side, one in plans.items()
    ]
    return _not_yet_driven(drives, args.bag) if args.bag.exists() else drives


def _not_yet_driven(drives: list[tuple[Plan, Path]], folder: Path) -> list[tuple[Plan, Path]]:
    """Drives of an interrupted series whose bags the folder does not hold yet.

    Raises
    ------
    BagError
        If the folder is not one of this series, holds all of it, or a bag of it that is not whole.
    """
    from parameter_identification.drives.reader import read_drive
    from parameter_identification.drives.recorded import TopicNames
    from trajectory_recorder.bag.writer import check_new

    there = [(plan, bag) for plan, bag in drives if bag.exists()]
    if len(there) in (0, len(drives)):
        check_new(folder)
    for plan, bag in there:
        pose = _pose_option(bag)
        topics = TopicNames(pose=pose[1]) if pose else None
        again = "move it away, and the same command drives it again, and those that are missing"
        try:
            found = read_drive(bag, topics=topics, sensors=False)
        except (BagError, JudgeError) as error:
            raise BagError(f"{error}; {again}") from error
        if found.plan_id != plan.id:
            raise BagError(f"{bag} is a drive of plan {found.plan_id}, not of {plan.id}: {again}")
        if not found.complete:
            raise BagError(f"{bag}: the drive is not whole: {again}")
    names = ", ".join(bag.name for _, bag in there)
    print(f"{folder} holds the drives {names}: going on with those that are missing")
    return [(plan, bag) for plan, bag in drives if not bag.exists()]


def _pose_option(bag: Path) -> list[str]:
    """The option that names the poses of a bag, where odom of the nodes was remapped."""
    from parameter_identification.drives.recorded import TopicNames
    from trajectory_recorder.bag.reader import BagReader

    try:
        with BagReader(bag) as reader:
            topics = reader.topics.values()
    except BagError:  # the recorder's computer is another one
        return []
    names = [topic.name for topic in topics if topic.type == "nav_msgs/msg/Odometry"]
    if len(names) != 1 or names[0].endswith(f"/{TopicNames.pose}"):
        return []
    return ["--pose", names[0]]
