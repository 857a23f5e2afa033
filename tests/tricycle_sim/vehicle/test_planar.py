"""Paths of many vehicles on the graphics card: as on the cores, and never instead of a result.

Without a card numba's simulator of one runs the same kernel as Python, in a process of its own.
"""

import os
import subprocess
import sys

import numpy as np
import pytest

from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import graphics_card, load_vehicle, planar
from tricycle_sim.vehicle.batch import CommandedBatch

VEHICLE = load_vehicle()
COMMANDS = Commands(np.array([0.0, 0.05]), np.array([0.1, 0.1]), np.array([0.2, 0.2]))

ON_CARD = """
from pathlib import Path
import numpy as np
import tricycle_sim
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle, planar
from tricycle_sim.vehicle.batch import CommandedBatch
from tricycle_sim.vehicle.layout import COMMANDED, EVENT, LANES, SLOPE, START
from tricycle_sim.vehicle.parts import ROWS

def samples(vehicle, n):
    low, high = np.array(list(vehicle.unknown.values())).T
    return np.random.default_rng(0).uniform(low, high, (n, len(low)))

def compare(vehicle, commands, n=3, **how):
    batch, P = CommandedBatch(vehicle, commands), samples(vehicle, n)
    columns = [name for name in batch.available if name != "yaw"]
    runs = [batch.run(P, columns, on_card=memory, **how) for memory in (None, np.empty(10**6))]
    for name in columns:
        cores, card = (run.columns[name] for run in runs)
        np.testing.assert_allclose(card, cores, rtol=1e-9, atol=1e-9, err_msg=name)
    # events too, but for the place of the friction's peak: rounding decides it while a wheel slides
    events = [*range(SLOPE, EVENT.friction_squared + 1), *range(EVENT.motor, COMMANDED)]
    rows = [*range(START), *events]
    cores, card = (run.groups.reshape(-1, ROWS, LANES)[:, rows] for run in runs)
    np.testing.assert_allclose(card, cores, rtol=1e-6, atol=1e-6)
    return runs[1]

def steering(angle, speed, duration):
    return Commands(np.array([0.0, duration]), np.full(2, angle), np.full(2, speed))

vehicle = load_vehicle()
compare(vehicle, steering(0.1, 1.0, 0.1), every=2)
car = load_vehicle(Path(tricycle_sim.__file__).parent / "car_1_10.yaml")
compare(car, steering(0.1, 1.0, 0.05))
compare(vehicle, steering(0.1, 1.0, 0.05), steering_delay=np.array([0.0, 0.013, 0.02]),
        faster=np.full((3, 6), 0.1))
over = compare(vehicle, steering(0.78, 4.8, 1.2), 1, speed=np.full(1, 4.8))
assert over.feasibility.rolled_over.happened.all()

planar._CARD_BYTES, planar._PART = 16 * 8 * 4 * 6, 8  # three blocks, in parts
batch, P, found = CommandedBatch(vehicle, steering(0.1, 1.0, 0.05)), samples(vehicle, 43), []
told = []
for drive in planar.drive_on_cores, planar.drive_on_card:
    x = np.full((43, 6), np.nan)
    def reduce(first, block):
        x[first : first + len(block.x)] = block.x
        assert len(block.feasibility.rolled_over.happened) == len(block.x)
    drive(batch, P, reduce, progress=lambda *done: told.append(done))
    found.append(x)
np.testing.assert_allclose(found[1], found[0], rtol=1e-9, atol=1e-12)
assert told[-3:] == [(16, 43), (32, 43), (43, 43)], told

planar.FOR_CARD = 1
planar.card_is_faster(vehicle)
"""


@pytest.mark.slow
def test_the_card_drives_as_the_cores_do():
    card = {} if graphics_card.is_there() else {"NUMBA_ENABLE_CUDASIM": "1"}
    process = subprocess.run(
        [sys.executable, "-W", "error", "-c", ON_CARD],
        env={**os.environ, **card},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert process.returncode == 0, process.stderr
    assert "without the graphics card" not in process.stderr


def test_a_card_that_fails_leaves_the_rest_to_the_cores(monkeypatch, caplog):
    monkeypatch.setattr(planar, "FOR_CARD", 1)
    monkeypatch.setattr(planar, "card_is_faster", lambda _: True)

    def fail(*_):
        raise RuntimeError("out of memory\nand much more")

    monkeypatch.setattr(graphics_card, "page_locked", fail)
    samples = np.tile(VEHICLE.nominal_point(), (20, 1))
    ends, told = np.full(20, np.nan), []

    def reduce(first, block):
        ends[first : first + len(block.x)] = block.x[:, -1]

    planar.simulate_planar(
        VEHICLE, COMMANDS, samples, reduce, progress=lambda *done: told.append(done)
    )
    alone = CommandedBatch(VEHICLE, COMMANDS).run(samples[:1], ("x",)).columns["x"][0, -1]
    assert np.all(ends == alone)
    assert told[-1] == (20, 20)
    assert "without the graphics card: out of memory" in caplog.text
    assert "much more" not in caplog.text


def test_an_error_while_reducing_is_not_taken_for_one_of_the_card(monkeypatch):
    monkeypatch.setattr(graphics_card, "page_locked", lambda *shape: np.empty(shape))
    batch = CommandedBatch(VEHICLE, COMMANDS)
    run = batch.run
    monkeypatch.setattr(batch, "run", lambda samples, columns, on_card: run(samples, columns))

    def fail(*_):
        raise ValueError("of the one who reduces")

    with pytest.raises(ValueError, match="of the one who reduces"):
        planar.drive_on_card(batch, np.tile(VEHICLE.nominal_point(), (9, 1)), fail)


def test_without_a_card_none_is_tried(monkeypatch):
    monkeypatch.setattr(graphics_card, "is_there", lambda: False)
    planar.card_is_faster.cache_clear()
    assert not planar.card_is_faster(VEHICLE)
    planar.card_is_faster.cache_clear()
