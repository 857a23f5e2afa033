"""Identification against known truth: bias, error and coverage; model errors; time.

    python benchmarks/identification.py [--vehicles 1000] [--part coverage|bags|model|time ...]

coverage  random vehicles drive a circle and a double lane change, position at 20 Hz with 1 and 3 cm
          of white noise; start pose and speed, delay and noise are estimated too. Printed for every
          parameter: bias and RMS error in % of the range, with standard errors, and how many of the
          95 % intervals hold the truth, over all vehicles and over those whose drives show it.
bags      the same for a quarter of the vehicles with what a bag holds: position (1 cm), heading
          (2 mrad) and gyro (5 mrad/s) at 100 Hz, and a wheel speed whose only noise is its rounding
          to 1 mm/s, as the drive PLC tells it.
model     the vehicle that drives has an effect that the model lacks; how often the residuals are
          told to be not white, and how often those of a vehicle without any are.
time      one identification of two drives and six parameters, with and without profiles.
"""

import argparse
import dataclasses
import time
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from excitation_planner.maneuver import Circle, DoubleLaneChange
from excitation_planner.planning.replay import nominal_run
from parameter_identification.drives.measured import Sensor, Signal
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from parameter_identification.identification import identify
from tricycle_bridge.protocol.units import SPEED_UNIT
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.setpoints import command_rows, slew_all
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate
from tricycle_sim.vehicle.groups import equilibrium, pack
from tricycle_sim.vehicle.kernel import functions_for
from tricycle_sim.vehicle.layout import LANES, STATE, WHEEL_STATES
from tricycle_sim.vehicle.parts import steering_constants

VEHICLE = load_vehicle()
LOW, HIGH = np.array(list(VEHICLE.unknown.values())).T
NOISES = (0.01, 0.03)  # m
BAG = {
    Sensor.POSITION: SensorNoise(0.01, rate=100.0),
    Sensor.HEADING: SensorNoise(0.002, rate=100.0),
    Sensor.YAW_RATE: SensorNoise(0.005, rate=100.0),
    Sensor.WHEEL_SPEED: SensorNoise(0.0, rate=100.0),
}
MANEUVERS = ((Circle(), (2.2, 1.0)), (DoubleLaneChange(), (2.0, 2.0)))


def commands_of_pair():
    return [nominal_run(VEHICLE, family, np.array(x)).commands for family, x in MANEUVERS]


def draw(seed):
    return LOW + (HIGH - LOW) * np.random.default_rng([seed, 0]).uniform(size=len(LOW))


def drives_of(motions, all_commands, noise, rng):
    """Drives measured with so many m of noise at 20 Hz, or as in a bag where `noise` is None."""
    noises = BAG if noise is None else {Sensor.POSITION: SensorNoise(noise)}
    drives = [
        measure(motion, commands, noises, rng=rng)
        for motion, commands in zip(motions, all_commands, strict=True)
    ]
    return [rounded(drive) for drive in drives] if noise is None else drives


def rounded(drive):
    """The drive with its wheel speed in steps of 1 mm/s."""
    wheel, step = drive.signals[Sensor.WHEEL_SPEED], SPEED_UNIT / VEHICLE.tyre_radius
    told = Signal(wheel.time, step * np.round(wheel.values / step))
    return dataclasses.replace(drive, signals={**drive.signals, Sensor.WHEEL_SPEED: told})


# ---- coverage ----


def one_vehicle(arguments):
    """Deviation in ranges, whether covered by profile and linear interval, whether identifiable."""
    seed, all_commands, noises = arguments
    truth = draw(seed)
    motions = [SensedMotion.of(simulate(VEHICLE, c, truth[None], threads=1)) for c in all_commands]
    rows = []
    for number, noise in enumerate(noises):
        rng = np.random.default_rng([seed, 1, number])
        found = identify(drives_of(motions, all_commands, noise, rng), VEHICLE, profiles=True)
        estimates = found.parameters.values()
        rows.append(
            [
                (
                    (e.estimate - p) / (high - low),
                    e.low <= p <= e.high,
                    e.linear[0] <= p <= e.linear[1],
                    e.identifiable,
                    found.white,
                )
                for e, p, low, high in zip(estimates, truth, LOW, HIGH, strict=True)
            ]
        )
    return rows


def coverage(seeds, noises):
    all_commands = commands_of_pair()
    with ProcessPoolExecutor(2) as pool:
        jobs = [(seed, all_commands, noises) for seed in seeds]
        return np.array(list(pool.map(one_vehicle, jobs, chunksize=4)))  # (v, noise, k, column)


def print_coverage(vehicles, noises):
    table = coverage(range(vehicles), noises)
    for number, noise in enumerate(noises):
        deviation, profiled, linear, shown, white = np.moveaxis(table[:, number], 2, 0)
        print(
            f"\n{vehicles} vehicles, {'as in a bag' if noise is None else f'{100 * noise:g} cm'}; "
            f"residuals white in {white[:, 0].mean():.1%}"
        )
        print(
            f"{'':24s}{'bias %':>14s}{'RMS %':>8s}{'shown':>8s}"
            f"{'covered if shown: profile':>27s}{'linear':>8s}{'all: profile':>14s}"
        )
        for i, name in enumerate(VEHICLE.unknown):
            d, at = 100 * deviation[:, i], shown[:, i] == 1
            share = lambda covered, at=at, i=i: (  # noqa: E731
                f"{covered[at, i].mean():.1%}" if at.any() else "-"
            )
            print(
                f"{name:24s}{d.mean():+8.2f} ±{d.std() / np.sqrt(len(d)):4.2f}"
                f"{np.sqrt(np.mean(d**2)):8.2f}{at.mean():8.0%}"
                f"{share(profiled):>27s}{share(linear):>8s}{profiled[:, i].mean():14.1%}"
            )


