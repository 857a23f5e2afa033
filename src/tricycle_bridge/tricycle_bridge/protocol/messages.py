"""The message table of the tricycle by-wire protocol (TBP v2), from which all else is generated.

Each message is a frozen dataclass whose fields are the payload's integers in wire order, little
endian. A field is annotated with its wire type and, where it has one, with its `Unit` or the
enumeration of its values; a comment adds what these do not say. The C header of the firmware
(``firmware_header.py``), the reference page (docs/generate_reference.py) and the values in
/diagnostics (``readable.py``) follow from these classes. Section numbers are those of
docs/protocol.md.
"""

from __future__ import annotations

import dataclasses
import enum
import struct
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Self, get_type_hints

from tricycle_bridge.protocol.limits import ECHO_TICK
from tricycle_bridge.protocol.units import (
    ANGLE_UNIT,
    BRAKE_UNIT,
    CURRENT_UNIT,
    LENGTH_UNIT,
    MASS_UNIT,
    SPEED_UNIT,
    STEER_RATE_UNIT,
    TORQUE_UNIT,
    TRAVEL_UNIT,
    VOLTAGE_UNIT,
)
from tricycle_core.errors import LinkError

MAJOR = 2  # version of the protocol
MINOR = 0
BAUD = 115_200  # 8N1
MAX_PAYLOAD = 40  # bytes
MAJOR_SHIFT = 5  # bits of the first header byte: major version, direction, board
FROM_PLC = 0x10
BOARD_MASK = 0x0F
OLD_STATE_SHIFT = 4  # in the states of an EVENT, beside the new state
NEW_STATE_MASK = 0x0F
ECHO_SHIFT = 10  # from microseconds to an echo
MAX_COMMAND_AGE = 255  # counts; also where there is no command
NEWEST_STEP = 127  # between numbers of operations; further is backwards


class Board(enum.IntEnum):
    """A PLC, as in bits 3..0 of the first header byte."""

    STEER = 1
    DRIVE = 2
    ANY = 15  # in HELLO only; in the table: a message of both boards

    @property
    def plc_name(self) -> str:
        """Name in messages for a person, e.g. ``steer PLC``."""
        return f"{self.name.lower()} PLC"


class PlcState(enum.IntEnum):
    """State machine of both PLCs (section 5)."""

    BOOT = 0
    SAFE = 1
    ARMED = 2
    STOPPING = 3
    ESTOP = 4
    FAULT = 5


class Fault(enum.IntFlag, boundary=enum.KEEP):
    """Fault bits; unknown bits (a newer minor version) are kept and count as faults."""

    CMD_TIMEOUT = 1 << 0
    TRACKING = 1 << 1
    SENSOR = 1 << 2
    ESTOP_HOST = 1 << 3
    ESTOP_HW = 1 << 4
    PULSES = 1 << 5
    OVERSPEED = 1 << 6
    WDT_RESET = 1 << 7
    LIMIT = 1 << 8  # neither latches nor blocks ARM
    SUPPLY = 1 << 9  # does not latch; blocks ARM while it is set
    STOP_TIMEOUT = 1 << 10
    HALL_LINE = 1 << 11


class Op(enum.IntEnum):
    """Operations of CTRL; SETUP stands only in the ACK of a SETUP message."""

    DISARM = 0
    ARM = 1
    ESTOP = 2
    CLEAR = 3
    SETUP = 4


class Result(enum.IntEnum):
    """Results in ACK."""

    OK = 0
    UNKNOWN_OP = 1
    BAD_GUARD = 2
    WRONG_STATE = 3  # or faults set
    PRECONDITIONS = 4
    WRONG_SESSION = 5
    OUT_OF_RANGE = 6
    STALE = 7


class Gear(enum.IntEnum):
    """Gear of the drive PLC."""

    NEUTRAL = 0
    DRIVE = 1
    REVERSE = 2


class ResetCause(enum.IntEnum):
    """Why a PLC booted."""

    POWER_ON = 1
    EXTERNAL = 2
    BROWN_OUT = 4
    WATCHDOG = 8


class CommandFlag(enum.IntFlag):
    """Bits of `flags` in STEER_CMD and DRIVE_CMD."""

    ENABLE = 1 << 0
    ESTOP = 1 << 1
    STANDSTILL = 1 << 2  # the host measures the vehicle at rest


