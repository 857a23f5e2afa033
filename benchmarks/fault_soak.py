"""Random drives with one or two faults each: the vehicle must end at rest, in time.

    make -C firmware host avr simulator
    python benchmarks/fault_soak.py --drives 1000
    python benchmarks/fault_soak.py --drives 200 --backend native
    python benchmarks/fault_soak.py --drives 400 --healthy
    python benchmarks/fault_soak.py --seed 17                      # one drive again

Speed, steering, load (up to 30 kg), slope (up to 5 %), unknown parameters and faults are drawn from
the seed. A drive ends with one of the host's stops. Checked are, in every drive:

- rest within the published distance (tricycle_core/stopping.py) of the tick at which the drive
  board left ARMED, which it must within a published time of a fault that makes driving impossible
  (a sensor that stuck only for less is none: it shows the truth again);
- no movement after rest;
- the steering motor stays where it was when its board left ARMED, but for its lag, while the
  vehicle moves, and the servo has its pulses for as long, 10 s at most;
- no more than 0.5 m/s above the set-point or the speed at the fault.

A violation after a stop with a dead friction brake, or with neither motor nor brake, is a hazard,
not a failure: the published distances need the brake.
--healthy: the same drives without faults raise none and stay armed. Ends with status 1 on failures.
"""

from __future__ import annotations

import argparse
import functools
import math
import multiprocessing
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from stopping import BACKENDS, STOPS, check_built, make_rig

from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_bridge.protocol.boards import AT_REST
from tricycle_bridge.protocol.messages import Board, Fault, PlcState
from tricycle_bridge.settings import BridgeSettings
from tricycle_core.cores import usable_cores
from tricycle_core.stopping import BRAKED, DETECTION, LINE_DETECTION, MAX_PAYLOAD, RAMPED, Cause
from tricycle_sim.rig.faults import FaultKind, FaultPlan, RigFault
from tricycle_sim.rig.host import Host
from tricycle_sim.rig.rig import Rig
from tricycle_sim.vehicle import Vehicle, draw_truth, load_vehicle
from tricycle_sim.vehicle.payload import Payload, with_payload

GAIN = 0.5  # m/s above what was wanted
HELD = 0.15  # rad that the steering motor may move by: its lag behind its set-point at 2 rad/s
HOLDS = 9.9  # s that the servo has pulses after its board left ARMED, while the vehicle moves
RESTING = 0.5  # s of rest after which nothing may move
CREEP = 0.05  # m of movement after rest; the tyres creep 1 mm/s on 5 %
# the board sees that the wire is broken, whatever the wheel does
LINES = {FaultKind.HALL_OPEN, FaultKind.HALL_SHORT, FaultKind.DIRECTION_OPEN}
# these must stop the vehicle by themselves
STOPPING_FAULTS = {
    FaultKind.ESTOP,
    FaultKind.STEER_RESET,
    FaultKind.DRIVE_RESET,
    FaultKind.STEER_HANG,
    FaultKind.DRIVE_HANG,
    FaultKind.STEER_CABLE,
    FaultKind.DRIVE_CABLE,
    FaultKind.HOST_SILENT,
    FaultKind.POTENTIOMETER_LOW,
    FaultKind.POTENTIOMETER_HIGH,
    FaultKind.HALL_STUCK,
    *LINES,
}
# a board that was reset has forgotten what it held
LETTING_GO = {FaultKind.STEER_RESET, FaultKind.STEER_HANG, FaultKind.STEER_CABLE}
# with these the motor is dead or misled: in STOPPING only the friction brake counts
NO_RAMP = {
    FaultKind.MOTOR_DEAD,
    FaultKind.HALL_STUCK,
    FaultKind.HALL_HALF,
    FaultKind.DIRECTION_STUCK,
    *LINES,
}


