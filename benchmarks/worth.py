"""Is the designed maneuver worth it? RMS errors of identified stiffnesses after different drives.

    python benchmarks/worth.py [--draws 100] [--output out/worth] [--docs docs]

Every cell of the table: as many vehicles with random unknown parameters drive the maneuvers (the
nine-degree-of-freedom model, open loop), are measured with the noise of the column, and identified
by `identify` from what was measured; the RMS of the estimates' errors in % of the parameter's range
(which is its nominal value for both stiffnesses), with its standard error. All drives are 20 s long
after 1 s at rest, pairs 40 s. The designs are made once, for a white noise of 1 cm and an unknown
start pose, without the heading and the gyro that `tricycle plan` counts on by default, and are
judged in all columns. Strategies that came to the same maneuvers, within 2 % of the operation box,
are driven once. Finished cells are kept in the output folder: an interrupted run goes on.
"""

import argparse
import json
import math
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from excitation_planner import Box, Criterion, MeasurementNoise
from excitation_planner.maneuver import family_by_name
from excitation_planner.planning import PlanRequest, plan_set, random_feasible_point
from excitation_planner.planning.prediction import (
    PERIOD,
    STANDSTILL,
    ReplayedTrajectories,
    predicted_covariance,
)
from excitation_planner.planning.replay import nominal_run
from parameter_identification.drives.measured import MeasuredDrive, Sensor, StartPose
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from parameter_identification.identification import identify
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate

DURATION = 20.0  # s of each drive that are used
TARGETS = ("cornering_stiffness", "camber_stiffness")
VEHICLE = load_vehicle()
UNKNOWN = Box.of(dict(VEHICLE.unknown))
CIRCLE, CHANGE = "circle", "double_lane_change"
ISO = {CIRCLE: [4.0, 0.8], CHANGE: [4.0, 4.0]}  # fixed: radius, speed; handles of the lane change
BEGIN, END = "<!-- printed by benchmarks/worth.py -->", "<!-- end -->"  # in docs/criteria.md
TICKS = (0.2, 0.5, 1, 2, 5, 10, 20, 40)  # %, of the figure
RANDOM_PREDICTED = 8  # random maneuvers over which a prediction is averaged


@dataclass(frozen=True)
class Scenario:
    """How drives are measured: position at 20 Hz, and yaw rate where there is a gyro."""

    name: str
    white: float = 0.01  # m per axis
    drift: float = 0.0  # m per axis, correlation time 5 s
    known_start: bool = False
    gyro: float = 0.0  # rad/s

    @property
    def start(self):
        """Standard deviations of the start pose, m and rad."""
        return (1e-4, 1e-4) if self.known_start else (0.02, math.radians(1.0))

    def sensors(self):
        """What measures, with its noise."""
        noise = {Sensor.POSITION: SensorNoise(self.white, drift=self.drift, drift_time=5.0)}
        return noise | ({Sensor.YAW_RATE: SensorNoise(self.gyro)} if self.gyro else {})

    def noise(self):
        """The same, as the planner knows it."""
        position, heading = self.start
        return MeasurementNoise(
            noise_std=self.white,
            yaw_rate_std=self.gyro,
            drift_std=self.drift,
            start_position_std=position,
            start_heading_std=heading,
        )


SCENARIOS = (
    Scenario("1 cm", known_start=True),
    Scenario("3 cm", white=0.03, known_start=True),
    Scenario("1 cm, start unknown"),
    Scenario("1 cm + drift 1 cm, start unknown", drift=0.01),
    Scenario("1 cm, start unknown, gyro", gyro=0.005),
)

