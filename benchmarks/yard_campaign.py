"""A campaign of ten drives in a yard of 12 m x 25 m, on live nodes, that nobody touches.

    python benchmarks/yard_campaign.py [--drives 10] [--real-time-factor 20] [--output DIR]

`tricycle campaign --return` plans, drives, records and identifies; between drives the vehicle goes
back by itself. The tolerance is one that ten drives do not reach. Printed: how many drives were
driven, how close the footprint came to the border in the recorded poses (their noise included), and
which 95 % intervals hold the hidden truth. Status 1 where a drive is missing or one left the yard.
"""

import argparse
import json
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import shapely

from excitation_planner.area.area import load_area
from excitation_planner.area.tube import footprint_of
from parameter_identification.drives.reader import read_drive
from tricycle_core.poses import placed
from tricycle_sim.vehicle import load_vehicle

YARD = "keep_in: [[0, 0], [12, 0], [12, 25], [0, 25]]\nmargin: 0.5\n"
TRICYCLE = Path(sysconfig.get_path("scripts")) / "tricycle"


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--drives", type=int, default=10)
    parser.add_argument("--real-time-factor", default="20")
    parser.add_argument("--output", type=Path)
    arguments = parser.parse_args()
    output = arguments.output or Path(tempfile.mkdtemp()) / "campaign"
    output.mkdir(parents=True, exist_ok=True)
    (file := output / "yard.yaml").write_text(YARD)
    subprocess.run(
        [
            *(TRICYCLE, "campaign", "--targets", "cornering_stiffness,yaw_inertia"),
            *("--tolerance", "0.01%", "--area", file, "--return", "--budget", "4000"),
            *("--most-drives", str(arguments.drives), "--output", output / "campaign"),
            *("--real-time-factor", arguments.real_time_factor),
        ],
        check=False,  # the tolerance is out of reach
    )
    if not (file_of_report := output / "campaign" / "report.json").exists():
        sys.exit("the campaign ended before its report")
    report = json.loads(file_of_report.read_text())
    area, footprint = load_area(file), footprint_of(load_vehicle())
    inside = shapely.Polygon(area.keep_in)
    closest = []
    for bag in sorted((output / "campaign" / "bags").iterdir()):
        poses = read_drive(bag, sensors=False).poses
        outlines = shapely.polygons(placed(footprint, poses.x, poses.y, poses.heading))
        least = shapely.distance(outlines, inside.exterior).min()
        closest.append(least if shapely.contains(inside, outlines).all() else -least)
    print(f"{len(closest)} drives; the footprint stays {min(closest):.2f} m inside the border")
    for name, known in report["targets"].items():
        half = 1.96 * known["standard_deviation"]
        off = (known["truth"] - known["estimate"]) / known["standard_deviation"]
        print(f"{name} {known['estimate']:.5g} ± {half:.2g}, off by {off:+.1f} σ")
    sys.exit(int(len(closest) < arguments.drives or min(closest) < 0.0))


if __name__ == "__main__":
    main()
