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
    unchecked = {"steer_supply_high": 0.0, "drive_supply_high": 0.0, "throttle_high": 5.0}
    for value in (low, high):
        BridgeSettings(**unchecked | {"max_acceleration": 0.001} | {field.name: value})


def test_an_acceleration_above_the_deceleration_of_a_stop_is_named():
    with pytest.raises(LinkError, match=r"max_acceleration = 1\.5 is above stopping_deceleration"):
        BridgeSettings(max_acceleration=1.5, stopping_deceleration=1.2)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"throttle_low": 1.0}, "throttle_low = 1 is not below throttle_high = 0"),
        ({"mass": 1.5, "mass_tolerance": 0.5}, "0.75 kg; the board takes 1 kg or more"),
        ({"drive_supply_high": 58.0}, r"drive_supply_high = 58 is outside 0\.\.54\.9"),
        ({"stopping_deceleration": 0.2, "max_acceleration": 0.2}, r"outside 1\.2\.\.2"),
    ],
)
def test_what_the_boards_would_refuse_or_cannot_check_is_named(settings, text):
    with pytest.raises(LinkError, match=text):
        BridgeSettings(**settings)


def test_thresholds_that_are_upside_down_are_named():
    with pytest.raises(
        LinkError, match="drive_supply_low = 50 is not below drive_supply_high = 45"
    ):
        BridgeSettings(drive_supply_low=50.0, drive_supply_high=45.0)
