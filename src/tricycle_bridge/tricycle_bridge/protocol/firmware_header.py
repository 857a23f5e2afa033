"""Writes the firmware's C header from the message table, the limits and the boards' constants.

    python -m tricycle_bridge.protocol.firmware_header > firmware/messages.h

A test fails when the file in the repository is stale.
"""

from __future__ import annotations

import enum
import re
import sys

from tricycle_bridge.protocol import boards, limits, messages, units
from tricycle_bridge.protocol.messages import MESSAGES, Board, Message, layout
from tricycle_core.timing import TICK

_ENUMS: tuple[type[enum.IntEnum] | type[enum.IntFlag], ...] = (
    messages.Board,
    messages.PlcState,
    messages.Fault,
    messages.Op,
    messages.Result,
    messages.Gear,
    messages.ResetCause,
    messages.CommandFlag,
    messages.StateFlag,
    messages.EventCode,
    messages.Capability,
)


def _snake(name: str) -> str:
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


def _struct(message: type[Message]) -> str:
    name = _snake(message.__name__)
    fields = layout(message)
    size = sum(wire.size for wire in fields.values())
    lines = [f"#define ID_{name.upper()} 0x{message.ID:02X}", f"#define SIZE_{name.upper()} {size}"]
    if fields:
        lines.append(f"struct {name} {{")
        lines += [f"\t{wire.c_type} {field};" for field, wire in fields.items()]
        lines.append("} __attribute__((packed));")
        lines.append(f'_Static_assert(sizeof(struct {name}) == {size}, "{name}");')
    return "\n".join(lines)


