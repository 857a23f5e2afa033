"""`tricycle film`: recorded drives as a film."""

import argparse
from pathlib import Path

from tricycle_cli.arguments import BAG_HELP, add_topic_options, bag_argument, topics_of
from tricycle_cli.progress import progress_bar
from tricycle_core.optional import check_installed
from tricycle_sim.vehicle import load_vehicle

EXAMPLE = """\
example:
  tricycle film out/demo/bags/designed out/demo/bags/random --output film.gif
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = (
        "Writes a GIF of recorded drives: the vehicle as it was measured, beside the nominal one, "
        "and its distance over time. Drives begin together."
    )
    parser.epilog = EXAMPLE
    add = parser.add_argument
    add("bags", nargs="+", metavar="BAG", type=bag_argument, help=BAG_HELP)
    add("--output", type=_gif, default=Path("out/film.gif"), metavar="FILE", help="GIF")
    add("--speed", type=_speed, default=3.0, help="seconds of the drive per second")
    add("--vehicle", type=Path, metavar="FILE", help="vehicle YAML (default: the paper's tricycle)")
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

    vehicle, topics = load_vehicle(args.vehicle), topics_of(args)
    judgements = [judge(bag, topics=topics) for bag in args.bags]
    args.output.parent.mkdir(parents=True, exist_ok=True)
    with progress_bar("drawing") as progress:
        write_film(judgements, vehicle, args.output, speed=args.speed, progress=progress)
    print(f"film: {args.output}")
    return 0


def _gif(text: str) -> Path:
    if Path(text).suffix != ".gif":
        raise argparse.ArgumentTypeError(f"{text}: needs to end in .gif")
    return Path(text)


def _speed(text: str) -> float:
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0.1 <= speed <= 100.0:
        raise argparse.ArgumentTypeError(f"{text!r} must be from 0.1 to 100")
    return speed
