"""Ranges of the settings."""

import dataclasses
import math

import pytest

from tricycle_bridge.settings import BridgeSettings
from tricycle_core.errors import LinkError


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("command_rate", 10.0),
        ("tyre_radius", 0.0),
        ("max_steering_rate", 3.5),
        ("max_acceleration", math.nan),
    ],
)
def test_settings_out_of_range_are_named(name, value):
    with pytest.raises(LinkError, match=f"{name} = "):
        BridgeSettings(**{name: value})


@pytest.mark.parametrize("field", dataclasses.fields(BridgeSettings), ids=lambda f: f.name)
def test_every_setting_has_a_description_and_a_range_that_holds_its_default(field):
    low, high = field.metadata["range"]
    assert low <= field.default <= high
    assert field.metadata["description"]
    unchecked = {f"{board}_supply_high": 0.0 for board in ("steer", "drive")}
    for value in (low, high):
        BridgeSettings(**unchecked | {"max_acceleration": 0.001} | {field.name: value})


def test_an_acceleration_above_the_deceleration_of_a_stop_is_named():
    with pytest.raises(LinkError, match=r"max_acceleration = 1\.5 is above stopping_deceleration"):
        BridgeSettings(max_acceleration=1.5, stopping_deceleration=1.0)


def test_thresholds_that_are_upside_down_are_named():
    with pytest.raises(
        LinkError, match="drive_supply_low = 50 is not below drive_supply_high = 45"
    ):
        BridgeSettings(drive_supply_low=50.0, drive_supply_high=45.0)
