"""The equations are computed for eight vehicles at once, not for one after the other."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numba
import numpy as np
import pytest
import structures
from llvmlite import binding as llvm

from tricycle_core.timing import TICK
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.groups import equilibrium, pack
from tricycle_sim.vehicle.kernel import NO_OUTPUT, NO_ROWS, functions_for
from tricycle_sim.vehicle.parts import servo_at_rest, steering_constants


def saturating():
    """A vehicle of the laws with the most conditions."""
    throttle = structures.WITHOUT_SPEED_LOOP["throttle_curve"]["constants"]
    car = structures.CAR
    return structures.vehicle_of(
        {
            **car,
            "parts": {**car["parts"], "motor": "throttle_curve", "servo": "geared"},
            "constants": car["constants"]
            | {name: value for name, value in throttle.items() if "throttle" in name},
        }
    )


VEHICLES = {"tricycle": load_vehicle, "saturating": saturating}


def processor_times():
    """Shortest processor time [s] of the kernel for 64 vehicles and two seconds, by vehicle."""
    found = {}
    for name, make in VEHICLES.items():
        vehicle, ticks, times = make(), 200, []
        points = np.tile(vehicle.nominal_point(), (64, 1))
        table, angles = np.empty((2 * ticks + 1, 8)), np.empty((2, ticks + 1))
        functions, constants = functions_for(vehicle), steering_constants(vehicle, 0.5 * TICK)
        functions.steer(servo_at_rest(vehicle), np.full(ticks, 0.1), constants, 2, table, angles)
        drive = np.tile([1.0, 1.0, 0.0], (ticks + 1, 1))
        start = equilibrium(vehicle)
        for _ in range(30):
            groups = pack(vehicle, points, start)
            began = time.process_time()
            functions.advance(
                groups, table, np.zeros(len(drive)), drive, 1, 0, NO_ROWS, 1, NO_OUTPUT
            )
            times.append(time.process_time() - began)
        found[name] = min(times[1:])  # the first one compiles
    return found


def in_another_process(**environment):
    code = "import json, test_vectorised as t; print(json.dumps(t.processor_times()))"
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **environment, "PYTHONPATH": path},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.slow  # compiles
@pytest.mark.skipif(
    numba.config.DISABLE_JIT or not llvm.get_host_cpu_features().get("avx2"),
    reason="needs a processor with vectors of four numbers, and compiled equations",
)
def test_vectors_make_every_law_faster(tmp_path):
    """A condition that the compiler cannot turn into arithmetic makes all of a step scalar.

    Beside the same equations compiled without vectors: vector instructions in the machine code do
    not tell, a law that was computed vehicle by vehicle had as many.
    """
    scalar = in_another_process(NUMBA_LOOP_VECTORIZE="0", NUMBA_CACHE_DIR=str(tmp_path))
    vectors = in_another_process()
    assert all(vectors[name] < 0.5 * scalar[name] for name in VEHICLES), (vectors, scalar)