class StateFlag(enum.IntFlag):
    """Bits of `flags` in STEER_STATE and DRIVE_STATE."""

    ENABLED = 1 << 0  # last command enabled
    ESTOP_PRESSED = 1 << 1  # hardware e-stop
    LIMITED = 1 << 2  # output limited
    SET_UP = 1 << 3  # SETUP was accepted in this session
    HOLDING = 1 << 4  # not armed, and the servo still holds its angle; or armed, brake on at rest


class EventCode(enum.IntEnum):
    """Values of `code` in EVENT."""

    BOOT = 0
    STATE_CHANGE = 1


class Capability(enum.IntFlag):
    """Bits of `capabilities` in HELLO_ACK."""

    HARDWARE_ESTOP = 1 << 0
    BOOT_COUNTER = 1 << 1
    SUPPLY_MEASURED = 1 << 2


@dataclass(frozen=True)
class WireType:
    """An integer on the wire.

    Attributes
    ----------
    name : str
        Name in the protocol's tables, e.g. ``u16``.
    code : str
        Format character of the `struct` module.
    c_type : str
        Type in the firmware.
    """

    name: str
    code: str
    c_type: str

    @property
    def low(self) -> int:
        """Smallest value."""
        return -(1 << (8 * self.size - 1)) if self.code.islower() else 0

    @property
    def high(self) -> int:
        """Largest value."""
        return (1 << (8 * self.size - (1 if self.code.islower() else 0))) - 1

    @property
    def size(self) -> int:
        """Bytes."""
        return struct.calcsize("<" + self.code)


@dataclass(frozen=True)
class Unit:
    """Physical value of one count of a field.

    Attributes
    ----------
    scale : float
        Value of one count, in the unit `symbol`.
    symbol : str
        Symbol of the unit, e.g. ``m/s``.
    """

    scale: float
    symbol: str

    def __str__(self) -> str:
        return f"{self.scale:g} {self.symbol}"


_U8 = WireType("u8", "B", "uint8_t")
_U16 = WireType("u16", "H", "uint16_t")
_I16 = WireType("i16", "h", "int16_t")
_U32 = WireType("u32", "I", "uint32_t")
_I32 = WireType("i32", "i", "int32_t")
U8 = Annotated[int, _U8]
U16 = Annotated[int, _U16]
I16 = Annotated[int, _I16]
U32 = Annotated[int, _U32]
I32 = Annotated[int, _I32]

_ANGLE = Unit(ANGLE_UNIT, "rad")
_RATE = Unit(STEER_RATE_UNIT, "rad/s")
_SPEED = Unit(SPEED_UNIT, "m/s")
_ACCELERATION = Unit(SPEED_UNIT, "m/s^2")
_BRAKE = Unit(100 * BRAKE_UNIT, "%")
_MICROSECONDS = Unit(1e-6, "s")
_MILLISECONDS = Unit(1e-3, "s")
_ECHO = Unit(ECHO_TICK, "s")
_CENTISECONDS = Unit(0.01, "s")
_VOLTAGE = Unit(VOLTAGE_UNIT, "V")
_CURRENT = Unit(CURRENT_UNIT, "A")
_LENGTH = Unit(LENGTH_UNIT, "m")
_TRAVEL = Unit(TRAVEL_UNIT, "m")
_TORQUE = Unit(TORQUE_UNIT, "N m")
_POWER = Unit(1.0, "W")
_MASS = Unit(MASS_UNIT, "kg")


Meaning = Unit | type[enum.IntEnum] | type[enum.IntFlag]


def layout(message: type[Message]) -> dict[str, WireType]:
    """Return the wire types of a message's fields in wire order.

    Parameters
    ----------
    message : type
        A subclass of `Message`.
    """
    return {name: metadata[0] for name, metadata in _annotations(message).items()}


def meanings(message: type[Message]) -> dict[str, Meaning | None]:
    """Return what the values of a message's fields stand for, in wire order.

    Parameters
    ----------
    message : type
        A subclass of `Message`.

    Returns
    -------
    meanings : dict
        Name to `Unit`, enumeration, or None for a plain number.
    """
    return _MEANINGS[message]


def _annotations(message: type[Message]) -> dict[str, tuple[Any, ...]]:
    hints = get_type_hints(message, include_extras=True)
    return {f.name: hints[f.name].__metadata__ for f in dataclasses.fields(message)}


