"""Identification behind the own firmware: what intervals hold of vehicles driven by real code.

    make firmware && python benchmarks/firmware_world.py [--vehicles 4] [--firmware build/firmware]
    make -C firmware host && python benchmarks/firmware_world.py --native --vehicles 24

The firmware runs on simulated ATmega328P behind the live nodes: its servo loop, speed loop and
clocks are no part of the model. With `--native` its logic is compiled for this computer and driven
without nodes, which takes a second instead of half a minute a vehicle. Random vehicles drive a
circle and a double lane change; the two drives are identified without effects and with all of them
weighed. Printed for every vehicle: by how many standard deviations what is shown is off; for every
parameter and way: in how many vehicles it is shown, in how many of these the 95 % interval holds
the truth, and the median width in % of the range, and whether a coverage of 90 % is rejected
(held_intervals.py); then how often residuals were white (of the
channels whose residuals exceed the sensor's steps), what was told to be missing, and how probable
each effect was in the mean.
"""

import argparse
import dataclasses
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from held_intervals import Tally
from identification import MANEUVERS

from excitation_planner.design.noise import SIMULATED
from excitation_planner.planning import PlanRequest, plan_at
from excitation_planner.planning.replay import nominal_run
from parameter_identification.drives.measured import STAMP_JITTER, Sensor, Signal, resolved
from parameter_identification.drives.measured_from_bag import read_measured_drive
from parameter_identification.drives.samples import Samples
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from parameter_identification.identification import EFFECTS, identify
from tricycle_cli.operation.session import simulated_session
from tricycle_core.errors import ExcitationError
from tricycle_core.joints import REAR_WHEEL_JOINT, STEERING_JOINT
from tricycle_sim.rig.host import Host
from tricycle_sim.rig.native import NativeRig
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.constants import draw_truth

VEHICLE = load_vehicle()
NOISE = {  # what the nodes add
    Sensor.POSITION: SensorNoise(SIMULATED.noise_std, rate=100.0),
    Sensor.HEADING: SensorNoise(SIMULATED.heading_std, rate=100.0),
    Sensor.YAW_RATE: SensorNoise(SIMULATED.yaw_rate_std, rate=100.0),
    Sensor.LATERAL_ACCELERATION: SensorNoise(0.05, rate=100.0),
}
WAYS = {"none": {}, "weighed": {"effects": EFFECTS, "weighed": True}}


def drives_of(seed, firmware, folder):
    """The two drives of a random vehicle, from their bags."""
    drives = []
    with simulated_session(
        vehicle_file=None,
        true_seed=seed,
        noise_seed=seed,
        real_time_factor=2.0,
        folder=folder,
        firmware=firmware,
    ) as drive:
        for number, (family, x) in enumerate(MANEUVERS):
            request = PlanRequest(VEHICLE, family, "cornering_stiffness", noise=SIMULATED)
            bag = folder / f"drive_{number}"
            drive(plan_at(request, np.array(x)), bag, lambda *_: None)
            drives.append(read_measured_drive(bag, VEHICLE))
    return drives


