"""An hour of simulated driving on a bad line, and a thousand watchdog trips; all on PLC time.

    .venv/bin/python benchmarks/link_soak.py --minutes 60 --trips 1000

Bridge and both emulated PLCs run in lockstep as fast as they can; 1 % of the frames are damaged in
either direction, and the PLCs' clocks wrap (71.6 min) in the middle. Whenever the vehicle stops,
the operator arms it again. Every frame sent must be accounted for on the other side.
"""

from __future__ import annotations

import argparse
import math
import random
import time

from tricycle_bridge.bridge import Bridge
from tricycle_bridge.commands.command_stream import Source, VehicleCommand
from tricycle_bridge.protocol.boards import HALL_PULSE
from tricycle_bridge.protocol.messages import Board, Fault, PlcState, echo_of
from tricycle_bridge.settings import BridgeSettings
from tricycle_sim.plc import (
    DriveMeasurement,
    DriveOutput,
    DrivePlc,
    SteerMeasurement,
    SteerOutput,
    SteerPlc,
)

TICK_US = 10_000


class Line:
    """A line that damages a fraction of the frames and counts them; others pass unchanged."""

    def __init__(self, rng: random.Random, damage: float) -> None:
        self._rng = rng
        self.damage = damage
        self.frames = 0
        self.damaged = 0

    def carry(self, data: bytes) -> bytes:
        """Return the bytes as they arrive at the other end."""
        passed = []
        for frame in data.split(b"\0")[:-1]:
            self.frames += bool(frame)
            if frame and self._rng.random() < self.damage:
                self.damaged += 1
                k = self._rng.randrange(len(frame))
                other = self._rng.choice([v for v in range(1, 256) if v != frame[k]])
                passed.append(frame[:k] + bytes([other]) + frame[k + 1 :])
            else:
                passed.append(frame)
        return b"".join(frame + b"\0" for frame in passed)


class Rig:
    """Bridge, two PLCs, four one-way lines and a vehicle that follows its set-points."""

    def __init__(self, rng: random.Random, *, damage: float, start_us: int) -> None:
        self.bridge = Bridge(BridgeSettings(), rng=rng)
        self.bridge.active = True
        self.plcs: dict[Board, SteerPlc | DrivePlc] = {
            Board.STEER: SteerPlc(),
            Board.DRIVE: DrivePlc(),
        }
        self.down = {board: Line(rng, damage) for board in self.plcs}
        self.up = {board: Line(rng, damage) for board in self.plcs}
        self.start_us = start_us
        self.ticks = 0
        self.measured_steer = SteerMeasurement()
        self.measured_drive = DriveMeasurement()
        self.travel = 0.0  # m
        self.steer_output = SteerOutput(False, 0.0)
        self.drive_output = DriveOutput(False, 0.0, 1.0)
        self._tick_plcs()
        for board in self.plcs:
            self.bridge.opened(board, self.now)

    @property
    def now(self) -> float:
        """Host time, s."""
        return 1000.0 + self.ticks * TICK_US * 1e-6

    @property
    def now_us(self) -> int:
        """PLC time."""
        return self.start_us + self.ticks * TICK_US

    def step(self, command: VehicleCommand | None) -> None:
        """One tick of everything."""
        self.ticks += 1
        now = self.now
        if command is not None:
            self.bridge.set_command(command, stamp=now, now=now, source=Source.JOINT_COMMANDS)
        self.bridge.poll(now)
        for board, frames in self.bridge.take_frames().items():
            data = self.down[board].carry(b"".join(frames))
            answer = self.plcs[board].receive(data, self.now_us)
            self.bridge.receive(board, self.up[board].carry(answer), now)
        for board, telemetry in self._tick_plcs().items():
            self.bridge.receive(board, self.up[board].carry(telemetry), now)
        self.bridge.take_readings()
        self.bridge.take_log()
        for board, link in self.bridge.links.items():
            if link.wants_reopen:
                self.bridge.closed(board, "reopened")
                self.bridge.opened(board, now)

    def _tick_plcs(self) -> dict[Board, bytes]:
        steer, drive = self.plcs[Board.STEER], self.plcs[Board.DRIVE]
        assert isinstance(steer, SteerPlc)
        assert isinstance(drive, DrivePlc)
        steer_data, self.steer_output = steer.tick(self.now_us, self.measured_steer)
        drive_data, self.drive_output = drive.tick(self.now_us, self.measured_drive)
        if self.steer_output.servo_on:
            self.measured_steer = SteerMeasurement(self.steer_output.setpoint)
        speed = self.drive_output.setpoint if self.drive_output.motor_on else 0.0
        self.travel += speed * TICK_US * 1e-6
        gain = (speed - self.measured_drive.speed) / (TICK_US * 1e-6)
        torque = self.bridge.settings.mass * self.bridge.settings.tyre_radius * gain
        self.measured_drive = DriveMeasurement(speed, int(self.travel / HALL_PULSE), torque)
        return {Board.STEER: steer_data, Board.DRIVE: drive_data}

    def unsafe(self) -> str | None:
        """Return what must never happen, if it does."""
        moving = self.drive_output.motor_on and self.drive_output.setpoint != 0.0
        drive = self.plcs[Board.DRIVE]
        if moving and drive.state not in (PlcState.ARMED, PlcState.STOPPING):
            return f"motor on in {drive.state.name}"
        if abs(self.steer_output.setpoint) > 0.7855 or abs(self.drive_output.setpoint) > 4.801:
            return "a set-point outside the limits"
        return None


