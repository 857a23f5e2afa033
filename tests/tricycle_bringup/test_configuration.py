"""The packaged parameter files, and what the bridge is told of a vehicle."""

import dataclasses
from pathlib import Path

import pytest
import yaml

from tricycle_bridge.commands.kinematics import TurningGeometry
from tricycle_bridge.settings import BridgeSettings
from tricycle_bringup.configuration import (
    SIMULATION_CONFIG,
    VEHICLE_CONFIG,
    bridge_parameters,
    bridge_settings,
    check_bridge,
)
from tricycle_core.errors import VehicleError
from tricycle_sim.vehicle import load_vehicle


@pytest.mark.parametrize("file", [SIMULATION_CONFIG, VEHICLE_CONFIG])
def test_every_section_holds_the_parameters_of_a_node(file):
    sections = yaml.safe_load(Path(file).read_text())
    assert "/**" in sections
    assert all(list(section) == ["ros__parameters"] for section in sections.values())


def test_the_bridge_is_told_what_the_vehicle_file_says(tmp_path):
    vehicle = load_vehicle()
    parameters = bridge_parameters("")
    assert parameters["tyre_radius"] == vehicle.tyre_radius
    assert parameters["mass"] == pytest.approx(48.3 + (2 * 0.3 + 0.5) / 0.335**2)


def test_the_bridges_defaults_are_the_packaged_vehicles():
    defaults = dataclasses.asdict(TurningGeometry())
    defaults |= dataclasses.asdict(BridgeSettings())
    for name, value in bridge_parameters("").items():
        assert defaults[name] == pytest.approx(value, rel=1e-3, abs=1e-9), name


def test_what_is_no_vehicle_file_is_named(tmp_path):
    file = tmp_path / "other.yaml"
    file.write_text("wheels: 3")
    with pytest.raises(VehicleError, match=str(file)):
        bridge_parameters(str(file))


def test_the_boards_drive_no_motor_without_a_speed_loop(without_speed_loop):
    with pytest.raises(VehicleError, match=r"parts\.motor: direct_torque has no speed loop"):
        bridge_settings(without_speed_loop)


def test_a_bridge_of_another_vehicle_is_named_by_what_differs():
    vehicle = load_vehicle()
    longer = vehicle.replace(com_to_front_axle=1.281)
    check_bridge(vehicle, bridge_parameters(""))
    with pytest.raises(VehicleError) as error:
        check_bridge(longer, bridge_parameters(""))
    assert str(error.value).startswith(
        "tricycle_bridge was started for another vehicle than tricycle: wheelbase 1.443 instead of"
    )
    assert "tyre_radius" not in str(error.value)


def test_a_bridge_may_have_lower_limits_and_other_values_of_what_is_to_be_found():
    vehicle = load_vehicle()
    check_bridge(vehicle, bridge_parameters("") | {"max_steering_angle": 0.3, "mass": 70.0})
    unknown = dict(vehicle.unknown) | {"tyre_radius": (0.3, 0.35)}
    check_bridge(
        dataclasses.replace(vehicle.replace(tyre_radius=0.33), unknown=unknown),
        bridge_parameters(""),
    )
