"""Real drives of a vehicle that nobody here built: DART, a car of scale 1:10.

    python benchmarks/dart.py --data DIR [--fit NAME ...] [--predict FILE ...] [--json]
    python benchmarks/dart.py --data DIR --identify [--fit NAME ...]

DIR holds recordings of the repository Lorenzo-Lyons/DART (folder System_identification/Data, commit
4b52523, MIT licence), renamed and packed: ramp_pos02.csv.gz, ramp_neg02, ramp_pos025, ramp_neg025
(81_throttle_ramps), lap_1_0 (70_racetrack_lap_v_1). They are not part of this repository. Lyons,
Niesten, Ferranti, "DART: A Compact Platform for Autonomous Driving Research", IEEE IV 2024.

Fitted are both axles' cornering stiffness and friction, the yaw inertia and, for each recording,
the steering's zero: least squares of position and heading after 0.5, 1 and 2 s of windows of the
four ramps that share no sample, where windows with large residuals count less (weights of
Student's t distribution); intervals of 95 % from resampling the windows (shown: an interval of less
than half the range). --zero gives all these recordings one zero instead, as -0.0138, which is the
authors'. Predicted are windows of 2 s begun every 0.5 s at more than 0.4 m/s: inside, only steering
commands and the speed of the pose are known. The steering's zero, play and lag are those by which
the headings after 0.5 s of the earlier windows are most probable (those of the last window are
printed). Printed, also with a zero only (no play, the authors' lag) and for the authors' model
(their parameters and zero) on the same windows: RMS of position [mm] and heading [deg] after 0.5, 1
and 2 s. Then the secant stiffness of the axles as driven in the ramps (their lateral force by the
fitted model, over the slip of the axle) over that of the authors' curves.

With --identify every third of these windows goes to `identify` instead, with the effects that
`tricycle identify` weighs by default, and its table is printed: the stiffness may be 10 to 60 N/rad
in front, 10 to 80 behind.
"""

import argparse
import dataclasses
import json
import math
from itertools import product
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import softmax

from parameter_identification.drives.motion import motion_of
from parameter_identification.drives.table import (
    Column,
    Columns,
    SensorPlace,
    SteeringMap,
    read_recording,
)
from parameter_identification.drives.windows import (
    APPROACH,
    RUN_IN,
    Windows,
    select_windows,
)
from parameter_identification.estimation.inputs import effects_of_columns
from parameter_identification.estimation.unknown import restrict
from parameter_identification.identification import identify
from tricycle_core.timing import TICK
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import CommandedBatch

CAR = Path(__file__).parents[1] / "src/tricycle_sim/tricycle_sim/car_1_10.yaml"
RAMPS = ("ramp_pos02", "ramp_neg02", "ramp_pos025", "ramp_neg025")
FRICTION = {f"{axle}.friction_coefficient": (0.6, 1.2) for axle in ("front", "rear")}
FITTED = ("front.cornering_stiffness", "rear.cornering_stiffness", *FRICTION, "yaw_inertia")
HORIZONS = (0.5, 1.0, 2.0)  # s
STEPS = np.round(np.array(HORIZONS) / TICK).astype(int)
LEAD = round((APPROACH + RUN_IN) / TICK)
SLIPS = (0.02, 0.04, 0.06, 0.08, 0.10, 0.12)  # rad
COLUMNS = Columns(
    time="vicon time",
    x="vicon x",
    y="vicon y",
    yaw="vicon yaw",
    steering=Column("steering", unit="1"),
    steering_map=SteeringMap(
        gain=0.366 * 1.393, limit=0.366, gain_right=0.515 * 1.023, limit_right=0.515
    ),
    # 0.115 m ahead of the rear axle, that is 0.093 m behind the COM
    sensor=SensorPlace(x=0.022, y=-0.01, yaw=-0.0077),
)
# the authors' model divides the drive force between the axles; gear with play
PARTS = {"drive": "all", "servo": "geared"}
DRIVEN = {
    # no PLC of ours slews; the servo follows with a time constant of 0.13 s, up to 0.4 rad
    "steering_slew": 20.0,
    "servo_natural_frequency": 40.0,
    "servo_damping_ratio": 2.7,
    "steering_limit": 0.45,
    # a drive that has the recorded speed, whatever it takes
    "acceleration": 20.0,
    "motor_no_load_speed": 200.0,
    "motor_power": 100.0,
    "motor_torque": 0.4,
    "regenerative_torque": 0.4,
    # not given: as low as the axles of the authors' bicycle, whose wheels share the load evenly
    "com_height": 0.02,
}

