"""Doubtful vehicles are named with their numbers."""

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
