"""Poses that come out of a filter: found by the gyro, and given to the model."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from parameter_identification.drives.motion import motion_of
from parameter_identification.drives.pose_filter import filter_of, low_passed
from parameter_identification.drives.samples import Samples
from parameter_identification.drives.table import Columns, Recording, SteeringMap, read_recording
from parameter_identification.drives.windows import Windows, select_windows
from parameter_identification.estimation.inputs import effects_of_columns
from parameter_identification.estimation.model import DriveModel
from parameter_identification.estimation.prior import box_prior
from parameter_identification.estimation.problem import LeastSquares, Loss
from tricycle_cli.main import main
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.effects import effects_of
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import simulate

VEHICLE = load_vehicle()
TRUTH = {"cornering_stiffness": 700.0, "camber_stiffness": 45.0}
WAVES = (0.3, 0.35), (0.25, 0.9), (0.1, 2.2)  # rad, rad/s
COLUMNS = Columns("t", "x", "y", yaw="yaw", yaw_rate="gyro", steering_angle="angle")


def one_pole(values: np.ndarray, constant: float) -> np.ndarray:
    found, state = np.empty_like(values), values[0]
    for i, value in enumerate(values):
        state += -math.expm1(-TICK / constant) * (value - state) if constant else value - state
        found[i] = state
    return found


def turning(constant: float, *, of_gyro: float = 0.0, end: float = 60.0, size: float = 1.0):
    """Times of poses, their yaw behind a filter and with 1 mrad of noise, and a gyro with 2 mrad/s.

    The gyro has a bias and starts later.
    """
    rng, ticks = np.random.default_rng(5), np.arange(0.0, end, TICK)
    yaw = size * sum(a / w * np.sin(w * ticks) for a, w in ((0.5, 0.35), (0.4, 0.9), (0.3, 2.2)))
    time = np.arange(0.0, end - TICK, 0.02)
    seen = np.interp(time, ticks, one_pole(yaw, constant)) + 0.001 * rng.standard_normal(len(time))
    at = np.arange(0.3, end - TICK, 0.01)
    rate = np.interp(at, ticks, one_pole(np.gradient(yaw, TICK), of_gyro)) + 0.01
    return time, seen, Samples(at, rate + 0.002 * rng.standard_normal(len(at)))


def test_a_ramp_comes_late_by_the_time_constant_from_its_first_tick_on() -> None:
    ramp = 2.0 * TICK * np.arange(50.0) + 1.0
    late = low_passed(np.array([ramp, ramp, -ramp]), np.array([0.15, 0.0, 0.3]))
    np.testing.assert_allclose(late, [ramp - 0.3, ramp, 0.6 - ramp])


def test_a_low_pass_damps_an_oscillation_as_that_of_the_first_order_does() -> None:
    time, rate, constant = TICK * np.arange(1000.0), 5.0, 0.15
    passed = low_passed(np.sin(rate * time)[np.newaxis], np.array([constant]))[0]
    gain = 1.0 / (1.0 + 1j * rate * constant)
    expected = np.imag(gain * np.exp(1j * rate * time))
    np.testing.assert_allclose(passed[300:], expected[300:], atol=1e-3)


@pytest.mark.parametrize("constant", [0.08, 0.15, 0.3])
def test_the_gyro_shows_the_filter_of_the_poses(constant: float) -> None:
    assert filter_of(*turning(constant)) == pytest.approx(constant, rel=0.1)


@pytest.mark.parametrize("lag", [0.0, 0.1, -0.1])
def test_poses_that_are_only_late_or_early_are_not_filtered(lag: float) -> None:
    time, yaw, rate = turning(0.0)
    assert filter_of(time, yaw, Samples(rate.time + lag, rate.values)) == 0.0


def test_a_filter_of_poses_and_gyro_alike_or_of_the_gyro_alone_is_none_of_the_poses() -> None:
    assert filter_of(*turning(0.15, of_gyro=0.15)) == 0.0
    assert filter_of(*turning(0.0, of_gyro=0.15)) == 0.0


def test_too_little_tells_no_filter() -> None:
    assert filter_of(*turning(0.15, end=15.0)) == 0.0
    assert filter_of(*turning(0.15, size=0.0)) == 0.0
    time, yaw, rate = turning(0.15)
    assert filter_of(time, np.zeros_like(yaw), Samples(rate.time, np.zeros_like(rate.values))) == 0


def test_gaps_are_left_out() -> None:
    time, yaw, rate = turning(0.15)
    kept = (time < 20.0) | (time > 27.0)
    assert filter_of(time[kept], yaw[kept], rate) == pytest.approx(0.15, rel=0.1)


def filtered_table(path: Path, constant: float, end: float) -> Recording:
    """A drive whose poses, with 1 mm of noise, come out of a filter."""
    rng, ticks = np.random.default_rng(3), np.arange(0.0, end, TICK)
    angle = sum(size * np.sin(rate * ticks) for size, rate in WAVES) * np.minimum(1.0, ticks / 3.0)
    speed = np.minimum(0.9 + 0.2 * np.sin(0.3 * ticks), ticks)
    true = VEHICLE.replace(**TRUTH)
    motion = simulate(true, Commands(ticks, angle, speed), true.nominal_point()[None])
    time = np.arange(0.0, end - 0.02, 0.02)
    columns = {"t": time}
    for name, values, noise in (
        ("x", one_pole(motion.x[0], constant), 0.001),
        ("y", one_pole(motion.y[0], constant), 0.001),
        ("yaw", one_pole(motion.yaw[0], constant), 0.0002),
        ("gyro", motion.yaw_rate[0], 0.001),
        ("angle", motion.steering_motor_angle[0], 0.002),
    ):
        seen = np.interp(time, motion.time, values)
        columns[name] = seen + noise * rng.standard_normal(len(time))
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, fmt="%.9f", delimiter=",", header=",".join(columns), comments="")
    return read_recording(path, COLUMNS, VEHICLE)


def test_the_true_vehicle_leaves_only_the_noise_of_filtered_poses(tmp_path: Path) -> None:
    recording = filtered_table(tmp_path / "drive.csv", 0.15, 30.0)
    drives = select_windows(recording, VEHICLE, SteeringMap(), Windows()).drives
    effects, prior = effects_of(VEHICLE, effects_of_columns(COLUMNS)), box_prior(VEHICLE, None)
    models = [DriveModel(VEHICLE, drive, effects) for drive in drives]
    truth = {**VEHICLE.nominal, **TRUTH}
    z = (np.array([truth[name] for name in VEHICLE.unknown]) - models[0].low) / models[0].width
    with LeastSquares(models, prior.mean, prior.information, Loss.SQUARED) as problem:
        free = np.arange(problem.n) >= problem.k
        fit = problem.minimise(problem.variables.beginning(z), free)
        predictions = problem.predictions(fit.at)
    left: dict[str, list[np.ndarray]] = {}
    for prediction in (p for own in predictions for p in own):
        left.setdefault(prediction.sensor.value, []).append(prediction.residual)
    for sensor, noise in (("position", 1e-3), ("heading", 2e-4), ("yaw rate", 1e-3)):
        assert np.std(np.concatenate(left[sensor])) == pytest.approx(noise, rel=0.1)


def test_the_speed_is_that_before_the_filter(tmp_path: Path) -> None:
    speeds = [motion_of(filtered_table(tmp_path / f"{c}.csv", c, 30.0)).speed for c in (0.0, 0.15)]
    assert np.std((speeds[1] - speeds[0])[300:-100]) < 0.002


@pytest.mark.slow
def test_identification_from_filtered_poses_holds_the_truth_and_tells_the_filter(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, mapping = tmp_path / "drive.csv", tmp_path / "mapping.yaml"
    filtered_table(table, 0.15, 40.0)
    mapping.write_text("time: t\nx: x\ny: y\nyaw: yaw\nyaw_rate: gyro\nsteering_angle: angle\n")
    assert main(["identify", str(table), "--columns", str(mapping), "--json"]) == 0
    out, told = capsys.readouterr()
    assert "like a low-pass of 0.15 s" in told
    parameters = json.loads(out)["parameters"]
    for name in ("cornering_stiffness", "camber_stiffness", "yaw_inertia"):
        estimate = parameters[name]
        assert estimate["identifiable"]
        assert estimate["low"] <= {**VEHICLE.nominal, **TRUTH}[name] <= estimate["high"]
