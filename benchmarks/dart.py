"""Real drives of a vehicle that nobody here built: DART, a car of scale 1:10.

    python benchmarks/dart.py --data DIR [--fit NAME ...] [--predict FILE ...] [--json]

DIR holds recordings of the repository Lorenzo-Lyons/DART (folder System_identification/Data, commit
4b52523, MIT licence), renamed and packed: ramp_pos02.csv.gz, ramp_neg02, ramp_pos025, ramp_neg025
(81_throttle_ramps), lap_1_0 (70_racetrack_lap_v_1). They are not part of this repository. Lyons,
Niesten, Ferranti, "DART: A Compact Platform for Autonomous Driving Research", IEEE IV 2024.

Fitted are both axles' cornering stiffness, the yaw inertia and the steering's zero, to windows of
2 s of the four ramps; the constant part of each recording's steering error comes from its slow
turns. Predicted are windows of 2 s begun every 0.5 s at more than 0.4 m/s: inside, only steering
commands and the speed of the pose are known. The steering's zero is the mean of the 10 s before the
window. Printed, also for the authors' model (their parameters and zero) on the same windows: RMS of
position [mm] and heading [deg] after 0.5, 1 and 2 s. Then the secant stiffness of the axles as
driven in the ramps (their lateral force by the fitted model, over the slip of the axle) over that
of the authors' curves.
"""

import argparse
import dataclasses
import json
import math
from pathlib import Path

import numpy as np

from parameter_identification.drives.table import (
    Column,
    Columns,
    SensorPlace,
    SteeringMap,
    read_recording,
)
from parameter_identification.drives.windows import (
    RUN_IN,
    Windows,
    estimate_offset,
    motion_of,
    steering_error,
    windows_of,
)
from parameter_identification.identification import identify
from tricycle_core.timing import TICK
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import CommandedBatch

CAR = Path(__file__).parents[1] / "src/tricycle_sim/tricycle_sim/car_1_10.yaml"
RAMPS = ("ramp_pos02", "ramp_neg02", "ramp_pos025", "ramp_neg025")
FITTED = ("front.cornering_stiffness", "rear.cornering_stiffness", "yaw_inertia")
HORIZONS = (0.5, 1.0, 2.0)  # s
MEMORY = 10.0  # s before a window that tell the steering's zero
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


def ours(drives, motion, starts, vehicle, offsets, ticks):
    """Poses (window, tick, 3) that the vehicle predicts with steering offsets (windows,)."""
    lead, out = round(RUN_IN / TICK), np.empty((len(starts), ticks + 1, 3))
    known = dataclasses.replace(vehicle, unknown={})
    for row, (drive, first, offset) in enumerate(zip(drives, starts, offsets, strict=True)):
        commands = dataclasses.replace(
            drive.commands, steering_motor_angle=drive.commands.steering_motor_angle + offset
        )
        speed = drive.start.speed
        run = CommandedBatch(known, commands, setpoint=speed).run(
            np.empty((1, 0)), ("x", "y", "yaw"), speed=np.array([speed])
        )
        x, y, yaw = (run.columns[name][0, lead : lead + ticks + 1] for name in ("x", "y", "yaw"))
        turn = motion.yaw[first] - yaw[0]
        way = ((x - x[0]) + 1j * (y - y[0])) * np.exp(1j * turn)
        out[row] = np.column_stack(
            [motion.x[first] + way.real, motion.y[first] + way.imag, yaw + turn]
        )
    return out


def errors(predicted, motion, starts):
    """RMS of position [mm] and heading [deg] at the horizons."""
    found = {}
    for horizon in HORIZONS:
        k = round(horizon / TICK)
        there = np.column_stack([v[starts + k] for v in (motion.x, motion.y, motion.yaw)])
        square = np.mean((predicted[:, k] - there) ** 2, axis=0)
        found[f"{horizon:g} s"] = {
            "position_mm": 1e3 * math.sqrt(square[0] + square[1]),
            "heading_deg": math.degrees(math.sqrt(square[2])),
        }
    return found