def payload_struct(message: type[Message]) -> struct.Struct:
    """Return the layout of a message's payload.

    Parameters
    ----------
    message : type
        A subclass of `Message`.
    """
    return _STRUCTS[message]


@dataclass(frozen=True)
class Message:
    """Base of all messages: integers that fit their wire types, in wire order."""

    ID: ClassVar[int]  # 0x01..0x7F host to PLC, 0x81..0xFF PLC to host
    BOARD: ClassVar[Board] = Board.ANY  # PLC that sends or receives it

    def payload(self) -> bytes:
        """Encode the fields.

        Raises
        ------
        LinkError
            A value does not fit its field.
        """
        try:
            return _STRUCTS[type(self)].pack(*self.__dict__.values())
        except struct.error:
            for name, wire in layout(type(self)).items():
                value = getattr(self, name)
                if not (isinstance(value, int) and wire.low <= value <= wire.high):
                    raise LinkError(
                        f"{type(self).__name__}.{name} = {value!r} does not fit {wire.name} "
                        f"({wire.low}..{wire.high})"
                    ) from None
            raise

    @classmethod
    def from_payload(cls, payload: bytes) -> Self:
        """Decode the fields; bytes behind them belong to a newer minor version."""
        message = cls.__new__(cls)  # setting each frozen field would be most of the decoder's work
        message.__dict__.update(zip(_NAMES[cls], _STRUCTS[cls].unpack_from(payload), strict=True))
        return message


# ---- host -> PLC ----


@dataclass(frozen=True)
class Hello(Message):
    """Ask a PLC who it is and give it a session (the header's)."""

    ID = 0x01
    minor: U8
    board: Annotated[U8, Board]  # wanted
    nonce: U32


@dataclass(frozen=True)
class Ping(Message):
    """Ask for the PLC's clock."""

    ID = 0x02
    token: U32


@dataclass(frozen=True)
class Control(Message):
    """CTRL: an operation of the state machine; build it with `of`."""

    ID = 0x03
    GUARD: ClassVar[int] = 0xA5
    op: Annotated[U8, Op]
    inverted_op: U8
    number: U8  # of the operation; its repeats have the same
    guard: U8
    echo: Annotated[U16, _ECHO]  # of the newest state frame's time

    @classmethod
    def of(cls, op: int, number: int = 0, echo: int = 0) -> Self:
        """Return the message for an operation with its guard bytes.

        Parameters
        ----------
        op : int
            Operation, e.g. ARM.
        number : int
            Number of the operation, modulo 256.
        echo : int
            `echo_of` the newest state frame's time.
        """
        return cls(op, ~op & 0xFF, number, cls.GUARD, echo)

    @property
    def guarded(self) -> bool:
        """Whether the guard bytes are right."""
        return self.inverted_op == ~self.op & 0xFF and self.guard == self.GUARD


@dataclass(frozen=True)
class LimitsRequest(Message):
    """Ask for LIMITS."""

    ID = 0x04


@dataclass(frozen=True)
class StatsRequest(Message):
    """Ask for STATS."""

    ID = 0x05


@dataclass(frozen=True)
class SteerCommand(Message):
    """Set-point of the steering motor."""

    ID = 0x10
    BOARD = Board.STEER
    flags: Annotated[U8, CommandFlag]
    reserved: U8
    angle: Annotated[I16, _ANGLE]  # left positive
    max_rate: Annotated[U16, _RATE]  # 0 = PLC maximum
    echo: Annotated[U16, _ECHO]  # of the newest state frame's time

    def echoing(self, t: int) -> SteerCommand:
        """Return the command with the echo of a state frame's time [us]."""
        return SteerCommand(self.flags, self.reserved, self.angle, self.max_rate, echo_of(t))


@dataclass(frozen=True)
class SteerSetup(Message):
    """SETUP: the vehicle's limits for this session; 0 = the board's own."""

    ID = 0x11
    BOARD = Board.STEER
    max_angle: Annotated[U16, _ANGLE]
    max_rate: Annotated[U16, _RATE]
    supply_low: Annotated[U16, _VOLTAGE]
    supply_high: Annotated[U16, _VOLTAGE]


