"""The rig with emulated boards: the live vehicle with its two emulated PLCs, tick by tick."""

from tricycle_bridge.protocol.boards import HALL_PULSE
from tricycle_bridge.protocol.messages import Board, PlcState
from tricycle_core.timing import TICK
from tricycle_sim.plc import DriveMeasurement, DrivePlc, Plc, SteerMeasurement, SteerPlc
from tricycle_sim.rig.rig import Rig
from tricycle_sim.vehicle import Vehicle

TICK_US = round(TICK * 1e6)


class EmulatedRig(Rig):
    """The rig with emulated boards.

    Parameters
    ----------
    vehicle : Vehicle
        With its true values.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        self._steer = SteerPlc()
        self._drive = DrivePlc()
        self._boot_tick = 0

    @property
    def armed(self) -> bool:
        """Whether both PLCs are armed."""
        return self._steer.state is PlcState.ARMED and self._drive.state is PlcState.ARMED

    def heard(self, board: Board) -> bool:
        """Whether a PLC has accepted a command since the last step."""
        return self._plcs[board].command_age(self._plc_time_us) == 0

    def _reboot(self) -> None:
        self._boot_tick = self._ticks
        for plc in self._plcs.values():
            plc.reset()

    def receive(self, board: Board, data: bytes) -> bytes:
        """Hand bytes of the host to a PLC; return its answers.

        Parameters
        ----------
        board : Board
            Steer or drive.
        data : bytes
            As they come from the line.
        """
        return self._plcs[board].receive(data, self._plc_time_us)

    def step(self) -> dict[Board, bytes]:
        """Run one tick: PLCs measure and control, the vehicle moves. Return the telemetry."""
        now, state = self._plc_time_us, self._live.state
        radius = self._vehicle.tyre_radius
        steer_bytes, steer = self._steer.tick(
            now,
            SteerMeasurement(angle=state.steering_motor_angle, rate=state.steering_motor_rate),
        )
        drive_bytes, drive = self._drive.tick(
            now,
            DriveMeasurement(
                speed=state.wheel_speeds[2] * radius,
                hall_count=int(state.rear_wheel_angle * radius / HALL_PULSE),
                torque=state.motor_torque,
                current=max(0.0, state.motor_current),
                supply=self._vehicle.battery_voltage,
            ),
        )
        self._live.step(
            steering=steer.setpoint if steer.servo_on else None,
            speed=drive.setpoint if drive.motor_on else None,
            brake=drive.brake,
        )
        self._ticks += 1
        return {Board.STEER: steer_bytes, Board.DRIVE: drive_bytes}

    @property
    def _plcs(self) -> dict[Board, Plc]:  # type: ignore[type-arg]
        return {Board.STEER: self._steer, Board.DRIVE: self._drive}

    @property
    def _plc_time_us(self) -> int:
        """The boards' clock: it starts at their boot."""
        return (self._ticks - self._boot_tick) * TICK_US
