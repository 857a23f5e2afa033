"""A rig whose boards are PLC objects that are called tick by tick."""

from abc import abstractmethod
from typing import Any, NamedTuple

from tricycle_bridge.protocol.boards import ADC_CENTRE, ADC_SCALE, STEER_SUPPLY, hall_pulse
from tricycle_bridge.protocol.messages import Board, Fault, PlcState, ResetCause
from tricycle_core.timing import TICK
from tricycle_sim.plants.plant import Plant
from tricycle_sim.plc import SteerMeasurement, SteerOutput
from tricycle_sim.rig.faults import NO_FAULTS, FaultKind, FaultPlan
from tricycle_sim.rig.rig import Rig
from tricycle_sim.rig.sensors import HallSensor, broken_potentiometer
from tricycle_sim.vehicle import Vehicle

TICK_US = round(TICK * 1e6)


class Push(NamedTuple):
    """Command of the drive board to the rear wheel.

    Attributes
    ----------
    speed : float or None
        Set-point [m/s] of the vehicle's own speed controller; None: `torque` counts.
    torque : float
        Torque of the motor [N m].
    brake : float
        Brake command, 0 (released) to 1 (full).
    """

    speed: float | None
    torque: float
    brake: float


# what boards put out until their first tick
_SERVO_OFF, _STOPPED = SteerOutput(False, 0.0), Push(None, 0.0, 1.0)


class PlcRig(Rig):
    """Vehicle and two PLC objects.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its true values.
    steer, drive : PLC
        The boards.
    faults : FaultPlan
        Faults of wires, boards and host.
    plant : Plant, optional
        Plant that the boards drive; by default our own model of the vehicle.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        steer: Any,
        drive: Any,
        faults: FaultPlan = NO_FAULTS,
        plant: Plant | None = None,
    ) -> None:
        super().__init__(vehicle, faults, plant)
        self._plcs = {Board.STEER: steer, Board.DRIVE: drive}
        self._boot_ticks = {Board.STEER: 0, Board.DRIVE: 0}
        self._servo, self._push = _SERVO_OFF, _STOPPED
        self._rest()

    def plc_state(self, board: Board) -> PlcState:
        """Return a PLC's state."""
        state: PlcState = self._plcs[board].state
        return state

    def plc_faults(self, board: Board) -> Fault:
        """Return a PLC's faults."""
        faults: Fault = self._plcs[board].faults
        return faults

    def heard(self, board: Board) -> bool:
        """Whether a PLC has accepted a command since the last step."""
        age: int | None = self._plcs[board].command_age(self._plc_time_us(board))
        return age == 0

    def _rest(self) -> None:
        self._hall = HallSensor(hall_pulse(self._vehicle.driven_radius))

    def _reboot(self, board: Board, cause: ResetCause) -> None:
        self._boot_ticks[board] = self._ticks
        self._plcs[board].reset(cause)
        if board is Board.STEER:
            self._servo = _SERVO_OFF
        else:
            self._push = _STOPPED

    def _receive(self, board: Board, data: bytes) -> bytes:
        answers: bytes = self._plcs[board].receive(data, self._plc_time_us(board))
        return answers

    def _step(self, hung: set[Board]) -> dict[Board, bytes]:
        state, faults = self._state, self._faults
        sent = {Board.STEER: b"", Board.DRIVE: b""}
        if Board.STEER not in hung:
            sent[Board.STEER], self._servo = self._plcs[Board.STEER].tick(
                self._plc_time_us(Board.STEER), self._steer_measurement()
            )
        travel = state.drive_angle * self._vehicle.driven_radius
        self._hall.turn(travel, self.time, faults)
        if Board.DRIVE not in hung:
            sent[Board.DRIVE], self._push = self._tick_drive()
        push = self._push
        if FaultKind.MOTOR_DEAD in faults:
            push = push._replace(speed=None, torque=0.0)
        servo_on = self._servo.servo_on and FaultKind.SERVO_DEAD not in faults
        self._advance(
            self._servo.setpoint if servo_on else None,
            push.torque,
            0.0 if FaultKind.BRAKE_DEAD in faults else push.brake,
            push.speed,
        )
        return sent

    @abstractmethod
    def _tick_drive(self) -> tuple[bytes, Push]:
        """Run the drive board's tick; return its bytes and what it does."""

    def _steer_measurement(self) -> SteerMeasurement:
        state, faults = self._state, self._faults
        counts = broken_potentiometer(faults)
        return SteerMeasurement(
            angle=(
                state.steering_motor_angle if counts is None else (counts - ADC_CENTRE) / ADC_SCALE
            ),
            rate=state.steering_motor_rate if counts is None else 0.0,
            supply=faults.get(FaultKind.STEER_SUPPLY, STEER_SUPPLY),
            estop_pressed=FaultKind.ESTOP in faults,
            adc=counts,
        )

    def _plc_time_us(self, board: Board) -> int:
        """A board's clock: it starts at its boot."""
        return (self._ticks - self._boot_ticks[board]) * TICK_US
