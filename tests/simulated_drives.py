"""Drives of the packaged tricycle with known parameters, measured in simulation."""

from functools import cache

import numpy as np

from excitation_planner.maneuver import Circle, DoubleLaneChange
from excitation_planner.planning.replay import nominal_run
from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate

VEHICLE = load_vehicle()
LOW, HIGH = np.array(list(VEHICLE.unknown.values())).T
TRUTH = LOW + (HIGH - LOW) * np.array([0.3, 0.7, 0.5, 0.4, 0.6, 0.5])
NAMES = tuple(VEHICLE.unknown)


def planned(family, *x, vehicle=VEHICLE):
    """Commands of a maneuver."""
    return nominal_run(vehicle, family, np.array(x)).commands


@cache
def commands_of_pair():
    return {
        "circle": planned(Circle(duration=12.0), 2.5, 0.9),
        "lane": planned(DoubleLaneChange(), 2.0, 2.0),
    }


def driven(commands, *, noise=0.01, seed=0, truth=TRUTH, vehicle=VEHICLE, others=(), **options):
    """A drive with the true parameters, its position measured with so many m of noise."""
    motion = SensedMotion.of(simulate(vehicle, commands, truth[None]))
    sensors = {Sensor.POSITION: SensorNoise(noise), **dict(others)}
    return measure(motion, commands, sensors, rng=np.random.default_rng(seed), **options)


def driven_pair():
    return [driven(c, seed=i, name=name) for i, (name, c) in enumerate(commands_of_pair().items())]


def shares(values):
    """Parameters in their ranges."""
    return (values - LOW) / (HIGH - LOW)
