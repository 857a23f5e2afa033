"""The message table of the tricycle by-wire protocol (TBP v1): the one truth for host and PLCs.

Each message is a frozen dataclass whose fields are the payload's integers in wire order, little
endian. The C header of the firmware is generated from these classes (``firmware_header.py``).
Fields keep their wire units, named beside each; ``SCALE_*`` convert to SI.
"""

from __future__ import annotations

import dataclasses
import enum
import struct
from dataclasses import dataclass
from typing import Annotated, ClassVar, Self, get_type_hints

from tricycle_core.errors import LinkError

MAJOR = 1  # protocol versions this suite speaks
MINOR = 0
BAUD = 115_200  # 8N1
MAX_PAYLOAD = 40  # bytes

# Wire units in SI.
ANGLE_UNIT = 1e-4  # rad
STEER_RATE_UNIT = 1e-3  # rad/s
SPEED_UNIT = 1e-3  # m/s; accelerations likewise 1e-3 m/s^2
BRAKE_UNIT = 0.005  # full brake = 200

# Limits inside the PLCs, which no host can widen (section 5).
MAX_STEERING_ANGLE = 0.7854  # rad, steering motor, either side
MAX_STEERING_RATE = 3.0  # rad/s
MAX_SPEED = 4.8  # m/s
MAX_ACCELERATION = 2.0  # m/s^2

# Time limits on the PLC.
WATCHDOG = 0.2  # s without an accepted command until STOPPING
STALE_TICKS = 150  # of ECHO_TICK: an older echo marks a stale command
ECHO_TICK = 1024e-6  # s
ARMING_COMMANDS = 5  # good commands in a row before ARM is accepted


class Board(enum.IntEnum):
    """A PLC, as in bits 3..0 of the first header byte."""

    STEER = 1
    DRIVE = 2
    ANY = 15  # in HELLO only; in the table: a message of both boards


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
    STALL = 1 << 5
    OVERSPEED = 1 << 6
    WDT_RESET = 1 << 7
    LIMIT = 1 << 8  # neither latches nor blocks ARM


class Op(enum.IntEnum):
    """Operations of CTRL."""

    DISARM = 0
    ARM = 1
    ESTOP = 2
    CLEAR = 3


class Result(enum.IntEnum):
    """Results in ACK."""

    OK = 0
    UNKNOWN_OP = 1
    BAD_GUARD = 2
    WRONG_STATE = 3  # or faults set
    PRECONDITIONS = 4
    WRONG_SESSION = 5


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
    """flags of STEER_CMD and DRIVE_CMD."""

    ENABLE = 1 << 0
    ESTOP = 1 << 1


class StateFlag(enum.IntFlag):
    """flags of STEER_STATE and DRIVE_STATE."""

    ENABLED = 1 << 0  # last command enabled
    ESTOP_PRESSED = 1 << 1  # hardware e-stop
    LIMITED = 1 << 2  # output limited


class EventCode(enum.IntEnum):
    """code of EVENT."""

    BOOT = 0
    STATE_CHANGE = 1


class Capability(enum.IntFlag):
    """capabilities of HELLO_ACK."""

    HARDWARE_ESTOP = 1 << 0
    BOOT_COUNTER = 1 << 1
    SUPPLY_MEASURED = 1 << 2


@dataclass(frozen=True)
class WireType:
    """An integer on the wire."""

    name: str  # as in the protocol's tables
    code: str  # of the struct module
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


# Types of payload fields. A second annotation, where there is one, is the unit.
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


def layout(message: type[Message]) -> dict[str, WireType]:
    """Payload fields of a message class in wire order."""
    hints = get_type_hints(message, include_extras=True)
    return {f.name: hints[f.name].__metadata__[0] for f in dataclasses.fields(message)}


def payload_struct(message: type[Message]) -> struct.Struct:
    """Return the layout of a message class as a `struct.Struct`."""
    return _STRUCTS[message]


@dataclass(frozen=True)
class Message:
    """Base of all messages: integers that fit their wire types, in wire order."""

    ID: ClassVar[int]  # 0x01..0x7F host to PLC, 0x81..0xFF PLC to host
    BOARD: ClassVar[Board] = Board.ANY  # whose message it is

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
        return cls(*_STRUCTS[cls].unpack_from(payload))


# ---- host -> PLC ----


@dataclass(frozen=True)
class Hello(Message):
    """Ask a PLC who it is and give it a session (the header's)."""

    ID = 0x01
    minor: U8
    board: U8  # wanted
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
    op: U8
    arg: U8
    inverted_op: U8
    guard: U8

    @classmethod
    def of(cls, op: int) -> Self:
        """Return the message for an operation with its guard bytes."""
        return cls(op, 0, ~op & 0xFF, cls.GUARD)

    @property
    def guarded(self) -> bool:
        """Whether the guard bytes are right."""
        return self.arg == 0 and self.inverted_op == ~self.op & 0xFF and self.guard == self.GUARD


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
    flags: U8  # CommandFlag
    reserved: U8
    angle: I16  # 1e-4 rad, left positive
    max_rate: U16  # 1e-3 rad/s; 0 = PLC maximum
    echo: U16  # of the newest state frame's time, ECHO_TICK


