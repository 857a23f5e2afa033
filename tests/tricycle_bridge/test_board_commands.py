"""A vehicle command in the units and limits of the boards."""

import pytest

from tricycle_bridge.board_commands import drive_command, steer_command, stop_command
from tricycle_bridge.command_stream import VehicleCommand
from tricycle_bridge.protocol.messages import (
    CommandFlag,
    DriveCommand,
    DriveState,
    Gear,
    SteerCommand,
    SteerState,
    layout,
)
from tricycle_bridge.settings import BridgeSettings

SETTINGS = BridgeSettings(max_steering_rate=1.5, max_acceleration=0.5)


@pytest.mark.parametrize(("angle", "counts"), [(0.3, 3000), (-0.3, -3000), (9.0, 7854)])
def test_the_steering_angle_is_in_1e_4_rad_and_limited(angle, counts):
    command = steer_command(VehicleCommand(angle, 1.0), SETTINGS, CommandFlag.ENABLE)
    assert command == SteerCommand(CommandFlag.ENABLE, 0, counts, 1500, 0)


@pytest.mark.parametrize(
    ("speed", "last", "gear", "counts"),
    [
        (1.5, Gear.REVERSE, Gear.DRIVE, 1500),
        (-1.5, Gear.DRIVE, Gear.REVERSE, 1500),
        (0.0, Gear.REVERSE, Gear.REVERSE, 0),
        (99.0, Gear.DRIVE, Gear.DRIVE, 4800),
    ],
)
def test_the_speed_is_in_mm_per_s_limited_and_its_sign_is_the_gear(speed, last, gear, counts):
    command = drive_command(VehicleCommand(0.0, speed), SETTINGS, 0, last)
    assert command == DriveCommand(0, gear, counts, 500, 0, 0, 0)


def test_stopping_keeps_angle_and_gear_and_is_not_enabled():
    steer = SteerState(**dict.fromkeys(layout(SteerState), 0) | {"setpoint": 1234})
    assert stop_command(steer) == SteerCommand(0, 0, 1234, 0, 0)
    drive = DriveState(**dict.fromkeys(layout(DriveState), 0) | {"gear": Gear.REVERSE})
    assert stop_command(drive) == DriveCommand(0, Gear.REVERSE, 0, 0, 0, 0, 0)