CORNERING, CAMBER = TARGETS
# strategy -> (how the maneuvers are chosen, of which families): criterion and target, or a word
STRATEGIES = {
    "circle: random": ("random", (CIRCLE,)),
    "circle: fixed (ISO-like)": ("iso", (CIRCLE,)),
    "circle: H for cornering": ((Criterion.H, CORNERING), (CIRCLE,)),
    "circle: H for camber": ((Criterion.H, CAMBER), (CIRCLE,)),
    "circle: c for cornering": ((Criterion.C, CORNERING), (CIRCLE,)),
    "circle: D": ((Criterion.D, CORNERING), (CIRCLE,)),
    "circle: A": ((Criterion.A, CORNERING), (CIRCLE,)),
    "lane change: random": ("random", (CHANGE,)),
    "lane change: fixed (ISO-like)": ("iso", (CHANGE,)),
    "lane change: H for cornering": ((Criterion.H, CORNERING), (CHANGE,)),
    "lane change: H without noise term": ("paper", (CHANGE,)),
    "lane change: c for cornering": ((Criterion.C, CORNERING), (CHANGE,)),
    "lane change: D": ((Criterion.D, CORNERING), (CHANGE,)),
    "lane change: A": ((Criterion.A, CORNERING), (CHANGE,)),
    "pair: random": ("random", (CIRCLE, CHANGE)),
    "pair: fixed (ISO-like)": ("iso", (CIRCLE, CHANGE)),
    "pair: H for cornering": ("h", (CIRCLE, CHANGE)),
    "pair: c for cornering": ((Criterion.C, CORNERING), (CIRCLE, CHANGE)),
    "pair: D": ((Criterion.D, CORNERING), (CIRCLE, CHANGE)),
    "pair: A": ((Criterion.A, CORNERING), (CIRCLE, CHANGE)),
}


def designed(output):
    """Operation parameters of the maneuvers of each designed strategy; None for random ones."""
    file = output / "designs.json"
    found = json.loads(file.read_text()) if file.exists() else {}
    for name, (how, families) in STRATEGIES.items():
        if name in found:
            continue
        if how == "random":
            found[name] = None
        elif how == "iso":
            found[name] = [ISO[family] for family in families]
        elif how == "h":  # H judges single maneuvers: the best of each family
            singles = ("circle: H for cornering", "lane change: H for cornering")
            found[name] = [found[single][0] for single in singles]
        else:
            criterion, target = (Criterion.H, CORNERING) if how == "paper" else how
            first, *others = map(family_by_name, families)
            request = PlanRequest(VEHICLE, first, target, criterion=criterion, others=tuple(others))
            if how == "paper":
                request = replace(request, noise=MeasurementNoise(noise_std=0.0))
            plans = plan_set(request)
            found[name] = [list(plan.operation.values()) for plan in plans]
        if found[name] is not None:
            print(f"{name}: {found[name]}", flush=True)
        file.write_text(json.dumps(found, indent=1))
    return found


def driven_as(designs):
    """Strategy -> the first one that drives the same maneuvers."""
    first = {}
    for name, points in designs.items():
        families = STRATEGIES[name][1]
        boxes = [family_by_name(family).operation for family in families]

        def same(other, points=points, families=families, boxes=boxes):
            return families == STRATEGIES[other][1] and all(
                np.abs(box.to_unit(x) - box.to_unit(y)).max() < 0.02
                for box, x, y in zip(boxes, points, designs[other], strict=True)
            )

        known = [other for other in first.values() if designs[other] is not None]
        alike = [other for other in known if points is not None and same(other)]
        first[name] = alike[0] if alike else name
    return first


@lru_cache(maxsize=256)
def run_of(family, x):
    return nominal_run(VEHICLE, family_by_name(family), np.array(x))


def maneuvers(name, points, draw):
    """Operation parameters of each maneuver of a strategy, as tuples."""
    families = STRATEGIES[name][1]
    if points is not None:
        return [tuple(x) for x in points]
    rng = np.random.default_rng([draw, 7])
    requests = [PlanRequest(VEHICLE, family_by_name(family), CORNERING) for family in families]
    return [tuple(random_feasible_point(request, rng)) for request in requests]


def error_of(name, points, scenario, draw):
    """Errors of the estimates (k,) in ranges, of one vehicle that drives once."""
    z = np.random.default_rng([draw, 1]).random(len(UNKNOWN))  # the same vehicle in every cell
    rng = np.random.default_rng([draw, 2, SCENARIOS.index(scenario)])
    position_std, heading_std = scenario.start
    drives = []
    for family, x in zip(STRATEGIES[name][1], maneuvers(name, points, draw), strict=True):
        commands = run_of(family, x).commands
        motion = simulate(VEHICLE, commands, UNKNOWN.from_unit(z)[None], threads=1)
        drive = measure(
            SensedMotion.of(motion),
            commands,
            scenario.sensors(),
            rng=rng,
            standstill=STANDSTILL,
            pose=tuple(rng.standard_normal(3) * [position_std, position_std, heading_std]),
            start=StartPose(0.0, 0.0, 0.0, position_std, heading_std),
        )
        signals = {s: v.between(-STANDSTILL, DURATION) for s, v in drive.signals.items()}
        drives.append(MeasuredDrive(family, commands, signals, start=drive.start))
    found = identify(drives, VEHICLE, starts=2)
    return UNKNOWN.to_unit(found.estimates) - z