# what the steering may be like on the day of a recording: play from stop to stop, lag
STEERING = {
    "steering_offset": (-0.1, 0.1),
    "servo_backlash": (0.0, 0.1),
    "servo_damping_ratio": (0.1, 5.0),
}
ZERO_STD = 0.02  # rad, about the mean of the fitted zeros
PLAYS = (0.0, 0.016, 0.032, 0.048, 0.064)  # rad
LAGS = (0.03, 0.06, 0.1, 0.13)  # s
HEADING_STD = 0.03  # rad, of a prediction over 0.5 s

# the authors' model
STEERING_ZERO, TIME_CONSTANT = -0.027, 0.13
FRONT, REAR = (8.60, 0.841, 0.841, 0.847), (11.55, 0.959, 0.855, 0.733)  # B, C, D, kg


def axle_force(slip, b, c, d, mass):
    return d * mass * 9.81 * np.sin(c * np.arctan(b * slip))


def authors(motion, command, starts, vehicle, ticks):
    """Poses (window, tick, 3) that the authors' bicycle predicts."""
    away = command + STEERING_ZERO
    wanted = np.where(away > 0, 0.366 * np.tanh(1.393 * away), 0.515 * np.tanh(1.023 * away))
    angle = np.zeros(len(wanted))
    for i in range(1, len(angle)):
        angle[i] = angle[i - 1] + TICK / TIME_CONSTANT * (wanted[i - 1] - angle[i - 1])
    vx, vy = np.gradient(motion.x, TICK), np.gradient(motion.y, TICK)
    x, y, yaw = motion.x[starts], motion.y[starts], motion.yaw[starts]
    lateral = (-vx * np.sin(motion.yaw) + vy * np.cos(motion.yaw))[starts]
    rate = motion.yaw_rate[starts]
    lf, lr, steps = vehicle.com_to_front_axle, vehicle.com_to_rear_axle, 5
    out = np.empty((len(starts), ticks + 1, 3))
    for k in range(ticks + 1):
        out[:, k] = np.column_stack([x, y, yaw])
        speed, steer = np.maximum(motion.speed[starts + k], 0.1), angle[starts + k]
        for _ in range(steps):
            h = TICK / steps
            front = axle_force(steer - np.arctan2(lateral + rate * lf, speed), *FRONT)
            rear = axle_force(-np.arctan2(lateral - rate * lr, speed), *REAR)
            x = x + h * (speed * np.cos(yaw) - lateral * np.sin(yaw))
            y = y + h * (speed * np.sin(yaw) + lateral * np.cos(yaw))
            yaw = yaw + h * rate
            lateral = lateral + h * ((front * np.cos(steer) + rear) / vehicle.mass - speed * rate)
            rate = rate + h * (lf * front * np.cos(steer) - lr * rear) / 0.0048
    return out


def deviations(drive, motion, first, batch, parameters):
    """Predicted less measured x, y, yaw (parameters, horizons, 3) of a window."""
    speeds = np.full(len(parameters), drive.start.speed)
    run = batch.run(parameters, ("x", "y", "yaw"), speed=speeds)
    x, y, yaw = (run.columns[name][:, LEAD + STEPS] for name in ("x", "y", "yaw"))
    x0, y0, yaw0 = (run.columns[name][:, LEAD, None] for name in ("x", "y", "yaw"))
    turn = motion.yaw[first] - yaw0
    way = ((x - x0) + 1j * (y - y0)) * np.exp(1j * turn)
    at = first + STEPS
    return np.stack(
        [
            motion.x[first] + way.real - motion.x[at],
            motion.y[first] + way.imag - motion.y[at],
            yaw + turn - motion.yaw[at],
        ],
        axis=2,
    )


