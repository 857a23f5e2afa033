"""Identification from tables of other people's loggers: how many intervals hold the truth.

    python benchmarks/tables.py [--vehicles 20] [--position NOISE ...] [--steering ...]
        [--loop none|own|late|quick|slow|scale ...] [--late SECONDS ...] [--angle NOISE ...]
        [--duration SECONDS ...] [--filtered SECONDS ...] [--wheel]

Random vehicles are driven for a minute at 0.7 to 1.1 m/s, steered by three sines. The tables come
at 50 Hz: the pose, with each noise of the positions in turn and 0.2 rad per m of it of the heading,
and the gyro (1 mrad/s); the angle of the steering motor (2 mrad) or its set-points; with `--wheel`
the speed of the driven wheel (0.01 rad/s). Where the positions are exact, all is. Windows of 2 s
are identified as `tricycle identify FILE --columns MAPPING` does it. With `--loop` the tables have
the set-points of the speed too, of a loop that is the vehicle file's, hears of them 0.1 s late, has
twice its gains or half of them, or is 2 % faster than it believes. With `--late` the steering comes
so much later than the poses (negative: earlier). `--angle` and `--duration` are other noises of the
angle [rad] and lengths of the drives. With `--filtered` the poses come out of a low-pass of the
first order, with such a time constant; noise is added behind it. Printed, of each parameter: in how
many vehicles it is shown, how many 95 % intervals hold the truth there, and their median width in %
of the range; then the cells whose coverage an exact binomial test rejects (held_intervals.py).
"""

import argparse
import itertools
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from held_intervals import Tally
from identification import VEHICLE, draw
from scipy.signal import lfilter

from parameter_identification.drives.table import Columns, SteeringMap, read_recording
from parameter_identification.drives.windows import Windows
from parameter_identification.estimation.inputs import effects_of_columns
from parameter_identification.estimation.redrawn import Table, redraw_of
from parameter_identification.identification import identify
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle.batch import simulate

EVERY = 0.02
STEERING = {"angle": "steering_angle", "set-points": "steering"}
GAINS = "speed_gain_proportional", "speed_gain_integral"
LATE = 0.1  # s
LOOPS = {  # constants of the vehicle that are other than in its file, as shares of these
    "none": {},
    "own": {},
    "late": {},
    "quick": dict.fromkeys(GAINS, 2.0),
    "slow": dict.fromkeys(GAINS, 0.5),
    "scale": {"speed_scale": 1.02},
}


def drive(rng, duration):
    """Commands of a drive."""
    time = np.arange(0.0, duration, TICK)
    angle = np.zeros(len(time))
    for size, rate in ((0.3, 0.35), (0.25, 0.9), (0.1, 2.2)):
        angle += size * np.sin(rate * time + rng.uniform(0.0, 2.0 * np.pi))
    speed = 0.9 + 0.2 * np.sin(0.3 * time)
    return Commands(time, angle * np.minimum(1.0, time / 3.0), np.minimum(speed, time))


def low_passed(values, constant):
    """Values on ticks, behind a low-pass of the first order."""
    if constant == 0.0:
        return values
    share = -np.expm1(-TICK / constant)
    start = [(1.0 - share) * values[0]]
    return lfilter([share], [1.0, share - 1.0], values, zi=start)[0]


