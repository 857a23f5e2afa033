"""Identification in worlds that the vehicle file lacks: coverage, width, and what was wrong.

    python benchmarks/worlds.py [--vehicles 200] [--first 0] [--world NAME ...]
                                [--plan none|all|random] [--predict]
                                [--constant NAME=FACTOR ...] [--without EFFECT ...]

Random vehicles drive a circle and a double lane change in each world; position (1 cm), gyro
(5 mrad/s) and wheel speed (rounded to 1 mm/s) come at 20 Hz, the steering's angle on every tick in
counts of its ADC. Each is identified without effects, with all, with all
weighed, and with those that act in that world (the oracle). Printed for the first two parameters
and the yaw inertia: in how many vehicles it is shown, how many 95 % intervals hold the truth where
it is, how many do not (wrong, though shown), and the median width of the intervals over all
vehicles, in % of the range; last, how often the identification said that the model lacks something:
residuals that are not white, or a deviation that the drives show. At the end, of each way: the
cells whose coverage is rejected (held_intervals.py), and those in which weighing is much more
cautious than the oracle: shown in less than 80 % of the vehicles in which the oracle shows the
parameter, or more than twice as wide.

The maneuvers are fixed, or planned as a pair by criterion d, counting no effects or all of them
(then the widths that the plan expects are printed, too), or drawn from their boxes, another pair
for each vehicle. With --predict each vehicle drives a slalom too, another one each, that is
predicted with what was found: printed are the distance by which the positions are off and the
expected one [mm] (both RMS), and the mean and the least share of them inside the 95 % band.
With --constant the worlds are vehicles one of whose constants is so many times that of the file;
effects that are named by --without are neither weighed nor among all.
benchmarks/firmware_world.py has the world of the own firmware.
"""

import argparse
import dataclasses
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from held_intervals import Tally
from identification import MANEUVERS, VEHICLE, commands_of_pair, draw, rounded, with_wind
from scipy.signal import lfilter

from excitation_planner import Criterion
from excitation_planner.design.noise import MeasurementNoise
from excitation_planner.maneuver import Slalom
from excitation_planner.planning import PlanRequest, plan_set, random_feasible_point
from excitation_planner.planning.replay import nominal_run
from parameter_identification.drives.measured import Sensor, Signal
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from parameter_identification.identification import EFFECTS, identify
from tricycle_bridge.protocol.boards import ADC_SCALE
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.setpoints import command_rows, slew_all
from tricycle_sim.vehicle.batch import simulate

SENSORS = {
    Sensor.POSITION: SensorNoise(0.01),
    Sensor.YAW_RATE: SensorNoise(0.005),
    Sensor.WHEEL_SPEED: SensorNoise(0.0),
}
FAMILIES = tuple(family for family, _ in MANEUVERS)
WAYS = ("none", "all", "weighed", "oracle")
PARAMETERS = ("cornering_stiffness", "camber_stiffness", "yaw_inertia")


def driven(vehicle, commands, truth):
    return SensedMotion.of(simulate(vehicle, commands, truth[None], threads=1))


def of(**values):
    """A world whose vehicle has other constants."""
    return lambda commands, truth: driven(VEHICLE.replace(**values), commands, truth)


def on_ticks(commands):
    rows = command_rows(commands)
    time = TICK * np.arange(len(rows))
    return time, commands.steering_motor_angle[rows], commands.speed[rows]


def gain_and_backlash(commands, truth):
    time, wanted, speed = on_ticks(commands)
    angle, play = wanted.copy(), np.radians(0.25)
    for i in range(1, len(angle)):
        angle[i] = np.clip(angle[i - 1], wanted[i] - play, wanted[i] + play)
    limit = VEHICLE.steering_limit
    angle = np.clip(1.02 * angle, -limit, limit)
    return driven(VEHICLE, Commands(time, angle, speed), truth)


def aside(commands, truth):
    com = {"com_to_front_axle": -0.03, "com_to_rear_axle": 0.03}
    vehicle = VEHICLE.replace(**{n: VEHICLE.values[n] + d for n, d in com.items()})
    m = driven(vehicle, commands, truth)
    cosine, sine = np.cos(m.heading), np.sin(m.heading)
    x, y = m.x - 0.03 * cosine - 0.05 * sine, m.y - 0.03 * sine + 0.05 * cosine
    return dataclasses.replace(m, x=x, y=y)