def soak(minutes: float, rng: random.Random) -> bool:
    """Drive for a time; True if nothing was unsafe and every counter adds up."""
    half_us = round(minutes * 30e6)
    rig = Rig(rng, damage=0.01, start_us=(1 << 32) - half_us)
    arms = stops = unsafe = 0
    armed_ticks = 0
    waiting = 0
    started = time.perf_counter()
    for tick in range(round(minutes * 6000)):
        t = tick * 0.01
        if rig.bridge.armed:
            armed_ticks += 1
            waiting = 0
            speed = 1.0 + 0.8 * math.sin(0.5 * t)
            rig.step(VehicleCommand(0.3 * math.sin(1.3 * t), speed))
        else:
            stops += waiting == 0 and tick > 100
            waiting += 1
            rig.step(VehicleCommand(0.0, 0.0))
            if waiting % 100 == 0 and not rig.bridge.refusal(rig.now):
                arms += 1
                rig.bridge.arm(rig.now, lambda _: None)
        unsafe += rig.unsafe() is not None
    for line in (*rig.down.values(), *rig.up.values()):
        line.damage = 0.0  # the last counters must arrive
    for _ in range(150):
        rig.step(VehicleCommand(0.0, 0.0))
    seconds = time.perf_counter() - started

    print(f"{minutes:g} min driven in {seconds:.0f} s ({minutes * 60 / seconds:.0f} x real time)")
    print(f"PLC clock            {rig.start_us} to {rig.now_us} us: wraps at {1 << 32}")
    print(f"echo at the end      {echo_of(rig.now_us)}")
    print(f"armed                {armed_ticks / (minutes * 6000):.1%} of the time")
    print(f"arm requests, stops  {arms}, {stops}")
    print(f"unsafe states        {unsafe}")
    adds_up = True
    print(f"{'line':14} {'sent':>8} {'good':>8} {'rejected':>8} {'damaged':>8} {'gaps':>8}")
    for board, plc in rig.plcs.items():
        link = rig.bridge.links[board]
        decoder = plc._decoder.counters  # noqa: SLF001 - beyond the 16 bits of STATS
        rows = (
            ("to", rig.down[board], decoder, plc.counters.seq_gap),
            ("from", rig.up[board], link.decoder.counters, link.counters.seq_gaps),
        )
        for way, line, counters, gaps in rows:
            sums = line.frames == counters.ok + counters.rejected
            sums &= counters.rejected == line.damaged
            adds_up &= sums
            verdict = "" if sums else "does not add up"
            print(
                f"{way + ' ' + board.name.lower():14} {line.frames:8} {counters.ok:8} "
                f"{counters.rejected:8} {line.damaged:8} {gaps:8} {verdict}"
            )
        adds_up &= plc.counters.stale == 0
    print(f"every counter adds up: {adds_up}")
    return adds_up and not unsafe


def watchdog_trips(trips: int, rng: random.Random) -> bool:
    """Stop the commander many times; True if every watchdog tripped after 200 to 210 ms."""
    ages = []
    for _ in range(trips):
        rig = Rig(rng, damage=0.0, start_us=rng.getrandbits(32))
        drive = rig.plcs[Board.DRIVE]
        while drive.state is not PlcState.ARMED:
            if rig.ticks % 20 == 10:
                rig.bridge.arm(rig.now, lambda _: None)
            rig.step(VehicleCommand(0.0, 0.0))
        # the last command comes at any moment between two ticks
        last_us = rig.now_us + rng.randrange(TICK_US)
        rig.bridge.set_command(
            VehicleCommand(0.001, 0.0),
            stamp=rig.now,
            now=rig.now + 0.01,
            source=Source.JOINT_COMMANDS,
        )
        frames = rig.bridge.take_frames()
        assert frames[Board.DRIVE]
        drive.receive(b"".join(frames[Board.DRIVE]), last_us)
        while not drive.faults & Fault.CMD_TIMEOUT:
            rig.ticks += 1
            assert isinstance(drive, DrivePlc)
            drive.tick(rig.now_us, rig.measured_drive)
        ages.append((rig.now_us - last_us) * 1e-3)
    print(f"watchdog trips       {trips}: {min(ages):.2f} to {max(ages):.2f} ms after the command")
    return min(ages) >= 200.0 and max(ages) <= 210.0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--trips", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    rng = random.Random(args.seed)
    tripped = watchdog_trips(args.trips, rng)
    return 0 if soak(args.minutes, rng) and tripped else 1


if __name__ == "__main__":
    raise SystemExit(main())
