"""The emulated drive PLC (`drive.c` in C): a slewed, limited speed set-point, gear and brake."""

from __future__ import annotations

from dataclasses import dataclass

from tricycle_bridge.protocol.boards import (
    AT_REST,
    DRIVE_SUPPLY,
    HALL_PULSE,
    HALL_PULSES,
    LINE_HIGH,
    LINE_LOW,
    LINE_RESTING,
    LINE_TICKS,
    MASS_HIGH,
    MASS_LOW,
    MASSES,
    MAX_THROTTLE,
    OVERSHOOT,
    OVERSHOOT_TIME,
    OVERSPEED_MARGIN,
    RUNAWAY_MARGIN,
    STOPPING_BRAKE_RATE,
    STOPPING_DECELERATION,
    STOPPING_EXCESS,
    STOPPING_TIME,
    TYRE_RADII,
    TYRE_RADIUS,
)
from tricycle_bridge.protocol.limits import (
    ARMING_SPEED,
    MAX_ACCELERATION,
    MAX_POWER,
    MAX_REGENERATIVE_TORQUE,
    MAX_SPEED,
    MAX_TORQUE,
    STALE_TICKS,
    WATCHDOG,
)
from tricycle_bridge.protocol.messages import (
    Board,
    DriveCommand,
    DriveLimits,
    DriveSetup,
    DriveState,
    Fault,
    Gear,
    PlcState,
)
from tricycle_bridge.protocol.units import (
    BRAKE_UNIT,
    LENGTH_UNIT,
    MASS_UNIT,
    SPEED_UNIT,
    TORQUE_UNIT,
    TRAVEL_UNIT,
    VOLTAGE_UNIT,
)
from tricycle_core.timing import TICK
from tricycle_sim.plc.plc import Plc, clamp, in_order, to_i16, to_u16
from tricycle_sim.plc.wheel import WheelCheck
from tricycle_sim.setpoints import slew

_STOPPING_US = round(STOPPING_TIME * 1e6)
_SIGNS = {Gear.DRIVE: 1, Gear.REVERSE: -1, Gear.NEUTRAL: 0}


