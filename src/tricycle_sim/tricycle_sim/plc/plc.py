"""The two PLCs, emulated: bytes, measurements and PLC time in; bytes and actuator outputs out.

No port, no thread and no clock inside. Every 10 ms of PLC time the owner calls

1. ``answer = plc.receive(bytes_from_the_line, now_us)``, as often as bytes arrive, then
2. ``telemetry, output = plc.tick(now_us, measurement)`` once,

writes both answers to the line and hands the output to the vehicle. Section numbers are those of
the protocol's specification (docs/link.md).
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Generic, TypeVar, cast

from tricycle_bridge.protocol.framing import Frame, FrameDecoder, encode
from tricycle_bridge.protocol.messages import (
    ANGLE_UNIT,
    ARMING_COMMANDS,
    BRAKE_UNIT,
    MAJOR,
    MAX_ACCELERATION,
    MAX_SPEED,
    MAX_STEERING_ANGLE,
    MAX_STEERING_RATE,
    MINOR,
    SPEED_UNIT,
    STALE_TICKS,
    STEER_RATE_UNIT,
    WATCHDOG,
    Ack,
    Board,
    Capability,
    CommandFlag,
    Control,
    DriveCommand,
    DriveLimits,
    DriveState,
    Event,
    EventCode,
    Fault,
    Gear,
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
    SteerLimits,
    SteerState,
    echo_of,
)
from tricycle_core.quantities import TICK
from tricycle_sim.setpoints import slew

HALL_PULSE = 0.015253  # m of travel per hall pulse: 23 pole pairs x 6 edges on a 0.335 m wheel
ADC_CENTRE = 512  # counts at 0 rad
ADC_SCALE = 435  # counts per rad of the steering motor
SERVO_CENTRE = 1500  # us pulse at 0 rad
SERVO_SCALE = 500 / MAX_STEERING_ANGLE  # us per rad

_WATCHDOG_US = round(WATCHDOG * 1e6)
_TICK_US = round(TICK * 1e6)
_STOPPING_US = 1_000_000  # steer: the angle is held this long
_TRACKING_ERROR = 0.15  # rad
_TRACKING_US = 1_000_000
_ADC_LOW, _ADC_HIGH = 5, 1018  # outside: broken wire
_AT_REST = 0.02  # m/s: what counts as measured speed 0
_STALL_SPEED = 0.3  # m/s of set-point at which a wheel that does not move is stalled ...
_STALL_US = 2_000_000  # ... for so long
_OVERSPEED = 1.1 * MAX_SPEED  # m/s
_MAX_TORQUE = 35.0  # N m at 1000 per mille PWM
_U16, _U32 = 0xFFFF, 0xFFFFFFFF


@dataclass(frozen=True)
class SteerMeasurement:
    """What the steer PLC's inputs see."""

    angle: float = 0.0  # rad, steering motor, left positive
    rate: float = 0.0  # rad/s
    supply: float = 12.0  # V, of the servo
    estop_pressed: bool = False  # hardware e-stop
    adc: int | None = None  # counts of the potentiometer; None: from the angle


@dataclass(frozen=True)
class DriveMeasurement:
    """What the drive PLC's inputs see."""

    speed: float = 0.0  # m/s at the rear wheel's tread, forward positive
    hall_count: int = 0  # pulses, forward counts up, HALL_PULSE each
    torque: float = 0.0  # N m, of the motor
    current: float = 0.0  # A, from the supply
    supply: float = 48.0  # V
    estop_pressed: bool = False  # hardware e-stop


@dataclass(frozen=True)
class SteerOutput:
    """What the steer PLC does to the steering."""

    servo_on: bool  # off: no pulse, the servo does not hold
    setpoint: float  # rad, steering motor, slewed and limited; the measured angle while off


@dataclass(frozen=True)
class DriveOutput:
    """What the drive PLC does to the rear wheel."""

    motor_on: bool  # off: no torque
    setpoint: float  # m/s, forward positive, slewed and limited
    brake: float  # 0..1


