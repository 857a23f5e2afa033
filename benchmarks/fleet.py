"""A fleet against the population that its vehicles were drawn from, reading included.

    python benchmarks/fleet.py [--vehicles 40] [--drives 2] [--folder DIR]

Vehicles whose unknown parameters are normally distributed, with a spread of 4 % of the ranges, and
one more whose cornering stiffness is far from the others. Each drives some circles (see
many_drives.py). Printed: wall and CPU time, for every population whether mean and spread are held,
how many of the vehicles' true values are, and which vehicles are called odd.
"""

import argparse
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from identification import HIGH, LOW, VEHICLE
from many_drives import make, used_in_all

from parameter_identification.fleet import identify_fleet

SPREAD = 0.04  # of the ranges
MIDDLE = np.array([0.4, 0.5, 0.5, 0.5, 0.5, 0.5])
ODD = 0.3  # of the range, by which one vehicle's cornering stiffness is larger


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--vehicles", type=int, default=40)
    parser.add_argument("--drives", type=int, default=2)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--folder", type=Path)
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    shares = MIDDLE + SPREAD * rng.standard_normal((arguments.vehicles, len(MIDDLE)))
    shares[-1, 0] += ODD
    truths = LOW + (HIGH - LOW) * shares
    with tempfile.TemporaryDirectory() as own, tempfile.TemporaryDirectory() as work:
        folder = arguments.folder or Path(own)
        names = [f"trike {i:03d}" for i in range(arguments.vehicles)]
        jobs = []
        for number, (name, truth) in enumerate(zip(names, truths, strict=True)):
            (folder / name).mkdir(parents=True, exist_ok=True)
            first = number * arguments.drives
            jobs += [(folder / name, first + i, truth) for i in range(arguments.drives)]
        with ProcessPoolExecutor(arguments.workers) as pool:
            made = list(pool.map(make, jobs))
        bags = {name: [bag for bag in made if bag.parent.name == name] for name in names}
        begun, cpu = time.perf_counter(), used_in_all()
        with ProcessPoolExecutor(arguments.workers, mp_context=get_context("spawn")) as executor:
            fleet = identify_fleet(bags, VEHICLE, folder=Path(work), executor=executor)
        wall, cpu = time.perf_counter() - begun, used_in_all() - cpu
    print(f"{len(names)} vehicles, {len(made)} drives: {wall:.1f} s, {cpu:.1f} s of CPU")
    for i, name in enumerate(VEHICLE.unknown):
        found = fleet.populations.get(name)
        if found is None:
            print(f"{name:26s} too few vehicles show it")
            continue
        width = HIGH[i] - LOW[i]
        mean, spread = LOW[i] + width * MIDDLE[i], SPREAD * width
        true = dict(zip(names, truths[:, i], strict=True))
        held = sum(m.value.low <= true[m.vehicle] <= m.value.high for m in found.members)
        print(
            f"{name:26s} mean {mean:.5g} in {found.mean.low:.5g} to {found.mean.high:.5g}, "
            f"spread {spread:.3g} in {found.spread.low:.3g} to {found.spread.high:.3g}, "
            f"{held} of {len(found.members)} vehicles held"
        )
    print(f"odd: {', '.join(fleet.odd) or 'none'} (made odd: {names[-1]})")


if __name__ == "__main__":
    main()