@dataclass(frozen=True)
class DriveCommand(Message):
    """Set-point of the drive."""

    ID = 0x20
    BOARD = Board.DRIVE
    flags: U8  # CommandFlag
    gear: U8  # Gear
    speed: I16  # mm/s, not negative
    max_acceleration: U16  # mm/s^2; 0 = PLC maximum
    brake: U8  # 0..200, 0.5 %
    reserved: U8
    echo: U16  # of the newest state frame's time, ECHO_TICK


# ---- PLC -> host ----


@dataclass(frozen=True)
class HelloAck(Message):
    """Who a PLC is."""

    ID = 0x81
    minor: U8
    board: U8
    version_major: U8  # of the firmware
    version_minor: U8
    version_patch: U8
    reset_cause: U8  # ResetCause
    boot_count: U16
    build_hash: U32
    nonce: U32  # of the HELLO
    capabilities: U16  # Capability
    watchdog: U16  # ms


@dataclass(frozen=True)
class Pong(Message):
    """The PLC's clock around a PING."""

    ID = 0x82
    token: U32
    t_rx: U32  # us, PLC clock
    t_tx: U32  # us, PLC clock


@dataclass(frozen=True)
class Ack(Message):
    """Answer to CTRL."""

    ID = 0x83
    op: U8
    ctrl_seq: U8  # header seq of the CTRL
    result: U8  # Result
    state: U8  # PlcState


@dataclass(frozen=True)
class SteerLimits(Message):
    """Limits inside the steer PLC."""

    ID = 0x84
    BOARD = Board.STEER
    min_angle: I16  # 1e-4 rad
    max_angle: I16  # 1e-4 rad
    max_rate: I16  # 1e-3 rad/s
    watchdog: I16  # ms
    stale: I16  # ECHO_TICK
    adc_scale: I16  # counts per rad
    reserved_1: I16
    reserved_2: I16


@dataclass(frozen=True)
class DriveLimits(Message):
    """Limits inside the drive PLC."""

    ID = 0x84
    BOARD = Board.DRIVE
    reserved_0: I16
    max_speed: I16  # mm/s
    max_acceleration: I16  # mm/s^2
    watchdog: I16  # ms
    stale: I16  # ECHO_TICK
    pulse: I16  # um of travel per hall pulse
    reserved_1: I16
    reserved_2: I16


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
    max_tick: U16  # us
    duplicate: U16
    version: U16
    session: U16


@dataclass(frozen=True)
class Event(Message):
    """Something happened on the PLC."""

    ID = 0x86
    t: U32  # us, PLC clock
    code: U8  # EventCode
    states: U8  # old << 4 | new
    faults: U16  # Fault


@dataclass(frozen=True)
class SteerState(Message):
    """Telemetry of the steer PLC, 100 Hz."""

    ID = 0x90
    BOARD = Board.STEER
    t: U32  # us, PLC clock
    state: U8  # PlcState
    flags: U8  # StateFlag
    faults: U16  # Fault
    angle: I16  # 1e-4 rad, steering motor, left positive
    setpoint: I16  # 1e-4 rad, after limits
    rate: I16  # 1e-3 rad/s
    servo: U16  # us pulse width; 0 = off
    adc: U16  # counts
    supply: U16  # mV
    command_seq: U8  # of the last command
    command_age: U8  # 10 ms, saturates at 255


@dataclass(frozen=True)
class DriveState(Message):
    """Telemetry of the drive PLC, 100 Hz."""

    ID = 0xA0
    BOARD = Board.DRIVE
    t: U32  # us, PLC clock
    state: U8  # PlcState
    flags: U8  # StateFlag
    faults: U16  # Fault
    speed: I16  # mm/s, forward positive
    setpoint: I16  # mm/s, after limits, forward positive
    hall_count: I32  # pulses, forward counts up
    pwm: I16  # per mille
    current: U16  # mA
    supply: U16  # mV
    gear: U8  # Gear
    brake: U8  # 0..200, 0.5 %
    command_seq: U8  # of the last command
    command_age: U8  # 10 ms, saturates at 255


MESSAGES: tuple[type[Message], ...] = (
    Hello,
    Ping,
    Control,
    LimitsRequest,
    StatsRequest,
    SteerCommand,
    DriveCommand,
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


def from_plc(message_id: int) -> bool:
    """Whether a message id travels from a PLC to the host."""
    return message_id >= 0x80


def echo_of(t: int) -> int:
    """Echo of a PLC time (us): ECHO_TICK units, 16 bits."""
    return t >> 10 & 0xFFFF


def fault_names(faults: int) -> str:
    """Name the fault bits, e.g. ``CMD_TIMEOUT|LIMIT``; empty without faults.

    >>> fault_names(0x101)
    'CMD_TIMEOUT|LIMIT'
    >>> fault_names(0x200)
    'BIT_9'
    """
    known = {fault.value: fault.name for fault in Fault}
    return "|".join(known.get(1 << bit) or f"BIT_{bit}" for bit in range(16) if faults & (1 << bit))
