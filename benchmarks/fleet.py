"""Fleets against the populations that their vehicles were drawn from.

    python benchmarks/fleet.py [--vehicles 200] [--drives 3] [--fleets 1] [--part drives|statistics]

drives      Vehicles whose unknown parameters are normally distributed, with a spread of 4 % of the
            ranges. Self aligning stiffness and rolling coefficient 2 are the same in all; the
            cornering stiffness falls by 10 ± 3 % of its range in the 180 days of the drives, camber
            stiffness does not change, and both are estimated as changing. In every second fleet the
            cornering stiffness of one vehicle is larger by 30 % of its range, and that of another
            falls by 40 %. Each drives some circles (see many_drives.py) at random times. Printed:
            wall and CPU time with reading; how many intervals hold the truth; which are called odd.
statistics  Many fleets of estimates that are drawn with errors of known size, by the same code from
            there on: coverage, false alarms, and how often an odd vehicle is found.

A share of intervals fails where an exact binomial test at 1 %, Holm-corrected over the rows,
rejects a coverage of 90 % or more.
"""

import argparse
import dataclasses
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from held_intervals import Tally
from identification import HIGH, LOW, VEHICLE, rounded
from many_drives import SENSORS, used_in_all

from excitation_planner.maneuver import Circle
from excitation_planner.planning.replay import nominal_run
from parameter_identification.drives.imported import recording_of, write_bag
from parameter_identification.drives.simulated import SensedMotion, measure
from parameter_identification.drives.table import SteeringMap
from parameter_identification.fleet import DAY, identify_fleet
from parameter_identification.fleet_fit import DriveEvidence
from tricycle_sim.vehicle.batch import simulate

NAMES = tuple(VEHICLE.unknown)
SPREAD = 0.04  # of the ranges
MIDDLE = np.array([0.5, 0.5, 0.5, 0.5, 0.5, 0.5])
SHARED = ("self_aligning_stiffness", "rolling_coefficient_2")
CHANGING = ("cornering_stiffness", "camber_stiffness")
RATE, RATE_SPREAD = np.array([-0.10, 0.0]), np.array([0.03, 0.0])  # of the ranges in `DAYS`
DAYS, FIRST = 180.0, 1.7e9  # length, and beginning in s since 1970
ODD, ODD_RATE = 0.3, -0.4  # of the range, of one vehicle each


def make(job):
    """One bag of a random circle of a vehicle with these parameters, at a time."""
    folder, number, truth, start = job
    bag = folder / f"{number:05d}"
    if not bag.exists():
        rng = np.random.default_rng([number, 1])
        x = np.array([rng.uniform(2.2, 5.0), rng.uniform(0.7, 1.0)])
        commands = nominal_run(VEHICLE, Circle(duration=12.0), x).commands
        motion = SensedMotion.of(simulate(VEHICLE, commands, truth[None], threads=1))
        drive = rounded(measure(motion, commands, SENSORS, rng=rng, name=bag.name, standstill=1.0))
        recording = dataclasses.replace(recording_of(drive), start=start)
        write_bag(recording, VEHICLE, SteeringMap(), bag)
    return bag


class Truth:
    """What a fleet was made with: shares of the ranges (v, k), and rates (v, 2)."""

    def __init__(self, vehicles, number):
        rng = np.random.default_rng([number, 7])
        self.shares = MIDDLE + SPREAD * rng.standard_normal((vehicles, len(NAMES)))
        for name in SHARED:
            self.shares[:, NAMES.index(name)] = 0.5
        self.rates = RATE + RATE_SPREAD * rng.standard_normal((vehicles, 2))
        self.odd = set()
        if number % 2 == 0:
            self.shares[-1, 0] += ODD
            self.rates[-2, 0] += ODD_RATE
            self.odd = {vehicles - 1, vehicles - 2}

    def at(self, vehicle, days):
        """Parameters of a vehicle so many days after the middle."""
        share = self.shares[vehicle].copy()
        for i, name in enumerate(CHANGING):
            share[NAMES.index(name)] += self.rates[vehicle, i] * days / DAYS
        return LOW + (HIGH - LOW) * share


