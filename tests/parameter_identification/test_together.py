"""Vehicles that share parameters, against the dense problem of all their drives."""

import numpy as np
import pytest
from simulated_drives import TRUTH, VEHICLE, driven, planned

from excitation_planner.maneuver import Circle
from parameter_identification.drives.kept import keep, kept
from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.simulated import SensorNoise
from parameter_identification.estimation.model import DriveModel
from parameter_identification.estimation.problem import LeastSquares, Loss
from parameter_identification.many_drives import begin, descend
from parameter_identification.together import Together

SENSORS = {Sensor.HEADING: SensorNoise(0.002), Sensor.YAW_RATE: SensorNoise(0.005)}
K, SHARED = 6, [1, 3]  # camber stiffness and yaw inertia


@pytest.fixture
def searches(tmp_path):
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


class Dense:
    """All drives in one matrix: what is shared, then of each vehicle, then of each drive."""

    def __init__(self, searches):
        self.at, self.problems, last = [], [], len(SHARED) + (K - len(SHARED)) * len(searches)
        self.own = [i for i in range(K) if i not in SHARED]
        for number, search in enumerate(searches):
            parameters = np.empty(K, dtype=int)
            parameters[SHARED] = np.arange(len(SHARED))
            first = len(SHARED) + len(self.own) * number
            parameters[self.own] = first + np.arange(len(self.own))
            for file in search.files:
                model = DriveModel(VEHICLE, kept(file))
                problem = LeastSquares([model], np.full(K, 0.5), np.zeros((K, K)), Loss.SQUARED)
                problem.noise = dict(search.setting.noise)
                q = problem.n - K
                self.at.append(np.concatenate([parameters, last + np.arange(q)]))
                self.problems.append(problem)
                last += q
        self.size = last
        self.parameters = len(SHARED) + len(self.own) * len(searches)

    def look(self, v):
        information, gradient = np.zeros((self.size, self.size)), np.zeros(self.size)
        ranges = np.arange(self.parameters)
        information[ranges, ranges] = 12.0
        gradient[ranges] = 12.0 * (v[ranges] - 0.5)
        for at, problem in zip(self.at, self.problems, strict=True):
            problem.weigh(v[at])
            gram = problem.gram(v[at])
            information[np.ix_(at, at)] += gram[:-1, :-1]
            gradient[at] += gram[:-1, -1]
        return information, gradient


@pytest.mark.slow
def test_it_is_the_dense_problem_of_all_drives(searches):
    together = Together(searches, SHARED)
    together.descend(None)
    found = together.result()
    dense = Dense(searches)
    v = np.zeros(dense.size)
    v[: dense.parameters] = 0.5
    v[: len(SHARED)] = found.at[0, SHARED]  # the start; the end must not depend on it
    for number, search in enumerate(searches):
        first = len(SHARED) + len(dense.own) * number
        v[first : first + len(dense.own)] = search.at[dense.own]
    for _ in range(8):
        information, gradient = dense.look(v)
        v = v - np.linalg.solve(information, gradient)
        v[: dense.parameters] = np.clip(v[: dense.parameters], 0.0, 1.0)
    covariance = np.linalg.inv(information)
    for number in range(len(searches)):
        places = dense.at[2 * number][:K]
        std = np.sqrt(np.diag(covariance)[places])
        assert found.at[number] == pytest.approx(v[places], abs=0.05 * std.min())
        expected = covariance[np.ix_(places, places)]
        scale = np.outer(std, std)
        assert found.covariance(number) / scale == pytest.approx(expected / scale, abs=0.02)
    alone = [search.sum.information for search in searches]
    assert found.of_common[0, 0] < min(np.linalg.inv(h)[1, 1] for h in alone)
    for problem in dense.problems:
        problem.close()
