"""Vehicles start at rest on their tyres, each in its own equilibrium where parameters move it."""

import dataclasses

import numpy as np
import pytest

from tricycle_core.errors import VehicleError
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate
from tricycle_sim.vehicle.groups import equilibrium, pack
from tricycle_sim.vehicle.layout import LANES, STATE, WHEEL_STATES

VEHICLE = load_vehicle()


def states(groups):
    return (
        groups.reshape(len(groups), -1, LANES).transpose(1, 0, 2).reshape(-1, len(groups) * LANES)
    )


def test_the_equilibrium_of_the_packaged_vehicle_is_that_of_all_its_samples():
    start = equilibrium(VEHICLE)
    height, roll, pitch = start.pose
    assert not start.moved_by
    assert VEHICLE.com_height - 0.004 < height < VEHICLE.com_height - 0.002
    assert abs(roll) < 1e-3
    assert abs(pitch) < 2e-3


def test_lanes_beyond_the_samples_repeat_the_last_one():
    points = np.outer([0.9, 1.0, 1.1], VEHICLE.nominal_point())
    rows = states(pack(VEHICLE, points, equilibrium(VEHICLE), speed=np.array([0.0, 1.0, 2.0])))
    assert rows.shape[1] == LANES
    assert rows[STATE.u].tolist() == [0.0, 1.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0]
    assert rows[STATE.spin + 2 * WHEEL_STATES] == pytest.approx(rows[STATE.u] / VEHICLE.tyre_radius)
    assert np.array_equal(rows[:, 2], rows[:, 7])


@pytest.fixture
def softly_known():
    """A vehicle with unknown parameters that move its equilibrium."""
    moving = ("com_to_front_axle", "vertical_stiffness", "com_height")
    ranges = ((0.6, 0.8), (4e4, 8e4), (0.4, 0.6))
    unknown = dict(zip(moving, ranges, strict=True))
    return dataclasses.replace(VEHICLE, unknown={**VEHICLE.unknown, **unknown})


def test_parameters_that_move_the_equilibrium_have_a_start_per_sample(softly_known):
    start = equilibrium(softly_known)
    assert start.moved_by
    nominal = softly_known.nominal_point()
    points = np.array([nominal] * 4)
    points[1, -2], points[2, -3], points[3, -1] = 4e4, 0.6, 0.6
    trajectory = simulate(softly_known, Commands([0.0, 1.0], [0.0, 0.0], [0.0, 0.0]), points)
    assert np.ptp(trajectory.z, axis=1).max() < 1e-6  # all of them rest
    assert trajectory.z[1, 0] < trajectory.z[0, 0] - 1e-3  # sinks deeper
    names = ("com_to_front_axle", "vertical_stiffness", "com_height")
    for sample, values in enumerate(points):
        single = VEHICLE.replace(**dict(zip(names, values[-3:], strict=True)))
        assert trajectory.z[sample, 0] == pytest.approx(equilibrium(single).pose[0], abs=1e-12)


def test_a_vehicle_too_heavy_for_its_tyres_is_told():
    heavy = VEHICLE.replace(mass=60_000.0)
    with pytest.raises(VehicleError, match="finds no rest on its tyres"):
        equilibrium(heavy)