def one_fleet(number, arguments, folder, tally):
    truth = Truth(arguments.vehicles, number)
    rng = np.random.default_rng([number, 8])
    names = [f"trike {i:03d}" for i in range(arguments.vehicles)]
    jobs = []
    for vehicle, name in enumerate(names):
        home = folder / f"fleet {number}" / name
        home.mkdir(parents=True, exist_ok=True)
        for i in range(arguments.drives):
            days = DAYS * ((i + rng.uniform()) / arguments.drives - 0.5)
            start = FIRST + DAY * (days + DAYS / 2)
            seed = (number * arguments.vehicles + vehicle) * arguments.drives + i
            jobs.append((home, seed, truth.at(vehicle, days), start))
    with ProcessPoolExecutor(arguments.workers) as pool:
        made = list(pool.map(make, jobs, chunksize=8))
    bags = {name: [bag for bag in made if bag.parent.name == name] for name in names}
    begun, cpu = time.perf_counter(), used_in_all()
    with (
        tempfile.TemporaryDirectory() as work,
        ProcessPoolExecutor(arguments.workers, mp_context=get_context("spawn")) as executor,
    ):
        fleet = identify_fleet(
            bags, VEHICLE, folder=Path(work), executor=executor, shared=SHARED, changing=CHANGING
        )
    wall, cpu = time.perf_counter() - begun, used_in_all() - cpu
    made_odd = ", ".join(names[i] for i in sorted(truth.odd)) or "none"
    print(
        f"fleet {number}: {len(made)} drives, {wall:.0f} s, {cpu:.0f} s of CPU; "
        f"made odd: {made_odd}; found odd: {', '.join(sorted(fleet.odd)) or 'none'}",
        flush=True,
    )
    count(fleet, truth, names, tally)
    return fleet


def count(fleet, truth, names, tally):
    days = (fleet.when - FIRST) / DAY - DAYS / 2
    width = dict(zip(NAMES, HIGH - LOW, strict=True))
    for name, found in fleet.populations.items():
        i, rate = NAMES.index(name), 0.0
        if name in CHANGING:
            rate = RATE[CHANGING.index(name)] * days / DAYS
        spread = np.hypot(SPREAD, RATE_SPREAD[0] * days / DAYS if rate else 0.0)
        tally.count(
            "means of parameters",
            found.mean.low <= LOW[i] + width[name] * (MIDDLE[i] + rate) <= found.mean.high,
        )
        tally.count(
            "spreads of parameters", found.spread.low <= width[name] * spread <= found.spread.high
        )
        for m in found.members:
            value = truth.at(names.index(m.vehicle), days)[i]
            tally.count(f"vehicles: {name}", m.value.low <= value <= m.value.high)
    for i, (name, found) in enumerate(fleet.changes.items()):
        scale = width[name] / DAYS
        tally.count("means of changes", found.mean.low <= scale * RATE[i] <= found.mean.high)
        if RATE_SPREAD[i]:
            tally.count(
                "spreads of changes",
                found.spread.low <= scale * RATE_SPREAD[i] <= found.spread.high,
            )
        for m in found.members:
            rate = scale * truth.rates[names.index(m.vehicle), i]
            tally.count(f"vehicles: change of {name}", m.value.low <= rate <= m.value.high)
    for name, e in fleet.shared.items():
        tally.count(
            "shared parameters", e.low <= LOW[NAMES.index(name)] + 0.5 * width[name] <= e.high
        )


# ---- estimates drawn with errors of known size ----