def slow_actuators(commands, truth):
    time, angle, speed = on_ticks(commands)
    late = round(0.06 / TICK)
    angle = np.concatenate([np.full(late, angle[0]), angle[:-late]])
    halved = ("servo_natural_frequency", "speed_gain_proportional", "speed_gain_integral")
    vehicle = VEHICLE.replace(**{name: 0.5 * VEHICLE.values[name] for name in halved})
    return driven(vehicle, Commands(time, angle, speed), truth)


def saturating(commands, truth):
    return driven(dataclasses.replace(VEHICLE, parts={"tyre": "fiala"}), commands, truth)


def magic(commands, truth):
    own = {
        "shape_longitudinal": 1.6,
        "curvature_longitudinal": 0.3,
        "shape_lateral": 1.5,
        "curvature_lateral": -0.8,
        "friction_load_slope": 0.1,
    }
    values = {**VEHICLE.values, **own}
    vehicle = dataclasses.replace(VEHICLE, parts={"tyre": "magic_formula"}, values=values)
    return driven(vehicle, commands, truth)


def slippery(commands, truth):
    values = {"friction_coefficient": 0.8 * VEHICLE.values["friction_coefficient"]}
    return driven(VEHICLE.replace(**values), commands, truth)


def another_servo(commands, truth):
    """A servo of another kind: late, with a dead band, never faster than 0.6 rad/s."""
    stiff = VEHICLE.replace(servo_natural_frequency=120.0)
    return driven(stiff, behind_servo(commands), truth)


def both_others(commands, truth):
    stiff = VEHICLE.replace(servo_natural_frequency=120.0)
    return driven(stiff, behind_loop(behind_servo(commands)), truth)


def behind_servo(commands):
    time, wanted, speed = on_ticks(commands)
    late = round(0.04 / TICK)
    wanted = np.concatenate([np.full(late, wanted[0]), wanted[:-late]])
    angle, moves = np.zeros(len(wanted)), False
    for i in range(1, len(angle)):
        off = wanted[i] - angle[i - 1]
        moves = abs(off) > (0.001 if moves else 0.015)
        rate = np.clip(12.0 * off, -0.6, 0.6) if moves else 0.0
        angle[i] = angle[i - 1] + rate * TICK
    return Commands(time, angle, speed)


def another_loop(commands, truth):
    """A speed loop of another kind: without an integral part, 0.3 s late and 2 % slow."""
    return driven(VEHICLE, behind_loop(commands), truth)


def lagging_loop(commands, truth):
    return driven(VEHICLE, behind_loop(commands, lag=0.06, share=1.0), truth)


def behind_loop(commands, lag=0.3, share=0.98):
    time, angle, speed = on_ticks(commands)
    wanted, _ = slew_all(speed, VEHICLE.acceleration)
    behind = lfilter([TICK / lag], [1.0, TICK / lag - 1.0], share * wanted)
    return Commands(time, angle, behind)


def late_drive(commands, truth):
    time, angle, speed = on_ticks(commands)
    late = round(0.12 / TICK)
    speed = np.concatenate([np.zeros(late), speed[:-late]])
    return driven(VEHICLE, Commands(time, angle, speed), truth)


def planned_pair(effects):
    """Commands of a circle and a double lane change planned together; prints what is expected."""
    first, second = FAMILIES
    noise = MeasurementNoise(yaw_rate_std=0.005, wheel_speed_std=0.003)
    request = PlanRequest(
        VEHICLE, first, PARAMETERS[0], Criterion.D, (second,), noise=noise, effects=effects
    )
    plans = plan_set(request)
    for plan in plans:
        print(plan.maneuver, {name: round(value, 3) for name, value in plan.operation.items()})
    ranges = {name: VEHICLE.unknown[name] for name in PARAMETERS}
    widths = (
        f"{name} {100 * 2 * 1.96 * plans[0].predicted_std[name] / (high - low):.1f}"
        for name, (low, high) in ranges.items()
    )
    print(f"expected widths, % of the range: {', '.join(widths)}", flush=True)
    return [plan.commands for plan in plans]


def random_commands(families, seed):
    """Commands of a maneuver of each family, anywhere in its box."""
    rng = np.random.default_rng([seed, 6])
    found = []
    for family in families:
        x = random_feasible_point(PlanRequest(VEHICLE, family, PARAMETERS[0]), rng)
        found.append(nominal_run(VEHICLE, family, x).commands)
    return found


