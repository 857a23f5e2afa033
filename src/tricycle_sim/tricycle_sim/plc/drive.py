"""The emulated drive PLC (`drive.c` in C): a slewed, limited speed set-point, gear and brake."""

from __future__ import annotations

from dataclasses import dataclass

from tricycle_bridge.protocol.boards import (
    AT_REST,
    DRIVE_SUPPLY,
    HALL_PULSE,
    MAX_TORQUE,
    OVERSPEED,
    STALL_SPEED,
    STALL_TIME,
)
from tricycle_bridge.protocol.limits import MAX_ACCELERATION, MAX_SPEED, STALE_TICKS, WATCHDOG
from tricycle_bridge.protocol.messages import (
    BRAKE_UNIT,
    SPEED_UNIT,
    Board,
    CommandFlag,
    DriveCommand,
    DriveLimits,
    DriveState,
    Fault,
    Gear,
    PlcState,
)
from tricycle_sim.plc.plc import Plc, clamp, to_i16, to_u16
from tricycle_sim.setpoints import slew

_STALL_US = round(STALL_TIME * 1e6)


@dataclass(frozen=True)
class DriveMeasurement:
    """What the drive PLC's inputs see.

    Attributes
    ----------
    speed : float
        Speed at the rear wheel's tread in m/s, forward positive.
    hall_count : int
        Hall pulses, `HALL_PULSE` of travel each; forward counts up.
    torque : float
        Torque of the motor in N m.
    current : float
        Current from the supply in A.
    supply : float
        Voltage of the battery in V.
    estop_pressed : bool
        Whether the hardware e-stop is pressed.
    """

    speed: float = 0.0
    hall_count: int = 0
    torque: float = 0.0
    current: float = 0.0
    supply: float = DRIVE_SUPPLY
    estop_pressed: bool = False


@dataclass(frozen=True)
class DriveOutput:
    """What the drive PLC does to the rear wheel.

    Attributes
    ----------
    motor_on : bool
        Whether the motor makes torque.
    setpoint : float
        Slewed and limited speed in m/s, forward positive.
    brake : float
        0 (released) to 1 (full).
    """

    motor_on: bool
    setpoint: float
    brake: float


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

    @property
    def _at_rest(self) -> bool:
        return abs(self._measured.speed) < AT_REST

    def _find_fault(self, now_us: int) -> Fault:
        if abs(self._measured.speed) > OVERSPEED:
            return Fault.OVERSPEED
        if not (self._at_rest and abs(self._setpoint) > STALL_SPEED):
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
            now_us & 0xFFFFFFFF,
            self.state,
            self._state_flags(),
            self.faults,
            to_i16(self._measured.speed / SPEED_UNIT),
            to_i16(self._setpoint / SPEED_UNIT),
            clamp(self._measured.hall_count, -(1 << 31), (1 << 31) - 1),
            clamp(round(self._measured.torque / MAX_TORQUE * 1000), -1000, 1000)
            if self._motor_on
            else 0,
            to_u16(self._measured.current * 1e3),
            to_u16(self._measured.supply * 1e3),
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
