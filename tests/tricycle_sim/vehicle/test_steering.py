"""Linkage and caster against the oracle, and as the paper gives them."""

import lagrange_oracle
import numpy as np
import pytest
import structures
from hypothesis import given
from hypothesis import strategies as st

from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.kernel import functions_for
from tricycle_sim.vehicle.parts import steering_constants, structure_of
from tricycle_sim.vehicle.steering import LINKAGES, turned

VEHICLE = load_vehicle()
FUNCTIONS = functions_for(VEHICLE)


@given(st.floats(-0.785, 0.785))
def test_linkage_agrees_with_the_oracle(motor_angle):
    constants = steering_constants(VEHICLE, 0.005)
    left, right, left_slope, right_slope = FUNCTIONS.wheel_angles(motor_angle, constants)
    angles, slopes = lagrange_oracle.describe(VEHICLE).steering(motor_angle)
    assert (left, right) == pytest.approx(tuple(angles[:2]), abs=1e-14)
    assert (left_slope, right_slope) == pytest.approx(tuple(slopes[:2]), abs=1e-9)


@pytest.mark.parametrize("name", structures.STRUCTURES)
@pytest.mark.parametrize("motor_angle", [-0.5, -0.03, 0.0, 0.2, 0.6])
def test_every_linkage_turns_each_wheel_as_the_oracle_does(name, motor_angle):
    structure = structures.STRUCTURES[name]
    vehicle = structures.vehicle_of(structure)
    oracle = lagrange_oracle.describe_file(
        structure["wheels"], structure["parts"], {**VEHICLE.values, **structure["constants"]}
    )
    layout = structure_of(vehicle)
    linkage, constants = LINKAGES[layout.steering].function, steering_constants(vehicle, 0.005)
    left, right, left_slope, right_slope = turned(linkage, constants, motor_angle)
    found = np.array([(0.0, 0.0), (left, left_slope), (right, right_slope)])
    angles, slopes = oracle.steering(motor_angle)
    for wheel, side in enumerate(layout.sides[: len(vehicle.wheels)]):
        assert found[side + 1] == pytest.approx((angles[wheel], slopes[wheel]), abs=1e-12)


def test_ratio_of_the_wheel_angles_falls_from_0_8_to_0_6():
    constants = steering_constants(VEHICLE, 0.005)
    left, right, _, _ = FUNCTIONS.wheel_angles(0.7854, constants)
    assert right / left == pytest.approx(0.6, abs=0.001)
    left, right, _, _ = FUNCTIONS.wheel_angles(0.1, constants)
    assert right / left == pytest.approx(0.78, abs=0.01)


@given(st.floats(-0.5, 0.5))
def test_motor_angle_is_the_inverse_of_the_road_angle(angle):
    constants = steering_constants(VEHICLE, 0.005)
    assert FUNCTIONS.road_angle(
        FUNCTIONS.motor_angle_for(angle, constants), constants
    ) == pytest.approx(angle, abs=1e-12)


def test_the_motor_angle_stays_within_its_limit():
    constants = steering_constants(VEHICLE, 0.005)
    for sign in (-1.0, 1.0):
        angle = FUNCTIONS.motor_angle_for(sign * 1.5, constants)
        assert angle == pytest.approx(sign * VEHICLE.steering_limit)


def test_axles_are_unit_vectors_that_turn_with_the_steering():
    table, rate = np.empty((3, 8)), 1e-6
    constants = steering_constants(VEHICLE, 0.005)
    FUNCTIONS.steer(np.array([0.3, rate]), np.full(1, 0.3), constants, 2, table, np.empty((2, 2)))
    assert np.linalg.norm(table[:, :3], axis=1) == pytest.approx(1.0)
    assert np.linalg.norm(table[:, 4:7], axis=1) == pytest.approx(1.0)
    # with caster the axle of the wheel that turns left points down on its left
    assert table[0, 2] < 0.0
