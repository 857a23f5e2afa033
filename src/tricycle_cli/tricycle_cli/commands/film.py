"""`tricycle film`: recorded drives as a film."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from tricycle_cli.argument_types import bag_argument, file_ending_in
from tricycle_cli.options import (
    BAG_HELP,
    add_overwrite_option,
    add_topic_options,
    add_vehicle_option,
    check_output_files,
    topics_of,
)
from tricycle_cli.progress import progress_bar
from tricycle_core.errors import PlantError
from tricycle_core.optional import check_installed
from tricycle_sim.vehicle import Vehicle, load_vehicle

if TYPE_CHECKING:
    from parameter_identification.drives.recorded import TopicNames

EXAMPLE = """\
example:
  tricycle film out/demo/bags/designed out/demo/bags/random --output film.gif
  tricycle film out/demo/bags/designed --plant mujoco --output rendered.gif
"""
RENDERED = "mujoco"
SIZE = 400, 300  # pixel


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = (
        "Writes a GIF of recorded drives: the vehicle as it was measured, beside the nominal one, "
        "and its distance over time. Drives begin together. Or one drive repeated by a plant, "
        "rendered without a screen, with the measured and the nominal way on the ground."
    )
    parser.epilog = EXAMPLE
    add = parser.add_argument
    add("bags", nargs="+", metavar="BAG", type=bag_argument, help=BAG_HELP)
    gif = file_ending_in(".gif")
    add("--output", type=gif, default=Path("out/film.gif"), metavar="FILE", help="GIF")
    add_overwrite_option(parser)
    add("--speed", type=_speed, default=3.0, help="seconds of the drive per second")
    add_vehicle_option(parser)
    add(
        "--plant",
        choices=[RENDERED],
        help="repeat the drive's commands with this plant and render it (one BAG)",
    )
    add_topic_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Judge the drives and draw them frame by frame.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    check_installed("matplotlib", "a film")
    from parameter_identification.judging.judgement import judge
    from tricycle_cli.reports.film import write_film

    check_output_files([args.output], args)
    vehicle, topics = load_vehicle(args.vehicle), topics_of(args)
    if args.plant:
        return _render(args, vehicle, topics)
    judgements = [judge(bag, topics=topics) for bag in args.bags]
    args.output.parent.mkdir(parents=True, exist_ok=True)
    with progress_bar("drawing") as progress:
        write_film(judgements, vehicle, args.output, speed=args.speed, progress=progress)
    print(f"film: {args.output}")
    return 0


def _render(args: argparse.Namespace, vehicle: Vehicle, topics: "TopicNames") -> int:
    from parameter_identification.drives.measured_from_bag import measured_drive
    from parameter_identification.drives.reader import read_drive
    from parameter_identification.judging.judgement import judge_drive
    from tricycle_bringup.configuration import bridge_settings
    from tricycle_cli.reports.rendered_film import write_rendered_film
    from tricycle_sim.plants.mujoco_view import MujocoView

    if len(args.bags) > 1:
        raise PlantError(f"--plant {args.plant}: one bag at a time, not {len(args.bags)}")
    recorded = read_drive(args.bags[0], topics=topics)
    commands = measured_drive(recorded, vehicle).commands
    series = judge_drive(recorded).series
    view = MujocoView(vehicle, SIZE)
    args.output.parent.mkdir(parents=True, exist_ok=True)
    with view, progress_bar("rendering") as progress:
        apart = write_rendered_film(
            *(view, commands, series, vehicle, bridge_settings(vehicle), args.output),
            speed=args.speed,
            progress=progress,
        )
    print(
        f"film: {args.output}; the plant {args.plant} drives {1e3 * apart:.0f} mm (rms) from where "
        "the drive was measured"
    )
    return 0


def _speed(text: str) -> float:
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0.1 <= speed <= 100.0:
        raise argparse.ArgumentTypeError(f"{text!r} must be from 0.1 to 100")
    return speed
