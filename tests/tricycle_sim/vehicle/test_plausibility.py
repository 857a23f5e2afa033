"""Doubtful vehicles are named with their numbers."""

import dataclasses

import pytest

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


def test_a_range_with_an_end_that_is_too_stiff_is_named():
    ranges = {"motor_lag": (0.001, 0.1), "vertical_stiffness": (50_000.0, 70_000.0)}
    vehicle = dataclasses.replace(load_vehicle(), unknown=ranges)
    (warning,) = (line for line in warnings_about(vehicle) if "steps of" in line)
    assert warning.startswith("motor_lag.range: with 0.001 s tricycle: moves at rates of up to ")