MeasurementT = TypeVar("MeasurementT", SteerMeasurement, DriveMeasurement)
OutputT = TypeVar("OutputT", SteerOutput, DriveOutput)
CommandT = TypeVar("CommandT", SteerCommand, DriveCommand)


class Plc(ABC, Generic[MeasurementT, OutputT, CommandT]):
    """What both PLCs share: framing, session, state machine, watchdog, counters.

    Parameters
    ----------
    boot_count
        As kept in EEPROM: boots before this one.
    firmware
        Version that HELLO_ACK tells.
    major, minor
        Protocol version of the emulated firmware, to emulate another one than this suite's.
    """

    board: ClassVar[Board]

    def __init__(
        self,
        *,
        boot_count: int = 0,
        firmware: tuple[int, int, int] = (1, 0, 0),
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
        self._last_rx_seq: int | None = None
        self._command_seq = 0
        self._command_at: int | None = None  # us, of the last accepted command
        self._commands_in_row = 0  # with enable = 1
        self._enabled = False  # flag of the last accepted command
        self._limited = False
        self._estop_pressed = False
        self._state_since = 0  # us
        self._transmit: list[bytes] = []
        self._reset_board()

    @property
    def session(self) -> int:
        """Session given by the host; 0 = none."""
        return self._decoder.session

    def command_age(self, now_us: int) -> int | None:
        """Time in us since a command was last accepted; None before the first one."""
        return None if self._command_at is None else now_us - self._command_at

    def receive(self, data: bytes, now_us: int) -> bytes:
        """Take bytes from the host at PLC time `now_us`; return the answers."""
        for frame in self._decoder.feed(data):
            if self.state is not PlcState.BOOT:
                self._handle(frame, now_us)
        return self._take_bytes()

    def tick(self, now_us: int, measurement: MeasurementT) -> tuple[bytes, OutputT]:
        """Run one 10 ms control tick; return events and the state frame, and the outputs."""
        self._estop_pressed = measurement.estop_pressed
        self._measure(measurement)
        if self.state is PlcState.BOOT:
            self._enter(PlcState.SAFE, now_us, code=EventCode.BOOT)
        if self._estop_pressed:
            self._estop(Fault.ESTOP_HW, now_us)
        self._check_watchdog(now_us)
        if self.state is PlcState.ARMED and (fault := self._find_fault(now_us)):
            self.faults |= fault
            self._enter(PlcState.FAULT, now_us)
        if self.state is PlcState.STOPPING and self._stopped(now_us):
            self._enter(PlcState.SAFE, now_us)
        output = self._control()
        if self._limited:
            self.faults |= Fault.LIMIT
        else:
            self.faults &= ~Fault.LIMIT
        self._send(self._state_frame(now_us))
        return self._take_bytes(), output

    def drop_sent(self, frames: int) -> None:
        """Count frames that the line did not take (STATS tx_drop)."""
        self._count(tx_drop=frames)

    # ---- what differs between the boards ----

    @abstractmethod
    def _reset_board(self) -> None:
        """Forget the board's own state."""

    @abstractmethod
    def _measure(self, measurement: MeasurementT) -> None:
        """Keep the inputs of this tick."""

    @abstractmethod
    def _find_fault(self, now_us: int) -> Fault:
        """Sensor, tracking, stall or overspeed faults of an armed board."""

    @abstractmethod
    def _stopped(self, now_us: int) -> bool:
        """Whether STOPPING is over."""

    @abstractmethod
    def _ready(self) -> bool:
        """Preconditions of ARM that only this board has."""

    @abstractmethod
    def _armed(self) -> None:
        """Prepare the set-point when arming."""

    @abstractmethod
    def _take_command(self, command: CommandT) -> CommandFlag:
        """Keep a command's set-point; return its flags."""

    @abstractmethod
    def _control(self) -> OutputT:
        """Advance the set-point by one tick; `_limited` tells whether a limit acted."""

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
                self._send(Ack(message.op, frame.seq, result, self.state))
            case Ping():
                self._send(Pong(message.token, now_us & _U32, now_us & _U32))
            case LimitsRequest():
                self._send(self._limits_frame())
            case StatsRequest():
                self._send(self._stats_frame())

    def _greet(self, frame: Frame, hello: Hello, now_us: int) -> None:
        if hello.board not in (self.board, Board.ANY):
            return  # section 3.2: stay silent
        if self.state in (PlcState.ARMED, PlcState.STOPPING):
            self._enter(PlcState.SAFE, now_us)
        self._decoder.session = frame.session
        self._last_rx_seq = frame.seq
        self._command_at = None
        self._commands_in_row = 0
        self._send(
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
        if (echo_of(now_us) - command.echo) & _U16 > STALE_TICKS:
            self._count(stale=1)
            self._commands_in_row = 0
            return
        flags = self._take_command(command)
        self._command_seq = seq
        self._command_at = now_us
        self._enabled = bool(flags & CommandFlag.ENABLE)
        self._commands_in_row = self._commands_in_row + 1 if self._enabled else 0
        if flags & CommandFlag.ESTOP:
            self._estop(Fault.ESTOP_HOST, now_us)
        elif self.state is PlcState.ARMED and not self._enabled:
            self._enter(PlcState.STOPPING, now_us)

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
        self._send(Event(now_us & _U32, code, old << 4 | state, self.faults))

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
        match control.op:
            case Op.ESTOP:
                self._estop(Fault.ESTOP_HOST, now_us)
                return Result.OK
            case Op.DISARM:
                if self.state in (PlcState.ARMED, PlcState.STOPPING):
                    self._enter(PlcState.SAFE, now_us)
                return Result.OK
            case Op.CLEAR:
                return self._clear(now_us)
            case Op.ARM:
                return self._arm(now_us)
            case _:
                return Result.UNKNOWN_OP

    def _clear(self, now_us: int) -> Result:
        if self.state in (PlcState.ARMED, PlcState.STOPPING):
            return Result.WRONG_STATE
        if self._estop_pressed:
            return Result.PRECONDITIONS
        self.faults = Fault(0)
        if self.state is not PlcState.SAFE:
            self._enter(PlcState.SAFE, now_us)
        return Result.OK

    def _arm(self, now_us: int) -> Result:
        if self.state is PlcState.ARMED:
            return Result.OK
        if self.state is not PlcState.SAFE or self.faults & ~Fault.LIMIT:
            return Result.WRONG_STATE
        age = self.command_age(now_us)
        if (
            self._commands_in_row < ARMING_COMMANDS
            or age is None
            or age > _WATCHDOG_US
            or not self._ready()
        ):
            return Result.PRECONDITIONS
        self._armed()
        self._enter(PlcState.ARMED, now_us)
        return Result.OK

    # ---- parts of state frames ----

    def _state_flags(self) -> int:
        return (
            (StateFlag.ENABLED if self._enabled else 0)
            | (StateFlag.ESTOP_PRESSED if self._estop_pressed else 0)
            | (StateFlag.LIMITED if self._limited else 0)
        )

    def _age_ticks(self, now_us: int) -> int:
        age = self.command_age(now_us)
        return 255 if age is None else min(age // _TICK_US, 255)


class SteerPlc(Plc[SteerMeasurement, SteerOutput, SteerCommand]):
    """The steer PLC: a slewed, limited set-point for the steering servo."""

    board = Board.STEER

    def _reset_board(self) -> None:
        self._measured = SteerMeasurement()
        self._target = 0.0  # rad, as commanded
        self._rate_limit = MAX_STEERING_RATE  # rad/s
        self._command_limited = False
        self._setpoint = 0.0  # rad
        self._tracking_since: int | None = None  # us

    def _measure(self, measurement: SteerMeasurement) -> None:
        self._measured = measurement

    def _adc(self) -> int:
        if self._measured.adc is not None:
            return self._measured.adc
        return _limit(round(ADC_CENTRE + ADC_SCALE * self._measured.angle), 0, 1023)

    def _find_fault(self, now_us: int) -> Fault:
        if not _ADC_LOW <= self._adc() <= _ADC_HIGH:
            return Fault.SENSOR
        if abs(self._setpoint - self._measured.angle) <= _TRACKING_ERROR:
            self._tracking_since = None
        elif self._tracking_since is None:
            self._tracking_since = now_us
        elif now_us - self._tracking_since >= _TRACKING_US:
            return Fault.TRACKING
        return Fault(0)

    def _stopped(self, now_us: int) -> bool:
        return now_us - self._state_since >= _STOPPING_US

    def _ready(self) -> bool:
        return True

    def _armed(self) -> None:
        self._setpoint = self._measured.angle
        self._tracking_since = None

    def _take_command(self, command: SteerCommand) -> CommandFlag:
        angle = command.angle * ANGLE_UNIT
        rate = command.max_rate * STEER_RATE_UNIT or MAX_STEERING_RATE
        self._target = min(max(angle, -MAX_STEERING_ANGLE), MAX_STEERING_ANGLE)
        self._rate_limit = min(rate, MAX_STEERING_RATE)
        self._command_limited = self._target != angle or self._rate_limit != rate
        return CommandFlag(command.flags & 3)

    def _control(self) -> SteerOutput:
        servo_on = self.state in (PlcState.ARMED, PlcState.STOPPING)
        self._limited = self._command_limited and self.state is PlcState.ARMED
        if self.state is PlcState.ARMED:
            self._setpoint = slew(self._setpoint, self._target, self._rate_limit)
        elif not servo_on:
            self._setpoint = self._measured.angle
        return SteerOutput(servo_on, self._setpoint)

    def _state_frame(self, now_us: int) -> SteerState:
        on = self.state in (PlcState.ARMED, PlcState.STOPPING)
        return SteerState(
            now_us & _U32,
            self.state,
            self._state_flags(),
            self.faults,
            _i16(self._measured.angle / ANGLE_UNIT),
            _i16(self._setpoint / ANGLE_UNIT),
            _i16(self._measured.rate / STEER_RATE_UNIT),
            round(SERVO_CENTRE + SERVO_SCALE * self._setpoint) if on else 0,
            self._adc(),
            _limit(round(self._measured.supply * 1e3), 0, _U16),
            self._command_seq,
            self._age_ticks(now_us),
        )

    def _limits_frame(self) -> SteerLimits:
        angle = round(MAX_STEERING_ANGLE / ANGLE_UNIT)
        return SteerLimits(
            -angle,
            angle,
            round(MAX_STEERING_RATE / STEER_RATE_UNIT),
            round(WATCHDOG * 1e3),
            STALE_TICKS,
            ADC_SCALE,
            0,
            0,
        )


class DrivePlc(Plc[DriveMeasurement, DriveOutput, DriveCommand]):
    """The drive PLC: a slewed, limited speed set-point, gear and brake."""

    board = Board.DRIVE

    def _reset_board(self) -> None:
        self._measured = DriveMeasurement()
        self._target = 0.0  # m/s, not negative, as commanded
        self._acceleration_limit = MAX_ACCELERATION  # m/s^2
        self._commanded_gear = Gear.NEUTRAL
        self._commanded_brake = 0.0
        self._command_limited = False
        self._gear = Gear.NEUTRAL
        self._brake = 1.0
        self._setpoint = 0.0  # m/s, forward positive
        self._stalled_since: int | None = None  # us

    def _measure(self, measurement: DriveMeasurement) -> None:
        self._measured = measurement

    @property
    def _at_rest(self) -> bool:
        return abs(self._measured.speed) < _AT_REST

    def _find_fault(self, now_us: int) -> Fault:
        if abs(self._measured.speed) > _OVERSPEED:
            return Fault.OVERSPEED
        if not (self._at_rest and abs(self._setpoint) > _STALL_SPEED):
            self._stalled_since = None
        elif self._stalled_since is None:
            self._stalled_since = now_us
        elif now_us - self._stalled_since >= _STALL_US:
            return Fault.STALL
        return Fault(0)

    def _stopped(self, now_us: int) -> bool:  # noqa: ARG002 - the steering's takes its time
        return self._at_rest and self._setpoint == 0.0

    def _ready(self) -> bool:
        return self._target == 0.0

    def _armed(self) -> None:
        self._setpoint = 0.0
        self._stalled_since = None

    def _take_command(self, command: DriveCommand) -> CommandFlag:
        speed = command.speed * SPEED_UNIT
        acceleration = command.max_acceleration * SPEED_UNIT or MAX_ACCELERATION
        self._target = min(max(speed, 0.0), MAX_SPEED)
        self._acceleration_limit = min(acceleration, MAX_ACCELERATION)
        self._commanded_brake = min(command.brake * BRAKE_UNIT, 1.0)
        known_gear = command.gear in (Gear.NEUTRAL, Gear.DRIVE, Gear.REVERSE)
        self._commanded_gear = Gear(command.gear) if known_gear else Gear.NEUTRAL
        self._command_limited = (
            self._target != speed
            or self._acceleration_limit != acceleration
            or self._commanded_brake != command.brake * BRAKE_UNIT
            or not known_gear
        )
        return CommandFlag(command.flags & 3)

    def _control(self) -> DriveOutput:
        self._limited = self._command_limited and self.state is PlcState.ARMED
        if self.state is PlcState.ARMED:
            self._brake = self._commanded_brake
            if self._commanded_gear != self._gear and self._at_rest and self._setpoint == 0.0:
                self._gear = self._commanded_gear
            sign = {Gear.DRIVE: 1.0, Gear.REVERSE: -1.0, Gear.NEUTRAL: 0.0}[self._gear]
            target = sign * self._target if self._gear == self._commanded_gear else 0.0
            self._setpoint = slew(self._setpoint, target, self._acceleration_limit)
        elif self.state is PlcState.STOPPING:
            self._setpoint = slew(self._setpoint, 0.0, MAX_ACCELERATION)
        else:
            self._setpoint, self._brake, self._gear = 0.0, 1.0, Gear.NEUTRAL
        return DriveOutput(self._motor_on, self._setpoint, self._brake)

    @property
    def _motor_on(self) -> bool:
        return self.state in (PlcState.ARMED, PlcState.STOPPING) and self._gear is not Gear.NEUTRAL

    def _state_frame(self, now_us: int) -> DriveState:
        return DriveState(
            now_us & _U32,
            self.state,
            self._state_flags(),
            self.faults,
            _i16(self._measured.speed / SPEED_UNIT),
            _i16(self._setpoint / SPEED_UNIT),
            _limit(self._measured.hall_count, -(1 << 31), (1 << 31) - 1),
            _limit(round(self._measured.torque / _MAX_TORQUE * 1000), -1000, 1000)
            if self._motor_on
            else 0,
            _limit(round(self._measured.current * 1e3), 0, _U16),
            _limit(round(self._measured.supply * 1e3), 0, _U16),
            self._gear,
            round(self._brake / BRAKE_UNIT),
            self._command_seq,
            self._age_ticks(now_us),
        )

    def _limits_frame(self) -> DriveLimits:
        return DriveLimits(
            0,
            round(MAX_SPEED / SPEED_UNIT),
            round(MAX_ACCELERATION / SPEED_UNIT),
            round(WATCHDOG * 1e3),
            STALE_TICKS,
            round(HALL_PULSE * 1e6),
            0,
            0,
        )


def _limit(value: int, low: int, high: int) -> int:
    return min(max(value, low), high)


def _i16(value: float) -> int:
    return _limit(round(value), -(1 << 15), (1 << 15) - 1)
