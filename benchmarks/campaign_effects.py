"""Campaigns whose plans count effects beside the parameters, against those whose plans do not.

    python benchmarks/campaign_effects.py [--campaigns 6] [--drives 3] [--budget 3000]

Each campaign has a vehicle of its own, with random unknown parameters and random effects that the
file does not know (steering zero and gain, wheel radius, loads, slopes, dead times, ...), and every
drive is measured as the simulation measures. It plans for the cornering stiffness, drives,
and identifies with all effects, which is repeated. Printed for both: error of the estimate and its
standard deviation after the last drive, in % of the range, and the processor time of a plan.
"""

import argparse
import os
import tempfile
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from excitation_planner.maneuver import family_by_name
from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from tricycle_cli.campaign.cycle import Campaign
from tricycle_cli.campaign.request import SIMULATED, CampaignRequest
from tricycle_sim.effects import (
    DRIVE_DEAD_TIME,
    EFFECTS,
    SERVO_DEAD_TIME,
    as_sensed,
    effects_of,
    with_effects,
)
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import CommandedBatch

VEHICLE = load_vehicle()
TARGET = "cornering_stiffness"
SENSORS = {
    Sensor.POSITION: SensorNoise(SIMULATED.noise_std, rate=SIMULATED.pose_rate),
    Sensor.HEADING: SensorNoise(SIMULATED.heading_std, rate=SIMULATED.pose_rate),
    Sensor.YAW_RATE: SensorNoise(SIMULATED.yaw_rate_std, rate=SIMULATED.gyro_rate),
    Sensor.WHEEL_SPEED: SensorNoise(SIMULATED.wheel_speed_std, rate=SIMULATED.wheel_rate),
}
CHANNELS = ("x", "y", "yaw", "yaw_rate", "drive_speed")


class Truth:
    """A vehicle with effects, that drives plans and is measured."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)
        self.effects = [e for e in effects_of(VEHICLE, EFFECTS) if not e.process]
        low, high = np.array(list(VEHICLE.unknown.values())).T
        self.parameters = dict(zip(VEHICLE.unknown, self.rng.uniform(low, high), strict=True))
        self.shared = {e.name: self._drawn(e) for e in self.effects if not e.per_drive}

    def _drawn(self, effect):
        return float(np.clip(effect.std * self.rng.standard_normal(), effect.low, effect.high))

    def driven(self, commands):
        """Measure a drive."""
        values = self.shared | {e.name: self._drawn(e) for e in self.effects if e.per_drive}
        affected = with_effects(VEHICLE, self.effects)
        point = dict(zip(affected.unknown, affected.nominal_point(), strict=True)) | self.parameters
        for e in self.effects:
            for name, change in e.constants.items():
                point[name] += change * values[e.name]
        batch = CommandedBatch(affected, commands)
        run = batch.run(
            np.array([list(point.values())]),
            CHANNELS,
            steering_delay=np.array([max(values[SERVO_DEAD_TIME], 0.0)]),
            drive_delay=max(values[DRIVE_DEAD_TIME], 0.0),
        )
        x, y, yaw, yaw_rate, wheel = (run.columns[name] for name in CHANNELS)
        x, y, yaw, wheel = as_sensed(
            x, y, yaw, wheel, {n: np.array([v]) for n, v in values.items()}
        )
        motion = SensedMotion(batch.time, x[0], y[0], yaw[0], yaw_rate[0], wheel[0])
        return measure(motion, commands, SENSORS, rng=self.rng, standstill=1.0)


@contextmanager
def silent(_):
    yield lambda *_: None


def cpu():
    return sum(os.times()[:4])


def campaigned(seed, plan_effects, arguments):
    """Error and standard deviation of the target [ranges], and the time of a plan [s]."""
    request = CampaignRequest(
        VEHICLE,
        tuple(map(family_by_name, ("circle", "double_lane_change"))),
        (TARGET,),
        0.0001,
        most_drives=arguments.drives,
        budget=arguments.budget,
        seed=seed,
        noise=SIMULATED,
        effects=EFFECTS,
        plan_effects=plan_effects,
    )
    truth, took = Truth(seed), 0.0
    measured = {}
    with tempfile.TemporaryDirectory() as folder:
        campaign = Campaign(Path(folder) / "campaign", request)
        while not campaign.finished:
            began = cpu()
            campaign.plan(silent)
            took += cpu() - began

            def drive(plan, bag, *_):
                measured[bag] = truth.driven(plan.commands)

            campaign.drive(drive, lambda *_: None)
            known = campaign.identify(lambda bag, _: measured[bag])
        driven = [step.maneuver for step in campaign.steps]
    low, high = VEHICLE.unknown[TARGET]
    off = (known[TARGET].estimate - truth.parameters[TARGET]) / (high - low)
    return off, known[TARGET].std / (high - low), took / len(driven), driven


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--campaigns", type=int, default=6)
    parser.add_argument("--drives", type=int, default=3)
    parser.add_argument("--budget", type=int, default=3000)
    arguments = parser.parse_args()
    print("campaign  plans count     error     std   plan takes  drives")
    found = {"parameters": [], "effects too": []}
    for seed in range(arguments.campaigns):
        for (name, rows), effects in zip(found.items(), ((), EFFECTS), strict=True):
            rows.append(campaigned(seed, effects, arguments))
            off, std, took, driven = rows[-1]
            told = ", ".join(driven)
            print(f"{seed:8d}  {name:12s}{off:8.2%}{std:8.2%}{took:9.0f} s   {told}", flush=True)
    for name, rows in found.items():
        off, std, took = np.array([row[:3] for row in rows]).T
        error, known = (np.sqrt(np.mean(v**2)) for v in (off, std))
        ratio = np.sqrt(np.mean((off / std) ** 2))
        print(
            f"{name:12s}: RMS error {error:.2%}, std {known:.2%}, error/std {ratio:.2f}, "
            f"a plan takes {np.mean(took):.0f} s"
        )


if __name__ == "__main__":
    main()
