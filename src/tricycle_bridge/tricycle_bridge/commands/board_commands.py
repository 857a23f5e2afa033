"""The vehicle's commands and its set-up in the units of the two boards."""

from __future__ import annotations

from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_bridge.plc_link.link import BoardCommand, BoardSetup, Telemetry
from tricycle_bridge.protocol.limits import MAX_SPEED, MAX_STEERING_ANGLE
from tricycle_bridge.protocol.messages import (
    Board,
    DriveCommand,
    DriveSetup,
    Gear,
    SteerCommand,
    SteerSetup,
    SteerState,
)
from tricycle_bridge.protocol.units import (
    ANGLE_UNIT,
    LENGTH_UNIT,
    MASS_UNIT,
    SPEED_UNIT,
    STEER_RATE_UNIT,
    TORQUE_UNIT,
    TRAVEL_UNIT,
    VOLTAGE_UNIT,
)
from tricycle_bridge.settings import UNCHECKED_SUPPLY, BridgeSettings


def board_setup(board: Board, settings: BridgeSettings) -> BoardSetup:
    """Return the message that sets up a board for the vehicle at the start of each session.

    Parameters
    ----------
    board : Board
        Board that is set up.
    settings : BridgeSettings
        The vehicle's limits, drive, mass and supplies.
    """
    if board is Board.STEER:
        return SteerSetup(
            max_angle=round(settings.max_steering_angle / ANGLE_UNIT),
            max_rate=round(settings.max_steering_rate / STEER_RATE_UNIT),
            **_thresholds(settings.steer_supply_low, settings.steer_supply_high),
        )
    lightest = (1.0 - settings.mass_tolerance) * settings.mass
    heaviest = (1.0 + settings.mass_tolerance) * settings.mass + settings.payload
    return DriveSetup(
        max_speed=round(settings.max_speed / SPEED_UNIT),
        max_acceleration=round(settings.stopping_deceleration / SPEED_UNIT),
        pulse=round(settings.hall_pulse / TRAVEL_UNIT),
        tyre_radius=round(settings.tyre_radius / LENGTH_UNIT),
        torque=round(settings.motor_torque / TORQUE_UNIT),
        regenerative_torque=round(settings.regenerative_torque / TORQUE_UNIT),
        power=round(settings.motor_power),
        mass_low=round(lightest / MASS_UNIT),
        mass_high=round(heaviest / MASS_UNIT),
        **_thresholds(settings.drive_supply_low, settings.drive_supply_high),
        throttle_low=round(settings.throttle_low / VOLTAGE_UNIT),
        throttle_high=round(settings.throttle_high / VOLTAGE_UNIT),
    )


def _thresholds(low: float, high: float) -> dict[str, int]:
    """Return both in mV; a board that checks one checks the other, so 0 becomes unreachable."""
    if low and not high:
        return {
            "supply_low": round(low / VOLTAGE_UNIT),
            "supply_high": round(UNCHECKED_SUPPLY / VOLTAGE_UNIT),
        }
    return {"supply_low": round(low / VOLTAGE_UNIT), "supply_high": round(high / VOLTAGE_UNIT)}


def steer_command(command: VehicleCommand, settings: BridgeSettings, flags: int) -> SteerCommand:
    """Return the command of the steer PLC.

    Parameters
    ----------
    command : VehicleCommand
        Command for the vehicle; its angle is limited.
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
        Command for the vehicle; its speed is limited.
    settings : BridgeSettings
        Settings of the bridge, among them the largest acceleration.
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


def stop_command(telemetry: Telemetry, flags: int = 0) -> BoardCommand:
    """Return the command that stops a board: not enabled, otherwise what it does already.

    Parameters
    ----------
    telemetry : SteerState or DriveState
        Newest telemetry of the board.
    flags : int
        Bits of `CommandFlag` for the steer PLC, without ENABLE.
    """
    if isinstance(telemetry, SteerState):
        return SteerCommand(flags, 0, telemetry.setpoint, 0, 0)
    return DriveCommand(0, telemetry.gear, 0, 0, 0, 0, 0)