@dataclass(frozen=True)
class Drive:
    """What is driven."""

    vehicle: Vehicle
    load: float  # kg
    slope: float
    speed: float  # m/s, negative backwards
    angle: float  # rad, amplitude of the steering motor
    period: float  # s, of the steering
    stop: Cause
    stop_at: float  # s after arming
    faults: tuple[RigFault, ...]  # times after arming

    def __str__(self) -> str:
        faults = "; ".join(
            f"{f.kind.value} at {f.start:.2f} s"
            + (f" to {f.end:.2f} s" if math.isfinite(f.end) else "")
            + (f" ({f.value:+.1f})" if f.value else "")
            for f in self.faults
        )
        return (
            f"{self.speed:+.2f} m/s, {self.load:.0f} kg, {100 * self.slope:+.1f} %, "
            f"{self.stop.value} at {self.stop_at:.2f} s; {faults or 'no fault'}"
        )


@dataclass(frozen=True)
class Outcome:
    """What came of it."""

    seed: int
    drive: str
    kinds: tuple[FaultKind, ...]
    failures: tuple[str, ...]
    hazards: tuple[str, ...]
    simulated: float  # s


def draw(seed: int, *, healthy: bool) -> Drive:
    """Draw a drive."""
    rng = np.random.default_rng(seed)
    vehicle = load_vehicle()
    vehicle = vehicle.replace(**draw_truth(vehicle, rng))
    load, slope = rng.uniform(0.0, MAX_PAYLOAD), rng.uniform(-0.05, 0.05)
    load = load if rng.random() < 0.7 else 0.0
    speed = rng.uniform(0.5, 4.8)
    backwards = rng.random() < 0.15
    speed = -min(speed, 1.5) if backwards else speed
    # a lateral acceleration of 1 m/s^2 at most
    angle = min(0.6, 1.4 / speed**2) * rng.random()
    stop_at = rng.uniform(1.0, abs(speed) + 3.0)
    kinds = rng.choice(np.array(list(FaultKind)), size=rng.integers(1, 3), replace=False)
    faults = tuple(draw_fault(kind, stop_at, rng) for kind in kinds)
    stop = rng.choice(np.array(list(STOPS)))
    vehicle = vehicle.replace(road_grade=math.atan(slope))
    return Drive(
        with_payload(vehicle, Payload(load, x=rng.uniform(-0.4, 0.2), z=rng.uniform(0.4, 0.8))),
        load,
        slope,
        speed,
        angle,
        rng.uniform(3.0, 8.0),
        stop,
        stop_at,
        () if healthy else faults,
    )


def draw_fault(kind: FaultKind, stop_at: float, rng: np.random.Generator) -> RigFault:
    """Draw the time of a fault: lasting, or mended after a while."""
    start = rng.uniform(0.0, stop_at + 1.0)
    lasts = math.inf if rng.random() < 0.6 else rng.uniform(0.1, 3.0)
    value = {
        FaultKind.DRIVE_SUPPLY: rng.choice([30.0, 58.0]),
        FaultKind.STEER_SUPPLY: rng.choice([7.0, 16.0]),
        FaultKind.HOST_CLOCK: rng.choice([-3.0, -0.5, 0.5, 3.0]),
    }.get(kind, 0.0)
    return RigFault(kind, start, start + lasts, float(value))


