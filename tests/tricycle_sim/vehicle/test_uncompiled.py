"""The compiled vehicle does what its Python source says.

With NUMBA_DISABLE_JIT the other way round: `make coverage` looks into the source so.
"""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate
from tricycle_sim.vehicle.live import LiveVehicle


def driven():
    """States after a short batch and a short live drive through every mode."""
    vehicle = load_vehicle()
    commands = Commands([0.0, 0.1, 0.2], [0.0, 0.5, -0.5], [0.5, 1.0, 1.0])
    points = np.outer([0.6, 1.0, 1.4], vehicle.nominal_point())
    batch = simulate(vehicle, commands, points, threads=1)
    live = LiveVehicle(vehicle)
    for setpoints in (
        {"steering": 0.01, "speed": 0.3},
        {"steering": 0.02, "speed": -0.3},
        {"torque": 20.0},
        {"torque": -20.0, "brake": 1.0},
    ):
        for _ in range(3):
            state = live.step(**setpoints)
    columns = [batch.x, batch.y, batch.yaw, batch.roll, batch.vx, batch.load_left]
    return [*np.array(columns)[:, :, -1].ravel().tolist(), state.x, state.vx, *state.loads]


@pytest.mark.slow
def test_compiled_and_interpreted_agree():
    other = "0" if os.environ.get("NUMBA_DISABLE_JIT", "0") == "1" else "1"
    done = subprocess.run(
        [sys.executable, __file__], env=os.environ | {"NUMBA_DISABLE_JIT": other},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert json.loads(done.stdout) == pytest.approx(driven(), rel=1e-9, abs=1e-9)


if __name__ == "__main__":
    print(json.dumps(driven()))