def errors(deviation):
    """RMS of position [mm] and heading [deg] of deviations (windows, horizons, 3)."""
    square = np.mean(deviation**2, axis=0)
    return {
        f"{horizon:g} s": {
            "position_mm": 1e3 * math.sqrt(x + y),
            "heading_deg": math.degrees(math.sqrt(yaw)),
        }
        for horizon, (x, y, yaw) in zip(HORIZONS, square, strict=True)
    }


def windows(path, vehicle, overlapping):
    """Recording, motion, windows, and the ticks at which they begin."""
    recording = read_recording(path, COLUMNS)
    motion = motion_of(recording)
    chosen = Windows(overlapping=overlapping)
    drives = select_windows(recording, vehicle, COLUMNS.steering_map, chosen).drives
    begin = np.array([float(drive.name.split()[-2]) for drive in drives])
    return recording, motion, drives, np.round((begin - motion.time[0]) / TICK).astype(int)


def predict(path, vehicle):
    only = dataclasses.replace(vehicle, unknown=STEERING)
    recording, motion, drives, starts = windows(path, vehicle, overlapping=True)
    away, between = (ZERO_STD * np.linspace(-2.0, 2.0, number) for number in (8, 81))
    dampings = [0.5 * vehicle.servo_natural_frequency * lag for lag in LAGS]
    steerings = np.array(list(product(vehicle.steering_offset + away, PLAYS, dampings)))
    simulated = np.array([
        deviations(drive, motion, first, batch_of(only, drive), steerings)
        for drive, first in zip(drives, starts, strict=True)
    ])  # fmt: skip
    axes = len(drives), len(away), len(PLAYS), len(LAGS), len(HORIZONS), 3
    each = CubicSpline(away, simulated.reshape(axes), axis=1)(between)
    before = -0.5 * (between[:, None, None] / ZERO_STD) ** 2
    ours, by_zero = [], []
    for window, first in enumerate(starts):
        heading = each[starts + STEPS[0] <= first, ..., 0, 2]
        log = before - 0.5 * np.sum((heading / HEADING_STD) ** 2, axis=0)
        ours.append(np.tensordot(softmax(log), each[window], 3))
        by_zero.append(np.tensordot(softmax(log[:, 0, -1]), each[window, :, 0, -1], 1))
    weights = softmax(log)
    steering = {
        "zero_rad": float(weights.sum((1, 2)) @ between + vehicle.steering_offset),
        "play_rad": float(weights.sum((0, 2)) @ PLAYS),
        "lag_s": float(weights.sum((0, 1)) @ LAGS),
    }
    command = recording.steering.at(motion.time, held=True)
    theirs = authors(motion, command, starts, vehicle, STEPS[-1])[:, STEPS]
    there = np.stack([v[starts[:, None] + STEPS] for v in (motion.x, motion.y, motion.yaw)], axis=2)
    return {
        "windows": len(drives),
        "ours": errors(np.array(ours)),
        "zero only": errors(np.array(by_zero)),
        "authors": errors(theirs - there),
        "steering": steering,
    }


def batch_of(vehicle, drive):
    return CommandedBatch(vehicle, drive.commands, setpoint=drive.start.speed)


def better(at, residuals, jacobians, information, mean):
    """Step of Gauss and Newton, with a prior; windows with large residuals count less."""
    square = np.mean(residuals**2, axis=1)
    weight = 1.0 / (1.0 + square / (4.0 * np.median(square)))
    weight /= np.average(square, weights=weight)
    normal = np.einsum("w,wri,wrj->ij", weight, jacobians, jacobians)
    pull = np.einsum("w,wri,wr->i", weight, jacobians, residuals)
    return at - np.linalg.solve(normal + np.diag(information), pull + information * (at - mean))


