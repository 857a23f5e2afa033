"""The firmware's own logic, compiled for this machine, behind the interface of `Plc`.

`FirmwareSteerPlc` and `FirmwareDrivePlc` stand wherever `SteerPlc` and `DrivePlc` do. Build the
libraries with ``make -C firmware host``.
"""

from __future__ import annotations

import ctypes
from pathlib import Path

from tricycle_bridge.protocol.boards import (
    ADC_FULL,
    ADC_REFERENCE,
    DRIVE_SUPPLY,
    LINE_RESTING,
)
from tricycle_bridge.protocol.messages import (
    MAX_COMMAND_AGE,
    Board,
    Fault,
    PlcState,
    ResetCause,
)
from tricycle_bridge.protocol.units import ANGLE_UNIT, BRAKE_UNIT, SPEED_UNIT, STEER_RATE_UNIT
from tricycle_core.errors import LinkError
from tricycle_sim.plc.drive import DriveMeasurement, DriveOutput
from tricycle_sim.plc.steer import SteerMeasurement, SteerOutput

_LINE = 4096  # bytes that a board may send per call


class _FirmwarePlc:
    """One board of the compiled firmware.

    Parameters
    ----------
    library : Path
        ``libsteer.so`` or ``libdrive.so``.
    boot_count : int
        Boots before this one.

    Raises
    ------
    LinkError
        The library is not there.
    """

    board: Board

    def __init__(self, library: Path, *, boot_count: int = 0) -> None:
        if not library.exists():
            raise LinkError(f"{library} does not exist: build it with `make -C firmware host`")
        self._c = ctypes.CDLL(str(library))
        self._c.host_new.restype = ctypes.c_void_p
        self._c.host_faults.restype = ctypes.c_uint16
        self._c.host_state.restype = ctypes.c_uint8
        self._c.host_session.restype = ctypes.c_uint8
        self._c.host_command_age.restype = ctypes.c_uint8
        self._c.host_alive.restype = ctypes.c_bool
        self._host = ctypes.c_void_p(self._c.host_new())
        self._boot_count = boot_count
        self.reset(ResetCause.POWER_ON)

    def __del__(self) -> None:
        if hasattr(self, "_host"):
            self._c.host_free(self._host)

    @property
    def state(self) -> PlcState:
        """State of the board."""
        return PlcState(self._c.host_state(self._host))

    @property
    def faults(self) -> Fault:
        """Faults of the board."""
        return Fault(self._c.host_faults(self._host))

    @property
    def session(self) -> int:
        """Session given by the host; 0 = none."""
        return int(self._c.host_session(self._host))

    @property
    def alive(self) -> bool:
        """Level of the alive output, which toggles while the board is armed or stopping."""
        return bool(self._c.host_alive(self._host))

    def command_age(self, now_us: int) -> int | None:
        """Return the time in us since a command was last accepted, in whole ticks.

        None before the first one and from 2.55 s on.

        Parameters
        ----------
        now_us : int
            PLC time in us.
        """
        ticks = self._c.host_command_age(self._host, ctypes.c_uint32(now_us & 0xFFFFFFFF))
        return None if ticks == MAX_COMMAND_AGE else 10_000 * ticks

    def reset(self, cause: ResetCause = ResetCause.EXTERNAL) -> None:
        """Boot: everything but the boot count is forgotten."""
        self._boot_count = (self._boot_count + 1) & 0xFFFF
        self._c.host_reset(self._host, ctypes.c_uint8(cause), ctypes.c_uint16(self._boot_count))

    def receive(self, data: bytes, now_us: int) -> bytes:
        """Take bytes from the host; as `Plc.receive`.

        Parameters
        ----------
        data : bytes
            Part of the stream, cut anywhere.
        now_us : int
            PLC time in us.

        Returns
        -------
        bytes
            The answers, for the line.
        """
        self._c.host_receive(self._host, data, len(data), ctypes.c_uint32(now_us & 0xFFFFFFFF))
        return self._take()

    def drop_sent(self, frames: int) -> None:
        """Count frames that the line did not take (STATS tx_drop)."""
        self._c.host_drop(self._host, ctypes.c_uint16(frames))

    def _take(self) -> bytes:
        line = ctypes.create_string_buffer(_LINE)
        length = self._c.host_take(self._host, line)
        return line.raw[:length]


