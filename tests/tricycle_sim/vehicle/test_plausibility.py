"""Doubtful vehicles are named with their numbers."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import brentq
from structures import PLAIN, WITHOUT_SPEED_LOOP, vehicle_of

from tricycle_sim.vehicle import load_vehicle, warnings_about


def test_impossible_inertia_is_doubted_with_its_numbers():
    first, second = warnings_about(load_vehicle())
    assert first.startswith("yaw_inertia: 50 kg m^2 is larger")
    assert "48.8" in first
    assert "75" in second


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"vertical_stiffness": 3000.0}, "tenth of its radius"),
        ({"rear_wheel_y": 3.0}, "tips over"),
        ({"cornering_stiffness": 500.0, "mass": 200.0}, "oversteers"),
        ({"roll_inertia": 90.0}, "roll_inertia"),
    ],
)
def test_doubtful_vehicles_are_named(values, word):
    warnings = warnings_about(load_vehicle().replace(**values))
    assert any(word in warning for warning in warnings)


def test_a_throttle_beyond_the_motor_is_named():
    vehicle = vehicle_of(WITHOUT_SPEED_LOOP["throttle_curve"])
    assert not any("throttle" in warning for warning in warnings_about(vehicle))
    warnings = warnings_about(vehicle.replace(throttle_torque_75=vehicle.motor_torque + 1.0))
    assert any(warning.startswith("throttle_torque_75: ") for warning in warnings)


# two thirds of the load in front: stiffness in proportion to it makes the vehicle oversteer
AHEAD = {"front_left.x": 0.5, "front_right.x": 0.5, "rear_left.x": -1.0, "rear_right.x": -1.0}
STIFFNESS = {"front.cornering_stiffness": 70.0, "rear.cornering_stiffness": 45.0}


@pytest.mark.parametrize(
    ("load_sensitivity", "unknown", "warns"),
    [
        (0.0, {}, False),
        (1.0, {}, True),
        (0.0, {"rear.cornering_stiffness": (20.0, 60.0)}, True),
    ],
)
def test_oversteer_of_loaded_tyres_and_in_ranges_is_named(load_sensitivity, unknown, warns):
    vehicle = vehicle_of(PLAIN)
    values = vehicle.values | AHEAD | STIFFNESS | {"load_sensitivity": load_sensitivity}
    vehicle = dataclasses.replace(vehicle, values=values, unknown=unknown)
    assert any("oversteers" in warning for warning in warnings_about(vehicle)) == warns


def test_the_speed_at_which_it_becomes_unstable_is_that_of_the_linear_bicycle():
    vehicle = load_vehicle().replace(cornering_stiffness=500.0, mass=200.0)
    front, rear = vehicle.axle_stiffness().values()
    a, b = vehicle.com_to_front_axle, vehicle.com_to_rear_axle

    def largest_rate(speed):
        """Of lateral velocity and yaw rate [1/s]."""
        mass, inertia = vehicle.mass * speed, vehicle.yaw_inertia * speed
        turning = b * rear - a * front
        slopes = [
            [-(front + rear) / mass, turning / mass - speed],
            [turning / inertia, -(a**2 * front + b**2 * rear) / inertia],
        ]
        return np.linalg.eigvals(slopes).real.max()

    critical = brentq(largest_rate, 0.1, 50.0)
    (warning,) = (line for line in warnings_about(vehicle) if "oversteers" in line)
    assert f"unstable from {critical:.1f} m/s" in warning


def test_a_range_with_an_end_that_is_too_stiff_is_named():
    ranges = {"motor_lag": (0.001, 0.1), "vertical_stiffness": (50_000.0, 70_000.0)}
    vehicle = dataclasses.replace(load_vehicle(), unknown=ranges)
    (warning,) = (line for line in warnings_about(vehicle) if "steps of" in line)
    assert warning.startswith("motor_lag.range: with 0.001 s tricycle: moves at rates of up to ")