def fit(paths, vehicle, zero=None, seed=0):
    """Parameters, their intervals, zeros of the recordings, and the windows."""
    names = [*FITTED, "steering_offset"]
    known = restrict(vehicle, tuple(names))
    order = [list(known.unknown).index(name) for name in names]
    low, high = np.array([vehicle.unknown[name] for name in FITTED]).T
    rows = []  # number of the recording, window, motion, first tick, batch
    for number, path in enumerate(paths):
        _, motion, drives, starts = windows(path, vehicle, overlapping=False)
        rows += [
            (number, drive, motion, first, batch_of(known, drive))
            for drive, first in zip(drives, starts, strict=True)
        ]
    k, n = len(FITTED), len(FITTED) + len(paths)
    first = vehicle.steering_offset if zero is None else zero
    at = mean = np.append(np.full(k, 0.5), np.full(len(paths), first))
    zeros_std = 0.03 if zero is None else 1e-6
    information = np.append(np.full(k, 12.0), np.full(len(paths), zeros_std**-2))
    steps = np.append(np.full(k, 0.02), 0.002)
    scale = 1.0 / np.array(HORIZONS)[:, None]  # m/s; rad/s at 1 m
    for _ in range(8):
        residuals, jacobians = [], []
        for number, drive, motion, first, batch in rows:
            z = np.append(at[:k], at[k + number])
            points = z + np.vstack([np.zeros(k + 1), np.diag(steps)])
            values = np.empty_like(points)
            values[:, order] = np.column_stack([low + (high - low) * points[:, :k], points[:, k:]])
            found = (deviations(drive, motion, first, batch, values) * scale).reshape(k + 2, -1)
            jacobian = np.zeros((found.shape[1], n))
            jacobian[:, [*range(k), k + number]] = (found[1:] - found[0]).T / steps
            residuals.append(found[0])
            jacobians.append(jacobian)
        r, j = np.array(residuals), np.array(jacobians)

        following = better(at, r, j, information, mean)
        following[:k] = np.clip(following[:k], 0.0, 1.0)
        done = np.abs(following - at).max() < 1e-3
        at = following
        if done:
            break
    rng = np.random.default_rng(seed)
    draws = [rng.integers(len(r), size=len(r)) for _ in range(500)]
    again = [better(at, r[chosen], j[chosen], information, mean) for chosen in draws]
    bounds = np.clip(np.quantile(np.array(again)[:, :k], [0.025, 0.975], axis=0), 0.0, 1.0)
    parameters = {
        name: {
            "estimate": float(low[i] + (high - low)[i] * at[i]),
            "low": float(low[i] + (high - low)[i] * bounds[0, i]),
            "high": float(low[i] + (high - low)[i] * bounds[1, i]),
            "shown": bool(bounds[1, i] - bounds[0, i] < 0.5 and 0.0 < at[i] < 1.0),
            "unit": vehicle.unit(name),
        }
        for i, name in enumerate(FITTED)
    }
    zeros = {path.name: float(zero) for path, zero in zip(paths, at[k:], strict=True)}
    return parameters, zeros, [(drive, zeros[paths[number].name]) for number, drive, *_ in rows]


def identified(paths, vehicle):
    """Print what `identify` makes of a third of the windows."""
    wide = {"front.cornering_stiffness": (10.0, 60.0), "rear.cornering_stiffness": (10.0, 80.0)}
    vehicle = dataclasses.replace(vehicle, unknown={**vehicle.unknown, **wide})
    vehicle = restrict(vehicle, (*FITTED, "steering_offset"))
    drives = [
        drive for path in paths for drive in windows(path, vehicle, overlapping=False)[2][::3]
    ]
    effects = effects_of_columns(COLUMNS)
    found = identify(drives, vehicle, effects=effects, weighed=True, starts=2)
    for name, e in found.parameters.items():
        shown = "" if e.identifiable else "  not shown"
        print(f"{name:27} {e.estimate:8.4g} [{e.low:.4g}, {e.high:.4g}] {e.unit}{shown}")
    print(*found.effects, sep="\n")
    if not found.converged:
        print("no minimum was found: nothing is shown")
    for deviation in found.deviations:
        print(f"the vehicle moves as the model cannot: {deviation.name}")
    print(f"{len(found.coloured)} of {len(found.whiteness)} channels of {len(drives)} not white")


