"""The road: a tilted one pulls and loads as gravity does; `test_reference_drive.py` is level."""

import dataclasses
import math

import numpy as np
import pytest

from tricycle_core.errors import VehicleError
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate
from tricycle_sim.vehicle.live import LiveVehicle

VEHICLE = load_vehicle()
FIVE_PERCENT = math.atan(0.05)


def held(vehicle, seconds):
    """Stands with the brake on."""
    live = LiveVehicle(vehicle)
    for _ in range(round(100 * seconds)):
        live.step(brake=1.0)
    return live.state


@pytest.mark.parametrize("grade", [-0.05, 0.05])
def test_it_rolls_down_a_grade(grade):
    live = LiveVehicle(VEHICLE.replace(road_grade=grade))
    speeds = [live.step().vx for _ in range(300)]
    pull = 9.81 * math.sin(grade)
    resistance = 9.81 * math.cos(grade) * VEHICLE.rolling_coefficient_1
    effective = VEHICLE.mass + 1.1 / 0.332**2  # the wheels' inertia at the loaded radius
    expected = -(pull - math.copysign(resistance, grade)) * VEHICLE.mass / effective
    assert (speeds[250] - speeds[100]) / 1.5 == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(("grade", "bank"), [(0.0, 0.1), (0.1, 0.0), (-0.05, -0.1)])
def test_loads_at_rest_are_those_of_the_moment_balance(grade, bank):
    vehicle = VEHICLE.replace(road_grade=grade, road_bank=bank)
    state = held(vehicle, 3.0)
    assert state.loads == pytest.approx(vehicle.static_loads(), abs=2.0)  # its tyres give way
    assert state.loads != pytest.approx(VEHICLE.static_loads(), abs=10.0)


def test_an_accelerometer_at_rest_reads_the_vertical():
    state = held(VEHICLE.replace(road_grade=0.1, road_bank=-0.05), 3.0)
    up = np.array([math.sin(0.1), -math.sin(0.05)])
    expected = 9.81 * np.append(up, math.sqrt(1.0 - up @ up))
    assert state.specific_force == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize("grade", [-FIVE_PERCENT, FIVE_PERCENT])
def test_the_brake_holds_on_a_grade(grade):
    state = held(VEHICLE.replace(road_grade=grade), 5.0)
    assert abs(state.wheel_speeds[2]) < 1e-4
    # the tyres' relaxed slip creeps: the slip's speed floor times the slip that the pull takes
    creep = 0.1 * VEHICLE.mass * 9.81 * math.sin(FIVE_PERCENT) / VEHICLE.slip_stiffness
    assert abs(state.vx) == pytest.approx(creep, rel=0.02)


def test_a_brake_too_weak_for_the_grade_does_not_hold():
    state = held(VEHICLE.replace(road_grade=0.2), 3.0)
    assert state.vx < -0.5


def test_the_road_may_be_unknown():
    unknown = {**VEHICLE.unknown, "road_grade": (-0.1, 0.1), "road_bank": (-0.1, 0.1)}
    vehicle = dataclasses.replace(VEHICLE, unknown=unknown)
    samples = np.array([vehicle.nominal_point()] * 3)
    samples[1, -2], samples[2, -1] = 0.04, 0.03
    commands = Commands([0.0, 3.0], [0.0, 0.0], [1.0, 1.0])
    trajectory = simulate(vehicle, commands, samples)
    for row, road in enumerate([{}, {"road_grade": 0.04}, {"road_bank": 0.03}]):
        alone = simulate(VEHICLE.replace(**road), commands)
        assert trajectory.y[row, -1] == pytest.approx(alone.y[0, -1], abs=1e-9)
        assert trajectory.x[row, -1] == pytest.approx(alone.x[0, -1], abs=1e-9)
    assert abs(trajectory.y[2, -1]) > 0.001


def test_too_steep_a_road_is_refused():
    with pytest.raises(VehicleError, match=r"road_bank: 0\.6 rad is not in"):
        VEHICLE.replace(road_bank=0.6)
