"""Both emulated PLCs on ptys in real time: a bench without hardware."""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time

from tricycle_bridge.protocol.boards import (
    HALL_PULSE,
    LINE_OPEN,
    LINE_RESTING,
    MASS_LOW,
    TYRE_RADIUS,
)
from tricycle_bridge.protocol.messages import Board, ResetCause
from tricycle_core.closing import Closing
from tricycle_core.timing import TICK
from tricycle_sim.plc.drive import DriveMeasurement, DriveOutput, DrivePlc
from tricycle_sim.plc.pty_port import PtyPort
from tricycle_sim.plc.steer import SteerMeasurement, SteerOutput, SteerPlc

_MASS = 1.5 * MASS_LOW  # kg at the tread
_BRAKING = 3.0  # m/s^2 at full brake


class PlcPair(Closing):
    """A steer and a drive PLC, each on a pty, served by one thread at 100 Hz.

    The vehicle behind them is the simplest one: steering and speed are at their set-points within
    the tick, with whatever torque that takes, the brake decelerates at 3 m/s^2.

    Parameters
    ----------
    steer_path, drive_path : str or PathLike
        Paths at which the serial devices appear.
    start_us : int
        Reading of the PLCs' clocks at the start in us, to come near their wrap.

    Attributes
    ----------
    steer, drive : SteerPlc, DrivePlc
        The two PLCs.
    ports : dict of Board to PtyPort
        Their serial devices.
    estop_pressed : bool
        Hardware e-stop of both boards; a test may press it.
    hall_plugged : bool
        Whether the hall sensor is connected to the drive board; a test may pull it.
    steer_output, drive_output : SteerOutput, DriveOutput
        Outputs of the PLCs to the vehicle.
    steering_angle, speed, distance : float
        State of the vehicle in rad of the steering motor, m/s and m.
    """

    def __init__(
        self,
        steer_path: str | os.PathLike[str],
        drive_path: str | os.PathLike[str],
        *,
        start_us: int = 0,
    ) -> None:
        self.steer = SteerPlc()
        self.drive = DrivePlc()
        self.ports = {Board.STEER: PtyPort(steer_path), Board.DRIVE: PtyPort(drive_path)}
        self.estop_pressed = False
        self.hall_plugged = True
        self.steer_output = SteerOutput(False, 0.0)
        self.drive_output = DriveOutput(False, 0.0, 1.0)
        self.steering_angle = 0.0
        self.speed = 0.0
        self.distance = 0.0
        self._torque = 0.0  # N m of the motor
        self._start_us = start_us
        self._started = time.monotonic()
        self._stalled: set[Board] = set()
        self._lock = threading.Lock()
        self._stopping = False
        self._tick()  # booted: whoever opens a port is answered at once
        self._thread = threading.Thread(target=self._run, name="plc pair", daemon=True)
        self._thread.start()

    @property
    def steer_path(self) -> str:
        """Serial device of the steer PLC."""
        return str(self.ports[Board.STEER].path)

    @property
    def drive_path(self) -> str:
        """Serial device of the drive PLC."""
        return str(self.ports[Board.DRIVE].path)

    def plc(self, board: Board) -> SteerPlc | DrivePlc:
        """Return the PLC of a board."""
        return self.steer if board is Board.STEER else self.drive

    def reset(self, board: Board, cause: ResetCause = ResetCause.EXTERNAL) -> None:
        """Reboot a board.

        Parameters
        ----------
        board : Board
            Board that is rebooted.
        cause : ResetCause
            Cause that its HELLO_ACK gives.
        """
        with self._lock:
            self.plc(board).reset(cause)

    def unplug(self, board: Board) -> None:
        """Pull a board's cable; the board itself keeps running."""
        with self._lock:
            self.ports[board].unplug()

    def plug(self, board: Board) -> None:
        """Put the cable back; opening the device resets a UNO, so the board reboots."""
        with self._lock:
            self.plc(board).reset(ResetCause.EXTERNAL)
            self.ports[board].plug()

    def swap(self) -> None:
        """Exchange the two devices' boards, as exchanged cables do."""
        with self._lock:
            self.ports[Board.STEER], self.ports[Board.DRIVE] = (
                self.ports[Board.DRIVE],
                self.ports[Board.STEER],
            )

    def stall(self, board: Board, *, stalled: bool = True) -> None:
        """Freeze a board: it neither reads nor ticks, its cable stays.

        Parameters
        ----------
        board : Board
            Board that is frozen.
        stalled : bool
            False lets it run again.
        """
        with self._lock:
            (self._stalled.add if stalled else self._stalled.discard)(board)

    def close(self) -> None:
        """Stop both boards and remove their devices."""
        self._stopping = True
        self._thread.join()
        for port in self.ports.values():
            port.close()

    def _now_us(self) -> int:
        return self._start_us + round((time.monotonic() - self._started) * 1e6)

    def _run(self) -> None:
        next_tick = time.monotonic()
        while not self._stopping:
            with self._lock:
                self._serve()
                if time.monotonic() >= next_tick:
                    self._tick()
                    next_tick += TICK
                readable = [
                    p for b, p in self.ports.items() if p.plugged and b not in self._stalled
                ]
            # not under the lock, so that a port may be unplugged meanwhile (OSError, ValueError)
            with contextlib.suppress(OSError, ValueError):
                select.select(readable, [], [], max(next_tick - time.monotonic(), 0.0))

    def _serve(self) -> None:
        for board, port in self.ports.items():
            if board not in self._stalled and (data := port.read()):
                self._write(board, self.plc(board).receive(data, self._now_us()))

    def _tick(self) -> None:
        now = self._now_us()
        if Board.STEER not in self._stalled:
            steer = SteerMeasurement(self.steering_angle, estop_pressed=self.estop_pressed)
            data, self.steer_output = self.steer.tick(now, steer)
            self._write(Board.STEER, data)
        if Board.DRIVE not in self._stalled:
            hall_line, direction_line = LINE_RESTING if self.hall_plugged else 2 * (LINE_OPEN,)
            drive = DriveMeasurement(
                self.speed,
                round(self.distance / HALL_PULSE),
                self._torque,
                hall_line,
                direction_line,
                estop_pressed=self.estop_pressed,
            )
            data, self.drive_output = self.drive.tick(now, drive)
            self._write(Board.DRIVE, data)
        if self.steer_output.servo_on:
            self.steering_angle = self.steer_output.setpoint
        self._torque = 0.0
        if self.drive_output.motor_on:
            gain = self.drive_output.setpoint - self.speed
            self._torque = _MASS * gain / TICK * TYRE_RADIUS
            self.speed = self.drive_output.setpoint
        braked = self.drive_output.brake * _BRAKING * TICK
        self.speed = max(self.speed - braked, min(self.speed + braked, 0.0))
        self.distance += self.speed * TICK

    def _write(self, board: Board, data: bytes) -> None:
        if not self.ports[board].write(data):
            self.plc(board).drop_sent(1)