RADIUS = {"tyre_radius": 1.01 * VEHICLE.tyre_radius, "speed_scale": 1.01}
RELAXED = {
    name: 0.4 * VEHICLE.values[name]
    for name in ("lateral_relaxation_length", "longitudinal_relaxation_length")
}
WORLDS = {  # motion, and the effects that act
    "nothing": (of(), ()),
    "steering 2° off": (of(steering_offset=np.radians(2.0)), ("steering-zero",)),
    "gain +2 %, backlash 0.5°": (gain_and_backlash, ("steering-gain", "steering-play")),
    "tyre radius +1 %": (of(**RADIUS), ("wheel-radius",)),
    "sensor 5 cm aside, COM 3 cm forward": (
        aside,
        ("sensor-forward", "sensor-left", "centre-of-mass-forward"),
    ),
    "stiffness grows with load": (of(load_sensitivity=1.0), ("load-sensitivity",)),
    "relaxation length -60 %": (
        of(**RELAXED),
        ("relaxation-length", "relaxation-length-along"),
    ),
    "tyre saturates": (saturating, ("tyre-saturation",)),
    "road friction -20 %": (slippery, ("road-friction",)),
    "wind 5 N": (
        lambda commands, truth: with_wind(commands, truth, 5.0),
        ("slope-or-wind-along", "slope-or-wind-across"),
    ),
    "road 1° across": (
        of(road_bank=np.radians(1.0)),
        ("slope-or-wind-along", "slope-or-wind-across"),
    ),
    "slow servo and speed loop": (
        slow_actuators,
        ("servo-bandwidth", "servo-dead-time", "speed-loop"),
    ),
    "localisation late, drifts": (of(), ()),
    "drive 120 ms late": (late_drive, ("drive-dead-time",)),
    # no effect is quite of its kind
    "servo of another kind": (another_servo, ("turn-deviation",)),
    "speed loop of another kind": (another_loop, ("speed-deviation", "start-deviation")),
    "speed loop lags by 60 ms": (lagging_loop, ("speed-deviation", "start-deviation")),
    "both actuators of another kind": (both_others, ("turn-deviation", "speed-deviation")),
    "tyre of the magic formula": (magic, ("tyre-saturation", "tyre-rounding", "road-friction")),
}


def drives_in(world, truth, seed, all_commands):
    rng = np.random.default_rng([seed, 3])
    late = world.startswith("localisation")
    sensors = SENSORS | ({Sensor.POSITION: SensorNoise(0.01, 0.01)} if late else {})
    found = []
    for name, commands in zip(("circle", "lane", "slalom"), all_commands, strict=False):
        motion = WORLDS[world][0](commands, truth)
        drive = rounded(
            measure(motion, commands, sensors, rng=rng, name=name, steering_step=1.0 / ADC_SCALE)
        )
        if late:
            p = drive.signals[Sensor.POSITION]
            later = Signal(p.time + 0.08, p.values)
            drive = dataclasses.replace(drive, signals={**drive.signals, Sensor.POSITION: later})
        found.append(drive)
    return found


def one_vehicle(job):
    """For each way and parameter: shown, covered, width in ranges, whether told; predictions."""
    world, seed, all_commands, ways, tried = job
    truth = draw(seed)
    drives = drives_in(world, truth, seed, all_commands)
    true = dict(zip(VEHICLE.unknown, truth, strict=True))
    rows, predicted = [], []
    for way in ways:
        effects = {"none": (), "oracle": WORLDS[world][1]}.get(way, tried)
        found = identify(
            drives[:2], VEHICLE, effects=effects, weighed=way == "weighed", held_out=drives[2:]
        )
        predicted += [(h.rms_estimated, h.expected, h.inside) for h in found.held_out]
        told = bool(found.deviations) or not found.white
        rows.append([])
        for name in PARAMETERS:
            e = found.parameters[name]
            width = (e.high - e.low) / (e.range[1] - e.range[0])
            rows[-1].append((e.identifiable, e.low <= true[name] <= e.high, width, told))
    return rows, predicted


def columns_of(predicted):
    """Distance that predictions are off by and the expected one; mean and least share inside."""
    off, expected = 1e3 * np.sqrt(np.mean(predicted[:, :2] ** 2, axis=0))
    inside = predicted[:, 2]
    return f"{off:6.0f}{expected:10.0f}{inside.mean():8.0%}{inside.min():7.0%}"


