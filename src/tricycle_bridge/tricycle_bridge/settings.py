"""Settings of the bridge, each with its range and its description."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from tricycle_bridge.protocol.boards import (
    HALL_PULSE,
    HALL_PULSES,
    MASSES,
    MAX_THROTTLE,
    STOPPING_DECELERATION,
    TYRE_RADII,
    TYRE_RADIUS,
)
from tricycle_bridge.protocol.limits import (
    MAX_ACCELERATION,
    MAX_POWER,
    MAX_REGENERATIVE_TORQUE,
    MAX_SPEED,
    MAX_STEERING_ANGLE,
    MAX_STEERING_RATE,
    MAX_TORQUE,
)
from tricycle_bridge.protocol.units import ANGLE_UNIT, SPEED_UNIT, STEER_RATE_UNIT, TORQUE_UNIT
from tricycle_core.errors import LinkError
from tricycle_core.supplies import (
    DRIVE_SUPPLY_THRESHOLDS,
    STEER_SUPPLY_THRESHOLDS,
    SUPPLY_LIMIT,
)

MASS_LIMIT = 1000.0
"""Largest mass and payload [kg]."""

UNCHECKED_SUPPLY = 65.535
"""Upper threshold that no supply reaches [V]."""


def _setting(default: float, low: float, high: float, description: str) -> Any:
    return dataclasses.field(
        default=default, metadata={"range": (low, high), "description": description}
    )


@dataclass(frozen=True)
class BridgeSettings:
    """Rates, and the vehicle that the boards are set up for; the node has a parameter of each name.

    The metadata of each field hold its ``range`` and its ``description``.

    Attributes
    ----------
    command_rate : float
        Rate at which a command is repeated between two messages of the commander [Hz].
    standstill_rate : float
        Rate at which standstill is commanded while nobody else does [Hz].
    max_steering_angle : float
        Largest angle of the steering motor, either side [rad].
    max_steering_rate : float
        Largest rate of the steering motor's set-point [rad/s].
    max_speed : float
        Largest speed [m/s].
    max_acceleration : float
        Largest acceleration of the commanded speed [m/s^2].
    stopping_deceleration : float
        Deceleration with which the drive PLC stops the vehicle by itself [m/s^2].
    tyre_radius : float
        Radius of the rear wheel [m].
    hall_pulse : float
        Travel per hall pulse [m].
    motor_torque, regenerative_torque : float
        Largest driving and braking torque of the motor [N m].
    motor_power : float
        Largest power of the motor [W].
    mass : float
        Mass at the tread, inertia of the wheels included [kg].
    payload : float
        Largest load besides [kg].
    mass_tolerance : float
        Largest error of the mass, as a share of it.
    drive_supply_low, drive_supply_high, steer_supply_low, steer_supply_high : float
        Thresholds of the supplies [V]; 0: not checked.
    throttle_low, throttle_high : float
        Voltage at the motor's controller without and with full torque [V]; 0: the board's own.

    Raises
    ------
    LinkError
        If a value is outside its range, a lower threshold above the upper one, the acceleration
        above the deceleration, or the mass too small for the board.
    """

    command_rate: float = _setting(50.0, 20.0, 100.0, "Hz of repeats between messages")
    standstill_rate: float = _setting(50.0, 20.0, 100.0, "Hz of standstill without a commander")
    max_steering_angle: float = _setting(
        MAX_STEERING_ANGLE, ANGLE_UNIT, MAX_STEERING_ANGLE, "rad, of the steering motor"
    )
    max_steering_rate: float = _setting(
        2.0, STEER_RATE_UNIT, MAX_STEERING_RATE, "rad/s, slew of the steering motor"
    )
    max_speed: float = _setting(MAX_SPEED, SPEED_UNIT, MAX_SPEED, "m/s")
    max_acceleration: float = _setting(
        1.0, SPEED_UNIT, MAX_ACCELERATION, "m/s^2, slew of the speed"
    )
    stopping_deceleration: float = _setting(
        MAX_ACCELERATION,
        STOPPING_DECELERATION,
        MAX_ACCELERATION,
        "m/s^2, of a stop by the drive PLC",
    )
    tyre_radius: float = _setting(TYRE_RADIUS, *TYRE_RADII, "m, of the rear wheel")
    hall_pulse: float = _setting(HALL_PULSE, *HALL_PULSES, "m of travel per hall pulse")
    motor_torque: float = _setting(MAX_TORQUE, TORQUE_UNIT, MAX_TORQUE, "N m, largest")
    regenerative_torque: float = _setting(
        MAX_REGENERATIVE_TORQUE, TORQUE_UNIT, MAX_REGENERATIVE_TORQUE, "N m, of the braking motor"
    )
    motor_power: float = _setting(MAX_POWER, 1.0, MAX_POWER, "W, largest")
    mass: float = _setting(
        58.1, 1.2 * MASSES[0], MASS_LIMIT, "kg at the tread, inertia of wheels included"
    )
    payload: float = _setting(0.0, 0.0, MASS_LIMIT, "kg, largest load besides")
    mass_tolerance: float = _setting(0.1, 0.0, 0.5, "share by which the mass may be wrong")
    drive_supply_low: float = _setting(
        DRIVE_SUPPLY_THRESHOLDS[0], 0.0, SUPPLY_LIMIT, "V of the battery; 0: not checked"
    )
    drive_supply_high: float = _setting(
        DRIVE_SUPPLY_THRESHOLDS[1], 0.0, SUPPLY_LIMIT, "V of the battery; 0: not checked"
    )
    steer_supply_low: float = _setting(
        STEER_SUPPLY_THRESHOLDS[0], 0.0, SUPPLY_LIMIT, "V of the servo; 0: not checked"
    )
    steer_supply_high: float = _setting(
        STEER_SUPPLY_THRESHOLDS[1], 0.0, SUPPLY_LIMIT, "V of the servo; 0: not checked"
    )
    throttle_low: float = _setting(
        0.0, 0.0, 0.9 * MAX_THROTTLE, "V without torque; 0: the board's own"
    )
    throttle_high: float = _setting(
        0.0, 0.0, MAX_THROTTLE, "V with full torque; 0: the board's own"
    )

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            low, high = field.metadata["range"]
            if not low <= value <= high:
                raise LinkError(f"{field.name} = {value:g} is outside {low:g}..{high:g}")
        for pair in ("drive_supply", "steer_supply", "throttle"):
            low, high = getattr(self, f"{pair}_low"), getattr(self, f"{pair}_high")
            if low >= high and (high or (low and pair == "throttle")):
                raise LinkError(f"{pair}_low = {low:g} is not below {pair}_high = {high:g}")
        lightest = (1.0 - self.mass_tolerance) * self.mass
        if lightest < MASSES[0]:
            raise LinkError(
                f"mass = {self.mass:g} less mass_tolerance = {self.mass_tolerance:g} is "
                f"{lightest:g} kg; the board takes {MASSES[0]:g} kg or more"
            )
        if self.max_acceleration > self.stopping_deceleration:
            raise LinkError(
                f"max_acceleration = {self.max_acceleration:g} is above stopping_deceleration = "
                f"{self.stopping_deceleration:g}"
            )
