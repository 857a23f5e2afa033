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
    STEERING_END_STOP,
    WATCHDOG,
)
from tricycle_bridge.protocol.messages import (
    Board,
    CommandFlag,
    Fault,
    PlcState,
    SteerCommand,
    SteerLimits,
    SteerSetup,
    SteerState,
)
from tricycle_bridge.protocol.units import ANGLE_UNIT, STEER_RATE_UNIT
from tricycle_sim.plc.plc import Plc, clamp, in_order, to_i16, to_u16
from tricycle_sim.setpoints import slew

_HOLDING_US = round(HOLDING_TIME * 1e6)
_TRACKING_US = round(TRACKING_TIME * 1e6)


@dataclass(frozen=True)
class SteerMeasurement:
    """Inputs of the steer PLC.

    Attributes
    ----------
    angle : float
        Angle of the steering motor in rad, left positive.
    rate : float
        Rate of the steering motor in rad/s.
    supply : float
        Voltage of the servo's supply in V.
    estop_pressed : bool
        Whether the hardware e-stop is pressed.
    adc : int or None
        Reading of the potentiometer in counts; None: follows from `angle`.
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
    """Outputs of the steer PLC to the steering.

    Attributes
    ----------
    servo_on : bool
        Whether the servo gets pulses; without them it does not hold.
    setpoint : float
        Slewed and limited angle of the steering motor in rad; the measured angle while off.
    """

    servo_on: bool
    setpoint: float


class SteerPlc(Plc[SteerMeasurement, SteerOutput, SteerCommand, SteerSetup]):
    """The steer PLC: a slewed, limited set-point for the steering servo."""

    board = Board.STEER
    _own = SteerSetup(
        max_angle=round(MAX_STEERING_ANGLE / ANGLE_UNIT),
        max_rate=round(MAX_STEERING_RATE / STEER_RATE_UNIT),
        supply_low=0,
        supply_high=0,
    )

    def _reset_board(self) -> None:
        self._measured = SteerMeasurement()
        self._target = 0.0  # rad, as commanded
        self._rate_limit = 0.0  # rad/s
        self._setpoint = 0.0  # rad
        self._holding_since: int | None = None  # us, when it left ARMED; None: it does not hold
        self._tracking_since: int | None = None  # us

    def _put_in_force(self) -> None:
        self._max_angle = self._in_force.max_angle * ANGLE_UNIT
        self._max_rate = self._in_force.max_rate * STEER_RATE_UNIT

    def _allowed(self, setup: SteerSetup) -> bool:
        return (
            setup.max_angle <= self._own.max_angle
            and setup.max_rate <= self._own.max_rate
            and in_order(setup.supply_low, setup.supply_high)
        )

    def _begin_tick(self, now_us: int) -> None:
        if self._holding_since is not None and now_us - self._holding_since >= _HOLDING_US:
            self._holding_since = None

    def _find_fault(self, now_us: int) -> Fault:
        if self.state is not PlcState.ARMED:
            return Fault(0)
        if not self._ready():
            return Fault.SENSOR
        if abs(self._setpoint - self._measured.angle) <= TRACKING_ERROR:
            self._tracking_since = None
        elif self._tracking_since is None:
            self._tracking_since = now_us
        elif now_us - self._tracking_since >= _TRACKING_US:
            return Fault.TRACKING
        return Fault(0)

    def _stopped(self) -> bool:
        return not self._holds

    def _ready(self) -> bool:
        return ADC_LOW <= self._measured.counts <= ADC_HIGH

    def _armed(self) -> None:
        stop = STEERING_END_STOP
        self._setpoint = min(max(self._measured.angle, -stop), stop)
        self._tracking_since = None
        self._holding_since = None

    def _left_armed(self, now_us: int) -> None:
        self._holding_since = now_us

    @property
    def _holds(self) -> bool:
        return self._holding_since is not None

    def _take_command(self, command: SteerCommand) -> bool:
        angle = command.angle * ANGLE_UNIT
        rate = command.max_rate * STEER_RATE_UNIT or self._max_rate
        self._target = min(max(angle, -self._max_angle), self._max_angle)
        self._rate_limit = min(rate, self._max_rate)
        if command.flags & CommandFlag.STANDSTILL:
            self._holding_since = None
        return self._target != angle or self._rate_limit != rate

    @property
    def _servo_on(self) -> bool:
        return self.state is PlcState.ARMED or self._holds

    def _control(self) -> SteerOutput:
        if self.state is PlcState.ARMED:
            self._setpoint = slew(self._setpoint, self._target, self._rate_limit)
        elif not self._holds:
            self._setpoint = self._measured.angle
        return SteerOutput(self._servo_on, self._setpoint)

    def _state_frame(self, now_us: int) -> SteerState:
        pulse = round(SERVO_CENTRE + SERVO_SPAN / STEERING_END_STOP * self._setpoint)
        return SteerState(
            now_us & 0xFFFFFFFF,
            self.state,
            self._state_flags(now_us),
            self.faults,
            to_i16(self._measured.angle / ANGLE_UNIT),
            to_i16(self._setpoint / ANGLE_UNIT),
            to_i16(self._measured.rate / STEER_RATE_UNIT),
            pulse if self._servo_on else 0,
            self._measured.counts,
            to_u16(self._measured.supply * 1e3),
            self._command_seq,
            self._age_ticks(now_us),
        )

    def _limits_frame(self) -> SteerLimits:
        return SteerLimits(
            **vars(self._in_force),
            watchdog=round(WATCHDOG * 1e3),
            stale=STALE_TICKS,
            end_stop=round(STEERING_END_STOP / ANGLE_UNIT),
            adc_scale=ADC_SCALE,
        )
