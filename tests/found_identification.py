"""A small identification, made by hand."""

import numpy as np

from parameter_identification.drives.measured import Sensor
from parameter_identification.estimation.noise import NoiseLevel
from parameter_identification.estimation.results import (
    Combination,
    DriveFit,
    Estimate,
    HeldOut,
    Identification,
    NuisanceEstimate,
    Profile,
)
from parameter_identification.estimation.whiteness import Whiteness

PROFILE = Profile(np.array([590.0, 600.0, 612.0]), np.array([4.0, 0.0, 4.5]))
FOUND = Identification(
    vehicle="tricycle",
    vehicle_hash="abc",
    parameters={
        "cornering_stiffness": Estimate(
            *("N/rad", 600.0, 5.0, 590.0, 611.0, (591.0, 610.0), (500.0, 1500.0), True, PROFILE)
        ),
        "yaw_inertia": Estimate("kg m^2", 50.0, 7.0, 40.0, 60.0, (40.0, 60.0), (25.0, 75.0), False),
    },
    covariance=np.array([[25.0, 1.0], [1.0, 49.0]]),
    fixed={"camber_stiffness": 50.0},
    hidden=(Combination({"yaw_inertia": 1.0}, 0.9),),
    noise={Sensor.YAW_RATE: NoiseLevel(0.005, 0.001, 2.0)},
    whiteness=(
        Whiteness("first", "x", 0.01, 0.1, 90.0, 100, 0.5),
        Whiteness("first", "wheel speed", 0.001, np.nan, np.nan, 100, np.nan),
    ),
    drives=(DriveFit("first", {"gyro bias": NuisanceEstimate(0.1, 0.01, "rad/s")}, {}, {}, {}),),
    held_out=(HeldOut("second", 0.2, 0.02, 0.014, 0.021, 0.97),),
    outliers=3,
    rivals=(np.array([700.0, 55.0]),),
    starts=(4, 3),
    truth={"cornering_stiffness": 601.0},
    level=0.95,
    seed=1,
    seconds=2.5,
)
