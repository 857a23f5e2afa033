"""What a plan expects to be known after a drive is what the drive then shows."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_drives import TRUTH, VEHICLE

from excitation_planner.design.noise import SIMULATED
from excitation_planner.maneuver import Circle
from excitation_planner.planning import PlanRequest, plan_at
from parameter_identification.drives.measured import Sensor, Signal, StartPose
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from parameter_identification.identification import identify
from tricycle_sim.vehicle.batch import simulate


@pytest.mark.slow
def test_a_forecast_agrees_with_the_drive_of_the_simulations_sensors():
    request = PlanRequest(
        VEHICLE, Circle(duration=12.0), "cornering_stiffness", samples=30, noise=SIMULATED
    )
    plan = plan_at(request, np.array([2.5, 0.9]))
    motion = SensedMotion.of(simulate(VEHICLE, plan.commands, TRUTH[None]))
    noise = {
        Sensor.POSITION: SensorNoise(0.01, rate=100.0),
        Sensor.HEADING: SensorNoise(0.002, rate=100.0),
        Sensor.YAW_RATE: SensorNoise(0.005, rate=100.0),
        Sensor.WHEEL_SPEED: SensorNoise(0.0, rate=100.0),
    }
    drive = measure(
        motion,
        plan.commands,
        noise,
        rng=np.random.default_rng(1),
        standstill=1.0,
        start=StartPose(0.0, 0.0, 0.0, 0.02, 0.0175),
    )
    wheel = drive.signals[Sensor.WHEEL_SPEED]
    step = 0.001 / VEHICLE.tyre_radius  # rad/s: the board tells mm/s
    rounded = Signal(wheel.time, step * np.round(wheel.values / step), jitter=0.005)
    drive = replace(drive, signals={**drive.signals, Sensor.WHEEL_SPEED: rounded})
    found = identify([drive], VEHICLE)
    for name in ("cornering_stiffness", "camber_stiffness", "yaw_inertia", "rolling_coefficient_1"):
        ratio = plan.predicted_std[name] / found.parameters[name].standard_deviation
        assert 0.5 < ratio < 2.0, f"{name}: {ratio:.2f}"
