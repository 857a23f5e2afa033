"""The rig with emulated boards: the live vehicle with its two emulated PLCs, tick by tick."""

from tricycle_bridge.protocol.boards import ADC_CENTRE, ADC_SCALE, STEER_SUPPLY
from tricycle_bridge.protocol.messages import Board, Fault, PlcState, ResetCause
from tricycle_core.timing import TICK
from tricycle_sim.plc import (
    DriveMeasurement,
    DriveOutput,
    DrivePlc,
    Plc,
    SteerMeasurement,
    SteerOutput,
    SteerPlc,
)
from tricycle_sim.rig.faults import NO_FAULTS, FaultKind, FaultPlan
from tricycle_sim.rig.rig import Rig
from tricycle_sim.rig.sensors import HallSensor, broken_potentiometer, measured_speed
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.speed_loop import SpeedLoop

TICK_US = round(TICK * 1e6)


class EmulatedRig(Rig):
    """The rig with emulated boards.

    Parameters
    ----------
    vehicle : Vehicle
        With its true values.
    faults : FaultPlan
        Faults of wires, boards and host.
    """

    def __init__(self, vehicle: Vehicle, faults: FaultPlan = NO_FAULTS) -> None:
        super().__init__(vehicle, faults)
        self._steer = SteerPlc()
        self._drive = DrivePlc()
        self._boot_ticks = {Board.STEER: 0, Board.DRIVE: 0}
        self._servo = SteerOutput(False, 0.0)
        self._motor = DriveOutput(False, 0.0, 1.0)
        self._rest()

    def plc_state(self, board: Board) -> PlcState:
        """Return a PLC's state."""
        return self._plcs[board].state

    def plc_faults(self, board: Board) -> Fault:
        """Return a PLC's faults."""
        return self._plcs[board].faults

    def heard(self, board: Board) -> bool:
        """Whether a PLC has accepted a command since the last step."""
        return self._plcs[board].command_age(self._plc_time_us(board)) == 0

    def _rest(self) -> None:
        self._hall = HallSensor()
        self._loop: SpeedLoop | None = None  # where the measured speed has been another one

    def _reboot(self, board: Board, cause: ResetCause) -> None:
        self._boot_ticks[board] = self._ticks
        self._plcs[board].reset(cause)

    def _receive(self, board: Board, data: bytes) -> bytes:
        return self._plcs[board].receive(data, self._plc_time_us(board))

    def _step(self, hung: set[Board]) -> dict[Board, bytes]:
        state, faults = self._live.state, self._faults
        sent = {Board.STEER: b"", Board.DRIVE: b""}
        if Board.STEER not in hung:
            sent[Board.STEER], self._servo = self._steer.tick(
                self._plc_time_us(Board.STEER), self._steer_measurement()
            )
        speed = state.wheel_speeds[2] * self._vehicle.tyre_radius
        measured = measured_speed(speed, faults)
        travel = state.rear_wheel_angle * self._vehicle.tyre_radius
        self._hall.turn(travel, self.time, faults)
        if Board.DRIVE not in hung:
            sent[Board.DRIVE], self._motor = self._drive.tick(
                self._plc_time_us(Board.DRIVE),
                DriveMeasurement(
                    speed=measured,
                    hall_count=self._hall.count,
                    torque=state.motor_torque,
                    current=max(0.0, state.motor_current),
                    supply=faults.get(FaultKind.DRIVE_SUPPLY, self._vehicle.battery_voltage),
                    estop_pressed=FaultKind.ESTOP in faults,
                ),
            )
        servo_on = self._servo.servo_on and FaultKind.SERVO_DEAD not in faults
        motor_on = self._motor.motor_on and FaultKind.MOTOR_DEAD not in faults
        if not self._motor.motor_on:
            self._loop = None
        torque = self._torque(speed, measured) if motor_on else None
        self._live.step(
            steering=self._servo.setpoint if servo_on else None,
            speed=self._motor.setpoint if motor_on and torque is None else None,
            torque=torque or 0.0,
            brake=0.0 if FaultKind.BRAKE_DEAD in faults else self._motor.brake,
        )
        return sent

    def _steer_measurement(self) -> SteerMeasurement:
        state, faults = self._live.state, self._faults
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

    def _torque(self, speed: float, measured: float) -> float | None:
        """Return the torque that the board's speed controller wants where it is misled.

        None: its speed is the wheel's, and the vehicle's own controller does the same.
        """
        setpoint = self._motor.setpoint
        if self._loop is None:
            if measured == speed:
                return None
            self._loop = SpeedLoop(self._vehicle, self._live.state.motor_torque, setpoint, speed)
        return self._loop.torque(setpoint, measured)

    @property
    def _plcs(self) -> dict[Board, Plc]:  # type: ignore[type-arg]
        return {Board.STEER: self._steer, Board.DRIVE: self._drive}

    def _plc_time_us(self, board: Board) -> int:
        """A board's clock: it starts at its boot."""
        return (self._ticks - self._boot_ticks[board]) * TICK_US
