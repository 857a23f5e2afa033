"""The trial: vehicles that are not our model, identified from designed, ISO-like and random drives.

    python benchmarks/plants.py [--plant mujoco ...] [--sets 20] [--effects weighed] [--ways ...]
    python benchmarks/plants.py --bound [--plant ...] [--effects ...]
    python benchmarks/plants.py --stiffness [--sets ...] [--effects ...]
    python benchmarks/plants.py --pace
    python benchmarks/plants.py --draw PRINTED FIGURE

Each plant is driven by the emulated boards. A set is a step steer and a sine sweep of 12 s each;
position (1 cm), gyro (5 mrad/s) and wheel speed (3 mrad/s) come at 20 Hz. Our model, with
the vehicle file's linear tyres, is fitted to each set. Three drives of other kinds (circle, double
lane change, slalom) are then predicted from their commands and their start alone, nothing of them
is fitted. The prediction has all that was identified, the dead times and the localisation's delay
too (the mean of the set's drives). Printed: the RMS distance of predicted and true position over
the three, median and quartiles over the sets, and the intervals of the yaw inertia, for

guess     the vehicle file, nothing fitted
ISO       both maneuvers in the middle of their boxes; sets differ by their noise
random    both maneuvers drawn from their boxes; sets differ by that and their noise
designed  planned as one set by criterion d; sets differ by their noise
counted   the same, counting effects (`tricycle plan --effects all`)
again     planned with the vehicle, its effects too, that ISO-like drives showed

The tricycle's ranges are wider than its file's: of a vehicle that is not our model less is known.
For `mujoco` the file's lateral relaxation length is corrected from 0.2 to 0.02 m: identification
holds this effect at an end of what is possible and asks for it, as in `make rehearsal`.
`own` is a control: our model with true values drawn from the file's ranges.
--effects  none, or weighed, as `tricycle identify` does by default
--ways     some of these rows only
--bound    only the guess, and our model fitted to the drives to predict themselves
--stiffness  only the car's cornering stiffness, identified, over its tyres' slope at no slip
--pace     only how fast each plant runs
--draw     a figure of the medians and quartiles that a run printed
"""

import argparse
import dataclasses
import functools
import multiprocessing
import re
import time
from concurrent.futures import ProcessPoolExecutor
from importlib.resources import files
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from excitation_planner import Criterion
from excitation_planner.box import Box
from excitation_planner.design.noise import MeasurementNoise
from excitation_planner.maneuver import Circle, DoubleLaneChange, Slalom
from excitation_planner.maneuver.steering import SineSweep, StepSteer
from excitation_planner.planning import PlanRequest, plan_set, random_feasible_point
from excitation_planner.planning.replay import nominal_run
from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from parameter_identification.identification import identify
from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_bringup.configuration import bridge_settings
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.effects import (
    DRIVE_DEAD_TIME,
    EFFECTS,
    SERVO_DEAD_TIME,
    corrected,
)
from tricycle_sim.plants import OWN
from tricycle_sim.plants.installed import plant_by_name
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.rig.host import Host
from tricycle_sim.setpoints import command_rows
from tricycle_sim.vehicle import draw_truth, load_vehicle
from tricycle_sim.vehicle.batch import CommandedBatch

WAYS = ("ISO", "random", "designed", "counted", "again")
DRAWN = {
    "guess": "the vehicle file",
    "ISO": "middle of the boxes",
    "random": "random",
    "designed": "designed",
    "counted": "designed,\neffects counted",
    "again": "designed with what\nthe middle showed",
}
"""Names of the rows in the figure."""
DURATION = 12.0  # s of every drive that is fitted
SENSORS = {
    Sensor.POSITION: SensorNoise(0.01),
    Sensor.YAW_RATE: SensorNoise(0.005),
    Sensor.WHEEL_SPEED: SensorNoise(0.003),
}
NOISE = MeasurementNoise(yaw_rate_std=0.005)


