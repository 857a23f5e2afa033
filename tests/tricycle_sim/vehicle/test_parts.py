"""Laws of parts are chosen by name; a second law is one entry of a registry."""

import dataclasses

import numpy as np
import pytest

from tricycle_core.errors import VehicleError
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate
from tricycle_sim.vehicle.kernel import functions_for
from tricycle_sim.vehicle.layout import CONSTANTS
from tricycle_sim.vehicle.parts import BLOCK, ROWS, group_constants
from tricycle_sim.vehicle.registry import PARTS, law_name

VEHICLE = load_vehicle()


def with_parts(**parts):
    return dataclasses.replace(VEHICLE, parts=parts)


def test_the_first_law_of_each_part_is_the_default():
    for part, laws in PARTS.items():
        assert law_name(part, VEHICLE.wheels, VEHICLE.parts) == next(iter(laws))


def test_vehicles_with_the_same_laws_share_their_functions():
    assert functions_for(VEHICLE) is functions_for(with_parts(tyre="linear"))


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"wing": "flat"}, "parts.wing: must be one of tyre, motor, brake, servo, steering, drive"),
        ({"tyre": "square"}, "parts.tyre: 'square' must be one of linear"),
    ],
)
def test_unknown_laws_are_named(parts, message):
    with pytest.raises(VehicleError, match=message):
        simulate(with_parts(**parts), Commands([0.0, 1.0], [0.0, 0.0], [0.0, 0.0]))


def test_constants_stand_in_blocks_one_after_the_other():
    rows = sorted(group_constants(VEHICLE, VEHICLE.values))
    assert len(rows) == len(set(rows))
    assert rows[0] == CONSTANTS
    assert rows[-1] < ROWS
    assert list(BLOCK) == sorted(BLOCK)


def test_constants_of_arrays_are_arrays():
    values = {**VEHICLE.values, "yaw_inertia": np.array([10.0, 20.0])}
    found = group_constants(VEHICLE, values)
    arrays = [value for value in found.values() if isinstance(value, np.ndarray)]
    assert [array.tolist() for array in arrays] == [[10.0, 20.0], [0.1, 0.05]]