@dataclass(frozen=True)
class Shortened:
    """The first `DURATION` of a maneuver's trajectories."""

    simulate: ReplayedTrajectories

    def __call__(self, x, P):
        """Trajectories (n, t, c)."""
        return self.simulate(x, P)[:, : round((STANDSTILL + DURATION) / PERIOD) + 1]


def predicted(name, points, scenario):
    """Predicted standard deviations (k,) in ranges."""
    noise, variances = scenario.noise(), []
    for draw in range(RANDOM_PREDICTED if points is None else 1):
        simulators = tuple(
            Shortened(ReplayedTrajectories(VEHICLE, family_by_name(family), noise.channels))
            for family in STRATEGIES[name][1]
        )
        covariance = predicted_covariance(
            simulators,
            tuple(np.array(x) for x in maneuvers(name, points, draw)),
            UNKNOWN,
            noise.of_trajectory,
            seed=5,
        )
        variances.append(np.diag(covariance))
    return np.sqrt(np.mean(variances, axis=0))


def kept(output, name, scenario):
    """File of a cell; its errors (draws, k) and predicted deviations (k,), None where not done."""
    slug = f"{name}--{scenario.name}".replace(" ", "_").replace(":", "").replace(",", "")
    file = output / f"{slug}.npz"
    if not file.exists():
        return file, np.empty((0, len(UNKNOWN))), None
    arrays = np.load(file)
    return file, arrays["errors"], arrays["predicted"]


def cell(output, name, points, scenario, draws, pool):
    """Errors (draws, k) and predicted deviations (k,) in ranges; what is on disk is not redone."""
    file, done, prediction = kept(output, name, scenario)
    if len(done) >= draws:
        return done[:draws], prediction
    if prediction is None:
        prediction = pool.submit(predicted, name, points, scenario)
    missing = range(len(done), draws)
    new = pool.map(error_of, *zip(*((name, points, scenario, d) for d in missing), strict=True))
    errors = np.vstack([done, *new])
    if not isinstance(prediction, np.ndarray):
        prediction = prediction.result()
    partial = file.with_suffix(".partial.npz")
    np.savez(partial, errors=errors, predicted=prediction)
    partial.replace(file)
    return errors, prediction


def rms(errors):
    """RMS (k,) of errors (draws, k), and its standard error."""
    squares = errors**2
    value = np.sqrt(squares.mean(axis=0))
    return value, squares.std(axis=0) / math.sqrt(len(errors)) / (2.0 * value)