class FirmwareSteerPlc(_FirmwarePlc):
    """The steer PLC's firmware."""

    board = Board.STEER

    def tick(self, now_us: int, measurement: SteerMeasurement) -> tuple[bytes, SteerOutput]:
        """Run one control tick of 10 ms; as `Plc.tick`.

        Parameters
        ----------
        now_us : int
            PLC time in us.
        measurement : SteerMeasurement
            Inputs at this time.

        Returns
        -------
        bytes
            Events and the state frame, for the line.
        SteerOutput
            Outputs to the actuators until the next tick.
        """
        outputs = (ctypes.c_int32 * 2)()
        self._c.host_tick(
            self._host,
            ctypes.c_uint32(now_us & 0xFFFFFFFF),
            ctypes.c_int16(round(measurement.angle / ANGLE_UNIT)),
            ctypes.c_int16(round(measurement.rate / STEER_RATE_UNIT)),
            ctypes.c_uint16(measurement.counts),
            ctypes.c_uint16(round(measurement.supply * 1e3)),
            ctypes.c_bool(measurement.estop_pressed),
            outputs,
        )
        return self._take(), SteerOutput(bool(outputs[0]), outputs[1] / 100_000)


class FirmwareDrivePlc(_FirmwarePlc):
    """The drive PLC's firmware."""

    board = Board.DRIVE

    def tick(self, now_us: int, measurement: DriveMeasurement) -> tuple[bytes, DriveOutput]:
        """Run one control tick of 10 ms; as `Plc.tick`.

        Parameters
        ----------
        now_us : int
            PLC time in us.
        measurement : DriveMeasurement
            Inputs at this time.

        Returns
        -------
        bytes
            Events and the state frame, for the line.
        DriveOutput
            Outputs to the actuators until the next tick.
        """
        outputs = (ctypes.c_int32 * 3)()
        self._c.host_tick(
            self._host,
            ctypes.c_uint32(now_us & 0xFFFFFFFF),
            ctypes.c_int16(round(measurement.speed / SPEED_UNIT)),
            ctypes.c_int32(measurement.hall_count),
            ctypes.c_int32(round(measurement.torque * 1e3)),
            _counts(measurement.hall_line, measurement.direction_line),
            ctypes.c_uint16(round(measurement.current * 1e3)),
            ctypes.c_uint16(round(measurement.supply * 1e3)),
            ctypes.c_bool(measurement.estop_pressed),
            outputs,
        )
        return self._take(), _drive_output(*outputs)

    def tick_pulses(
        self,
        now_us: int,
        hall_count: int,
        edge_us: int,
        *,
        hall_line: float = LINE_RESTING[0],
        direction_line: float = LINE_RESTING[1],
        supply: float = DRIVE_SUPPLY,
        current: float = 0.0,
        estop_pressed: bool = False,
    ) -> tuple[bytes, float, DriveOutput]:
        """Run one control tick with the board's own speed measurement and torque controller.

        Parameters
        ----------
        now_us : int
            PLC time in us.
        hall_count : int
            Hall pulses; forward counts up. Where they begin at a reset makes no difference.
        edge_us : int
            PLC time of the newest pulse in us, not after `now_us`.
        hall_line, direction_line : float
            Voltages of the hall sensor's lines in V.
        supply : float
            Voltage of the battery in V.
        current : float
            Current from the supply in A.
        estop_pressed : bool
            Whether the hardware e-stop is pressed.

        Returns
        -------
        bytes
            Events and the state frame, for the line.
        float
            Torque demanded of the motor until the next tick in N m, forward positive.
        DriveOutput
            Outputs to the actuators until the next tick.
        """
        outputs = (ctypes.c_int32 * 4)()
        self._c.host_tick_pulses(
            self._host,
            ctypes.c_uint32(now_us & 0xFFFFFFFF),
            ctypes.c_int32(hall_count),
            ctypes.c_uint32(edge_us & 0xFFFFFFFF),
            _counts(hall_line, direction_line),
            ctypes.c_uint16(round(current * 1e3)),
            ctypes.c_uint16(round(supply * 1e3)),
            ctypes.c_bool(estop_pressed),
            outputs,
        )
        torque, *output = outputs
        return self._take(), torque * 1e-3, _drive_output(*output)


def _counts(*volts: float) -> ctypes.Array[ctypes.c_uint16]:
    return (ctypes.c_uint16 * len(volts))(*(round(v / ADC_REFERENCE * ADC_FULL) for v in volts))


def _drive_output(motor_on: int, setpoint: int, brake: int) -> DriveOutput:
    return DriveOutput(bool(motor_on), setpoint / 100_000, brake * BRAKE_UNIT)
