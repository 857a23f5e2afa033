"""The emulated steer PLC (`steer.c` in C): a slewed, limited set-point for the steering servo."""

from __future__ import annotations

from dataclasses import dataclass

from tricycle_bridge.protocol.boards import (
    ADC_CENTRE,
    ADC_HIGH,
    ADC_LOW,
    ADC_SCALE,
    HOLDING_TIME,
    SERVO_CENTRE,
    SERVO_SPAN,
    STEER_SUPPLY,
    TRACKING_ERROR,
    TRACKING_TIME,
)
from tricycle_bridge.protocol.limits import (
    MAX_STEERING_ANGLE,
    MAX_STEERING_RATE,
    STALE_TICKS,
    WATCHDOG,
)
from tricycle_bridge.protocol.messages import (
    ANGLE_UNIT,
    STEER_RATE_UNIT,
    Board,
    CommandFlag,
    Fault,
    PlcState,
    SteerCommand,
    SteerLimits,
    SteerState,
)
from tricycle_sim.plc.plc import Plc, clamp, to_i16, to_u16
from tricycle_sim.setpoints import slew

_HOLDING_US = round(HOLDING_TIME * 1e6)
_TRACKING_US = round(TRACKING_TIME * 1e6)


@dataclass(frozen=True)
class SteerMeasurement:
    """What the steer PLC's inputs see.

    Attributes
    ----------
    angle : float
        Angle of the steering motor in rad, left positive.
    rate : float
        Its rate in rad/s.
    supply : float
        Voltage of the servo's supply in V.
    estop_pressed : bool
        Whether the hardware e-stop is pressed.
    adc : int or None
        Counts of the potentiometer; None: those of `angle`.
    """

    angle: float = 0.0
    rate: float = 0.0
    supply: float = STEER_SUPPLY
    estop_pressed: bool = False
    adc: int | None = None

    @property
    def counts(self) -> int:
        """Counts of the potentiometer, 0..1023."""
        if self.adc is not None:
            return self.adc
        return clamp(round(ADC_CENTRE + ADC_SCALE * self.angle), 0, 1023)


@dataclass(frozen=True)
class SteerOutput:
    """What the steer PLC does to the steering.

    Attributes
    ----------
    servo_on : bool
        Whether the servo gets pulses; without them it does not hold.
    setpoint : float
        Slewed and limited angle of the steering motor in rad; the measured angle while off.
    """

    servo_on: bool
    setpoint: float


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

    def _find_fault(self, now_us: int) -> Fault:
        if not ADC_LOW <= self._measured.counts <= ADC_HIGH:
            return Fault.SENSOR
        if abs(self._setpoint - self._measured.angle) <= TRACKING_ERROR:
            self._tracking_since = None
        elif self._tracking_since is None:
            self._tracking_since = now_us
        elif now_us - self._tracking_since >= _TRACKING_US:
            return Fault.TRACKING
        return Fault(0)

    def _stopped(self, now_us: int) -> bool:
        return now_us - self._state_since >= _HOLDING_US

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
            now_us & 0xFFFFFFFF,
            self.state,
            self._state_flags(),
            self.faults,
            to_i16(self._measured.angle / ANGLE_UNIT),
            to_i16(self._setpoint / ANGLE_UNIT),
            to_i16(self._measured.rate / STEER_RATE_UNIT),
            round(SERVO_CENTRE + SERVO_SPAN / MAX_STEERING_ANGLE * self._setpoint) if on else 0,
            self._measured.counts,
            to_u16(self._measured.supply * 1e3),
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
