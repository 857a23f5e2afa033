"""The cost of one drive as a function of the common variables, its own variables eliminated.

Every drive has start pose, clocks and bias of its own, and shares parameters and effects with the
others: the information matrix has the shape of an arrow. Drives can therefore be fitted one by one:
a drive's own variables are eliminated (Schur complement), and the small matrices that are left are
summed.

Letters of shapes: `c` common variables, parameters in their ranges and then the effects of all
drives in standard deviations of their priors; `q` variables of the drive alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from excitation_planner.design.prior import BoxPrior
from parameter_identification.drives.measured import Input, MeasuredDrive, Sensor
from parameter_identification.estimation.inputs import Inputs, measured_inputs
from parameter_identification.estimation.model import DriveModel
from parameter_identification.estimation.noise import NoiseLevel
from parameter_identification.estimation.optimum import find_optimum
from parameter_identification.estimation.problem import LeastSquares, Loss
from parameter_identification.estimation.validation import whiteness_of_residuals
from parameter_identification.estimation.whiteness import coloured
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray
from tricycle_sim.effects import Effect
from tricycle_sim.vehicle import Vehicle


@dataclass(frozen=True, eq=False)
class FitSetting:
    """Model and noise by which the drives of a vehicle are fitted.

    Attributes
    ----------
    vehicle : Vehicle
        Known constants, and the unknown parameters with their ranges.
    effects : tuple of Effect
        Estimated beside the parameters.
    noise : mapping of Sensor to NoiseLevel
        Noise of every sensor that a drive has.
    sizes : mapping of str to float
        Size of each deviation among the effects, by name, in standard deviations of its prior.
    measured : frozenset of Input
        Inputs that move as measured in all drives.
    """

    vehicle: Vehicle
    effects: tuple[Effect, ...]
    noise: Mapping[Sensor, NoiseLevel]
    sizes: Mapping[str, float]
    measured: frozenset[Input] = frozenset()

    @property
    def shared(self) -> tuple[Effect, ...]:
        """Effects that all drives have in common, in the order of the common variables."""
        return tuple(e for e in self.effects if not e.per_drive)


@dataclass(frozen=True, eq=False)
class DriveShare:
    """The cost of one drive near a point of the common variables, its own variables eliminated.

    Attributes
    ----------
    name : str
        Name of the drive.
    began : float
        Time at which it began [s since 1970]; NaN: not known.
    samples : int
        Numbers measured.
    at : ndarray of float, shape (c,)
        The point.
    cost : float
        Squared residuals over their variances.
    information : ndarray of float, shape (c, c)
        Half the second derivatives of the cost by the common variables, without their priors.
    gradient : ndarray of float, shape (c,)
        Half the slope of the cost.
    own : ndarray of float, shape (q,)
        The drive's own variables.
    white : bool
        Whether the residuals are.
    truth : mapping of str to float
        True parameters, where the drive was simulated.
    complete : bool
        Whether its bag is.
    vehicle_hash : str
        Fingerprint of the vehicle file that it was driven with; empty: not recorded.
    steering_late : float
        By how much the steering of its commands may be late against the signals [s].
    converged : bool
        Whether `own` is a minimum.
    unheard : tuple of Sensor
        As in `MeasuredDrive`.
    """

    name: str
    began: float
    samples: int
    at: FloatArray
    cost: float
    information: FloatArray
    gradient: FloatArray
    own: FloatArray
    white: bool
    truth: Mapping[str, float]
    complete: bool = True
    vehicle_hash: str = ""
    steering_late: float = 0.0
    converged: bool = True
    unheard: tuple[Sensor, ...] = ()


def first_fit(
    drives: Sequence[MeasuredDrive],
    vehicle: Vehicle,
    effects: Sequence[Effect],
    prior: BoxPrior,
    seed: int,
    *,
    changing: bool = False,
) -> tuple[FitSetting, FloatArray]:
    """Return noise and common variables (c,) of the best fit of a few drives together.

    Parameters
    ----------
    drives : sequence of MeasuredDrive
        Drives to fit; they have every sensor that other drives of the vehicle have.
    vehicle : Vehicle
        Known constants and ranges.
    effects : sequence of Effect
        Estimated beside the parameters.
    prior : BoxPrior
        Prior of the parameters, in their ranges.
    seed : int
        Seed of the starts.
    changing : bool
        Whether parameters may differ between the drives.
    """
    near, known = None, (prior.mean, prior.information)
    with threadpool_limits(1, user_api="blas"):
        measured = measured_inputs(drives, vehicle, Inputs.EITHER, changing=changing)
        if effects:  # without them a search takes a tenth of the time
            models = [DriveModel(vehicle, drive, measured=measured) for drive in drives]
            with LeastSquares(models, *known, Loss.SQUARED) as without:
                first = find_optimum(without, starts=4, seed=seed, level=0.95)
            near = [first.fit.at[: without.k], *first.rivals]
        models = [DriveModel(vehicle, drive, effects, measured=measured) for drive in drives]
        with LeastSquares(models, *known, Loss.SQUARED) as problem:
            best = find_optimum(problem, starts=4, seed=seed, level=0.95, near=near)
            common = problem.k + models[0].shared
            noise, sizes = dict(problem.noise), problem.sizes.by_name()
    return FitSetting(vehicle, tuple(effects), noise, sizes, measured), best.fit.at[:common]


def missing_inputs(setting: FitSetting, drive: MeasuredDrive) -> str:
    """Return which inputs a drive lacks, as a message; empty if none.

    Parameters
    ----------
    setting : FitSetting
        Model and noise by which the vehicle's drives are fitted.
    drive : MeasuredDrive
        The drive.
    """
    if not (missing := setting.measured - drive.measured_throughout):
        return ""
    names = ", the ".join(sorted(one.value for one in missing))
    return (
        f"does not tell throughout the {names}, which moves otherwise than servo and speed loop of "
        "the vehicle file make it move"
    )


def share_of(
    setting: FitSetting, drive: MeasuredDrive, common: FloatArray, own: FloatArray | None = None
) -> DriveShare:
    """Return the share of a drive at a point, its own variables fitted and eliminated.

    Parameters
    ----------
    setting : FitSetting
        Model and noise by which the vehicle's drives are fitted.
    drive : MeasuredDrive
        The drive.
    common : ndarray of float, shape (c,)
        The point.
    own : ndarray of float, shape (q,), optional
        Own variables at which their search begins. Default: the means of their priors.
    """
    if reason := missing_inputs(setting, drive):
        raise IdentificationError(f"{drive.name}: {reason}")
    model = DriveModel(setting.vehicle, drive, setting.effects, measured=setting.measured)
    k, c = len(model.low), len(common)
    with LeastSquares([model], common[:k], np.zeros((k, k)), Loss.SQUARED) as problem:
        at = np.append(common, np.zeros(problem.n - c) if own is None else own)
        problem.set_weights(setting.noise, setting.sizes, at)
        free: NDArray[np.bool_] = np.arange(problem.n) >= c
        fit = problem.minimise(at, free)
        at, quadratic = fit.at, problem.quadratic(fit.at)
        white = not coloured(whiteness_of_residuals(problem, problem.predictions(at)))
        samples = problem.samples_in_all
    information, gradient = quadratic.information.copy(), quadratic.gradient.copy()
    effects, places = common[k:], np.arange(k, c)
    information[places, places] -= 1.0  # priors of what is common count once, not for every drive
    gradient[places] -= effects
    cost = quadratic.cost - effects @ effects
    across, alone = information[:c, c:], information[c:, c:]
    eliminated = np.linalg.solve(alone, np.column_stack([across.T, gradient[c:]]))
    return DriveShare(
        name=drive.name,
        began=drive.began,
        samples=samples,
        at=common,
        cost=float(cost - gradient[c:] @ eliminated[:, -1]),
        information=information[:c, :c] - across @ eliminated[:, :-1],
        gradient=gradient[:c] - across @ eliminated[:, -1],
        own=at[c:] - eliminated[:, -1],
        white=white,
        truth=drive.truth,
        complete=drive.complete,
        vehicle_hash=drive.vehicle_hash,
        steering_late=drive.steering_late,
        converged=fit.converged,
        unheard=drive.unheard,
    )