@dataclasses.dataclass(frozen=True)
class Trial:
    """A vehicle file, two families to learn from, three drives to predict, and the file before."""

    vehicle: object
    learnt: tuple
    predicted: tuple
    guess: object


PAPERS = load_vehicle()
WIDER = {
    "cornering_stiffness": (300.0, 4000.0),
    "camber_stiffness": (0.0, 100.0),
    "self_aligning_stiffness": (0.0, 0.6),
    "rolling_coefficient_1": (0.001, 0.04),
}
TRICYCLE = Trial(
    dataclasses.replace(PAPERS, unknown={**PAPERS.unknown, **WIDER}),
    (StepSteer(duration=DURATION), SineSweep(duration=9.0)),
    (
        (Circle(duration=12.0), (3.0, 1.0)),
        (DoubleLaneChange(), (5.0, 5.0)),
        (Slalom(), (4.0, 0.5)),
    ),
    PAPERS,
)
BMW = load_vehicle(files("tricycle_sim") / "plants" / "bmw_320i.yaml")
CAR = Trial(
    BMW,
    (
        StepSteer(Box.of({"angle": (0.05, 0.45), "speed": (1.5, 4.5)}), duration=DURATION),
        SineSweep(
            Box.of({"amplitude": (0.03, 0.2), "frequency": (0.25, 0.5)}), 0.1, 9.0, speed=4.0
        ),
    ),
    (
        (Circle(duration=12.0), (14.0, 3.5)),
        (DoubleLaneChange(length=30.0, speed=4.0), (14.0, 14.0)),
        (Slalom(speed=3.0), (14.0, 0.7)),
    ),
    BMW,
)
WITHOUT_RELAXATION = dataclasses.replace(  # as `tricycle identify` asks for after ISO-like drives
    TRICYCLE, vehicle=TRICYCLE.vehicle.replace(lateral_relaxation_length=0.02)
)
TRIALS = {"mujoco": WITHOUT_RELAXATION, "commonroad": CAR, OWN: TRICYCLE}


def true_vehicle(name):
    vehicle = TRIALS[name].vehicle
    if name == OWN:
        vehicle = vehicle.replace(**draw_truth(PAPERS, np.random.default_rng(1)))
    return vehicle


def plant_of(name):
    return plant_by_name(name, true_vehicle(name))


def true_yaw_inertia(name):
    if name == "commonroad":
        from vehiclemodels.parameters_vehicle2 import parameters_vehicle2

        return parameters_vehicle2().I_z / 20  # as the vehicle file's masses
    return true_vehicle(name).yaw_inertia


def lasting(commands):
    """The commands, cut or held to the duration."""
    rows = command_rows(commands)[: round(DURATION / TICK)]
    rows = np.concatenate([rows, np.full(round(DURATION / TICK) + 1 - len(rows), rows[-1])])
    return Commands(
        TICK * np.arange(len(rows)), commands.steering_motor_angle[rows], commands.speed[rows]
    )


def driven(plant, vehicle, commands):
    """The true motion of a plant whose boards get the commands, after they have armed."""
    host = Host(rig := EmulatedRig(vehicle, plant=plant), bridge_settings(vehicle))
    host.arm()
    start, motion = rig.time, []

    def look():
        s = rig.state
        motion.append((rig.time - start, s.x, s.y, s.yaw, s.yaw_rate, s.drive_speed))

    look()
    for _ in host.play(commands):
        look()
    when, x, y, heading, *rest = np.array(motion).T
    return SensedMotion(when, x, y, np.unwrap(heading), *rest)


@dataclasses.dataclass(frozen=True)
class Known:
    """What is known of a vehicle: its constants, dead times, and how late it is located [s].

    And the estimates of its parameters.
    """

    vehicle: object
    servo_dead_time: float = 0.0
    drive_dead_time: float = 0.0
    pose_delay: float = 0.0
    parameters: dict = dataclasses.field(default_factory=dict)


