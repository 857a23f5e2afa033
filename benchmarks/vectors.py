"""How much faster equations of eight vehicles at once are, with the laws of the shipped vehicles.

    python benchmarks/vectors.py

A condition that the compiler cannot turn into arithmetic makes all of a step scalar. Printed for
each vehicle, with a geared servo: the processor time of a step with vectors, and how much shorter
it is than that of the same equations compiled without. Vector instructions in the machine code
would not tell: a law that was computed vehicle by vehicle had as many. Ends with status 1 where a
step is less than twice as fast; needs a processor with vectors of four numbers.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from importlib.resources import files

import numpy as np

from tricycle_core.timing import TICK
from tricycle_sim.effects import extend
from tricycle_sim.vehicle import Vehicle, load_vehicle
from tricycle_sim.vehicle.groups import equilibrium, pack
from tricycle_sim.vehicle.kernel import NO_OUTPUT, NO_ROWS, functions_for
from tricycle_sim.vehicle.parts import servo_at_rest, steering_constants

NAMES = ("tricycle", "delta_tricycle", "cargo_tadpole", "car_1_10")
SAMPLES, TICKS, REPEATS, LEAST = 64, 200, 30, 2.0


def step_time(vehicle: Vehicle) -> float:
    """Return the shortest processor time per vehicle and step [s]."""
    points = np.tile(vehicle.nominal_point(), (SAMPLES, 1))
    table, angles = np.empty((2 * TICKS + 1, 8)), np.empty((2, TICKS + 1))
    functions, constants = functions_for(vehicle), steering_constants(vehicle, 0.5 * TICK)
    functions.steer(servo_at_rest(vehicle), np.full(TICKS, 0.1), constants, 2, table, angles)
    drive = np.tile([1.0, 1.0, 0.0], (TICKS + 1, 1))
    start, times = equilibrium(vehicle), []
    for _ in range(REPEATS):
        groups = pack(vehicle, points, start)
        began = time.process_time()
        functions.advance(groups, table, np.zeros(len(drive)), drive, 1, 0, NO_ROWS, 1, NO_OUTPUT)
        times.append(time.process_time() - began)
    return min(times[1:]) / SAMPLES / TICKS  # the first one compiles


def in_another_process(**environment: str) -> dict[str, float]:
    """Return `step_time` of each vehicle, measured by this script in a process of its own."""
    command = [sys.executable, __file__, "--times"]
    done = subprocess.run(
        command, env={**os.environ, **environment}, capture_output=True, text=True, check=True
    )
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def main() -> int:
    if "--times" in sys.argv:
        packaged = {name: load_vehicle(files("tricycle_sim") / f"{name}.yaml") for name in NAMES}
        geared = {name: extend(v, {"servo": "geared"}) for name, v in packaged.items()}
        print(json.dumps({name: step_time(vehicle) for name, vehicle in geared.items()}))
        return 0
    with tempfile.TemporaryDirectory() as cache:
        scalar = in_another_process(NUMBA_LOOP_VECTORIZE="0", NUMBA_CACHE_DIR=cache)
    vectors = in_another_process()
    ratios = {name: scalar[name] / vectors[name] for name in NAMES}
    for name, ratio in ratios.items():
        print(f"{name:<16} {1e9 * vectors[name]:6.0f} ns per step, {ratio:.1f} times as fast")
    return int(min(ratios.values()) < LEAST)


if __name__ == "__main__":
    sys.exit(main())
