"""Common part of both emulated PLCs: session, state machine, watchdog, counters (`plc.c` in C).

Bytes, measurements and PLC time in; bytes and actuator outputs out. No port, no thread and no clock
inside. Every 10 ms of PLC time the owner calls

1. ``answer = plc.receive(bytes_from_the_line, now_us)``, as often as bytes arrive, then
2. ``telemetry, output = plc.tick(now_us, measurement)`` once,

writes both answers to the line and hands the output to the vehicle. Section numbers are those of
docs/protocol.md.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from typing import ClassVar, Generic, Protocol, TypeVar, cast

from tricycle_bridge.protocol.framing import DELIMITER, Frame, FrameDecoder, encode
from tricycle_bridge.protocol.limits import ANSWER_BUDGET, ARMING_COMMANDS, STALE_TICKS, WATCHDOG
from tricycle_bridge.protocol.messages import (
    MAJOR,
    MAX_COMMAND_AGE,
    MINOR,
    NEWEST_STEP,
    OLD_STATE_SHIFT,
    Ack,
    Board,
    Capability,
    CommandFlag,
    Control,
    DriveCommand,
    DriveSetup,
    Event,
    EventCode,
    Fault,
    Hello,
    HelloAck,
    LimitsRequest,
    Message,
    Op,
    Ping,
    PlcState,
    Pong,
    ResetCause,
    Result,
    StateFlag,
    Stats,
    StatsRequest,
    SteerCommand,
    SteerSetup,
    echo_of,
)
from tricycle_bridge.protocol.units import VOLTAGE_UNIT
from tricycle_core.timing import TICK
from tricycle_sim.setpoints import slew

_WATCHDOG_US = round(WATCHDOG * 1e6)
_TICK_US = round(TICK * 1e6)
_U16, _U32 = 0xFFFF, 0xFFFFFFFF


class Measurement(Protocol):
    """The inputs that both PLCs have."""

    @property
    def supply(self) -> float:
        """Voltage of the supply in V."""
        ...

    @property
    def estop_pressed(self) -> bool:
        """Whether the hardware e-stop is pressed."""
        ...


MeasurementT = TypeVar("MeasurementT", bound=Measurement)
OutputT = TypeVar("OutputT")
CommandT = TypeVar("CommandT", SteerCommand, DriveCommand)
SetupT = TypeVar("SetupT", SteerSetup, DriveSetup)


class Plc(ABC, Generic[MeasurementT, OutputT, CommandT, SetupT]):
    """An emulated PLC; `SteerPlc` and `DrivePlc` add what differs between the boards.

    Parameters
    ----------
    boot_count : int
        Boots before this one, as the firmware keeps them in EEPROM.
    firmware : tuple of int
        Major, minor and patch version in HELLO_ACK.
    major, minor : int
        Protocol version, to emulate another one than this suite's.

    Attributes
    ----------
    state : PlcState
        State of the state machine.
    faults : Fault
        Faults that are set.
    counters : Stats
        Counters; those of the frames are in the decoder until STATS is asked for.
    """

    board: ClassVar[Board]
    _own: SetupT  # what is in force without a SETUP
    _measured: MeasurementT  # inputs of the newest tick

    def __init__(
        self,
        *,
        boot_count: int = 0,
        firmware: tuple[int, int, int] = (2, 0, 0),
        major: int = MAJOR,
        minor: int = MINOR,
    ) -> None:
        self._boot_count = boot_count
        self._firmware = firmware
        self._major = major
        self._minor = minor
        slew(0.0, 0.0, 0.0)  # compiled now, not within the first armed tick
        self.reset(ResetCause.POWER_ON)

    def reset(self, cause: ResetCause = ResetCause.EXTERNAL) -> None:
        """Boot: everything but the boot count is forgotten, the session too."""
        self._boot_count = (self._boot_count + 1) & _U16
        self._reset_cause = cause
        self.state = PlcState.BOOT
        self.faults = Fault.WDT_RESET if cause is ResetCause.WATCHDOG else Fault(0)
        self.counters = Stats(*([0] * len(dataclasses.fields(Stats))))
        self._decoder = FrameDecoder(self.board, host=False)
        self._seq = 0
        self._answered = 0  # bytes of answers since the last tick
        self._last_rx_seq: int | None = None
        self._operation: int | None = None  # number of the last one in this session ...
        self._operation_result = Result.OK  # ... and its result
        self._setup: SetupT | None = None  # as accepted in this session
        self._in_force: SetupT = self._own
        self._command_seq = 0
        self._command_at: int | None = None  # us, of the last accepted command
        self._commands_in_row = 0  # with enable = 1
        self._enabled = False  # flag of the last accepted command
        self._command_limited = False  # the last accepted command
        self._estop_pressed = False
        self._state_since = 0  # us
        self._transmit = [DELIMITER]  # ends a frame that the reset has cut
        self._reset_board()
        self._put_in_force()

    @property
    def session(self) -> int:
        """Session given by the host; 0 = none."""
        return self._decoder.session

    def command_age(self, now_us: int) -> int | None:
        """Time in us since a command was last accepted; None before the first one."""
        return None if self._command_at is None else now_us - self._command_at

    def receive(self, data: bytes, now_us: int) -> bytes:
        """Take bytes from the host.

        Parameters
        ----------
        data : bytes
            Part of the stream, cut anywhere.
        now_us : int
            PLC time in us; it need not wrap.

        Returns
        -------
        bytes
            The answers, for the line.
        """
        for frame in self._decoder.feed(data):
            if self.state is not PlcState.BOOT:
                self._handle(frame, now_us)
        return self._take_bytes()

    def tick(self, now_us: int, measurement: MeasurementT) -> tuple[bytes, OutputT]:
        """Run one control tick of 10 ms.

        Parameters
        ----------
        now_us : int
            PLC time in us; it need not wrap.
        measurement : SteerMeasurement or DriveMeasurement
            Inputs at this time.

        Returns
        -------
        bytes
            Events and the state frame, for the line.
        SteerOutput or DriveOutput
            Outputs to the actuators until the next tick.
        """
        self._estop_pressed = measurement.estop_pressed
        self._measured = measurement
        self._answered = 0
        self._begin_tick(now_us)
        if self.state is PlcState.BOOT:
            self._enter(PlcState.SAFE, now_us, code=EventCode.BOOT)
        if self._estop_pressed:
            self._estop(Fault.ESTOP_HW, now_us)
        self._check_watchdog(now_us)
        moving = self.state in (PlcState.ARMED, PlcState.STOPPING)
        if moving and (fault := self._find_fault(now_us)):
            self.faults |= fault
            self._enter(PlcState.FAULT, now_us)
        if self.state is PlcState.STOPPING and self._stopped():
            self._enter(PlcState.SAFE, now_us)
        output = self._control()
        self._mark(Fault.LIMIT, is_set=self._limited(now_us))
        self._mark(Fault.SUPPLY, is_set=self._supply_wrong)
        self._send(self._state_frame(now_us))
        return self._take_bytes(), output

    def drop_sent(self, frames: int) -> None:
        """Count frames that the line did not take (STATS tx_drop)."""
        self._count(tx_drop=frames)

    # ---- what differs between the boards ----

    @abstractmethod
    def _reset_board(self) -> None:
        """Forget the board's own state, `_measured` too."""

    @abstractmethod
    def _put_in_force(self) -> None:
        """Use the values of `_in_force`."""

    @abstractmethod
    def _allowed(self, setup: SetupT) -> bool:
        """Whether a SETUP, its zeros replaced, is within the board's own limits."""

    @abstractmethod
    def _begin_tick(self, now_us: int) -> None:
        """Part of a tick before the state machine."""

    @abstractmethod
    def _find_fault(self, now_us: int) -> Fault:
        """Faults of an armed or stopping board that end in FAULT."""

    @abstractmethod
    def _stopped(self) -> bool:
        """Whether STOPPING is over."""

    @abstractmethod
    def _ready(self) -> bool:
        """Preconditions of ARM that only this board has."""

    @abstractmethod
    def _armed(self) -> None:
        """Prepare the set-point when arming."""

    @abstractmethod
    def _left_armed(self, now_us: int) -> None:
        """Do what leaving ARMED needs, whatever the reason."""

    @abstractmethod
    def _take_command(self, command: CommandT) -> bool:
        """Keep a command's set-point; return whether a limit acts on it."""

    @abstractmethod
    def _control(self) -> OutputT:
        """Advance the set-point by one tick."""

    @property
    @abstractmethod
    def _holds(self) -> bool:
        """Flag HOLDING."""

    @abstractmethod
    def _state_frame(self, now_us: int) -> Message:
        """Telemetry."""

    @abstractmethod
    def _limits_frame(self) -> Message:
        """LIMITS."""

    # ---- frames ----

    def _send(self, message: Message) -> None:
        frame = encode(
            message, board=self.board, seq=self._seq, session=self.session, major=self._major
        )
        self._transmit.append(frame)
        self._seq = (self._seq + 1) & 0xFF

    def _answer(self, message: Message) -> None:
        """Send an answer unless the answers since the last tick leave no room for it."""
        before = len(self._transmit)
        self._send(message)
        size = len(self._transmit[before])
        if self._answered + size > ANSWER_BUDGET:
            del self._transmit[before]
            self._count(tx_drop=1)
        else:
            self._answered += size

    def _take_bytes(self) -> bytes:
        data = b"".join(self._transmit)
        self._transmit.clear()
        return data

    def _count(self, **more: int) -> None:
        self.counters = dataclasses.replace(
            self.counters,
            **{name: (getattr(self.counters, name) + n) & _U16 for name, n in more.items()},
        )

    def _handle(self, frame: Frame, now_us: int) -> None:
        message = frame.message
        if isinstance(message, Hello):
            self._greet(frame, message, now_us)
            return
        if not self._count_seq(frame.seq):
            return
        match message:
            case SteerCommand() | DriveCommand():
                # the decoder lets only this board's command through
                self._accept_command(frame.seq, cast(CommandT, message), now_us)
            case Control():
                result = self._operate(message, now_us)
                self._answer(Ack(message.op, frame.seq, result, self.state))
            case SteerSetup() | DriveSetup():
                result = self._set_up(cast(SetupT, message))
                self._answer(Ack(Op.SETUP, frame.seq, result, self.state))
            case Ping():
                self._answer(Pong(message.token, now_us & _U32, now_us & _U32))
            case LimitsRequest():
                self._answer(self._limits_frame())
            case StatsRequest():
                self._answer(self._stats_frame())

    def _greet(self, frame: Frame, hello: Hello, now_us: int) -> None:
        if hello.board not in (self.board, Board.ANY):
            return  # section 3.2: stay silent
        if self.state in (PlcState.ARMED, PlcState.STOPPING):
            self._enter(PlcState.SAFE, now_us)
        self._decoder.session = frame.session
        self._last_rx_seq = frame.seq
        self._command_at = None
        self._enabled = False
        self._commands_in_row = 0
        self._operation = None
        self._setup = None
        self._use(self._own)
        self._answer(
            HelloAck(
                self._minor,
                self.board,
                *self._firmware,
                self._reset_cause,
                self._boot_count,
                0,  # build hash: emulated
                hello.nonce,
                Capability.HARDWARE_ESTOP | Capability.BOOT_COUNTER | Capability.SUPPLY_MEASURED,
                round(WATCHDOG * 1e3),
            )
        )

    def _count_seq(self, seq: int) -> bool:
        """Count gaps and duplicates (section 4); False for a duplicate."""
        if self._last_rx_seq is not None:
            step = (seq - self._last_rx_seq) & 0xFF
            if step == 0:
                self._count(duplicate=1)
                return False
            self._count(seq_gap=step - 1)
        self._last_rx_seq = seq
        return True

    def _accept_command(self, seq: int, command: CommandT, now_us: int) -> None:
        if self._is_stale(command.echo, now_us):
            self._commands_in_row = 0
            return
        self._command_limited = self._take_command(command)
        self._command_seq = seq
        self._command_at = now_us
        self._enabled = bool(command.flags & CommandFlag.ENABLE)
        self._commands_in_row = self._commands_in_row + 1 if self._enabled else 0
        if command.flags & CommandFlag.ESTOP:
            self._estop(Fault.ESTOP_HOST, now_us)
        elif self.state is PlcState.ARMED and not self._enabled:
            self._enter(PlcState.STOPPING, now_us)

    def _is_stale(self, echo: int, now_us: int) -> bool:
        """Judge an echo (section 4) and count a stale one."""
        stale = (echo_of(now_us) - echo) & _U16 > STALE_TICKS
        if stale:
            self._count(stale=1)
        return stale

    def _stats_frame(self) -> Stats:
        decoder = self._decoder.counters
        return dataclasses.replace(
            self.counters,
            ok=decoder.ok & _U32,
            crc=decoder.crc & _U16,
            cobs=decoder.cobs & _U16,
            length=decoder.length & _U16,
            unknown=decoder.unknown & _U16,
            version=decoder.version & _U16,
            session=decoder.session & _U16,
        )

    # ---- state machine (section 5) ----

    def _enter(
        self, state: PlcState, now_us: int, *, code: EventCode = EventCode.STATE_CHANGE
    ) -> None:
        old, self.state = self.state, state
        self._state_since = now_us
        if old is PlcState.ARMED:
            self._left_armed(now_us)
        self._send(Event(now_us & _U32, code, old << OLD_STATE_SHIFT | state, self.faults))

    def _estop(self, fault: Fault, now_us: int) -> None:
        self.faults |= fault
        if self.state is not PlcState.ESTOP:
            self._enter(PlcState.ESTOP, now_us)

    def _check_watchdog(self, now_us: int) -> None:
        age = self.command_age(now_us)
        if age is not None and age < _WATCHDOG_US:
            return
        self._commands_in_row = 0
        if self.state is PlcState.ARMED:
            self.faults |= Fault.CMD_TIMEOUT
            self._count(watchdog_trips=1)
            self._enter(PlcState.STOPPING, now_us)

    def _operate(self, control: Control, now_us: int) -> Result:
        if not control.guarded:
            return Result.BAD_GUARD
        if control.op not in (Op.DISARM, Op.ARM, Op.ESTOP, Op.CLEAR):
            return Result.UNKNOWN_OP
        last = self._operation
        step = 1 if last is None else (control.number - last) & 0xFF
        if control.op in (Op.ARM, Op.CLEAR):
            if step == 0:
                return self._operation_result
            if step > NEWEST_STEP or self._is_stale(control.echo, now_us):
                return Result.STALE
        result = self._do(Op(control.op), now_us)
        if 0 < step <= NEWEST_STEP:
            self._operation, self._operation_result = control.number, result
        return result

    def _do(self, op: Op, now_us: int) -> Result:
        match op:
            case Op.ESTOP:
                self._estop(Fault.ESTOP_HOST, now_us)
                return Result.OK
            case Op.DISARM:
                if self.state in (PlcState.ARMED, PlcState.STOPPING):
                    self._enter(PlcState.SAFE, now_us)
                return Result.OK
            case Op.CLEAR:
                return self._clear(now_us)
            case _:
                return self._arm(now_us)

    def _clear(self, now_us: int) -> Result:
        if self.state in (PlcState.ARMED, PlcState.STOPPING):
            return Result.WRONG_STATE
        if self._estop_pressed:
            return Result.PRECONDITIONS
        self.faults &= Fault.LIMIT | Fault.SUPPLY
        if self.state is not PlcState.SAFE:
            self._enter(PlcState.SAFE, now_us)
        return Result.OK

    def _arm(self, now_us: int) -> Result:
        if self.state is PlcState.ARMED:
            return Result.OK
        if self.state is not PlcState.SAFE or self.faults & ~(Fault.LIMIT | Fault.SUPPLY):
            return Result.WRONG_STATE
        age = self.command_age(now_us)
        if (
            self._setup is None
            or self._commands_in_row < ARMING_COMMANDS
            or age is None
            or age > _WATCHDOG_US
            or not self._ready()
            or self._supply_wrong
        ):
            return Result.PRECONDITIONS
        self._armed()
        self._enter(PlcState.ARMED, now_us)
        return Result.OK

    # ---- values of the vehicle (SETUP) ----

    def _set_up(self, setup: SetupT) -> Result:
        if self.state is not PlcState.SAFE:
            return Result.WRONG_STATE
        if self._setup is not None:
            return Result.OK if setup == self._setup else Result.WRONG_STATE
        values = zip(dataclasses.astuple(setup), dataclasses.astuple(self._own), strict=True)
        wanted = type(setup)(*(given or own for given, own in values))
        if not self._allowed(wanted):
            return Result.OUT_OF_RANGE
        self._setup = setup
        self._use(wanted)
        return Result.OK

    def _use(self, values: SetupT) -> None:
        """Put values in force; commands so far were judged by other ones."""
        self._in_force = values
        self._commands_in_row = 0
        self._put_in_force()

    @property
    def _supply_wrong(self) -> bool:
        low, high = self._in_force.supply_low, self._in_force.supply_high
        return high > 0 and not low <= to_u16(self._measured.supply / VOLTAGE_UNIT) <= high

    # ---- parts of state frames ----

    def _mark(self, fault: Fault, *, is_set: bool) -> None:
        """Set or clear a fault that does not latch."""
        self.faults = self.faults | fault if is_set else self.faults & ~fault

    def _limited(self, now_us: int) -> bool:
        age = self.command_age(now_us)
        return self._command_limited and age is not None and age < _WATCHDOG_US

    def _state_flags(self, now_us: int) -> int:
        return (
            (StateFlag.ENABLED if self._enabled else 0)
            | (StateFlag.ESTOP_PRESSED if self._estop_pressed else 0)
            | (StateFlag.LIMITED if self._limited(now_us) else 0)
            | (StateFlag.SET_UP if self._setup is not None else 0)
            | (StateFlag.HOLDING if self._holds else 0)
        )

    def _age_ticks(self, now_us: int) -> int:
        age = self.command_age(now_us)
        return MAX_COMMAND_AGE if age is None else min(age // _TICK_US, MAX_COMMAND_AGE)


def clamp(value: int, low: int, high: int) -> int:
    """Limit a value to a range.

    Parameters
    ----------
    value : int
        Any value.
    low, high : int
        Smallest and largest value that are returned.
    """
    return min(max(value, low), high)


def in_order(low: int, high: int) -> bool:
    """Whether two thresholds are in order, or both 0: not used.

    Parameters
    ----------
    low, high : int
        Lower and upper threshold.
    """
    return low < high or low == high == 0


def to_i16(value: float) -> int:
    """Round a value and limit it to i16.

    Parameters
    ----------
    value : float
        Any value.
    """
    return clamp(round(value), -(1 << 15), (1 << 15) - 1)


def to_u16(value: float) -> int:
    """Round a value and limit it to u16.

    Parameters
    ----------
    value : float
        Any value.
    """
    return clamp(round(value), 0, _U16)
