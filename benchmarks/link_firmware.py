"""The firmware in the loop: both images on simulated UNOs, driven by the bridge.

    make -C firmware avr simulator
    .venv/bin/python benchmarks/link_firmware.py --seconds 20

Prints how much faster than real time it runs, what the boards counted, how long after the
commander's last message each watchdog tripped, on the board's clock, and how far the vehicle that
the firmware drives gets from the one that the emulated PLCs drive, on a circle.
"""

from __future__ import annotations

import argparse
import random
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from excitation_planner.maneuver import Circle
from excitation_planner.planning.replay import nominal_run
from tricycle_bridge.bridge import Bridge
from tricycle_bridge.commands.command_stream import Source, VehicleCommand
from tricycle_bridge.protocol.messages import Board, Fault
from tricycle_bridge.settings import BridgeSettings
from tricycle_sim.commands import Commands
from tricycle_sim.plc.simulated_uno import SimulatedUno
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.rig.firmware import FirmwareRig
from tricycle_sim.rig.rig import Rig
from tricycle_sim.setpoints import command_rows
from tricycle_sim.vehicle import load_vehicle


class Loop:
    """Bridge and two UNOs on a bench: the steering follows, the wheel stands."""

    def __init__(self, build: Path) -> None:
        self.bridge = Bridge(BridgeSettings(), rng=random.Random(0))
        self.bridge.active = True
        self.unos = {board: SimulatedUno(build, board.name.lower()) for board in self.bridge.links}
        self.ms = 0
        for board in self.unos:
            self.bridge.opened(board, self.now)

    @property
    def now(self) -> float:
        """Host time, s."""
        return 100.0 + self.ms * 1e-3

    def step(self, speed: float | None) -> None:
        """One millisecond of everything; None: the commander is silent."""
        self.ms += 1
        for board, uno in self.unos.items():
            uno.run(self.ms * 1000)
            self.bridge.receive(board, uno.read(), self.now)
        self.bridge.poll(self.now)
        self.bridge.take_readings()
        self.bridge.take_log()
        if speed is not None and self.ms % 10 == 0:
            self.bridge.set_command(
                VehicleCommand(0.0, speed),
                stamp=self.now,
                now=self.now,
                source=Source.JOINT_COMMANDS,
            )
        for board, frames in self.bridge.take_frames().items():
            self.unos[board].write(b"".join(frames))

    def arm(self) -> None:
        """Stream standstill until both boards are armed."""
        while not self.bridge.armed:
            if self.ms % 500 == 0 and not self.bridge.refusal(self.now):
                self.bridge.arm(self.now, lambda _: None)
            self.step(0.0)


def drive(simulator: Rig, commands: Commands) -> tuple[NDArray[np.float64], dict[Board, int]]:
    """Arm, then drive.

    Returns x, y (m), steering angle (rad) and way of the rear wheel (rad), (t, 4), and each board's
    longest tick in us.
    """
    bridge = Bridge(BridgeSettings(), rng=random.Random(0))
    bridge.active = True
    for board in bridge.links:
        bridge.opened(board, 0.0)

    def tick(angle: float, speed: float) -> None:
        now = simulator.time
        command = VehicleCommand(angle, speed)
        bridge.set_command(command, stamp=now, now=now, source=Source.JOINT_COMMANDS)
        bridge.poll(now)
        for board, frames in bridge.take_frames().items():
            bridge.receive(board, simulator.receive(board, b"".join(frames)), now)
        for board, data in simulator.step().items():
            bridge.receive(board, data, simulator.time)
        bridge.take_readings()
        bridge.take_log()

    for k in range(200):
        if k == 100:
            bridge.arm(simulator.time, lambda _: None)
        tick(0.0, 0.0)
    rows = []
    for row in command_rows(commands):
        tick(float(commands.steering_motor_angle[row]), float(commands.speed[row]))
        state = simulator.state
        rows.append((state.x, state.y, state.steering_motor_angle, state.drive_angle))
    ticks = {b: link.stats.max_tick for b, link in bridge.links.items() if link.stats is not None}
    return np.array(rows), ticks


def compare_with_the_emulation(build: Path) -> None:
    """Drive the same commands on the firmware and on the emulated PLCs; print the differences."""
    vehicle = load_vehicle()
    radius, speed = 2.4, 1.0
    commands = nominal_run(vehicle, Circle(), np.array([radius, speed])).commands
    emulated, _ = drive(EmulatedRig(vehicle), commands)
    simulator = FirmwareRig(vehicle, build)
    started = time.perf_counter()
    firmware, ticks = drive(simulator, commands)
    factor = simulator.time / (time.perf_counter() - started)
    simulator.close()
    difference = firmware - emulated
    distance = 1e3 * np.hypot(difference[:, 0], difference[:, 1])
    angle, way = 1e3 * difference[:, 2], 1e3 * vehicle.tyre_radius * difference[:, 3]
    print(f"circle of {radius} m at {speed} m/s with the vehicle: {factor:.1f} x real time")
    longest = ", ".join(f"{board.name.lower()} {tick} us" for board, tick in ticks.items())
    print(f"longest tick while driving, of 10000 us: {longest}")
    print(
        f"firmware against emulation: rms {np.sqrt(np.mean(distance**2)):.1f} mm, largest "
        f"{distance.max():.1f} mm; steering angle rms {np.sqrt(np.mean(angle**2)):.3f} mrad; way "
        f"of the wheel at the end {way[-1]:+.1f} mm, largest {np.abs(way).max():.1f} mm"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--build", type=Path, default=Path("build/firmware"))
    parser.add_argument("--seconds", type=int, default=20)
    parser.add_argument("--trips", type=int, default=5)
    args = parser.parse_args()
    loop = Loop(args.build)
    for uno in loop.unos.values():
        uno.steering_angle(0.0)
    loop.arm()
    start = time.perf_counter()
    for _ in range(args.seconds * 1000):
        loop.step(0.0)
    factor = args.seconds / (time.perf_counter() - start)
    print(f"{args.seconds} s of both boards under 100 Hz of commands: {factor:.1f} x real time")
    for board, link in loop.bridge.links.items():
        stats = link.stats
        if stats is not None:
            print(
                f"{board.name.lower()}: longest tick {stats.max_tick} us, ok {stats.ok}, crc "
                f"{stats.crc}, stale {stats.stale}, overruns {stats.rx_overrun} of the line and "
                f"{stats.tick_overrun} of the tick; host rejected {link.decoder.counters.rejected}"
            )
    ages = []
    for _ in range(args.trips):
        loop.arm()
        for _ in range(100):  # silence stops who was to move; slow: the wheel of this bench stands
            loop.step(0.03)
        telemetry = loop.bridge.links[Board.STEER].telemetry
        while telemetry is not None and not telemetry.faults & Fault.CMD_TIMEOUT:
            loop.step(None)
            before, telemetry = telemetry, loop.bridge.links[Board.STEER].telemetry
        # the age of the last command is told in whole ticks
        ages.append(before.command_age + 1)
        for _ in range(1500):
            loop.step(0.0)
    print(f"watchdog trips of the firmware: at a command age of {sorted(set(ages))} ticks of 10 ms")
    compare_with_the_emulation(args.build)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