def drives_on_nodes(seed, firmware):
    """The two drives of a random vehicle; begun anew where a busy machine ended one."""
    for _ in range(2):
        with tempfile.TemporaryDirectory() as folder:
            try:
                return drives_of(seed, firmware, Path(folder))
            except ExcitationError as error:
                print(f"vehicle {seed} once more: {error}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        return drives_of(seed, firmware, Path(folder))


def deviations(truth, identified):
    """By how many standard deviations each shown estimate is off, as a line."""
    shown = {n: e for n, e in identified.parameters.items() if e.identifiable}
    off = {n: (e.estimate - truth[n]) / (e.high - e.low) * 2 * 1.96 for n, e in shown.items()}
    return ", ".join(f"{name} {sigma:+.1f}" for name, sigma in off.items())


def native_drives_of(seed, firmware):
    """The two drives of a random vehicle, without nodes: the same noise as these add."""
    rng = np.random.default_rng(seed)
    truth = draw_truth(VEHICLE, rng)
    vehicle = dataclasses.replace(VEHICLE, values={**VEHICLE.values, **truth}, unknown={})
    drives = []
    for family, x in MANEUVERS:
        commands = nominal_run(VEHICLE, family, np.array(x)).commands
        with NativeRig(vehicle, firmware) as rig:
            drives.append(native_drive(rig, commands, rng, truth))
    return drives


def native_drive(rig, commands, rng, truth):
    """Drive commands on a rig and measure its motion; the wheel's speed is what the board reads."""
    host = Host(rig)
    host.arm()
    host.run(1.0)  # it stands
    start, rows, readings = host.now, [], []
    for _ in host.play(commands):
        s = rig.state
        row = (s.x, s.y, s.yaw, s.yaw_rate, s.drive_speed, s.specific_force[1])
        rows.append((host.now - start, *row))
        readings += host.readings
    time, x, y, yaw, yaw_rate, speed, sideways = np.array(rows).T
    motion = SensedMotion(
        time, x, y, np.unwrap(yaw), yaw_rate, speed, lateral_acceleration=sideways
    )
    drive = measure(motion, commands, NOISE, rng=rng, name=f"drive {len(rows)}", truth=truth)
    told = {REAR_WHEEL_JOINT: [], STEERING_JOINT: []}
    for reading in readings:
        for joint in reading.joints:
            told[joint.name].append((reading.stamp - start, joint.position, joint.velocity))
    tables = {name: np.array(rows) for name, rows in told.items()}
    wheel, steering = (t[np.append(True, np.diff(t[:, 0]) > 0)] for t in tables.values())
    steering = steering[(steering[:, 0] >= 0.0) & (steering[:, 0] <= commands.duration)]
    wheel = Signal(wheel[:, 0], wheel[:, 2:], STAMP_JITTER[Sensor.WHEEL_SPEED])
    signals = drive.signals | {Sensor.WHEEL_SPEED: resolved(wheel)}
    return dataclasses.replace(
        drive, signals=signals, steering_angle=Samples(steering[:, 0], steering[:, 1])
    )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--vehicles", type=int, default=4)
    parser.add_argument("--firmware", type=Path, default=Path("build/firmware"))
    parser.add_argument("--native", action="store_true", help="without nodes")
    arguments = parser.parse_args()
    found = {way: [] for way in WAYS}
    for seed in range(arguments.vehicles):
        if arguments.native:
            drives = native_drives_of(seed, arguments.firmware)
        else:
            drives = drives_on_nodes(seed, arguments.firmware)
        for way, options in WAYS.items():
            identified = identify(drives, VEHICLE, **options)
            found[way].append((drives[0].truth, identified))
            print(f"vehicle {seed} {way:8s} {deviations(drives[0].truth, identified)}", flush=True)
    for way, results in found.items():
        tally = Tally()
        for name, (low, high) in VEHICLE.unknown.items():
            intervals = [(truth[name], f.parameters[name]) for truth, f in results]
            shown = [(truth, e) for truth, e in intervals if e.identifiable]
            for truth, e in shown:
                tally.count(name, e.low <= truth <= e.high)
            held = tally.held.get(name, 0)
            width = np.median([(e.high - e.low) / (high - low) for _, e in intervals])
            print(
                f"{way:8s} {name:26s} shown {len(shown)} of {len(intervals)}, "
                f"held {held} of {len(shown)}, width {100 * width:5.1f} %"
            )
        print(f"{way:8s} {tally.summary()}")
        tested = [t for _, f in results for t in f.whiteness if np.isfinite(t.p)]
        white = 1.0 - sum(len(f.coloured) for _, f in results) / len(tested)
        missing = Counter(e.name for _, f in results for e in f.deviations)
        told = ", ".join(f"{name} {count}" for name, count in missing.items()) or "nothing"
        print(f"{way:8s} white {white:.0%} of {len(tested)} channels; told to be missing: {told}")
        acts = {}
        for _, f in results:
            for e in f.effects:
                acts.setdefault(e.name, []).append(e.acts)
        likely = {name: np.mean(p) for name, p in acts.items() if np.mean(p) > 0.05}
        print(f"{way:8s} acts with: {', '.join(f'{n} {p:.0%}' for n, p in likely.items())}")


if __name__ == "__main__":
    main()