def distance(known, commands, motion):
    """RMS distance [m] of the predicted way from a motion."""
    batch = CommandedBatch(known.vehicle, commands)
    point = known.vehicle.nominal_point()[np.newaxis]
    run = batch.run(
        point,
        ("x", "y"),
        steering_delay=np.array([known.servo_dead_time]),
        drive_delay=known.drive_dead_time,
    )
    time = motion.time[motion.time <= batch.time[-1]]
    x, y = (
        np.interp(time - known.pose_delay, batch.time, run.columns[name][0]) for name in ("x", "y")
    )
    squares = (x - motion.x[: len(time)]) ** 2 + (y - motion.y[: len(time)]) ** 2
    return float(np.sqrt(squares.mean()))


def identified(vehicle, motions, all_commands, seed, weighed):
    """The best fit: parameters, effects, and the localisation's delay, their mean.

    Parameters that are not shown too: what is shown was estimated together with them.
    """
    rng = np.random.default_rng([seed, 7])
    drives = [
        measure(motion, commands, SENSORS, rng=rng, name=f"drive {i}")
        for i, (motion, commands) in enumerate(zip(motions, all_commands, strict=True))
    ]
    effects = EFFECTS if weighed else ()
    found = identify(drives, vehicle, effects=effects, weighed=weighed, starts=2)
    values = {name: e.estimate for name, e in found.parameters.items()}
    estimates = {e.name: e.estimate for e in found.effects if not e.drive}
    of_vehicle = {n: v for n, v in estimates.items() if n != SERVO_DEAD_TIME}
    return Known(
        corrected(vehicle, of_vehicle)[0].replace(**values),
        estimates.get(SERVO_DEAD_TIME, 0.0),
        estimates.get(DRIVE_DEAD_TIME, 0.0),
        float(np.mean([drive.nuisances["pose delay"].estimate for drive in found.drives])),
        dict(found.parameters),
    )


def points(trial, way, seed):
    """Operation parameters of both maneuvers."""
    if way == "ISO":
        return [family.operation.from_unit(np.full(2, 0.5)) for family in trial.learnt]
    rng = np.random.default_rng([seed, 5])
    target = next(iter(trial.vehicle.unknown))
    return [
        random_feasible_point(PlanRequest(trial.vehicle, family, target), rng)
        for family in trial.learnt
    ]


def designed(trial, effects):
    first, *others = trial.learnt
    target = next(iter(trial.vehicle.unknown))
    request = PlanRequest(
        *(trial.vehicle, first, target, Criterion.D, tuple(others)),
        budget=8000,
        noise=NOISE,
        effects=effects,
    )
    return [np.array(list(plan.operation.values())) for plan in plan_set(request)]


def points_of_all(name, way, weighed):
    """Operation parameters of both maneuvers that all sets have in common; None if none."""
    trial = TRIALS[name]
    if way == "again":
        commands, motions = learnt(name, hashable(points(trial, "ISO", 0)))
        known = identified(trial.vehicle, motions, commands, 0, weighed)
        trial = dataclasses.replace(trial, vehicle=known.vehicle)
    if way in ("designed", "counted", "again"):
        return hashable(designed(trial, EFFECTS if way == "counted" else ()))
    return None


def hashable(points):
    return tuple(tuple(one.tolist()) for one in points)


def errors(name, known):
    """RMS distance of each drive to predict [m]."""
    to_predict, truths = held_out(name)
    return [distance(known, c, m) for c, m in zip(to_predict, truths, strict=True)]


@functools.cache
def held_out(name):
    """Commands and true motions of the drives to predict."""
    trial = TRIALS[name]
    commands = [nominal_run(trial.vehicle, f, np.array(x)).commands for f, x in trial.predicted]
    plant = plant_of(name)
    return commands, [driven(plant, trial.vehicle, each) for each in commands]