def identified(seed, position, steering, loop, late, angle, duration, filtered, wheel):
    """Truth, parameters found and number of windows of a vehicle."""
    rng, truth = np.random.default_rng([seed, 1]), draw(seed)
    commands = drive(rng, duration)
    driven = VEHICLE.replace(**{n: VEHICLE.values[n] * share for n, share in LOOPS[loop].items()})
    heard = commands
    if loop == "late":
        before = np.interp(commands.time - LATE, commands.time, commands.speed)
        heard = replace(commands, speed=before)
    motion = simulate(driven, heard, truth[None], threads=1)
    exact = position == 0.0
    time = np.arange(0.0, commands.duration - EVERY, EVERY)
    columns = {"t": time}
    for name, values, noise in (
        ("x", low_passed(motion.x[0], filtered), position),
        ("y", low_passed(motion.y[0], filtered), position),
        ("yaw", low_passed(motion.yaw[0], filtered), 0.2 * position),
        ("yaw_rate", motion.yaw_rate[0], 0.0 if exact else 1e-3),
        ("steering_angle", motion.steering_motor_angle[0], 0.0 if exact else angle),
        ("wheel_speed", motion.drive_speed[0], 0.0 if exact else 1e-2),
    ):
        seen = time - late if name == "steering_angle" else time
        columns[name] = np.interp(seen, motion.time, values)
        columns[name] += noise * rng.standard_normal(len(time))
    held, told = (
        np.searchsorted(commands.time, at + 1e-9, side="right") - 1 for at in (time, time - late)
    )
    columns["steering"] = commands.steering_motor_angle[np.maximum(told, 0)]
    columns["speed"] = commands.speed[held]
    mapping = {"time": "t", "x": "x", "y": "y", "yaw": "yaw", "yaw_rate": "yaw_rate"}
    if wheel:
        mapping["wheel_speed"] = "wheel_speed"
    entry = STEERING[steering]
    if loop != "none":
        mapping["speed_command"] = "speed"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drive.csv"
        rows = np.column_stack(list(columns.values()))
        np.savetxt(path, rows, fmt="%.9f", delimiter=",", header=",".join(columns), comments="")
        mapped = Columns(**mapping, **{entry: entry})
        recording = read_recording(path, mapped, VEHICLE)
    table = Table(recording, VEHICLE, SteeringMap(), Windows())
    drives = table.drives()
    found = identify(
        drives,
        VEHICLE,
        effects=effects_of_columns(mapped),
        weighed=True,
        redraw=redraw_of([table]) if loop == "none" else None,
        seed=seed,
    )
    return truth, found.parameters, len(drives)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--vehicles", type=int, default=20)
    parser.add_argument("--position", type=float, nargs="+", default=[0.01, 0.001, 0.0])
    parser.add_argument("--steering", nargs="+", choices=STEERING, default=list(STEERING))
    parser.add_argument("--loop", nargs="+", choices=LOOPS, default=["none"])
    parser.add_argument("--late", type=float, nargs="+", default=[0.0], metavar="SECONDS")
    parser.add_argument("--angle", type=float, nargs="+", default=[2e-3], metavar="NOISE")
    parser.add_argument("--duration", type=float, nargs="+", default=[60.0], metavar="SECONDS")
    parser.add_argument("--filtered", type=float, nargs="+", default=[0.0], metavar="SECONDS")
    parser.add_argument("--wheel", action="store_true")
    args = parser.parse_args()
    tally = Tally()
    with ProcessPoolExecutor() as pool:
        for position, steering, loop, late, angle, duration, filtered in itertools.product(
            args.position,
            args.steering,
            args.loop,
            args.late,
            args.angle,
            args.duration,
            args.filtered,
        ):
            seeds = range(args.vehicles)
            values = position, steering, loop, late, angle, duration, filtered, args.wheel
            found = list(pool.map(identified, seeds, *map(itertools.repeat, values)))
            cell = f"{1e3 * position:g} mm, {steering}" + f", loop {loop}" * (loop != "none")
            cell += f", steering {late:g} s late" * (late != 0.0)
            cell += f", angle {1e3 * angle:g} mrad" * (steering == "angle" and len(args.angle) > 1)
            cell += f", {duration:g} s" * (len(args.duration) > 1)
            cell += f", poses filtered by {filtered:g} s" * (filtered != 0.0)
            windows = np.median([number for _, _, number in found])
            print(f"positions {cell}: {windows:g} windows (median)", flush=True)
            for i, name in enumerate(VEHICLE.unknown):
                own = [(truth[i], parameters[name]) for truth, parameters, _ in found]
                shown = [(t, e) for t, e in own if e.identifiable]
                low, high = VEHICLE.unknown[name]
                width = np.median([e.high - e.low for _, e in own]) / (high - low)
                held = [e.low <= t <= e.high for t, e in shown]
                for one in held:
                    tally.count(f"{cell}, {name}", one)
                print(
                    f"  {name:24s} shown in {len(shown):3d} of {len(own)}, {sum(held):3d} hold; "
                    f"width {100.0 * width:5.1f} %",
                    flush=True,
                )
    print(tally.summary())


if __name__ == "__main__":
    main()