class Watch:
    """Follows a drive and notes what must not be."""

    def __init__(self, drive: Drive, rig: Rig) -> None:
        self.failures: list[str] = []
        self.hazards: list[str] = []
        self._drive, self._rig = drive, rig
        self._begun = rig.time
        self._way = 0.0
        self._faulted: tuple[RigFault, float, float] | None = None  # fault, way, speed
        self._left: tuple[float, float, float, bool] | None = None  # time, way, speed, ramped
        self._held: tuple[float, float] | None = None  # time, rad
        self._helpless = False  # no brake in a stop, or neither brake nor motor
        self._motorless = False  # there was a time in which the motor could not follow the ramp
        self._fastest = 0.0
        self._wanted = 0.0
        self._rest_since: float | None = None
        self._rested_at: float | None = None

    @property
    def rested(self) -> bool:
        """Whether the vehicle has come to rest, disarmed."""
        return self._rested_at is not None

    def note(self, what: str) -> None:
        """Note a violation, once."""
        notes = self.hazards if self._helpless else self.failures
        kind = what.split(":")[0]
        if not any(kind in noted for noted in self.failures + self.hazards):
            notes.append(f"{what} at {self._rig.time - self._begun:.2f} s")

    def look(self, setpoint: float) -> None:
        """Look at the vehicle after a tick."""
        rig = self._rig
        state, failing = rig.state, rig.active_faults
        motor = FaultKind.MOTOR_DEAD not in failing
        stopping = rig.plc_state(Board.DRIVE) is not PlcState.ARMED
        self._helpless |= FaultKind.BRAKE_DEAD in failing and (stopping or not motor)
        self._motorless |= bool(NO_RAMP & failing)
        speed = math.hypot(state.vx, state.vy)
        self._way += speed * 0.01
        elapsed = rig.time - self._begun
        for fault in self._drive.faults:
            if self._faulted is None and fault.kind in STOPPING_FAULTS and elapsed >= fault.start:
                self._faulted = (fault, self._way, speed) if self._left is None else None
        if not any(elapsed >= fault.start for fault in self._drive.faults):
            self._fastest = max(self._fastest, speed)
        self._wanted = max(self._wanted, abs(setpoint))
        if state.rolled_over:
            self.note("rolled over")
        if speed > max(self._wanted, self._fastest) + GAIN:
            self.note(f"too fast: {speed:.2f} m/s")
        self._look_at_the_stop(state.steering_motor_angle, speed)

    def _may_let_go(self) -> bool:
        """Whether the steer board was reset, or the sensor stuck when nobody could see that."""
        begun = [f for f in self._drive.faults if self._rig.time - self._begun >= f.start]
        left = math.inf if self._left is None else self._left[0] - self._begun
        return any(
            f.kind in LETTING_GO or (f.kind is FaultKind.HALL_STUCK and f.start > left - DETECTION)
            for f in begun
        )

    def _look_at_the_stop(self, angle: float, speed: float) -> None:
        rig, failing = self._rig, self._rig.active_faults
        drive_state = rig.plc_state(Board.DRIVE)
        if self._left is None and drive_state is not PlcState.ARMED:
            self._left = rig.time, self._way, speed, drive_state is PlcState.STOPPING
        if self._held is None and rig.plc_state(Board.STEER) is not PlcState.ARMED:
            self._held = rig.time, angle
        # a servo whose wire is mended goes to the set-point that its board holds
        by_wire = all(fault.kind is not FaultKind.SERVO_DEAD for fault in self._drive.faults)
        if by_wire and self._held is not None and speed > 0.1:
            since, at = self._held
            if abs(angle - at) > HELD:
                self.note(f"steering not held: by {angle - at:+.2f} rad")
            if not rig.steered and rig.time - since < HOLDS and not self._may_let_go():
                self.note(f"steering let go: at {speed:.2f} m/s")
        if self._left is not None and self._rested_at is None:
            _, way, at, ramped = self._left
            # an e-stop or a fault in STOPPING takes the motor away
            self._motorless |= drive_state is not PlcState.STOPPING and speed >= AT_REST
            law = RAMPED if ramped and not self._motorless else BRAKED
            allowed = law.distance(at) + (RAMPED.delay * at if ramped and law is BRAKED else 0.0)
            if self._way - way > allowed:
                self.note(f"too far: {self._way - way:.2f} m from {at:.2f} m/s")
        if self._faulted is not None and self._left is None:
            fault, way, at = self._faulted
            lasts = fault.kind is not FaultKind.HALL_STUCK or fault.kind in failing
            within = LINE_DETECTION if fault.kind in LINES else DETECTION
            if lasts and self._way - way > within * (at + GAIN) + 0.05:
                self.note(f"not stopped: by {fault.kind.value}")
        if speed >= AT_REST:
            self._rest_since = None
        elif self._rest_since is None:
            self._rest_since = rig.time
        if self._rested_at is None:
            at_rest = self._rest_since is not None and rig.time - self._rest_since >= RESTING
            if at_rest and self._left is not None:
                self._rested_at = self._way
        elif self._way - self._rested_at > CREEP:
            self.note("moved again: after rest")


