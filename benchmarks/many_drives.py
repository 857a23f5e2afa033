"""Identification drive by drive: time and memory against the number of drives.

    python benchmarks/many_drives.py [--drives 100] [--workers 2] [--folder DIR]

Makes so many bags of one vehicle on different circles (position 1 mm, heading 1 mrad, gyro
5 mrad/s, wheel speed rounded to 1 mm/s, all at 100 Hz, some 20 s each), then identifies from a
tenth of them and from all, as `tricycle identify --drive-by-drive` does, reading included. Printed:
wall and CPU time, the largest memory of a process, the ratio to a tenth, and the error of every
estimate in its deviations. Bags that are in the folder already are not made again.
"""

import argparse
import resource
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from identification import VEHICLE, draw, rounded

from excitation_planner.maneuver import Circle
from excitation_planner.planning.replay import nominal_run
from parameter_identification.drives.imported import recording_of, write_bag
from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from parameter_identification.drives.table import SteeringMap
from parameter_identification.many_drives import identify_many
from tricycle_sim.vehicle.batch import simulate

SENSORS = {
    Sensor.POSITION: SensorNoise(0.001, rate=100.0),
    Sensor.HEADING: SensorNoise(0.001, rate=100.0),
    Sensor.YAW_RATE: SensorNoise(0.005, rate=100.0),
    Sensor.WHEEL_SPEED: SensorNoise(0.0, rate=100.0),
}
TRUTH = draw(3)


def make(job):
    """One bag of a random circle of a vehicle with these parameters."""
    folder, number, truth = job
    bag = folder / f"{number:04d}"
    if not bag.exists():
        rng = np.random.default_rng([number, 1])
        x = np.array([rng.uniform(2.2, 5.0), rng.uniform(0.7, 1.0)])
        commands = nominal_run(VEHICLE, Circle(duration=18.0), x).commands
        motion = SensedMotion.of(simulate(VEHICLE, commands, truth[None], threads=1))
        drive = rounded(measure(motion, commands, SENSORS, rng=rng, name=bag.name, standstill=1.0))
        write_bag(recording_of(drive), VEHICLE, SteeringMap(), bag)
    return bag


def used_in_all():
    """CPU time of this process and those that it has waited for [s]."""
    usages = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def timed(bags, workers):
    """Result, wall and CPU time of one identification that has read nothing before."""
    with tempfile.TemporaryDirectory() as work:
        before = used_in_all()
        begun = time.perf_counter()
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as executor:
            found = identify_many(bags, VEHICLE, folder=Path(work), executor=executor)
        wall = time.perf_counter() - begun
        cpu = used_in_all() - before
    return found, wall, cpu


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--drives", type=int, default=100)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--folder", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as own, ProcessPoolExecutor(arguments.workers) as pool:
        folder = arguments.folder or Path(own)
        folder.mkdir(parents=True, exist_ok=True)
        bags = list(pool.map(make, [(folder, i, TRUTH) for i in range(arguments.drives)]))
        walls = []
        for count in (max(1, arguments.drives // 10), arguments.drives):
            found, wall, cpu = timed(bags[:count], arguments.workers)
            walls.append(wall)
            memory = max(
                resource.getrusage(who).ru_maxrss
                for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
            )
            print(
                f"{count} drives of some {found.drives[0].samples} numbers: {wall:.1f} s, "
                f"{cpu:.1f} s of CPU ({cpu / count:.2f} per drive), "
                f"at most {memory / 1024:.0f} MB per process"
            )
        print(f"ten times the drives: {walls[1] / walls[0]:.1f} times as long")
        for (name, e), truth in zip(found.parameters.items(), TRUTH, strict=True):
            off = (e.estimate - truth) / e.standard_deviation
            print(
                f"{name:26s} {e.estimate:10.5g} ± {e.standard_deviation:.2g}, off by {off:+.1f} σ"
            )
        print(f"scatter over noise {found.scatter:.2f}, not white {found.not_white}")


if __name__ == "__main__":
    main()