def drawn(vehicles, number, spread, rate, rate_spread):
    """Levels and rates (v, 2), and what some drives of each vehicle tell of them."""
    rng = np.random.default_rng([number, 9])
    true = np.array([0.5, rate]) + np.array([spread, rate_spread]) * rng.standard_normal(
        (vehicles, 2)
    )
    error = 0.02 * np.exp(0.7 * rng.standard_normal(vehicles))
    estimates, covariances = np.empty((vehicles, 2)), np.empty((vehicles, 2, 2))
    for i in range(vehicles):
        times = rng.uniform(-1.0, 1.0, 3)
        rows = np.column_stack([np.ones(3), times]) / error[i]
        covariances[i] = np.linalg.inv(rows.T @ rows + np.diag([0.0, 0.004]))
        noise = rng.standard_normal(3)
        estimates[i] = covariances[i] @ (rows.T @ (rows @ true[i] + noise))
    return true, DriveEvidence(
        estimates, covariances, np.zeros((vehicles, 2, 0)), [True] * vehicles
    )


def one_drawn(job):
    """Populations of levels and rates of one fleet; a vehicle may be moved by so many spreads."""
    vehicles, number, spread, rate, rate_spread, moved = job
    true, alone = drawn(vehicles, number, spread, rate, rate_spread)
    sizes = np.array([np.hypot(spread, 0.02), np.hypot(rate_spread, 0.02)])
    true[0] += moved * sizes
    alone.estimates[0] += moved * sizes
    names = [str(i) for i in range(vehicles)]
    rates = alone.population(names, 1, (0.0, 1.0), 0.95)
    levels = alone.with_rates(rates, 1.0, 0.95).population(names, 0, (0.0, 1.0), 0.95)
    return true, levels, rates


def statistics(arguments):
    cases = {"with change": (0.04, -0.10, 0.03), "without": (0.04, 0.0, 0.0)}
    tally, alarms = Tally(), {}
    with ProcessPoolExecutor(arguments.workers) as pool:
        for case, (spread, rate, rate_spread) in cases.items():
            jobs = [
                (arguments.vehicles, n, spread, rate, rate_spread, 0.0)
                for n in range(arguments.fleets)
            ]
            for true, levels, rates in pool.map(one_drawn, jobs):
                for kind, found, middle, size, values in (
                    ("level", levels, 0.5, spread, true[:, 0]),
                    ("change", rates, rate, rate_spread, true[:, 1]),
                ):
                    row = f"{case}: {kind}"
                    tally.count(f"{row}, mean", found.mean.low <= middle <= found.mean.high)
                    if size:
                        tally.count(f"{row}, spread", found.spread.low <= size <= found.spread.high)
                    for m, value in zip(found.members, values, strict=True):
                        tally.count(f"{row}, vehicles", m.value.low <= value <= m.value.high)
                    alarms.setdefault(row, []).append(any(m.odd for m in found.members))
        tally.print()
        for row, rung in alarms.items():
            print(
                f"{row:42s} {sum(rung):6d} of {len(rung):6d} fleets have an odd vehicle by chance"
            )
        for moved in (4.0, 5.0, 6.0, 8.0):
            jobs = [
                (arguments.vehicles, n, 0.04, -0.10, 0.03, moved) for n in range(arguments.fleets)
            ]
            found = [
                (levels.members[0].odd, rates.members[0].odd)
                for _, levels, rates in pool.map(one_drawn, jobs)
            ]
            level, rate = np.mean(found, axis=0)
            print(
                f"odd by {moved:.0f} times the hypotenuse of spread and 2 % of the range: found by "
                f"its level in {level:.0%}, by its change in {rate:.0%}"
            )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--part", choices=("drives", "statistics"), default="drives")
    parser.add_argument("--vehicles", type=int, default=200)
    parser.add_argument("--drives", type=int, default=3)
    parser.add_argument("--fleets", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--folder", type=Path)
    arguments = parser.parse_args()
    if arguments.part == "statistics":
        statistics(arguments)
        return
    tally = Tally()
    with tempfile.TemporaryDirectory() as own:
        for number in range(arguments.fleets):
            one_fleet(number, arguments, arguments.folder or Path(own), tally)
    tally.print()


if __name__ == "__main__":
    main()
