"""The three hot paths: vehicle step, Kriging fit with indices, frame codec; against another tree.

    python benchmarks/hot_paths.py                      # this tree
    python benchmarks/hot_paths.py --other ../before    # in turn with another checkout, as ratios
    python benchmarks/hot_paths.py --fence              # the driver's fence, as part of a tick

The other checkout needs this file and the same environment.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

ROUNDS = 10


def vehicle_step() -> float:
    """Time per vehicle and Runge-Kutta step of 200 vehicles on a lane change, one thread [s]."""
    import numpy as np

    from excitation_planner.maneuver import DoubleLaneChange
    from excitation_planner.planning.replay import nominal_run
    from tricycle_sim.vehicle import load_vehicle
    from tricycle_sim.vehicle.batch import simulate

    vehicle = load_vehicle()
    family = DoubleLaneChange()
    commands = nominal_run(
        vehicle, family, family.operation.from_unit(np.array([0.5, 0.5]))
    ).commands
    samples = np.tile(vehicle.nominal_point(), (200, 1))
    steps = 200 * len(simulate(vehicle, commands, samples, threads=1).time)
    return best_of(lambda: simulate(vehicle, commands, samples, threads=1), 5) / steps


def kriging() -> float:
    """Fit of a Kriging model to 200 samples of six parameters, with its Sobol' indices [s]."""
    import numpy as np

    from excitation_planner import Kriging, sobol_indices

    rng = np.random.default_rng(0)
    X = rng.random((200, 6))
    y = np.sin(3 * X[:, 0]) + X[:, 1] ** 2 + X[:, 2] * X[:, 3] + 0.1 * X[:, 4]
    return best_of(lambda: sobol_indices(Kriging().fit(X, y)), 3)


def codec() -> float:
    """Encoding and decoding of a state frame [s]."""
    from tricycle_bridge.protocol.framing import FrameDecoder, encode
    from tricycle_bridge.protocol.messages import Board, DriveState, layout

    state = DriveState(**dict.fromkeys(layout(DriveState), 1))

    def work() -> None:
        decoder = FrameDecoder(Board.DRIVE, host=True)
        decoder.session = 5
        for seq in range(2000):
            decoder.feed(encode(state, board=Board.DRIVE, seq=seq & 0xFF, session=5))
        assert decoder.counters.ok == 2000

    return best_of(work, 5) / 2000


def fence() -> None:
    """Print the fence's longest ticks at 4 m/s, past keep_outs and up to the border."""
    import math

    import numpy as np

    from excitation_planner.area.area import MAX_CORNERS, Area
    from excitation_planner.area.fence import Fence
    from excitation_planner.localisation import PlanarState
    from tricycle_core.timing import TICK

    def ring(x, y, radius, corners):
        turn = 2 * np.pi * (np.arange(corners) + 0.5) / corners
        return np.stack([x + radius * np.cos(turn), y + radius * np.sin(turn)], axis=-1)

    def posts(number, corners):
        """On the right of the way, on 80 m x 40 m."""
        columns = math.ceil(math.sqrt(2 * number))
        rows, columns_of = np.divmod(np.arange(number), columns)
        x, y = 80 * ((columns_of + 0.5) / columns - 0.5), 2 - 80 * rows / columns
        return tuple(ring(*middle, 0.2, corners) for middle in zip(x, y, strict=True))

    square = ring(0, 0, 57, 4)
    footprint = np.array([[1.2, 0.5], [-1.1, 0.5], [-1.1, -0.5], [1.2, -0.5]])
    print("longest time of the fence / tick     before it trips   as it trips")
    for name, keep_in, keep_out in (
        ("square", square, ()),
        *((f"square, {n} rectangles", square, posts(n, 4)) for n in (3, 10, 20)),
        (f"{MAX_CORNERS} corners", ring(0, 0, 45, MAX_CORNERS), ()),
        (f"square, {MAX_CORNERS // 3 - 2} triangles", square, posts(MAX_CORNERS // 3 - 2, 3)),
    ):
        ground = Area(keep_in, keep_out).within(Area.margin)
        guard = Fence("odom", ground, footprint, np.zeros(2), (0.0, 0.0, 0.0))
        times = []
        for x in np.arange(-15.0, 45.0, 0.2):
            state = PlanarState(x, 6.0, 0.0, 4.0, frame="odom")
            ask = partial(guard.trespass, state, age=0.02, curvature=0.15, push=1.0)
            times.append(best_of(ask, 3) / TICK)
            if ask():
                break
        print(f"{name:<35}{max(times[:-1]):>17.2f}{times[-1]:>14.2f}")


def best_of(work, repeats: int) -> float:
    """Shortest of some calls, after one that does not count [s]."""
    work()
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        work()
        times.append(time.perf_counter() - begun)
    return min(times)


def measure(tree: Path) -> dict[str, float]:
    """Run the hot paths of a tree in a process of its own."""
    path = os.pathsep.join(str(folder) for folder in sorted((tree / "src").iterdir()))
    environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, tree / "benchmarks" / "hot_paths.py", "--measure"],
        env=environment, stdout=subprocess.PIPE, check=True,
    )  # fmt: skip
    return dict(json.loads(done.stdout))


def main() -> None:
    """Print medians, and ratios to another tree."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--other", type=Path, help="root of another checkout")
    parser.add_argument("--measure", action="store_true", help="print one measurement as JSON")
    parser.add_argument("--fence", action="store_true", help="print the fence's times instead")
    args = parser.parse_args()
    if args.fence:
        fence()
        return
    if args.measure:
        print(json.dumps({f.__name__: f() for f in (vehicle_step, kriging, codec)}))
        return
    ours, theirs = [], []
    for _ in range(ROUNDS):
        ours.append(measure(Path(__file__).parents[1]))
        if args.other:
            theirs.append(measure(args.other.absolute()))
    for name in ours[0]:
        line = f"{name}: {statistics.median(run[name] for run in ours) * 1e6:.3f} us"
        if theirs:
            ratios = [a[name] / b[name] for a, b in zip(ours, theirs, strict=True)]
            line += f", {statistics.median(ratios):.3f} times the other's (median of {ROUNDS})"
        print(line)


if __name__ == "__main__":
    main()
