"""Vehicles that share parameters, against the dense problem of all their drives."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import binom
from simulated_drives import TRUTH, VEHICLE, driven, planned

from excitation_planner.maneuver import Circle
from parameter_identification import vehicle_fit
from parameter_identification.drives.kept import keep, load_kept
from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.simulated import SensorNoise
from parameter_identification.estimation.model import DriveModel
from parameter_identification.estimation.problem import LeastSquares, Loss
from parameter_identification.estimation.shares import FitSetting
from parameter_identification.fleet_fit import DriveEvidence, FleetFit
from parameter_identification.many_drives import begin
from parameter_identification.vehicle_fit import Variables, VehicleCost, VehicleFit, descend
from tricycle_core.errors import IdentificationError

SENSORS = {Sensor.HEADING: SensorNoise(0.002), Sensor.YAW_RATE: SensorNoise(0.005)}
K, SHARED = 6, [1, 3]  # camber stiffness and yaw inertia


@pytest.fixture
def fits(tmp_path):
    rng = np.random.default_rng(0)
    files = []
    for number in range(4):
        truth = TRUTH * (1.0 + 0.05 * rng.standard_normal(K))
        truth[SHARED] = TRUTH[SHARED]
        files.append([])
        for i, circle in enumerate(((2.5, 0.8), (3.5, 0.9))):
            file = tmp_path / f"{number}_{i}.npz"
            seed = 10 * number + i
            commands = planned(Circle(duration=6.0), *circle)
            keep(driven(commands, noise=0.002, seed=seed, truth=truth, others=SENSORS), file)
            files[-1].append(file)
    found = begin(files, VEHICLE, (), None, 0, None)
    descend(found, None)
    return found


@pytest.mark.slow
def test_the_vehicle_that_has_no_minimum_is_named(fits, monkeypatch):
    fits[1].at = fits[1].at + 0.2
    monkeypatch.setattr(vehicle_fit, "PASSES", 1)
    with pytest.raises(IdentificationError, match=r"^b: no minimum after 1 passes"):
        descend(fits, None, "abcd")


def test_a_cost_that_falls_nowhere_is_no_minimum(monkeypatch):
    """Its slope and its values contradict each other."""

    def contradicting(fits, points, *_):
        empty = np.empty((0, 1))
        return [
            VehicleCost(p, 1.0 + abs(p[0]), np.array([5.0]), np.eye(1), empty, ()) for p in points
        ]

    monkeypatch.setattr(vehicle_fit, "evaluate", contradicting)
    wide = Variables(np.array([-9.0]), np.array([9.0]), np.zeros(1), np.eye(1))
    fit = VehicleFit(None, (), wide, np.empty(0), np.zeros(1))
    with pytest.raises(IdentificationError, match=r"^a: no minimum found"):
        descend([fit], None, "a")


class Dense:
    """All drives in one matrix: what is shared, then of each vehicle, then of each drive."""

    def __init__(self, fits):
        self.at, self.problems, last = [], [], len(SHARED) + (K - len(SHARED)) * len(fits)
        self.own = [i for i in range(K) if i not in SHARED]
        for number, fit in enumerate(fits):
            parameters = np.empty(K, dtype=int)
            parameters[SHARED] = np.arange(len(SHARED))
            first = len(SHARED) + len(self.own) * number
            parameters[self.own] = first + np.arange(len(self.own))
            for file in fit.files:
                model = DriveModel(VEHICLE, load_kept(file))
                problem = LeastSquares([model], np.full(K, 0.5), np.zeros((K, K)), Loss.SQUARED)
                problem.noise = dict(fit.setting.noise)
                q = problem.n - K
                self.at.append(np.concatenate([parameters, last + np.arange(q)]))
                self.problems.append(problem)
                last += q
        self.size = last
        self.parameters = len(SHARED) + len(self.own) * len(fits)

    def look(self, v):
        information, gradient = np.zeros((self.size, self.size)), np.zeros(self.size)
        ranges = np.arange(self.parameters)
        information[ranges, ranges] = 12.0
        gradient[ranges] = 12.0 * (v[ranges] - 0.5)
        for at, problem in zip(self.at, self.problems, strict=True):
            problem.weigh(v[at])
            own = problem.quadratic(v[at])
            information[np.ix_(at, at)] += own.information
            gradient[at] += own.gradient
        return information, gradient


@pytest.mark.slow
def test_it_is_the_dense_problem_of_all_drives(fits):
    fleet = FleetFit(fits, SHARED)
    fleet.descend(None)
    found = fleet.posterior(0.95)
    dense = Dense(fits)
    v = np.zeros(dense.size)
    v[: dense.parameters] = 0.5
    v[: len(SHARED)] = found.at[0, SHARED]  # the start; the end must not depend on it
    for number, fit in enumerate(fits):
        first = len(SHARED) + len(dense.own) * number
        v[first : first + len(dense.own)] = fit.at[dense.own]
    for _ in range(8):
        information, gradient = dense.look(v)
        v = v - np.linalg.solve(information, gradient)
        v[: dense.parameters] = np.clip(v[: dense.parameters], 0.0, 1.0)
    covariance = np.linalg.inv(information)
    for number in range(len(fits)):
        places = dense.at[2 * number][:K]
        std = np.sqrt(np.diag(covariance)[places])
        assert found.at[number] == pytest.approx(v[places], abs=0.05 * std.min())
        expected = covariance[np.ix_(places, places)]
        scale = np.outer(std, std)
        assert found.covariance(number) / scale == pytest.approx(expected / scale, abs=0.02)
    alone = [fit.quadratic.information for fit in fits]
    assert found.shared_covariance[0, 0] < min(np.linalg.inv(h)[1, 1] for h in alone)
    for problem in dense.problems:
        problem.close()


def telling(drives, *, deviation=0.01):
    """Vehicles whose drives tell of one shared parameter, and nothing of another one."""
    unknown = {"shown": (0.0, 1.0), "hidden": (0.0, 1.0)}
    setting = FitSetting(SimpleNamespace(unknown=unknown), (), {}, {})
    variables = Variables(np.zeros(2), np.ones(2), np.full(2, 0.5), np.eye(2) * 12.0)
    told = deviation**-2
    at = np.append(np.clip(np.mean(drives), 0.0, 1.0), 0.5)
    fits = []
    for values in drives:
        slopes = np.array([[told * (at[0] - value), 0.0] for value in values])
        prior_gradient = variables.information @ (at - variables.mean)
        information = variables.information + np.diag([told * len(values), 0.0])
        there = VehicleCost(at, 0.0, prior_gradient + slopes.sum(axis=0), information, slopes, ())
        fits.append(VehicleFit([], setting, variables, np.zeros(len(values)), at.copy(), there))
    return FleetFit(fits, [0])


def test_few_vehicles_whose_drives_contradict_each_other_know_little():
    rng = np.random.default_rng(0)
    values = rng.normal(0.5, 0.05, (4, 8))
    found = telling(values).posterior(0.95)
    assert found.shared_covariance[0, 0] ** 0.5 == pytest.approx(0.05 / 32**0.5, rel=0.4)
    alike = telling(rng.normal(0.5, 0.01, (4, 8))).posterior(0.95)
    assert alike.shared_covariance[0, 0] ** 0.5 == pytest.approx(0.01 / 32**0.5, rel=0.4)


def test_what_all_drives_pull_beyond_its_range_is_as_unknown_as_before():
    found = telling(np.full((4, 2), 1.2)).posterior(0.95)
    assert found.beyond.tolist() == [True]
    assert found.shared_covariance[0, 0] == pytest.approx(1.0 / 12.0)
    assert not telling(np.full((4, 2), 0.999)).posterior(0.95).beyond.any()


def test_a_parameter_that_no_drive_shows_has_no_evidence():
    fleet = telling(np.full((4, 3), 0.5))
    fleet.common = []
    found = fleet.posterior(0.95)
    shown, hidden = (found.without_prior([i]) for i in (0, 1))
    assert shown.shown == [True] * 4
    assert shown.covariances == pytest.approx(np.full((4, 1, 1), 0.01**2 / 3))
    assert hidden.shown == [False] * 4
    assert hidden.estimates.shape == (0, 1)


def drawn(rng, count, *, rate, rate_spread):
    """Level and rate of vehicles, and what three drives of each at random times tell of them."""
    true = rng.normal((0.5, rate), (0.04, rate_spread), (count, 2))
    estimates, covariances = np.empty((count, 2)), np.empty((count, 2, 2))
    for i in range(count):
        rows = np.column_stack([np.ones(3), rng.uniform(-1.0, 1.0, 3)]) / rng.uniform(0.01, 0.04)
        covariances[i] = np.linalg.inv(rows.T @ rows + np.diag([0.0, 0.004]))
        estimates[i] = covariances[i] @ rows.T @ (rows @ true[i] + rng.standard_normal(3))
    return true, DriveEvidence(estimates, covariances, np.zeros((count, 2, 0)), [True] * count)


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "rate_spread"), [(0.0, 0.0), (-0.1, 0.03)])
def test_levels_and_rates_are_held_and_rarely_odd(rate, rate_spread):
    rng, fleets, count = np.random.default_rng(1), 40, 20
    names = [str(i) for i in range(count)]
    held, odd = np.zeros(4), 0
    for _ in range(fleets):
        true, alone = drawn(rng, count, rate=rate, rate_spread=rate_spread)
        rates = alone.population(names, 1, (0.0, 1.0), 0.95)
        levels = alone.with_rates(rates, 1.0, 0.95).population(names, 0, (0.0, 1.0), 0.95)
        for i, (found, mean) in enumerate(((levels, 0.5), (rates, rate))):
            held[i] += found.mean.low <= mean <= found.mean.high
            values = zip(found.members, true[:, i], strict=True)
            held[2 + i] += np.mean([m.value.low <= t <= m.value.high for m, t in values])
            odd += any(m.odd for m in found.members)
    assert np.all(held > binom.ppf(0.001, fleets, 0.95)), held / fleets
    assert odd <= binom.ppf(0.999, 2 * fleets, 0.01)


def test_the_rates_of_the_others_tell_the_level_of_a_vehicle_that_drove_late():
    rng = np.random.default_rng(2)
    true, alone = drawn(rng, 12, rate=-0.2, rate_spread=0.001)
    late = np.array([[1.0, 0.9]]) / 0.01  # one drive
    alone.covariances[0] = np.linalg.inv(late.T @ late + np.diag([0.0, 0.004]))
    alone.estimates[0] = alone.covariances[0] @ late.T @ (late @ true[0])
    names = [str(i) for i in range(12)]
    rates = alone.population(names, 1, (0.0, 1.0), 0.95)
    found = alone.with_rates(rates, 1.0, 0.95)
    before, after = alone.covariances[0, 0, 0], found.covariances[0, 0, 0]
    assert after < 0.01 * before
    assert found.estimates[0, 0] == pytest.approx(true[0, 0], abs=0.05)