def first_ticks(drives, motion):
    """Ticks of the recording at which windows begin."""
    begin = [float(drive.name.split()[-2]) for drive in drives]
    return np.round((np.array(begin) - motion.time[0]) / TICK).astype(int)


def predict(path, vehicle):
    recording = read_recording(path, COLUMNS)
    motion, steering = motion_of(recording), COLUMNS.steering_map
    drives = windows_of(recording, vehicle, steering, Windows(overlapping=True))
    starts, ticks = first_ticks(drives, motion), round(HORIZONS[-1] / TICK)
    error = steering_error(recording, vehicle, steering)
    moving = np.where(motion.speed > 0.4, 1.0, 0.0)
    offsets = []
    for first in starts:
        before = slice(max(0, first - round(MEMORY / TICK)), first)
        weight = moving[before]
        # as if a second had shown the zero of the fitted drives
        offsets.append(np.sum(weight * np.clip(error[before], -0.1, 0.1)) / (weight.sum() + 100.0))
    command = recording.steering.at(motion.time, held=True)
    return {
        "windows": len(drives),
        "ours": errors(ours(drives, motion, starts, vehicle, offsets, ticks), motion, starts),
        "authors": errors(authors(motion, command, starts, vehicle, ticks), motion, starts),
    }


def fit(paths, vehicle):
    drives = []
    for path in paths:
        recording = read_recording(path, COLUMNS)
        steering = estimate_offset(recording, vehicle, COLUMNS.steering_map)
        drives += windows_of(recording, vehicle, steering, Windows(every=EVERY))
    return drives, identify(drives, vehicle, parameters=FITTED)


EVERY = 6.0


def secants(drives, vehicle):
    """Secant stiffness of both axles as driven, over the authors'; by slip."""
    known, lead = dataclasses.replace(vehicle, unknown={}), round(RUN_IN / TICK)
    slips, forces = {"front": [], "rear": []}, {"front": [], "rear": []}
    for drive in drives:
        batch = CommandedBatch(known, drive.commands, setpoint=drive.start.speed)
        run = batch.run(
            np.empty((1, 0)), ("vx", "vy", "yaw_rate"), speed=np.array([drive.start.speed])
        )
        vx, vy, rate = (run.columns[name][0] for name in ("vx", "vy", "yaw_rate"))
        accel = np.gradient(vy, TICK) + vx * rate
        steer = run.steering_motor_angle[0] + vehicle.steering_offset
        lf, lr = vehicle.com_to_front_axle, vehicle.com_to_rear_axle
        length = lf + lr
        for axle, slip, share in (
            ("front", steer - np.arctan2(vy + lf * rate, vx), lr / length / np.cos(steer)),
            ("rear", -np.arctan2(vy - lr * rate, vx), lf / length),
        ):
            slips[axle].append(slip[lead:])
            forces[axle].append((vehicle.mass * accel * share)[lead:])
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
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    vehicle = load_vehicle(CAR).replace(**DRIVEN)
    drives, found = fit([args.data / f"{name}.csv.gz" for name in args.fit], vehicle)
    fitted = vehicle.replace(**{name: e.estimate for name, e in found.parameters.items()})
    files = args.predict
    if files is None:
        files = [args.data / f"{name}.csv.gz" for name in (*RAMPS, "lap_1_0")]
    result = {
        "parameters": {
            name: {
                "estimate": e.estimate, "low": e.low, "high": e.high, "shown": e.identifiable,
                "unit": e.unit,
            }
            for name, e in found.parameters.items()
        },
        "white": found.white,
        "fitted_windows": len(drives),
        "seconds": found.seconds,
        "secant_over_authors": secants(drives, fitted),
        "predictions": {path.name: predict(path, fitted) for path in files},
    }  # fmt: skip
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
        for who in ("ours", "authors"):
            cells = (
                f"{h}: {e['position_mm']:4.0f} mm {e['heading_deg']:4.1f} deg"
                for h, e in one[who].items()
            )
            print(f"{name:20} {one['windows']:4} windows  {who:8}", "   ".join(cells))


if __name__ == "__main__":
    main()
