"""The firmware in the loop: both images on simulated UNOs, driven by the bridge in 1 ms slices.

    make -C firmware avr simulator
    .venv/bin/python benchmarks/link_firmware.py --seconds 20

Prints how much faster than real time it runs, what the boards counted, and how long after the
commander's last message each watchdog tripped, on the board's clock.
"""

from __future__ import annotations

import argparse
import random
import time
from pathlib import Path

from tricycle_bridge.bridge import Bridge, BridgeSettings, Setpoint, Source
from tricycle_bridge.messages import Board, Fault
from tricycle_sim.simulated_avr import SimulatedUno


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

    def step(self, *, commanding: bool) -> None:
        """One millisecond of everything."""
        self.ms += 1
        for board, uno in self.unos.items():
            uno.run(self.ms * 1000)
            self.bridge.receive(board, uno.read(), self.now)
        self.bridge.poll(self.now)
        self.bridge.take_readings()
        self.bridge.take_messages()
        if commanding and self.ms % 10 == 0:
            self.bridge.set_command(
                Setpoint(0.0, 0.0), stamp=self.now, now=self.now, source=Source.JOINT_COMMANDS
            )
        for board, frames in self.bridge.take_frames().items():
            self.unos[board].write(b"".join(frames))

    def arm(self) -> None:
        """Stream standstill until both boards are armed."""
        while not self.bridge.armed:
            if self.ms % 500 == 0 and not self.bridge.refusal(self.now):
                self.bridge.arm(self.now, lambda *_: None)
            self.step(commanding=True)


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
        loop.step(commanding=True)
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
        telemetry = loop.bridge.links[Board.STEER].telemetry
        while telemetry is not None and not telemetry.faults & Fault.CMD_TIMEOUT:
            loop.step(commanding=False)
            before, telemetry = telemetry, loop.bridge.links[Board.STEER].telemetry
        # the age of the last command is told in whole ticks
        ages.append(before.command_age + 1)
        for _ in range(1500):
            loop.step(commanding=True)
    print(f"watchdog trips of the firmware: at a command age of {sorted(set(ages))} ticks of 10 ms")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