@dataclass(frozen=True)
class DriveCommand(Message):
    """Set-point of the drive."""

    ID = 0x20
    BOARD = Board.DRIVE
    flags: Annotated[U8, CommandFlag]
    gear: Annotated[U8, Gear]
    speed: Annotated[I16, _SPEED]  # not negative
    max_acceleration: Annotated[U16, _ACCELERATION]  # 0 = PLC maximum
    brake: Annotated[U8, _BRAKE]  # 200 counts = full
    reserved: U8
    echo: Annotated[U16, _ECHO]  # of the newest state frame's time

    def echoing(self, t: int) -> DriveCommand:
        """Return the command with the echo of a state frame's time [us]."""
        return DriveCommand(
            self.flags,
            self.gear,
            self.speed,
            self.max_acceleration,
            self.brake,
            self.reserved,
            echo_of(t),
        )


@dataclass(frozen=True)
class DriveSetup(Message):
    """SETUP: the vehicle's drive for this session; 0 = the board's own."""

    ID = 0x21
    BOARD = Board.DRIVE
    max_speed: Annotated[U16, _SPEED]
    max_acceleration: Annotated[U16, _ACCELERATION]
    pulse: Annotated[U16, _TRAVEL]  # of travel per hall pulse
    tyre_radius: Annotated[U16, _LENGTH]
    torque: Annotated[U16, _TORQUE]  # largest of the motor
    regenerative_torque: Annotated[U16, _TORQUE]  # largest braking one of the motor
    power: Annotated[U16, _POWER]
    mass_low: Annotated[U16, _MASS]  # lightest at the tread, wheels' inertia included
    mass_high: Annotated[U16, _MASS]  # heaviest
    supply_low: Annotated[U16, _VOLTAGE]
    supply_high: Annotated[U16, _VOLTAGE]
    throttle_low: Annotated[U16, _VOLTAGE]  # at the motor's controller without torque
    throttle_high: Annotated[U16, _VOLTAGE]  # with full torque


# ---- PLC -> host ----


@dataclass(frozen=True)
class HelloAck(Message):
    """Who a PLC is."""

    ID = 0x81
    minor: U8
    board: Annotated[U8, Board]
    version_major: U8  # of the firmware
    version_minor: U8
    version_patch: U8
    reset_cause: Annotated[U8, ResetCause]
    boot_count: U16
    build_hash: U32
    nonce: U32  # of the HELLO
    capabilities: Annotated[U16, Capability]
    watchdog: Annotated[U16, _MILLISECONDS]


@dataclass(frozen=True)
class Pong(Message):
    """The PLC's clock around a PING."""

    ID = 0x82
    token: U32
    t_rx: Annotated[U32, _MICROSECONDS]  # PLC clock, when the PING arrived
    t_tx: Annotated[U32, _MICROSECONDS]  # PLC clock, when this was sent


@dataclass(frozen=True)
class Ack(Message):
    """Answer to CTRL and SETUP."""

    ID = 0x83
    op: Annotated[U8, Op]
    ctrl_seq: U8  # header seq of what it answers
    result: Annotated[U8, Result]
    state: Annotated[U8, PlcState]


@dataclass(frozen=True)
class SteerLimits(Message):
    """Limits in force in the steer PLC."""

    ID = 0x84
    BOARD = Board.STEER
    max_angle: Annotated[U16, _ANGLE]
    max_rate: Annotated[U16, _RATE]
    supply_low: Annotated[U16, _VOLTAGE]
    supply_high: Annotated[U16, _VOLTAGE]
    watchdog: Annotated[U16, _MILLISECONDS]
    stale: Annotated[U16, _ECHO]
    end_stop: Annotated[U16, _ANGLE]  # of the steering motor, either side
    adc_scale: U16  # counts per rad


@dataclass(frozen=True)
class DriveLimits(Message):
    """Limits in force in the drive PLC."""

    ID = 0x84
    BOARD = Board.DRIVE
    max_speed: Annotated[U16, _SPEED]
    max_acceleration: Annotated[U16, _ACCELERATION]
    pulse: Annotated[U16, _TRAVEL]  # of travel per hall pulse
    tyre_radius: Annotated[U16, _LENGTH]
    torque: Annotated[U16, _TORQUE]
    regenerative_torque: Annotated[U16, _TORQUE]
    power: Annotated[U16, _POWER]
    mass_low: Annotated[U16, _MASS]
    mass_high: Annotated[U16, _MASS]
    supply_low: Annotated[U16, _VOLTAGE]
    supply_high: Annotated[U16, _VOLTAGE]
    throttle_low: Annotated[U16, _VOLTAGE]
    throttle_high: Annotated[U16, _VOLTAGE]
    watchdog: Annotated[U16, _MILLISECONDS]
    stale: Annotated[U16, _ECHO]