def secants(drives, vehicle):
    """Secant stiffness of both axles as driven, over the authors'; by slip."""
    known = dataclasses.replace(vehicle, unknown={})
    slips, forces = {"front": [], "rear": []}, {"front": [], "rear": []}
    for drive, zero in drives:
        turned = known.replace(steering_offset=zero)
        run = batch_of(turned, drive).run(
            np.empty((1, 0)), ("vx", "vy", "yaw_rate"), speed=np.array([drive.start.speed])
        )
        vx, vy, rate = (run.columns[name][0] for name in ("vx", "vy", "yaw_rate"))
        accel = np.gradient(vy, TICK) + vx * rate
        steer = run.steering_motor_angle[0] + zero
        lf, lr = vehicle.com_to_front_axle, vehicle.com_to_rear_axle
        length = lf + lr
        for axle, slip, share in (
            ("front", steer - np.arctan2(vy + lf * rate, vx), lr / length / np.cos(steer)),
            ("rear", -np.arctan2(vy - lr * rate, vx), lf / length),
        ):
            slips[axle].append(slip[LEAD:])
            forces[axle].append((vehicle.mass * accel * share)[LEAD:])
    found = {}
    for axle, curve in (("front", FRONT), ("rear", REAR)):
        slip, force = np.concatenate(slips[axle]), np.concatenate(forces[axle])
        near = {at: np.abs(np.abs(slip) - at) < 0.003 for at in SLIPS}
        found[axle] = {
            f"{at:.2f}": float(np.median(force[q] / slip[q]) / (axle_force(at, *curve) / at))
            for at, q in near.items()
            if q.sum() > 50
        }
    return found


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--fit", nargs="+", default=RAMPS, metavar="NAME")
    parser.add_argument("--predict", nargs="*", type=Path, metavar="FILE")
    parser.add_argument("--zero", type=float, metavar="RAD")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--identify", action="store_true")
    args = parser.parse_args()
    car = load_vehicle(CAR)
    wheels = tuple(dataclasses.replace(wheel, driven=True) for wheel in car.wheels)
    car = dataclasses.replace(car, wheels=wheels, parts={**car.parts, **PARTS}).replace(**DRIVEN)
    vehicle = dataclasses.replace(car, unknown={**car.unknown, **FRICTION})
    fitted_to = [args.data / f"{name}.csv.gz" for name in args.fit]
    if args.identify:
        identified(fitted_to, vehicle)
        return
    parameters, zeros, drives = fit(fitted_to, vehicle, args.zero)
    fitted = vehicle.replace(
        **{name: found["estimate"] for name, found in parameters.items()},
        steering_offset=float(np.mean(list(zeros.values()))),
    )
    files = args.predict
    if files is None:
        files = [args.data / f"{name}.csv.gz" for name in (*RAMPS, "lap_1_0")]
    result = {
        "parameters": parameters,
        "steering_zero_rad": zeros,
        "fitted_windows": len(drives),
        "secant_over_authors": secants(drives, fitted),
        "predictions": {path.name: predict(path, fitted) for path in files},
    }
    if args.json:
        print(json.dumps(result))
        return
    for name, e in result["parameters"].items():
        shown = "" if e["shown"] else "  not shown"
        print(
            f"{name:27} {e['estimate']:8.4g} [{e['low']:.4g}, {e['high']:.4g}] {e['unit']}{shown}"
        )
    for axle, ratios in result["secant_over_authors"].items():
        print(
            f"secant stiffness over the authors', {axle}:",
            *(f"{a}: {r:.2f}" for a, r in ratios.items()),
        )
    for name, one in result["predictions"].items():
        steering = ", ".join(f"{of} {value:.3f}" for of, value in one["steering"].items())
        print(f"{name:20} steering by the earlier windows of the last one: {steering}")
        for who in ("ours", "zero only", "authors"):
            cells = (
                f"{h}: {e['position_mm']:4.0f} mm {e['heading_deg']:4.1f} deg"
                for h, e in one[who].items()
            )
            print(f"{name:20} {one['windows']:4} windows  {who:9}", "   ".join(cells))


if __name__ == "__main__":
    main()