def _constants() -> dict[str, tuple[int | float, str]]:
    """Limits, times and board constants in the units of the firmware, each with its unit."""
    return {
        "TBP_MAJOR": (messages.MAJOR, ""),
        "TBP_MINOR": (messages.MINOR, ""),
        "BAUD": (messages.BAUD, ""),
        "MAX_PAYLOAD": (messages.MAX_PAYLOAD, "bytes"),
        "MAJOR_SHIFT": (messages.MAJOR_SHIFT, ""),
        "FROM_PLC": (messages.FROM_PLC, ""),
        "BOARD_MASK": (messages.BOARD_MASK, ""),
        "OLD_STATE_SHIFT": (messages.OLD_STATE_SHIFT, ""),
        "ECHO_SHIFT": (messages.ECHO_SHIFT, ""),
        "MAX_COMMAND_AGE": (messages.MAX_COMMAND_AGE, "ticks"),
        "NEWEST_STEP": (messages.NEWEST_STEP, ""),
        "ANSWER_BUDGET": (limits.ANSWER_BUDGET, "bytes"),
        "CONTROL_GUARD": (messages.Control.GUARD, ""),
        "END_STOP": (round(limits.STEERING_END_STOP / units.ANGLE_UNIT), "1e-4 rad"),
        "MAX_ANGLE": (round(limits.MAX_STEERING_ANGLE / units.ANGLE_UNIT), "1e-4 rad"),
        "MAX_RATE": (round(limits.MAX_STEERING_RATE / units.STEER_RATE_UNIT), "1e-3 rad/s"),
        "MAX_SPEED": (round(limits.MAX_SPEED / units.SPEED_UNIT), "mm/s"),
        "MAX_ACCELERATION": (round(limits.MAX_ACCELERATION / units.SPEED_UNIT), "mm/s^2"),
        "MAX_TORQUE": (round(limits.MAX_TORQUE * 1e3), "mN m at full PWM"),
        "MAX_REGENERATIVE_TORQUE": (round(limits.MAX_REGENERATIVE_TORQUE * 1e3), "mN m"),
        "MAX_POWER": (round(limits.MAX_POWER * 1e3), "mW"),
        "MAX_BRAKE": (round(1 / units.BRAKE_UNIT), "0.5 %"),
        "WATCHDOG_MS": (round(limits.WATCHDOG * 1e3), "ms"),
        "STALE_TICKS": (limits.STALE_TICKS, "1.024 ms"),
        "TICK_US": (round(TICK * 1e6), "us"),
        "ARMING_COMMANDS": (limits.ARMING_COMMANDS, ""),
        "ARMING_SPEED": (round(limits.ARMING_SPEED / units.SPEED_UNIT), "mm/s"),
        "ADC_CENTRE": (boards.ADC_CENTRE, "counts at 0 rad"),
        "ADC_SCALE": (boards.ADC_SCALE, "counts per rad"),
        "ADC_LOW": (boards.ADC_LOW, "counts"),
        "ADC_HIGH": (boards.ADC_HIGH, "counts"),
        "LINE_LOW_MIN": (_counts(boards.LINE_LOW[0]), "counts"),
        "LINE_LOW_MAX": (_counts(boards.LINE_LOW[1]), "counts"),
        "LINE_HIGH_MIN": (_counts(boards.LINE_HIGH[0]), "counts"),
        "LINE_HIGH_MAX": (_counts(boards.LINE_HIGH[1]), "counts"),
        "LINE_TICKS": (boards.LINE_TICKS, ""),
        "HALL_PULSE": (round(boards.HALL_PULSE / units.TRAVEL_UNIT), "um"),
        "HALL_PULSE_MIN": (round(boards.HALL_PULSES[0] / units.TRAVEL_UNIT), "um"),
        "HALL_PULSE_MAX": (round(boards.HALL_PULSES[1] / units.TRAVEL_UNIT), "um"),
        "TYRE_RADIUS": (round(boards.TYRE_RADIUS / units.LENGTH_UNIT), "0.1 mm"),
        "TYRE_RADIUS_MIN": (round(boards.TYRE_RADII[0] / units.LENGTH_UNIT), "0.1 mm"),
        "TYRE_RADIUS_MAX": (round(boards.TYRE_RADII[1] / units.LENGTH_UNIT), "0.1 mm"),
        "SUPPLY_DIVIDER": (boards.SUPPLY_DIVIDER, ""),
        "SERVO_CENTRE": (boards.SERVO_CENTRE, "us at 0 rad"),
        "SERVO_SPAN": (boards.SERVO_SPAN, "us more at END_STOP"),
        "PWM_TOP": (boards.PWM_TOP, "timer counts"),
        "THROTTLE_MAX": (round(boards.MAX_THROTTLE / units.VOLTAGE_UNIT), "mV"),
        "HOLDING_MS": (round(boards.HOLDING_TIME * 1e3), "ms"),
        "TRACKING_ERROR": (round(boards.TRACKING_ERROR / units.ANGLE_UNIT), "1e-4 rad"),
        "TRACKING_MS": (round(boards.TRACKING_TIME * 1e3), "ms"),
        "AT_REST": (round(boards.AT_REST / units.SPEED_UNIT), "mm/s"),
        "STOPPING_MS": (round(boards.STOPPING_TIME * 1e3), "ms"),
        "STOPPING_DECELERATION": (
            round(boards.STOPPING_DECELERATION / units.SPEED_UNIT),
            "mm/s^2",
        ),
        "STOPPING_EXCESS": (round(boards.STOPPING_EXCESS / units.SPEED_UNIT), "mm/s"),
        "STOPPING_BRAKE_RATE": (
            round(boards.STOPPING_BRAKE_RATE / units.BRAKE_UNIT),
            "0.5 % per tick",
        ),
        "OVERSPEED_MARGIN": (round(boards.OVERSPEED_MARGIN / units.SPEED_UNIT), "mm/s"),
        "OVERSHOOT": (round(boards.OVERSHOOT / units.SPEED_UNIT), "mm/s"),
        "OVERSHOOT_TICKS": (round(boards.OVERSHOOT_TIME / TICK), "ticks"),
        "RUNAWAY_MARGIN": (round(boards.RUNAWAY_MARGIN / units.SPEED_UNIT), "mm/s"),
        "HARDWARE_WATCHDOG_MS": (round(boards.HARDWARE_WATCHDOG * 1e3), "ms"),
        "MASS_LOW": (round(boards.MASS_LOW / units.MASS_UNIT), "0.1 kg"),
        "MASS_HIGH": (round(boards.MASS_HIGH / units.MASS_UNIT), "0.1 kg"),
        "MASS_MIN": (round(boards.MASSES[0] / units.MASS_UNIT), "0.1 kg"),
        "MASS_MAX": (round(boards.MASSES[1] / units.MASS_UNIT), "0.1 kg"),
        "NO_LOAD": (round(boards.MOTOR_NO_LOAD_SPEED * 1e3), "mrad/s"),
        "NO_LOAD_SLOPE": (round(boards.MOTOR_SLOPE), "mN m per mrad/s"),
        "GAIN": (round(boards.SPEED_GAIN), "mN m per mrad/s, and per mrad"),
        "RESISTANCE": (boards.RESISTANCE, "m/s^2"),
        "TORQUE_LAG": (boards.TORQUE_LAG, "s"),
        "PULSE_MARGIN": (boards.PULSE_MARGIN, "pulses"),
        "AGAINST_GEAR": (boards.AGAINST_GEAR, "m/s"),
        "NO_PULSE_SPEED": (boards.NO_PULSE_SPEED, "m/s"),
        "NO_PULSE_TIME": (boards.NO_PULSE_TIME, "s"),
        "DOUBT_PULSES": (boards.DOUBT_PULSES, "pulses"),
        "RESTING_TIME": (boards.RESTING_TIME, "s"),
    }


def _counts(volts: float) -> int:
    return round(volts / boards.ADC_REFERENCE * boards.ADC_FULL)


def _define(name: str, value: float, unit: str) -> str:
    number = f"{value!r}f" if isinstance(value, float) else str(value)
    return f"#define {name} {number}" + (f" /* {unit} */" if unit else "")


def firmware_header() -> str:
    """Return the text of ``firmware/messages.h``."""
    parts = [
        "/* Generated by `python -m tricycle_bridge.protocol.firmware_header`: do not edit. */",
        "#ifndef MESSAGES_H\n#define MESSAGES_H\n\n#include <stdint.h>",
        "\n".join(_define(name, *constant) for name, constant in _constants().items()),
    ]
    for kind in _ENUMS:
        prefix = _snake(kind.__name__).upper()
        parts.append("\n".join(f"#define {prefix}_{member.name} {member.value}" for member in kind))
    for message in MESSAGES:
        whose = "" if message.BOARD is Board.ANY else f" ({message.BOARD.name.lower()} PLC)"
        summary = (message.__doc__ or "").splitlines()[0]
        parts.append(f"/* {summary}{whose} */\n{_struct(message)}")
    parts.append("#endif")
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    sys.stdout.write(firmware_header())