@functools.cache
def learnt(name, x):
    """Commands and true motions of the maneuvers with operation parameters x."""
    trial = TRIALS[name]
    commands = [
        lasting(nominal_run(trial.vehicle, family, np.array(one)).commands)
        for family, one in zip(trial.learnt, x, strict=True)
    ]
    plant = plant_of(name)
    return commands, [driven(plant, trial.vehicle, each) for each in commands]


def one_set(job):
    """Errors of the predictions by one set, its yaw inertia, and its operation parameters."""
    name, way, seed, weighed, x = job
    trial = TRIALS[name]
    if x is None:
        x = hashable(points(trial, way, seed))
    commands, motions = learnt(name, x)
    known = identified(trial.vehicle, motions, commands, seed, weighed)
    return errors(name, known), known.parameters["yaw_inertia"], x


def try_plant(name, sets, weighed, processes, ways):
    trial = TRIALS[name]
    kinds = [family.name for family, _ in trial.predicted]
    rows, inertias = {"guess": np.array([errors(name, Known(trial.guess))])}, {}
    print(f"{name}, {sets} sets, effects {'weighed' if weighed else 'none'}", flush=True)
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        for way in ways:
            x = points_of_all(name, way, weighed)
            jobs = [(name, way, seed, weighed, x) for seed in range(sets)]
            results, inertias[way], points_of = zip(*pool.map(one_set, jobs), strict=True)
            rows[way] = np.array(results)
            if way != "random":
                print(f"  {way}: {', '.join(str(np.round(one, 3)) for one in points_of[0])}")
    print("  RMS distance, mm: median (quartiles); of each kind")
    tell(rows, kinds)
    truth = true_yaw_inertia(name)
    print(f"  yaw inertia, {truth:.1f} kg m^2 in the plant")
    for way, found in inertias.items():
        shown = [e for e in found if e.identifiable]
        held = sum(e.low <= truth <= e.high for e in shown)
        wide = 1e2 * np.median([(e.high - e.low) / truth for e in found])
        print(
            f"  {way:9s} shown {len(shown)} of {sets}, held {held} of {len(shown)}, "
            f"median width {wide:.0f} % of it",
            flush=True,
        )


def tell(rows, kinds):
    """Print errors (sets, kinds) by way, and how often one way is better than another."""
    whole = {way: np.sqrt((each**2).mean(axis=1)) for way, each in rows.items()}
    for way, each in rows.items():
        low, middle, high = 1e3 * np.percentile(whole[way], [25, 50, 75])
        of_kinds = ", ".join(
            f"{kind} {value:.0f}"
            for kind, value in zip(kinds, 1e3 * np.median(each, axis=0), strict=True)
        )
        print(f"  {way:9s} {middle:7.0f} ({low:.0f} to {high:.0f}); {of_kinds}", flush=True)
    median = {way: np.median(each) for way, each in whole.items()}
    for way, at in median.items():
        ratios = (f"{at / other:.2f} by {best}" for best, other in median.items() if best != way)
        print(f"  {way}: {', '.join(ratios)}", flush=True)


def bound(name, weighed):
    """Print how well the drives to predict are predicted by what is fitted to themselves."""
    vehicle = TRIALS[name].vehicle
    commands, motions = held_out(name)
    known = identified(vehicle, motions, commands, 0, weighed)
    guess, fitted = (
        1e3 * float(np.sqrt(np.mean(np.square(errors(name, one)))))
        for one in (Known(TRIALS[name].guess), known)
    )
    print(
        f"{name}, effects {'weighed' if weighed else 'none'}: RMS distance {guess:.0f} mm by the "
        f"guess, {fitted:.0f} mm fitted to the drives themselves",
        flush=True,
    )


