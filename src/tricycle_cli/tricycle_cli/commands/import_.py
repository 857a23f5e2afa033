"""``tricycle import``: a bag of a drive that another system recorded as a table."""

import argparse
import sys
from pathlib import Path

from tricycle_cli.options import add_vehicle_option
from tricycle_core.documents import check_folder
from tricycle_sim.vehicle import load_vehicle

EXAMPLE = """\
example:
  tricycle import drive.csv --columns mapping.yaml --vehicle car.yaml --output out/drive
"""

LONG = 60.0  # s


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the subcommand.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the subcommand.
    """
    parser.description = (
        "Writes a table (CSV) as a bag (MCAP) with the suite's topics. Where the vehicle stands "
        "before it drives, the bag can be judged: its reference is what the nominal vehicle does "
        "with the recorded commands. With a speed_command, and a steering_map that is not "
        "estimated, it can be identified from, too."
    )
    parser.epilog = EXAMPLE
    add = parser.add_argument
    add("table", metavar="TABLE", type=Path, help=".csv or .csv.gz file with a header")
    add("--columns", type=Path, required=True, metavar="FILE", help="mapping of its columns, YAML")
    add_vehicle_option(parser)
    add("--output", type=Path, required=True, metavar="DIR", help="bag to create")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Read the table, write the bag.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.
    """
    from parameter_identification.drives.imported import write_bag
    from parameter_identification.drives.samples import MAX_GAP
    from parameter_identification.drives.table import EstimatedMap, load_columns, read_recording
    from parameter_identification.drives.windows import steering_of
    from trajectory_recorder.bag.writer import check_new

    check_new(args.output)
    check_folder(args.output.parent)
    columns, vehicle = load_columns(args.columns), load_vehicle(args.vehicle)
    recording = read_recording(args.table, columns, vehicle)
    steering = steering_of(recording, vehicle, columns)
    start = write_bag(recording, vehicle, steering, args.output)
    print(f"{len(recording.time)} poses in {args.output}")
    apart = (recording.time[-1] - recording.time[0]) / (len(recording.time) - 1)
    if apart > MAX_GAP:
        print(f"a pose every {apart:.3g} s: is the unit of time wrong?", file=sys.stderr)
    estimated = isinstance(steering, EstimatedMap)
    if estimated:
        print(f"{steering}: that of nominal tyres, which `tricycle identify` of the table corrects")
    if start is None:
        print(
            "no start event: the vehicle does not drive, or does not stand for 0.6 s before; the "
            "bag cannot be judged, identify from the table instead",
            file=sys.stderr,
        )
    elif columns.speed_command is None:
        print("no speed_command: the bag can be judged; identify from the table", file=sys.stderr)
    elif estimated:
        print("estimated map: the bag can be judged; identify from the table", file=sys.stderr)
    elif recording.time[-1] - start > LONG:
        print(
            f"a drive of {recording.time[-1] - start:.0f} s: a model without feedback loses its "
            "position over minutes; identify windows of the table instead",
            file=sys.stderr,
        )
    return 0