def too_cautious(world, ways, table):
    """Lines on cells in which weighing shows less than the oracle, or is wider."""
    if not {"weighed", "oracle"} <= set(ways):
        return
    weighed, oracle = (table[:, ways.index(way)] for way in ("weighed", "oracle"))
    for i, name in enumerate(PARAMETERS):
        by_oracle = oracle[:, i, 0] == 1
        shown = weighed[by_oracle, i, 0].mean() if by_oracle.any() else 1.0
        wider = np.median(weighed[:, i, 2]) / np.median(oracle[:, i, 2])
        if shown < 0.8 or wider > 2.0:
            yield f"{world}, {name}: shown {shown:.0%} of the oracle's, {wider:.1f} times as wide"


def constant(text):
    """A name and a factor, of an option."""
    name, _, factor = text.partition("=")
    if name not in VEHICLE.values or name in VEHICLE.unknown:
        raise argparse.ArgumentTypeError(f"{name!r} is no known constant of the vehicle")
    return name, float(factor)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--vehicles", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="number of the first vehicle")
    parser.add_argument("--world", choices=WORLDS, action="append", default=[])
    parser.add_argument("--way", choices=WAYS, action="append", default=[])
    parser.add_argument("--plan", choices=("none", "all", "random"))
    parser.add_argument("--predict", action="store_true")
    parser.add_argument("--constant", type=constant, action="append", default=[])
    parser.add_argument("--without", choices=EFFECTS, action="append", default=[])
    parser.add_argument("--processes", type=int, default=2)
    arguments = parser.parse_args()
    tried = tuple(name for name in EFFECTS if name not in arguments.without)
    worlds = arguments.world or list(WORLDS)
    if arguments.constant:
        off = {
            f"{n} x {by}": (of(**{n: by * VEHICLE.values[n]}), ()) for n, by in arguments.constant
        }
        WORLDS.update(off)  # before the processes begin
        worlds = list(off)
    seeds = range(arguments.first, arguments.first + arguments.vehicles)
    if arguments.plan == "random":
        pairs = [random_commands(FAMILIES, seed) for seed in seeds]
    else:
        planned = {"none": (), "all": tried}.get(arguments.plan)
        pair = commands_of_pair() if planned is None else planned_pair(planned)
        pairs = [pair] * arguments.vehicles
    if arguments.predict:
        pairs = [
            [*pair, *random_commands([Slalom()], seed)]
            for seed, pair in zip(seeds, pairs, strict=True)
        ]
    ways = tuple(arguments.way or WAYS)
    print(f"{arguments.vehicles} vehicles; a cell: shown, covered where shown, wrong; width %")
    print(
        f"{'world':37s}{'effects':>8s}"
        + "".join(f"{name:>26s}" for name in PARAMETERS)
        + "   told"
        + "   off  expected  inside  least" * arguments.predict
    )
    tallies, cautious = {way: Tally() for way in ways}, []
    with ProcessPoolExecutor(arguments.processes) as pool:
        for world in worlds:
            jobs = [
                (world, seed, pair, ways, tried) for seed, pair in zip(seeds, pairs, strict=True)
            ]
            rows, predicted = zip(*pool.map(one_vehicle, jobs), strict=True)
            table = np.array(rows, dtype=float)
            for number, way in enumerate(ways):
                line = f"{world:37s}{way:>8s}"
                for i in range(len(PARAMETERS)):
                    shown, covered, width, told = table[:, number, i].T
                    wrong = int(np.sum((shown == 1) & (covered == 0)))
                    for held in covered[shown == 1]:
                        tallies[way].count(f"{world}, {PARAMETERS[i]}", held)
                    share = f"{covered[shown == 1].mean():.0%}" if shown.any() else "-"
                    line += f"{shown.mean():8.0%}{share:>6s}{wrong:4d}{100 * np.median(width):8.1f}"
                line += f"{told.mean():7.0%}"
                if arguments.predict:
                    line += columns_of(np.array([of_ways[number] for of_ways in predicted]))
                print(line, flush=True)
            cautious += too_cautious(world, ways, table)
    for way, tally in tallies.items():
        print(f"{way}: {tally.summary()}")
    print(f"more cautious than the oracle: {'; '.join(cautious) or 'nowhere'}")


if __name__ == "__main__":
    main()
