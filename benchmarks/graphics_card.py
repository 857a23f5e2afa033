"""Trajectory errors of many samples: on the cores of this machine and on its graphics card.

    python benchmarks/graphics_card.py [--samples 2048 16384 100000] [--duration 22] [--repeats 3]

Every time is the shortest of several, in turn; the first run on the card, which compiles, is told
apart. Needs the extra `gpu` and a card by NVIDIA.
"""

import argparse
import time

import numpy as np
from numpy.typing import NDArray

from excitation_planner.trajectory_error import NominalTrajectory
from tricycle_core.cores import usable_cores
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import CommandedBatch
from tricycle_sim.vehicle.planar import (
    COLUMNS,
    PlanarBlock,
    card_is_faster,
    drive_on_card,
    drive_on_cores,
)

Array = NDArray[np.float64]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--samples", type=int, nargs="+", default=[2048, 16_384, 100_000])
    parser.add_argument("--duration", type=float, default=22.0, help="of the drive [s]")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    from tricycle_sim.vehicle import graphics_card

    if not graphics_card.is_there():
        raise SystemExit("no graphics card here, or the extra gpu is not installed")
    vehicle = load_vehicle()
    when = np.arange(0.0, options.duration, 0.02)
    commands = Commands(when, 0.1 * np.sin(when), np.minimum(0.9 * when, 2.0))
    batch = CommandedBatch(vehicle, commands)
    columns = batch.run(vehicle.nominal_point()[np.newaxis], COLUMNS).columns
    nominal = NominalTrajectory(batch.time, *(column[0] for column in columns.values()))
    low, high = np.array(list(vehicle.unknown.values())).T
    samples = np.random.default_rng(0).uniform(low, high, (max(options.samples), len(low)))

    def errors(n: int, on_card: bool) -> tuple[Array, float]:
        found = np.empty(n)

        def reduce(first: int, block: PlanarBlock) -> None:
            te = nominal.error(block.x, block.y, block.vx_world, block.vy_world)
            found[first : first + len(te)] = te

        start = time.perf_counter()
        if not on_card:
            drive_on_cores(batch, samples[:n], reduce)
        elif drive_on_card(batch, samples[:n], reduce) != n:
            raise SystemExit("the card failed")
        return found, time.perf_counter() - start

    errors(1, on_card=False)  # compiles
    _, first = errors(1024, on_card=True)
    print(f"first run on the card: {first:.1f} s; {usable_cores()} cores")
    print(f"a trial says that the card is faster: {card_is_faster(vehicle)}")
    print("samples   cores s   card s   ratio   ns per step   largest relative difference of TE")
    for n in options.samples:
        pairs = [
            (errors(n, on_card=False), errors(n, on_card=True)) for _ in range(options.repeats)
        ]
        (cores, _), (card, _) = pairs[0]
        on_cores, on_card = (min(pair[place][1] for pair in pairs) for place in (0, 1))
        steps, apart = n * len(batch.time), np.abs(card - cores).max() / cores.max()
        print(
            f"{n:7d}  {on_cores:8.3f} {on_card:8.3f} {on_cores / on_card:7.1f}"
            f" {on_card / steps * 1e9:13.2f}   {apart:.0e}"
        )


if __name__ == "__main__":
    main()