@dataclass(frozen=True)
class Stats(Message):
    """Counters of a PLC; they wrap, max_tick saturates."""

    ID = 0x85
    ok: U32
    crc: U16
    cobs: U16
    length: U16
    unknown: U16
    stale: U16
    seq_gap: U16
    rx_overrun: U16
    tx_drop: U16
    watchdog_trips: U16
    tick_overrun: U16
    max_tick: Annotated[U16, Unit(1.0, "us")]  # longest tick
    duplicate: U16
    version: U16
    session: U16


@dataclass(frozen=True)
class Event(Message):
    """Something happened on the PLC."""

    ID = 0x86
    t: Annotated[U32, _MICROSECONDS]  # PLC clock
    code: Annotated[U8, EventCode]
    states: U8  # old << 4 | new
    faults: Annotated[U16, Fault]


@dataclass(frozen=True)
class SteerState(Message):
    """Telemetry of the steer PLC, 100 Hz."""

    ID = 0x90
    BOARD = Board.STEER
    t: Annotated[U32, _MICROSECONDS]  # PLC clock
    state: Annotated[U8, PlcState]
    flags: Annotated[U8, StateFlag]
    faults: Annotated[U16, Fault]
    angle: Annotated[I16, _ANGLE]  # steering motor, left positive
    setpoint: Annotated[I16, _ANGLE]  # after limits
    rate: Annotated[I16, _RATE]
    servo: Annotated[U16, Unit(1.0, "us")]  # pulse width; 0 = off
    adc: U16  # counts
    supply: Annotated[U16, _VOLTAGE]
    command_seq: U8  # of the last command
    command_age: Annotated[U8, _CENTISECONDS]  # saturates at 255 counts


@dataclass(frozen=True)
class DriveState(Message):
    """Telemetry of the drive PLC, 100 Hz."""

    ID = 0xA0
    BOARD = Board.DRIVE
    t: Annotated[U32, _MICROSECONDS]  # PLC clock
    state: Annotated[U8, PlcState]
    flags: Annotated[U8, StateFlag]
    faults: Annotated[U16, Fault]
    speed: Annotated[I16, _SPEED]  # forward positive
    setpoint: Annotated[I16, _SPEED]  # after limits, forward positive
    hall_count: I32  # pulses, forward counts up
    pwm: Annotated[I16, Unit(0.1, "%")]
    current: Annotated[U16, _CURRENT]
    supply: Annotated[U16, _VOLTAGE]
    gear: Annotated[U8, Gear]
    brake: Annotated[U8, _BRAKE]  # 200 counts = full
    command_seq: U8  # of the last command
    command_age: Annotated[U8, _CENTISECONDS]  # saturates at 255 counts


MESSAGES: tuple[type[Message], ...] = (
    Hello,
    Ping,
    Control,
    LimitsRequest,
    StatsRequest,
    SteerCommand,
    SteerSetup,
    DriveCommand,
    DriveSetup,
    HelloAck,
    Pong,
    Ack,
    SteerLimits,
    DriveLimits,
    Stats,
    Event,
    SteerState,
    DriveState,
)

_STRUCTS: dict[type[Message], struct.Struct] = {
    message: struct.Struct("<" + "".join(wire.code for wire in layout(message).values()))
    for message in MESSAGES
}

_NAMES: dict[type[Message], tuple[str, ...]] = {
    message: tuple(layout(message)) for message in MESSAGES
}

_MEANINGS: dict[type[Message], dict[str, Meaning | None]] = {
    message: {
        name: metadata[1] if len(metadata) > 1 else None
        for name, metadata in _annotations(message).items()
    }
    for message in MESSAGES
}


def from_plc(message_id: int) -> bool:
    """Whether a message travels from a PLC to the host.

    Parameters
    ----------
    message_id : int
        Id in the header.
    """
    return message_id >= 0x80


def echo_of(t: int) -> int:
    """Return the echo of a PLC time (section 4), in units of `ECHO_TICK`, 16 bits.

    Parameters
    ----------
    t : int
        Time of a state frame [us].
    """
    return t >> ECHO_SHIFT & 0xFFFF
