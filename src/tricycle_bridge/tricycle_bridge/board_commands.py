"""A vehicle command as the commands of the two boards, limited to what the PLCs allow."""

from __future__ import annotations

from tricycle_bridge.command_stream import VehicleCommand
from tricycle_bridge.link import BoardCommand, Telemetry
from tricycle_bridge.protocol.limits import MAX_SPEED, MAX_STEERING_ANGLE
from tricycle_bridge.protocol.messages import (
    ANGLE_UNIT,
    SPEED_UNIT,
    STEER_RATE_UNIT,
    DriveCommand,
    Gear,
    SteerCommand,
    SteerState,
)
from tricycle_bridge.settings import BridgeSettings


def steer_command(command: VehicleCommand, settings: BridgeSettings, flags: int) -> SteerCommand:
    """Return the command of the steer PLC.

    Parameters
    ----------
    command : VehicleCommand
        What is wanted; the angle is limited.
    settings : BridgeSettings
        Largest steering rate.
    flags : int
        Bits of `CommandFlag`.
    """
    angle = min(max(command.steering_motor_angle, -MAX_STEERING_ANGLE), MAX_STEERING_ANGLE)
    rate = round(settings.max_steering_rate / STEER_RATE_UNIT)
    return SteerCommand(flags, 0, round(angle / ANGLE_UNIT), rate, 0)


def drive_command(
    command: VehicleCommand, settings: BridgeSettings, flags: int, gear: Gear
) -> DriveCommand:
    """Return the command of the drive PLC.

    Parameters
    ----------
    command : VehicleCommand
        What is wanted; the speed is limited.
    settings : BridgeSettings
        Largest acceleration.
    flags : int
        Bits of `CommandFlag`.
    gear : Gear
        Gear of the last command; it is kept at speed 0.
    """
    speed = round(min(abs(command.speed), MAX_SPEED) / SPEED_UNIT)
    if speed:
        gear = Gear.DRIVE if command.speed > 0 else Gear.REVERSE
    acceleration = round(settings.max_acceleration / SPEED_UNIT)
    return DriveCommand(flags, gear, speed, acceleration, 0, 0, 0)


def stop_command(telemetry: Telemetry) -> BoardCommand:
    """Return the command that stops a board: not enabled, otherwise what it does already.

    Parameters
    ----------
    telemetry : SteerState or DriveState
        Newest telemetry of the board.
    """
    if isinstance(telemetry, SteerState):
        return SteerCommand(0, 0, telemetry.setpoint, 0, 0)
    return DriveCommand(0, telemetry.gear, 0, 0, 0, 0, 0)