def stiffness(sets, weighed):
    """Print the car's stiffnesses that sets of drives show over those of the authors' tyres."""
    from vehiclemodels.parameters_vehicle2 import parameters_vehicle2

    trial, slope = TRIALS["commonroad"], -parameters_vehicle2().tire.p_ky1  # per load, 1/rad
    values = trial.vehicle.values
    length = values["com_to_front_axle"] + values["com_to_rear_axle"]
    weight = values["mass"] * values["gravity"]
    print(f"commonroad, {sets} sets, effects {'weighed' if weighed else 'none'}")
    for way in ("ISO", "random"):
        ratios, shown, held = [], 0, 0
        for seed in range(sets):
            x = hashable(points(trial, way, seed))
            known = identified(trial.vehicle, *reversed(learnt("commonroad", x)), seed, weighed)
            ratios.append([])
            for axle, other in (("front", "rear"), ("rear", "front")):
                truth = slope * 0.5 * weight * values[f"com_to_{other}_axle"] / length
                e = known.parameters[f"{axle}.cornering_stiffness"]
                ratios[-1].append(e.estimate / truth)
                shown += e.identifiable
                held += e.identifiable and e.low <= truth <= e.high
        low, middle, high = np.percentile(ratios, [25, 50, 75], axis=0)
        print(
            f"  {way:6s} "
            + ", ".join(
                f"{axle} {m:.2f} ({lo:.2f} to {hi:.2f})"
                for axle, lo, m, hi in zip(("front", "rear"), low, middle, high, strict=True)
            )
            + f"; shown {shown} of {2 * sets}, held {held} of {shown}",
            flush=True,
        )


def pace(name):
    """Print how fast a plant runs with both emulated boards and the bridge, on one core."""
    vehicle = TRIALS[name].vehicle
    host = Host(EmulatedRig(vehicle, plant=plant_of(name)), bridge_settings(vehicle))
    host.arm()
    host.target = VehicleCommand(0.2, 2.0)
    host.run(4.0)  # at speed
    begin = time.perf_counter()
    host.run(5.0)
    print(f"{name}: times real time {5.0 / (time.perf_counter() - begin):.1f}", flush=True)


def draw(printed, figure):
    """Draw medians and quartiles of the trial from what it printed."""
    trials = {}
    for line in printed.read_text().splitlines():
        if start := re.match(r"(\w+), (\d+) sets, effects (\w+)", line):
            rows = trials[start.group()] = {}
        elif row := re.match(r"  (\w+) +(\d+) \((\d+) to (\d+)\)", line):
            rows[row[1]] = [float(number) for number in row.groups()[1:]]
    canvas = Figure(figsize=(9.0, 3.2), layout="constrained")
    panels = canvas.subplots(1, len(trials), sharey=True, squeeze=False)[0]
    for axes, (title, rows) in zip(panels, trials.items(), strict=True):
        middle, low, high = np.array(list(rows.values())).T
        names = [DRAWN[way] for way in rows]
        axes.errorbar(middle, names, xerr=[middle - low, high - middle], fmt="o", capsize=4)
        axes.set(title=title, xlabel="RMS distance of prediction and truth / mm", xlim=(0, None))
        axes.grid(axis="x", alpha=0.3)
    panels[0].invert_yaxis()  # of all
    canvas.savefig(figure)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--plant", choices=TRIALS, nargs="+", default=list(TRIALS))
    parser.add_argument("--sets", type=int, default=20)
    parser.add_argument("--ways", choices=WAYS, nargs="+", default=WAYS)
    parser.add_argument("--effects", choices=("none", "weighed"), default="weighed")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--bound", action="store_true")
    parser.add_argument("--stiffness", action="store_true")
    parser.add_argument("--pace", action="store_true")
    parser.add_argument("--draw", type=Path, nargs=2)
    arguments = parser.parse_args()
    if arguments.draw:
        draw(*arguments.draw)
        return
    weighed = arguments.effects == "weighed"
    if arguments.stiffness:
        stiffness(arguments.sets, weighed)
        return
    for name in arguments.plant:
        if arguments.pace:
            pace(name)
        elif arguments.bound:
            bound(name, weighed)
        else:
            try_plant(*(name, arguments.sets, weighed, arguments.processes, arguments.ways))


if __name__ == "__main__":
    main()