def run(seed: int, backend: str, build: Path, *, healthy: bool) -> Outcome:
    """Drive one drive."""
    drive = draw(seed, healthy=healthy)
    armed_at = 2.0
    plan = FaultPlan(
        tuple(RigFault(f.kind, f.start + armed_at, f.end + armed_at, f.value) for f in drive.faults)
    )
    with make_rig(backend, drive.vehicle, build, plan) as rig:
        host = Host(rig, BridgeSettings(payload=MAX_PAYLOAD))
        host.arm()
        host.run(armed_at - rig.time)
        watch = Watch(drive, rig)
        raised = Fault(0)
        stopped = False
        for tick in range(round(100 * (drive.stop_at + 40.0))):
            elapsed = 0.01 * tick
            if not stopped and elapsed >= drive.stop_at:
                stopped = True
                if healthy and not rig.armed:
                    watch.failures.append(f"not armed any more at the end: {host.log[-1]}")
                STOPS[drive.stop](host)
            angle = drive.angle * math.sin(2.0 * math.pi * elapsed / drive.period)
            host.target = VehicleCommand(angle, drive.speed)
            host.tick()
            if not stopped:
                for board in Board.STEER, Board.DRIVE:
                    raised |= rig.plc_faults(board)
            watch.look(drive.speed)
            done = max([drive.stop_at, *(f.start for f in drive.faults)])
            if watch.rested and elapsed > done + 1.0:
                break
        else:
            watch.note("does not rest: 40 s after the stop")
        host.run(1.0)
        watch.look(drive.speed)
        if healthy and raised & ~Fault.LIMIT:
            watch.failures.append(f"raised {raised & ~Fault.LIMIT!r}")
        kinds = tuple(sorted((f.kind for f in drive.faults), key=lambda kind: kind.name))
        return Outcome(
            seed, str(drive), kinds, tuple(watch.failures), tuple(watch.hazards), rig.time
        )


def main() -> int:
    """Print failures, hazards and a summary."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--drives", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--seed", type=int, help="one drive")
    parser.add_argument("--backend", choices=BACKENDS, default="emulation")
    parser.add_argument("--build", type=Path, default=Path("build/firmware"))
    parser.add_argument("--healthy", action="store_true", help="no faults")
    parser.add_argument("--jobs", type=int, default=usable_cores())
    args = parser.parse_args()
    check_built(parser, [args.backend], args.build)
    one = functools.partial(run, backend=args.backend, build=args.build, healthy=args.healthy)
    seeds = range(args.first, args.first + args.drives) if args.seed is None else [args.seed]
    started = time.perf_counter()
    found: list[Outcome] = []
    with multiprocessing.Pool(min(args.jobs, len(seeds))) as pool:
        for outcome in pool.imap_unordered(one, seeds, chunksize=4):
            found.append(outcome)
            for text in outcome.failures:
                print(f"FAILED seed {outcome.seed}: {text} ({outcome.drive})", flush=True)
    hazards = Counter(
        " and ".join(kind.value for kind in outcome.kinds) for outcome in found if outcome.hazards
    )
    for kinds, count in sorted(hazards.items()):
        print(f"hazard, {count} drives: {kinds}")
    if args.seed is not None:
        print(found[0])
    failed = sum(bool(outcome.failures) for outcome in found)
    elapsed = time.perf_counter() - started
    print(
        f"{len(found)} drives on {args.backend}, {sum(o.simulated for o in found):.0f} s of "
        f"driving in {elapsed:.0f} s: {failed} failed, {sum(hazards.values())} hazards"
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