def table(results, same):
    """Markdown: RMS error ± standard error (predicted), in % of the range.

    Strategies that drive the same maneuvers share a row.
    """
    lines = ["| drives | " + " | ".join(scenario.name for scenario in SCENARIOS) + " |"]
    lines.append("|---" * (len(SCENARIOS) + 1) + "|")
    for parameter in TARGETS:
        at = UNKNOWN.index(parameter)
        lines.append(f"| **{parameter.replace('_', ' ')}** |" + " |" * len(SCENARIOS))
        for name in dict.fromkeys(same.values()):
            others = [n.partition(": ")[2] for n in same if n != name and same[n] == name]
            cells = []
            for scenario in SCENARIOS:
                if (name, scenario.name) not in results:
                    cells.append("–")
                    continue
                errors, prediction = results[name, scenario.name]
                value, error = rms(errors)
                cells.append(
                    f"{100 * value[at]:.2g} ± {100 * error[at]:.1g} ({100 * prediction[at]:.2g})"
                )
            lines.append(f"| {', '.join([name, *others])} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def plot(results, path):
    """A panel per scenario, and prediction against outcome."""
    from matplotlib import pyplot as plt

    colors = dict(zip(TARGETS, ("#0072B2", "#D55E00"), strict=True))
    figure, axes = plt.subplots(2, 3, figsize=(15.0, 13.0), layout="constrained")
    names = list(STRATEGIES)
    *panels, against = axes.flat
    for axis, scenario in zip(panels, SCENARIOS, strict=True):
        for parameter, color in colors.items():
            at = UNKNOWN.index(parameter)
            there = [i for i, name in enumerate(names) if (name, scenario.name) in results]
            cells = [results[names[i], scenario.name] for i in there]
            found = [rms(errors) for errors, _ in cells]
            axis.errorbar(
                [100 * value[at] for value, _ in found],
                there,
                xerr=[100 * error[at] for _, error in found],
                fmt="o",
                markersize=5,
                color=color,
                label=f"{parameter.replace('_', ' ')}: outcome, with its standard error",
            )
            axis.plot(
                [100 * prediction[at] for _, prediction in cells],
                there,
                "|",
                markersize=11,
                color=color,
                label=f"{parameter.replace('_', ' ')}: predicted",
            )
        for between in (6.5, 13.5):  # singles of each family, pairs
            axis.axhline(between, color="0.5", linewidth=0.8)
        axis.set_xscale("log")
        axis.set_xlim(0.2, 45)
        axis.set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])
        axis.set_title(scenario.name, fontsize="medium")
        axis.set_yticks(range(len(names)), names if axis in axes[:, 0] else [])
        axis.set_ylim(len(names) - 0.5, -0.5)
        axis.set_xlabel("RMS error / % of the range")
        axis.grid(alpha=0.3, which="both")
    for parameter, color in colors.items():
        at = UNKNOWN.index(parameter)
        pairs = [(prediction[at], rms(errors)[0][at]) for errors, prediction in results.values()]
        against.plot(*(100 * np.array(pairs)).T, ".", color=color)
    against.plot([0.2, 45], [0.2, 45], color="0.4", linewidth=0.8)
    against.set(
        xscale="log", yscale="log", xlim=(0.2, 45), ylim=(0.2, 45), aspect="equal",
        xlabel="predicted standard deviation / % of the range",
        ylabel="RMS error / % of the range", title="all panels: prediction against outcome",
    )  # fmt: skip
    against.set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])
    against.set_yticks(TICKS, [f"{tick:g}" for tick in TICKS])
    against.grid(alpha=0.3)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    figure.savefig(path, dpi=110)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--output", type=Path, default=Path("out/worth"))
    parser.add_argument("--seconds", type=float, default=math.inf, help="stop after; run again")
    parser.add_argument("--report", action="store_true", help="only show what is there")
    parser.add_argument("--docs", type=Path, help="folder whose criteria.md gets the result")
    arguments = parser.parse_args()
    begun, output = time.monotonic(), arguments.output
    output.mkdir(parents=True, exist_ok=True)
    designs, results = designed(output), {}
    same = driven_as(designs)
    if arguments.report:
        for scenario in SCENARIOS:
            for name in STRATEGIES:
                _, errors, prediction = kept(output, same[name], scenario)
                if prediction is not None:
                    results[name, scenario.name] = errors[: arguments.draws], prediction
    else:
        with ProcessPoolExecutor() as pool:
            for scenario in SCENARIOS:
                for name in STRATEGIES:
                    if time.monotonic() - begun > arguments.seconds:
                        raise SystemExit(
                            f"{len(results)} cells have {arguments.draws} draws; run again to go on"
                        )
                    drives = same[name]
                    results[name, scenario.name] = cell(
                        output, drives, designs[drives], scenario, arguments.draws, pool
                    )
    summary = [table(results, same)]
    for parameter in TARGETS:
        at = UNKNOWN.index(parameter)
        ratio = [rms(errors)[0][at] / prediction[at] for errors, prediction in results.values()]
        summary.append(
            f"{parameter}: RMS error / predicted deviation: median {np.median(ratio):.2f}, "
            f"5 to 95 % of the cells {np.quantile(ratio, 0.05):.2f} to "
            f"{np.quantile(ratio, 0.95):.2f}"
        )
    least, most = (f(len(errors) for errors, _ in results.values()) for f in (min, max))
    summary.append(
        f"{least} to {most} draws per cell" if least < most else f"{most} draws per cell"
    )
    text = "\n".join(summary)
    print(text)
    plot(results, output / "worth.png")
    if arguments.docs is not None:
        page = arguments.docs / "criteria.md"
        before, _, rest = page.read_text().partition(BEGIN)
        page.write_text(before + BEGIN + "\n" + text + "\n" + END + rest.partition(END)[2])
        plot(results, arguments.docs / "criteria.png")


if __name__ == "__main__":
    main()
