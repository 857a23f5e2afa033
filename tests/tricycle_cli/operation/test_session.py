"""Sessions: what the simulation drives with. Driving itself: tests/ros/test_drive.py."""

from tricycle_cli.operation.session import hidden_truth
from tricycle_sim.vehicle import load_vehicle


def test_the_truth_is_drawn_from_its_seed_alone_and_is_nominal_without_one():
    vehicle = load_vehicle()
    drawn = hidden_truth(vehicle, 3)
    assert drawn == hidden_truth(vehicle, 3) != hidden_truth(vehicle, 4)
    assert all(low <= drawn[name] <= high for name, (low, high) in vehicle.unknown.items())
    assert hidden_truth(vehicle, -1) == vehicle.nominal