@dataclass(frozen=True)
class DriveMeasurement:
    """Inputs of the drive PLC.

    Attributes
    ----------
    speed : float
        Speed at the rear wheel's tread in m/s, forward positive.
    hall_count : int
        Hall pulses; forward counts up.
    torque : float
        Torque of the motor in the last tick in N m.
    hall_line, direction_line : float
        Voltages of the hall sensor's lines in V.
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
    hall_line: float = LINE_RESTING[0]
    direction_line: float = LINE_RESTING[1]
    current: float = 0.0
    supply: float = DRIVE_SUPPLY
    estop_pressed: bool = False


@dataclass(frozen=True)
class DriveOutput:
    """Outputs of the drive PLC to the rear wheel.

    Attributes
    ----------
    motor_on : bool
        Whether the motor makes torque.
    setpoint : float
        Slewed and limited speed in m/s, forward positive.
    brake : float
        Brake command, 0 (released) to 1 (full).
    """

    motor_on: bool
    setpoint: float
    brake: float


class DrivePlc(Plc[DriveMeasurement, DriveOutput, DriveCommand, DriveSetup]):
    """The drive PLC: a slewed, limited speed set-point, gear and brake."""

    board = Board.DRIVE
    _own = DriveSetup(
        max_speed=round(MAX_SPEED / SPEED_UNIT),
        max_acceleration=round(MAX_ACCELERATION / SPEED_UNIT),
        pulse=round(HALL_PULSE / TRAVEL_UNIT),
        tyre_radius=round(TYRE_RADIUS / LENGTH_UNIT),
        torque=round(MAX_TORQUE / TORQUE_UNIT),
        regenerative_torque=round(MAX_REGENERATIVE_TORQUE / TORQUE_UNIT),
        power=round(MAX_POWER),
        mass_low=round(MASS_LOW / MASS_UNIT),
        mass_high=round(MASS_HIGH / MASS_UNIT),
        supply_low=0,
        supply_high=0,
        throttle_low=0,
        throttle_high=0,
    )

    def _reset_board(self) -> None:
        self._measured = DriveMeasurement()
        self._target = 0.0  # m/s, not negative, as commanded
        self._acceleration_limit = 0.0  # m/s^2
        self._commanded_gear = Gear.NEUTRAL
        self._commanded_brake = 0.0
        self._gear = Gear.NEUTRAL
        self._brake = 1.0
        self._setpoint = 0.0  # m/s, forward positive
        self._braking = False  # armed, from a command with a brake on until rest
        self._holding = False  # armed and at rest: brake full, motor off
        self._ceiling = 0.0  # m/s, of a motor that holds the vehicle
        self._lagging = 0.0  # m/s, measured speed behind a lag
        self._line_ticks = 0  # in a row in which a hall line was outside of its bands
        self._hall_count = 0  # of the last tick
        self._pulses = 0  # since then
        self._resting = False  # the brake holds a wheel that may still turn, unseen

    def _put_in_force(self) -> None:
        force = self._in_force
        self._max_speed = force.max_speed * SPEED_UNIT
        self._max_acceleration = force.max_acceleration * SPEED_UNIT
        self._wheel = WheelCheck(
            force.pulse * TRAVEL_UNIT,
            force.tyre_radius * LENGTH_UNIT,
            force.mass_low * MASS_UNIT,
            force.mass_high * MASS_UNIT,
        )

    def _allowed(self, setup: DriveSetup) -> bool:
        own = self._own
        return (
            setup.max_speed <= own.max_speed
            and setup.max_acceleration <= own.max_acceleration
            and _within(setup.pulse * TRAVEL_UNIT, HALL_PULSES)
            and _within(setup.tyre_radius * LENGTH_UNIT, TYRE_RADII)
            and setup.torque <= own.torque
            and setup.regenerative_torque <= own.regenerative_torque
            and setup.power <= own.power
            and _within(setup.mass_low * MASS_UNIT, MASSES)
            and _within(setup.mass_high * MASS_UNIT, MASSES)
            and setup.mass_low <= setup.mass_high
            and in_order(setup.supply_low, setup.supply_high)
            and in_order(setup.throttle_low, setup.throttle_high)
            and setup.throttle_high <= round(MAX_THROTTLE / VOLTAGE_UNIT)
        )

    @property
    def pulse(self) -> float:
        """Travel per hall pulse that the board counts with [m]."""
        return round(self._in_force.pulse * TRAVEL_UNIT, 6)

    @property
    def _at_rest(self) -> bool:
        return abs(self._measured.speed) < AT_REST

    def _begin_tick(self, now_us: int) -> None:  # noqa: ARG002 - only the steer PLC uses the time
        lines = self._measured.hall_line, self._measured.direction_line
        whole = all(_within(line, LINE_LOW) or _within(line, LINE_HIGH) for line in lines)
        self._line_ticks = 0 if whole else self._line_ticks + 1
        if self._line_broken:
            self.faults |= Fault.HALL_LINE
        count = self._measured.hall_count
        self._pulses, self._hall_count = count - self._hall_count, count
        if not self._pushes:
            self._wheel.rest(self._pulses)
        self._resting = not (self._pushes or self._wheel.rests)

    @property
    def _line_broken(self) -> bool:
        return self._line_ticks >= LINE_TICKS

    def _find_fault(self, now_us: int) -> Fault:
        if self._line_broken:
            return Fault.HALL_LINE
        if abs(self._measured.speed) > self._max_speed + OVERSPEED_MARGIN + 1e-9:
            return Fault.OVERSPEED
        if self._wheel_fails():
            return Fault.PULSES
        if self.state is PlcState.ARMED and self._runs_away():
            return Fault.OVERSPEED
        late = now_us - self._state_since >= _STOPPING_US
        if self.state is PlcState.STOPPING and late and not self._stopped():
            return Fault.STOP_TIMEOUT
        return Fault(0)

    def _runs_away(self) -> bool:
        """Whether the vehicle gains speed above what is wanted although the motor brakes.

        A set-point may fall faster than the vehicle, which is then above it but does not gain. A
        controller overshoots by a third of a second of the acceleration with which it arrives:
        a slope alone does not give more than `OVERSHOOT`.
        """
        speed = abs(self._measured.speed)
        pushes = _SIGNS[self._gear] * self._measured.torque > 0.0
        wanted = max(abs(self._setpoint), abs(self._target_in_gear))
        overshoot = max(OVERSHOOT, speed - self._lagging)
        self._lagging += (speed - self._lagging) * TICK / OVERSHOOT_TIME
        pushed = wanted + overshoot if pushes else wanted
        self._ceiling = max(wanted, min(speed, max(pushed, self._ceiling)))
        return speed > self._ceiling + RUNAWAY_MARGIN + 1e-9

    def _wheel_fails(self) -> bool:
        """Whether torque and pulses of the last tick do not fit together."""
        if not self._pushes:
            return False
        sign = _SIGNS[self._gear]
        return self._wheel.fails(
            sign * self._measured.torque,
            sign * self._pulses,
            sign * self._measured.speed,
            sign * self._setpoint,
        )

    def _stopped(self) -> bool:
        return self._at_rest and self._setpoint == 0.0

    def _ready(self) -> bool:
        return self._target == 0.0 and abs(self._measured.speed) < ARMING_SPEED

    def _armed(self) -> None:
        self._setpoint = 0.0
        self._ceiling = self._lagging = 0.0
        self._braking = self._holding = False

    def _left_armed(self, now_us: int) -> None:  # noqa: ARG002 - only the steer PLC uses the time
        self._braking = self._holding = False
        self._begin_at_speed()

    def _begin_at_speed(self) -> None:
        """Let a stop not push: it goes on from the speed, where that is less than wanted."""
        low, high = min(self._setpoint, 0.0), max(self._setpoint, 0.0)
        self._setpoint = min(max(self._measured.speed, low), high)

    @property
    def _holds(self) -> bool:
        return self._holding

    def _take_command(self, command: DriveCommand) -> bool:
        speed = command.speed * SPEED_UNIT
        acceleration = command.max_acceleration * SPEED_UNIT or self._max_acceleration
        self._target = min(max(speed, 0.0), self._max_speed)
        self._acceleration_limit = min(acceleration, self._max_acceleration)
        self._commanded_brake = min(command.brake * BRAKE_UNIT, 1.0)
        known_gear = command.gear in (Gear.NEUTRAL, Gear.DRIVE, Gear.REVERSE)
        self._commanded_gear = Gear(command.gear) if known_gear else Gear.NEUTRAL
        return (
            self._target != speed
            or self._acceleration_limit != acceleration
            or self._commanded_brake != command.brake * BRAKE_UNIT
            or not known_gear
        )

    def _control(self) -> DriveOutput:
        if self.state is PlcState.ARMED:
            self._follow_command()
        elif self.state is PlcState.STOPPING:
            self._stop(self._max_acceleration)
        else:
            self._setpoint, self._brake, self._gear = 0.0, 1.0, Gear.NEUTRAL
        return DriveOutput(self._motor_on, self._setpoint, self._brake)

    def _stop(self, deceleration: float) -> None:
        """Ramp down; the brake joins where the vehicle cannot follow, or the ramp is over."""
        self._setpoint = slew(self._setpoint, 0.0, max(deceleration, STOPPING_DECELERATION))
        excess = abs(self._measured.speed - self._setpoint)
        if self._setpoint == 0.0 or excess > STOPPING_EXCESS:
            self._brake = min(self._brake + STOPPING_BRAKE_RATE, 1.0)

    def _follow_command(self) -> None:
        """Follow the command, and hold where that is to stand.

        A commanded brake stops the vehicle without the motor: against a brake, torque and pulses
        cannot be compared, and the comparison begins at rest.
        """
        at_rest = self._at_rest and self._setpoint == 0.0
        self._braking = self._commanded_brake > 0.0 or (self._braking and not at_rest)
        if self._commanded_gear != self._gear and at_rest and self._wheel.rests:
            self._gear = self._commanded_gear
            self._wheel.restart()
        target = self._target_in_gear
        self._holding = target == 0.0 and (at_rest or self._holding)
        if self._holding or not self._braking:
            self._setpoint = slew(self._setpoint, target, self._acceleration_limit)
            self._brake = 1.0 if self._holding else 0.0
        else:
            self._begin_at_speed()
            self._stop(self._acceleration_limit)
            self._brake = max(self._brake, self._commanded_brake)

    @property
    def _target_in_gear(self) -> float:
        in_gear = self._gear == self._commanded_gear
        stands = self._braking or self._resting or not in_gear
        return 0.0 if stands else _SIGNS[self._gear] * self._target

    @property
    def _pushes(self) -> bool:
        """Whether the motor alone acts on the wheel."""
        return self._motor_on and self._brake == 0.0

    @property
    def _motor_on(self) -> bool:
        on = self.state in (PlcState.ARMED, PlcState.STOPPING)
        return on and self._gear is not Gear.NEUTRAL and not (self._holding or self._braking)

    def _state_frame(self, now_us: int) -> DriveState:
        return DriveState(
            now_us & 0xFFFFFFFF,
            self.state,
            self._state_flags(now_us),
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
            **vars(self._in_force), watchdog=round(WATCHDOG * 1e3), stale=STALE_TICKS
        )


def _within(value: float, bounds: tuple[float, float]) -> bool:
    low, high = bounds
    return low - 1e-9 <= value <= high + 1e-9
