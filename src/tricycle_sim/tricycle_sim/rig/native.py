"""The rig with the firmware's logic compiled for this computer: fast, and the C code itself."""

from pathlib import Path

from tricycle_bridge.protocol.messages import Board
from tricycle_sim.plants.plant import Plant
from tricycle_sim.plc.firmware import FirmwareDrivePlc, FirmwareSteerPlc
from tricycle_sim.rig.faults import NO_FAULTS, FaultKind, FaultPlan
from tricycle_sim.rig.plc_rig import TICK_US, PlcRig, Push
from tricycle_sim.rig.sensors import line_voltages
from tricycle_sim.vehicle import Vehicle


class NativeRig(PlcRig):
    """The rig with the C code of both boards, its speed measurement and its torque controller.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its true values.
    build : Path
        Directory of the libraries: `make -C firmware host`.
    faults : FaultPlan
        Faults of wires, boards and host.
    plant : Plant, optional
        Plant that the boards drive; by default our own model of the vehicle.

    Raises
    ------
    LinkError
        If the files of the build are missing.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        build: Path,
        faults: FaultPlan = NO_FAULTS,
        plant: Plant | None = None,
    ) -> None:
        steer = FirmwareSteerPlc(build / "libsteer.so")
        drive = FirmwareDrivePlc(build / "libdrive.so")
        super().__init__(vehicle, steer, drive, faults, plant)

    def _tick_drive(self) -> tuple[bytes, Push]:
        state, faults = self._state, self._faults
        now = self._plc_time_us(Board.DRIVE)
        edge = round(self._hall.edge_at * 1e6) - (self._ticks * TICK_US - now)
        hall_line, direction_line = line_voltages(faults)
        data, torque, output = self._plcs[Board.DRIVE].tick_pulses(
            now,
            self._hall.count,
            edge,
            hall_line=hall_line,
            direction_line=direction_line,
            supply=faults.get(FaultKind.DRIVE_SUPPLY, self._vehicle.battery_voltage),
            current=max(0.0, state.motor_current),
            estop_pressed=FaultKind.ESTOP in faults,
        )
        return data, Push(None, torque if output.motor_on else 0.0, output.brake)
