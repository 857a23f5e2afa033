"""What errs alike in all drives is in the intervals when the drives can be redrawn."""

import dataclasses

import numpy as np
import pytest
from simulated_drives import HIGH, LOW, NAMES, TRUTH, VEHICLE, commands_of_pair, driven

from excitation_planner.design.prior import BoxPrior
from parameter_identification.drives.measured import MeasuredDrive
from parameter_identification.estimation.bootstrap import bootstrap_deviations
from parameter_identification.estimation.levenberg_marquardt import Fit
from parameter_identification.estimation.model import DriveModel
from parameter_identification.estimation.optimum import Optimum
from parameter_identification.estimation.problem import LeastSquares, Loss
from parameter_identification.estimation.results import Identification
from parameter_identification.identification import identify

PRIOR = BoxPrior.uniform(len(NAMES))
TOLD = 0.995  # of the steering that was commanded, here


def measured(truth: np.ndarray, seed: int) -> list[MeasuredDrive]:
    found = []
    for name, commands in commands_of_pair().items():
        drive = driven(commands, truth=truth, seed=seed, name=name)
        angle = TOLD * commands.steering_motor_angle
        told = dataclasses.replace(commands, steering_motor_angle=angle)
        found.append(dataclasses.replace(drive, commands=told))
    return found


@pytest.mark.slow
def test_an_error_of_all_drives_is_in_the_intervals_when_they_can_be_redrawn() -> None:
    drives = measured(TRUTH, 0)

    def redraw(parameters, noise, rng):
        truth = np.array([parameters[name] for name in NAMES])
        return measured(truth, int(rng.integers(1 << 30)))

    def off(found: Identification) -> np.ndarray:
        return np.abs(found.estimates - TRUTH) / found.standard_deviations

    steps: list[tuple[int, int]] = []
    plain = identify(drives, VEHICLE)
    counted = identify(
        drives, VEHICLE, redraw=redraw, profiles=True, progress=lambda *step: steps.append(step)
    )
    shown = [i for i, name in enumerate(NAMES) if plain.identifiable[name]]
    assert off(plain)[shown].max() > 4.0
    assert off(counted).max() < 2.0
    assert np.array_equal(plain.estimates, counted.estimates)
    assert (counted.standard_deviations >= plain.standard_deviations * (1 - 1e-9)).all()
    assert all(LOW[i] <= counted.parameters[name].low for i, name in enumerate(NAMES))
    assert all(counted.parameters[name].high <= HIGH[i] for i, name in enumerate(NAMES))
    assert steps[-1][0] == steps[-1][1]


def test_what_is_redrawn_of_a_fit_at_the_ends_of_ranges_is_in_them() -> None:
    """Round-off of 0.0015 + 0.012 * 1 is beyond 0.0135, which no vehicle takes."""
    redrawn = []

    def redraw(parameters, noise, rng):
        redrawn.append(VEHICLE.replace(**parameters))
        raise InterruptedError

    model = DriveModel(VEHICLE, measured(TRUTH, 0)[0])
    with LeastSquares([model], PRIOR.mean, PRIOR.information, Loss.SQUARED) as problem:
        at_the_ends = Optimum(Fit(np.ones(problem.n), 0.0), np.eye(problem.n), (), (1, 1))
        with pytest.raises(InterruptedError):
            bootstrap_deviations(
                *(problem, at_the_ends, redraw),
                loss=Loss.SQUARED,
                level=0.95,
                seed=0,
                count=lambda: None,
            )
    assert [redrawn[0].nominal[name] for name in NAMES] == HIGH.tolist()
