"""The rig with emulated boards: the live vehicle with its two emulated PLCs, tick by tick."""

from tricycle_bridge.protocol.boards import hall_pulse
from tricycle_bridge.protocol.messages import Board
from tricycle_sim.plants.plant import Plant
from tricycle_sim.plc import DriveMeasurement, DrivePlc, SteerPlc
from tricycle_sim.rig.faults import NO_FAULTS, FaultKind, FaultPlan
from tricycle_sim.rig.plc_rig import PlcRig, Push
from tricycle_sim.rig.sensors import line_voltages, measured_speed
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.speed_loop import SpeedLoop


class EmulatedRig(PlcRig):
    """The rig with emulated boards.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its true values.
    faults : FaultPlan
        Faults of wires, boards and host.
    plant : Plant, optional
        Plant that the boards drive; by default our own model of the vehicle.
    """

    def __init__(
        self, vehicle: Vehicle, faults: FaultPlan = NO_FAULTS, plant: Plant | None = None
    ) -> None:
        super().__init__(vehicle, SteerPlc(), DrivePlc(), faults, plant)

    def _rest(self) -> None:
        super()._rest()
        self._loop: SpeedLoop | None = None  # where the vehicle's own controller would not do
        self._demand = 0.0  # N m, of that loop

    def _tick_drive(self) -> tuple[bytes, Push]:
        state, faults = self._state, self._faults
        speed = state.drive_speed * self._vehicle.driven_radius
        # as a board knows it: from pulses, each as long as it was told
        told = self._plcs[Board.DRIVE].pulse / hall_pulse(self._vehicle.driven_radius)
        measured = measured_speed(speed * told, faults)
        hall_line, direction_line = line_voltages(faults)
        data, output = self._plcs[Board.DRIVE].tick(
            self._plc_time_us(Board.DRIVE),
            DriveMeasurement(
                speed=measured,
                hall_count=self._hall.count,
                torque=state.motor_torque if self._loop is None else self._demand,
                hall_line=hall_line,
                direction_line=direction_line,
                current=max(0.0, state.motor_current),
                supply=faults.get(FaultKind.DRIVE_SUPPLY, self._vehicle.battery_voltage),
                estop_pressed=FaultKind.ESTOP in faults,
            ),
        )
        if not output.motor_on:
            self._loop = None
            return data, Push(None, 0.0, output.brake)
        outside = self._holds_speed is None or measured != speed
        if self._loop is None and (outside or FaultKind.MOTOR_DEAD in faults):
            self._loop = SpeedLoop(self._vehicle, state.motor_torque, output.setpoint, speed)
        if self._loop is None:
            return data, Push(output.setpoint, 0.0, output.brake)
        self._demand = self._loop.torque(output.setpoint, measured)
        return data, Push(None, self._demand, output.brake)
