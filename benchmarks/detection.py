"""How long the drive board takes to notice that hall sensor or motor fails, and what it costs.

    make -C firmware host
    python benchmarks/detection.py

Each fault begins while the vehicle rests, armed, or while it drives at its set-point, straight on;
empty and with 30 kg, on slopes of -5, 0 and +5 %. Printed are, for each fault and set-point, the
longest time until the drive board leaves ARMED (at rest: from the command to move) and the largest
speed above the set-point until then. A motor that fails is a fault only where the vehicle then
gains speed. Ends with status 1 where a wire of the hall sensor takes longer than is published
(tricycle_core/stopping.py), or the vehicle gains more than 0.5 m/s otherwise than by a
sensor that is stuck from the start where there is neither odometry nor IMU: torque and pulses do
not show it earlier.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import math
import multiprocessing
import sys
from pathlib import Path
from typing import NamedTuple

from stopping import BACKENDS, LOAD, SLOPES, check_built, make_rig

from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_bridge.protocol.messages import Board, PlcState
from tricycle_bridge.settings import BridgeSettings
from tricycle_core.cores import usable_cores
from tricycle_core.stopping import LINE_DETECTION, MAX_PAYLOAD
from tricycle_sim.rig.faults import FaultKind, FaultPlan, RigFault
from tricycle_sim.rig.host import Host
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.payload import with_payload

ARMED = 2.0  # s after which the vehicle is commanded to move
DRIVING = 8.0  # s later a fault on the way begins
GAIN = 0.5  # m/s
SPEEDS = (0.25, 1.0, 4.0)
# alone, and with what the host compares the wheel with
FAULTS = (
    (FaultKind.HALL_OPEN, ""),
    (FaultKind.HALL_STUCK, ""),
    (FaultKind.HALL_STUCK, "odometry"),
    (FaultKind.HALL_STUCK, "IMU"),
    (FaultKind.MOTOR_DEAD, ""),
)


class Case(NamedTuple):
    """One drive."""

    kind: FaultKind
    beside: str
    at_rest: bool
    speed: float  # m/s
    loaded: bool
    slope: float


def run(case: Case, backend: str, build: Path) -> tuple[float, float]:
    """Return time in which ARMED is left [s], nan if not, and speed above the set-point [m/s]."""
    vehicle = load_vehicle().replace(road_grade=math.atan(case.slope))
    vehicle = with_payload(vehicle, LOAD) if case.loaded else vehicle
    start = ARMED if case.at_rest else ARMED + DRIVING
    plan = FaultPlan((RigFault(case.kind, start),))
    with make_rig(backend, vehicle, build, plan) as rig:
        host = Host(rig, BridgeSettings(payload=MAX_PAYLOAD))
        host.odometry, host.imu = case.beside == "odometry", case.beside == "IMU"
        host.arm()
        host.run(ARMED - rig.time)
        host.target = VehicleCommand(0.0, case.speed)
        host.run(start - rig.time)
        fastest = 0.0
        for tick in range(1500):
            if rig.plc_state(Board.DRIVE) is not PlcState.ARMED:
                return 0.01 * tick, fastest - case.speed
            host.tick()
            fastest = max(fastest, rig.state.vx)
        return math.nan, fastest - case.speed


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--backend", choices=BACKENDS, default="native")
    parser.add_argument("--build", type=Path, default=Path("build/firmware"))
    parser.add_argument("--jobs", type=int, default=usable_cores())
    args = parser.parse_args()
    check_built(parser, [args.backend], args.build)
    cases = [
        Case(*fault, *rest)
        for fault, *rest in itertools.product(FAULTS, (True, False), SPEEDS, (False, True), SLOPES)
    ]
    one = functools.partial(run, backend=args.backend, build=args.build)
    with multiprocessing.Pool(args.jobs) as pool:
        found = dict(zip(cases, pool.map(one, cases, chunksize=1), strict=True))
    failed = False
    print("| fault | where | set-point | found after at most | most above the set-point |")
    print("|---|---|---|---|---|")
    for fault, at_rest, speed in itertools.product(FAULTS, (True, False), SPEEDS):
        kind, beside = fault
        of = [found[case] for case in cases if case[:4] == (kind, beside, at_rest, speed)]
        times = [time for time, _ in of if not math.isnan(time)]
        gain = max(gain for _, gain in of)
        after = f"{max(times):.2f} s" if times else "not"
        what = f"{kind.value}, {beside}" if beside else kind.value
        where = "at rest" if at_rest else "on the way"
        print(f"| {what} | {where} | {speed:g} m/s | {after} | {max(gain, 0.0):.2f} m/s |")
        failed |= kind is FaultKind.HALL_OPEN and not (times and max(times) <= LINE_DETECTION)
        hidden = kind is FaultKind.HALL_STUCK and at_rest and not beside
        failed |= gain > GAIN and not hidden
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
