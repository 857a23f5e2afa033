"""A vehicle command in the units and limits of the boards."""

import dataclasses

import pytest

from tricycle_bridge.commands.board_commands import (
    board_setup,
    drive_command,
    steer_command,
    stop_command,
)
from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_bridge.protocol.messages import (
    Board,
    CommandFlag,
    DriveCommand,
    DriveSetup,
    DriveState,
    Gear,
    SteerCommand,
    SteerSetup,
    SteerState,
    layout,
)
from tricycle_bridge.settings import BridgeSettings

SETTINGS = BridgeSettings(max_steering_rate=1.5, max_acceleration=0.5)


@pytest.mark.parametrize(("angle", "counts"), [(0.3, 3000), (-0.3, -3000), (9.0, 7461)])
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


def test_the_boards_are_set_up_for_the_vehicle_in_the_units_of_the_line():
    assert board_setup(Board.STEER, SETTINGS) == SteerSetup(7461, 1500, 10_000, 14_000)
    settings = BridgeSettings(max_speed=2.0, mass=60.0, payload=30.0, drive_supply_high=54.6)
    assert board_setup(Board.DRIVE, settings) == DriveSetup(
        max_speed=2000,
        max_acceleration=2000,
        pulse=15253,
        tyre_radius=3350,
        torque=3500,
        regenerative_torque=1500,
        power=250,
        mass_low=540,
        mass_high=960,
        supply_low=40_000,
        supply_high=54_600,
        throttle_low=0,
        throttle_high=0,
    )


@pytest.mark.parametrize("board", [Board.STEER, Board.DRIVE])
def test_the_largest_settings_fit_the_line(board):
    largest = {f.name: f.metadata["range"][1] for f in dataclasses.fields(BridgeSettings)}
    lows = {name: 0.0 for name in largest if name.endswith("_low")}
    assert board_setup(board, BridgeSettings(**largest | lows)).payload()


def test_stopping_keeps_angle_and_gear_and_is_not_enabled():
    steer = SteerState(**dict.fromkeys(layout(SteerState), 0) | {"setpoint": 1234})
    assert stop_command(steer) == SteerCommand(0, 0, 1234, 0, 0)
    drive = DriveState(**dict.fromkeys(layout(DriveState), 0) | {"gear": Gear.REVERSE})
    assert stop_command(drive) == DriveCommand(0, Gear.REVERSE, 0, 0, 0, 0, 0)
