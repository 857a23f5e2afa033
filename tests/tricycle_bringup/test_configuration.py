"""The packaged parameter files, and what the bridge is told of a vehicle."""

from pathlib import Path

import pytest
import yaml

from tricycle_bringup.configuration import SIMULATION_CONFIG, VEHICLE_CONFIG, bridge_parameters
from tricycle_core.errors import VehicleError
from tricycle_sim.vehicle import load_vehicle


@pytest.mark.parametrize("file", [SIMULATION_CONFIG, VEHICLE_CONFIG])
def test_every_section_holds_the_parameters_of_a_node(file):
    sections = yaml.safe_load(Path(file).read_text())
    assert "/**" in sections
    assert all(list(section) == ["ros__parameters"] for section in sections.values())


def test_the_bridge_is_told_what_the_vehicle_file_says(tmp_path):
    vehicle = load_vehicle()
    assert bridge_parameters("") == {
        "tyre_radius": vehicle.tyre_radius,
        "max_steering_rate": vehicle.steering_slew,
        "max_acceleration": vehicle.acceleration,
    }
    file = tmp_path / "other.yaml"
    file.write_text("wheels: 3")
    with pytest.raises(VehicleError, match=str(file)):
        bridge_parameters(str(file))
