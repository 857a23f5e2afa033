"""The paper's tricycle moves as it did before vehicles came from their files.

`reference_drive.json` holds numbers of that model (commit da880fb), which no change may move by
more than rounding does. They were written anew twice: since the motor's speed is relative to the
body, and since the aligning moment follows the direction of rolling (at most 0.7 mN of a load).
"""

import json
from pathlib import Path

import numpy as np
import pytest

from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate
from tricycle_sim.vehicle.live import LiveVehicle

VEHICLE = load_vehicle()
REFERENCE = json.loads(Path(__file__).with_name("reference_drive.json").read_text())


def batch_drive():
    """Columns at some ticks of four vehicles in a slalom, by name."""
    time = np.arange(0.0, 8.01, 0.02)
    commands = Commands(time, 0.5 * np.sin(1.3 * time) * (time > 1.0), np.minimum(time, 2.5))
    low, high = np.array([*VEHICLE.unknown.values()]).T
    points = low + (high - low) * np.random.default_rng(1).random((4, len(low)))
    columns = simulate(VEHICLE, commands, points, threads=1).columns()
    return {name: np.atleast_2d(column)[:, ::200].tolist() for name, column in columns.items()}


def live_drive():
    """What instruments read after each phase of a drive tick by tick."""
    live, read = LiveVehicle(VEHICLE), []
    for setpoints in (
        {"steering": 0.3, "speed": 2.0},
        {"steering": -0.2, "torque": -8.0},
        {"steering": None, "torque": 5.0, "brake": 0.3},
    ):
        for _ in range(100):
            state = live.step(**setpoints)
        read.append([state.x, state.y, state.vx, state.motor_torque, *state.wheel_speeds])
        read.append([*state.loads, *state.specific_force, state.yaw])
    return read


def test_the_batch_drives_as_it_did():
    found = batch_drive()
    assert list(found) == list(REFERENCE["batch"])
    for name, column in REFERENCE["batch"].items():
        assert np.array(found[name]) == pytest.approx(np.array(column), rel=1e-9, abs=1e-9), name


def test_the_live_vehicle_drives_as_it_did():
    for found, expected in zip(live_drive(), REFERENCE["live"], strict=True):
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)
