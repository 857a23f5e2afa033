"""What a plan expects of its drives, against what identification finds in them.

    python benchmarks/forecast.py [--vehicles 24]

Three pairs of circles are driven by random vehicles, measured as the simulation measures, and
identified without effects. Printed, for each parameter that the plan expects to be shown: the
expected standard deviation, the root mean square of those that identification states, that of the
estimates' deviations from the truth, and both divided by what was expected; at last, what a plan
expects of a position at 20 Hz alone, with the stated one divided by it. The first expectation is
that of `tricycle plan` without options.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
from identification import VEHICLE, draw, rounded

from excitation_planner import Box
from excitation_planner.design.noise import SIMULATED, MeasurementNoise
from excitation_planner.design.prior import SHOWN, UNIFORM_STD
from excitation_planner.maneuver import family_by_name
from excitation_planner.planning.prediction import ReplayedTrajectories, predicted_covariance
from excitation_planner.planning.replay import nominal_run
from parameter_identification.drives.measured import Sensor, StartPose
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from parameter_identification.identification import identify
from tricycle_core.timing import TICK
from tricycle_sim.vehicle.batch import simulate

CIRCLE = family_by_name("circle")
PAIRS = {  # radius, speed
    "tutorial": ((2.418, 0.9931), (4.0, 0.7)),
    "README": ((2.132, 0.961), (3.013, 0.763)),
    "wide": ((3.5, 0.9), (5.0, 0.9)),
}
START = StartPose(0.0, 0.0, 0.0, SIMULATED.start_position_std, SIMULATED.start_heading_std)
SENSORS = {
    Sensor.POSITION: SensorNoise(SIMULATED.noise_std, rate=SIMULATED.pose_rate),
    Sensor.HEADING: SensorNoise(SIMULATED.heading_std, rate=SIMULATED.pose_rate),
    Sensor.YAW_RATE: SensorNoise(SIMULATED.yaw_rate_std, rate=SIMULATED.gyro_rate),
    Sensor.WHEEL_SPEED: SensorNoise(0.0, rate=100.0),
}


def expected(points, noise):
    """Standard deviations (k,), in ranges."""
    covariance = predicted_covariance(
        tuple(ReplayedTrajectories(VEHICLE, CIRCLE, noise.channels) for _ in points),
        tuple(np.array(x) for x in points),
        Box.of(dict(VEHICLE.unknown)),
        noise.of_trajectory,
        seed=2,
    )
    return np.sqrt(np.diag(covariance))


def as_recorded(drive):
    """The drive with its wheel speed as a bag has it: rounded, its stamps off by a tick or so."""
    drive = rounded(drive)
    wheel = replace(drive.signals[Sensor.WHEEL_SPEED], jitter=0.5 * TICK)
    return replace(drive, signals={**drive.signals, Sensor.WHEEL_SPEED: wheel})


def found(job):
    """Stated standard deviations and deviations (2, k) of one vehicle, in ranges."""
    points, seed = job
    truth, rng = draw(seed), np.random.default_rng([seed, 4])
    drives = []
    for number, x in enumerate(points):
        commands = nominal_run(VEHICLE, CIRCLE, np.array(x)).commands
        motion = SensedMotion.of(simulate(VEHICLE, commands, truth[None], threads=1))
        drive = measure(
            motion, commands, SENSORS, rng=rng, name=str(number), standstill=1.0, start=START
        )
        drives.append(as_recorded(drive))
    estimates = identify(drives, VEHICLE).parameters.values()
    width = np.array([e.range[1] - e.range[0] for e in estimates])
    return np.array(
        [
            [e.standard_deviation for e in estimates] / width,
            ([e.estimate for e in estimates] - truth) / width,
        ]
    )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--vehicles", type=int, default=24, help="of each pair (default: 24)")
    vehicles = parser.parse_args().vehicles
    with ProcessPoolExecutor() as pool:
        for name, points in PAIRS.items():
            forecast, alone = expected(points, SIMULATED), expected(points, MeasurementNoise())
            all_found = np.array(list(pool.map(found, [(points, s) for s in range(vehicles)])))
            stated, missed = np.sqrt((all_found**2).mean(axis=0))
            print(f"{name}: circles {points}, {vehicles} vehicles, 1σ in % of the range")
            for i, parameter in enumerate(VEHICLE.unknown):
                if forecast[i] > SHOWN * UNIFORM_STD:
                    continue
                print(
                    f"  {parameter:22} expected {100 * forecast[i]:5.2f}"
                    f"  stated {100 * stated[i]:5.2f} ({stated[i] / forecast[i]:4.2f})"
                    f"  missed by {100 * missed[i]:5.2f} ({missed[i] / forecast[i]:4.2f})"
                    f"  position alone {100 * alone[i]:5.2f} ({stated[i] / alone[i]:4.2f})",
                    flush=True,
                )


if __name__ == "__main__":
    main()