# ---- model error ----


def with_wind(commands, truth, force):
    """Motion under a force of the wind along the world's y, N, as kicks between the ticks."""
    group = pack(VEHICLE, truth[None], equilibrium(VEHICLE))
    servo, constants = np.zeros(2), steering_constants(VEHICLE, 0.5 * TICK)
    rows = command_rows(commands)
    angles, _ = slew_all(commands.steering_motor_angle[rows], VEHICLE.steering_slew)
    speeds, _ = slew_all(commands.speed[rows], VEHICLE.acceleration)
    states = group.reshape(-1, LANES)
    record = []
    for angle, speed in zip(angles, speeds, strict=True):
        w, x, y, z = states[STATE.q0 : STATE.q3 + 1, 0]
        yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        record.append(
            (
                *states[[STATE.x, STATE.y], 0],
                yaw,
                states[STATE.r, 0],
                states[STATE.spin + 2 * WHEEL_STATES, 0] - states[STATE.q, 0],  # of the motor
            )
        )
        kick = force / VEHICLE.mass * TICK
        states[STATE.u] += kick * np.sin(yaw)
        states[STATE.v] += kick * np.cos(yaw)
        functions_for(VEHICLE).advance_tick(group, servo, constants, angle, (1.0, speed, 0.0), 1)
    x, y, yaw, yaw_rate, spin = np.transpose(record)
    return SensedMotion(TICK * np.arange(len(record)), x, y, np.unwrap(yaw), yaw_rate, spin)


def offset(commands, degrees):
    """What the steering does of commands when it is mounted so many degrees off."""
    limit = VEHICLE.steering_limit
    angle = np.clip(commands.steering_motor_angle + np.radians(degrees), -limit, limit)
    return Commands(commands.time, angle, commands.speed)


def replayed(vehicle, commands, truth):
    return SensedMotion.of(simulate(vehicle, commands, truth[None], threads=1))


EFFECTS = {
    "none": lambda c, p: replayed(VEHICLE, c, p),
    "stiffness grows with load": lambda c, p: replayed(VEHICLE.replace(load_sensitivity=1.0), c, p),
    "wind, 5 N to the left of the start": lambda c, p: with_wind(c, p, 5.0),
    "steering 2° off": lambda c, p: replayed(VEHICLE, offset(c, 2.0), p),
}


def one_effect(arguments):
    name, seed, all_commands = arguments
    truth = draw(seed)
    motions = [EFFECTS[name](commands, truth) for commands in all_commands]
    found = [
        identify(drives_of(motions, all_commands, noise, np.random.default_rng([seed, 2])), VEHICLE)
        for noise in NOISES
    ]
    return [
        (
            f.white,
            f.noise[Sensor.POSITION].drift,
            *((f.intervals[:2, 0] <= truth[:2]) & (truth[:2] <= f.intervals[:2, 1])),
        )
        for f in found
    ]


def model_error(vehicles):
    print(
        f"\n{'truth has':38s}{'noise cm':>9s}{'not white':>11s}{'drift mm':>10s}"
        f"{'covered Ca, Cg':>18s}"
    )
    for name in EFFECTS:
        jobs = [(name, seed, commands_of_pair()) for seed in range(vehicles)]
        with ProcessPoolExecutor(2) as pool:
            rows = np.array(list(pool.map(one_effect, jobs, chunksize=4)), dtype=float)
        for number, noise in enumerate(NOISES):
            white, drift, cornering, camber = rows[:, number].T
            print(
                f"{name:38s}{100 * noise:9g}{1 - white.mean():11.0%}{1e3 * np.median(drift):10.1f}"
                f"{cornering.mean():10.0%}{camber.mean():8.0%}"
            )


# ---- time ----


def timing():
    all_commands = commands_of_pair()
    motions = [replayed(VEHICLE, c, draw(0)) for c in all_commands]
    rng = np.random.default_rng(0)
    slow, fast = (drives_of(motions, all_commands, noise, rng) for noise in (0.01, None))
    print("\ntwo drives, six parameters; best of 5, s")
    for name, drives in (("position at 20 Hz", slow), ("as in a bag", fast)):
        line = f"{name:38s}"
        for profiles in (False, True):
            times = []
            for _ in range(5 if not profiles else 2):
                start = time.perf_counter()
                identify(drives, VEHICLE, profiles=profiles)
                times.append(time.perf_counter() - start)
            line += f"{'with' if profiles else 'without'} profiles {min(times):.2f}   "
        print(line)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--vehicles", type=int, default=1000)
    parser.add_argument(
        "--part", choices=("coverage", "bags", "model", "time"), action="append", default=[]
    )
    arguments = parser.parse_args()
    parts = arguments.part or ["time", "coverage", "bags", "model"]
    if "time" in parts:
        timing()
    if "coverage" in parts:
        print_coverage(arguments.vehicles, NOISES)
    if "bags" in parts:
        print_coverage(max(arguments.vehicles // 4, 1), (None,))
    if "model" in parts:
        model_error(min(arguments.vehicles, 100))


if __name__ == "__main__":
    main()
